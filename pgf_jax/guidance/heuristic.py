"""The `heuristic` operator (D5): a person's look at the shelf, in geometry; no rollouts.

It weighs every push of an object by a hand's breadth or two: how well the hand gets behind the
object, what is in the way of the push, and above all what the next reach would find: which objects
stand in the corridor from where the hand will be to the goal, how far the hand must turn, and
whether it fits beside the walls there. Objects that stop the best trajectory so far (in the hand at
its end, pressed by hand or goal, jammed against a wall) count double. The cheapest push wins; after
pushes that the planner could not do, the next.
"""

import dataclasses

import numpy as np

from pgf_jax.guidance.operators import View
from pgf_jax.physics import hand
from pgf_jax.planning.nominal import PUSH_BEHIND, PUSH_SHORT, REACH_SHORT
from pgf_jax.planning.planner import RETREAT_M
from pgf_jax.planning.types import Push
from pgf_jax.scene.scene import BACK_WALL_X, RADIUS, SIDE_WALL_Y


@dataclasses.dataclass(frozen=True)
class Weights:
    """What the operator minds, in blockers: 1 is an object in the middle of the corridor."""

    corridor: float = 0.065  # half-width, m (D2)
    culprit: float = 1.0  # extra for a blocker that stops the best trajectory so far
    approach: float = 0.35  # per object brushed on the way behind the pushed one
    squeeze: float = 0.5  # per object that the pushed one runs into
    in_hand: float = 3.0  # per object in front of the hand where the push ends: it spoils the push
    wall: float = 60.0  # per metre that the hand would be in a wall where push or reach ends
    distance: float = 1.5  # per metre pushed
    angle: float = 2.0  # per rad between the pointing direction and the goal: bearing costs reach
    freed: float = 1.0  # gain for moving an object that stops the best trajectory so far


DISTANCES = (0.06, 0.10, 0.15, 0.20)  # m
DIRECTIONS = 16
FRONT_MOST = 0.28  # m, x of targets: an object that the retreat drags off the front costs (c_e)
HALF_CLOSED, AHEAD = 0.055, 0.067  # the closed hand's half breadth and its reach ahead of `ee`, m
_FRONT = hand.capsule_segments(0.0).max((1, 2)) > 0.12  # not the base and the wrist
_FRONT_RADII = hand.RADII[_FRONT]
_OPEN = hand.capsule_segments(0.0)[_FRONT]
_CLOSED = hand.capsule_segments(hand.GRIPPER_CLOSED)[_FRONT]


class HeuristicOperator:
    """Chooses among pushes of every object in 16 directions over 4 distances."""

    name = "heuristic"

    def __init__(self, weights: Weights | None = None) -> None:
        self.weights = weights or Weights()

    def decide(self, view: View) -> Push | None:
        """The best push that has not failed yet; None where no push is possible."""
        pushed, targets = _candidates(view)
        if not len(pushed):
            return None
        ee, yaw = _end_effector(view.hand), float(view.hand[2]) + hand.POINTING_YAW
        cost = self._cost(view, pushed, targets)
        order = np.argsort(cost, kind="stable")
        # A push that could not be planned says that its like cannot either: offer another object,
        # or the same one another way.
        chosen: list[int] = []
        for c in order:
            alike = [
                k
                for k in chosen
                if pushed[k] == pushed[c] and np.linalg.norm(targets[k] - targets[c]) < 0.08
            ]
            if not alike:
                chosen.append(int(c))
            if len(chosen) > view.dropped:
                break
        best = chosen[-1]
        present = self._blocked(view, ee[None], yaw, view.objects[None].copy())[0]
        if present <= cost[best] and not _culprits(view).any() and view.request > 0:
            return None
        x, y = targets[best]
        return Push(int(pushed[best]), float(x), float(y))

    def _cost(self, view: View, pushed: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """[P] cost of each candidate, in blockers."""
        w, objects = self.weights, view.objects
        n = len(objects)
        yaw = view.hand[2] + hand.POINTING_YAW
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        ee = _end_effector(view.hand)
        start = objects[pushed]  # [P, 2]
        along = targets - start
        length = np.linalg.norm(along, axis=1)
        along = along / length[:, None]
        behind, stop = start - PUSH_BEHIND * along, targets - PUSH_SHORT * along
        others = np.arange(n)[None] != pushed[:, None]  # [P, N]

        # On the way behind the object: what the closed hand brushes, and whether it fits there.
        tip = AHEAD * ahead
        brushed = _segment_distance(objects, ee + tip, behind + tip) < HALF_CLOSED + RADIUS
        beside = _segment_distance(objects, behind - 0.1 * ahead, behind + tip)
        brushed = (brushed | (beside < HALF_CLOSED)) & others
        # While pushing: what the object, or the hand behind it, runs into.
        squeezed = (_segment_distance(objects, start, targets) < 1.9 * RADIUS) & others
        # At the end of the push an object in front of the hand is a blocking cost.
        to = objects[None] - stop[:, None]
        bearing = _wrap(np.arctan2(to[..., 1], to[..., 0]) - yaw)
        in_front = (np.hypot(np.linalg.norm(to, axis=-1), 0.09 * bearing) < 0.085) & others
        yaws = np.full(len(pushed), view.hand[2])
        push_wall = _into_walls(behind, yaws, _CLOSED) + _into_walls(stop, yaws, _CLOSED)

        # Then the hand retracts, and reaches for the goal along a new corridor.
        after = np.broadcast_to(objects, (len(pushed), n, 2)).copy()
        after[np.arange(len(pushed)), pushed] = targets
        from_ee = stop - RETREAT_M * ahead
        blocked = self._blocked(view, from_ee, yaw, after)
        return (
            blocked
            + w.approach * brushed.sum(1)
            + w.squeeze * squeezed.sum(1)
            + w.in_hand * in_front.sum(1)
            + w.wall * push_wall
            + w.distance * length
            - w.freed * _culprits(view)[pushed]
        )

    def _blocked(self, view: View, ee: np.ndarray, yaw: float, objects: np.ndarray) -> np.ndarray:
        """[P] what a reach from `ee` ([P, 2]) meets among objects [P, N, 2]: blockers and walls."""
        w = self.weights
        goal = objects[:, view.goal]
        to = goal - ee
        length = np.linalg.norm(to, axis=1)
        line = to / length[:, None]
        rel = objects - ee[:, None]
        forward = (rel * line[:, None]).sum(-1)
        aside = np.abs(rel[..., 1] * line[:, None, 0] - rel[..., 0] * line[:, None, 1])
        inside = (forward > 0) & (forward < length[:, None] + 0.02)
        # An object in the middle blocks; one at the corridor's edge is brushed aside.
        each = np.clip((w.corridor + RADIUS - aside) / w.corridor, 0, 1) * inside
        each[:, view.goal] = 0
        each = each * (1 + w.culprit * _culprits(view))
        # The reach nominal turns by half the goal's angle as seen from the base (D4).
        c, s = np.cos(view.hand[2]), np.sin(view.hand[2])
        seen = goal - ee + np.array([[c, -s], [s, c]]) @ hand.EE_POINT
        turn = 0.5 * _wrap(np.arctan2(seen[:, 1], seen[:, 0]) - yaw)
        wall = _into_walls(goal - REACH_SHORT * line, view.hand[2] + turn, _OPEN)
        return each.sum(1) + w.wall * wall + w.angle * np.abs(turn)


def _culprits(view: View) -> np.ndarray:
    """[N] 1 for objects that stop the best trajectory so far, else 0."""
    n = len(view.objects)
    marked = np.zeros(n)
    if not np.isfinite(view.terms).all():
        return marked
    last, pose = view.path[-1], view.hands[-1]
    ee, yaw = _end_effector(pose), pose[2] + hand.POINTING_YAW
    to = last - ee
    bearing = _wrap(np.arctan2(to[:, 1], to[:, 0]) - yaw)
    marked[np.hypot(np.linalg.norm(to, axis=1), 0.09 * bearing) < 0.075] = 1  # sits in the hand
    goal_and_hand = {view.goal, n}
    for force, (a, b) in zip(view.force[-1], view.bodies[-1], strict=True):
        for one, other in ((a, b), (b, a)):
            # What is ahead of the hand stops it, and what is jammed between hand and wall; what
            # merely slides along its side does not.
            stops = other in goal_and_hand and abs(bearing[one % n]) < 1.2 and force > 1
            jammed = other == n + 1 and force > 20
            if one < n and (stops or jammed):
                marked[one] = 1
    marked[view.goal] = 0
    return marked


def _candidates(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Pushed object [P] and target [P, 2] of every push that ends on the shelf."""
    n = len(view.objects)
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    steps = np.array([[d * np.cos(a), d * np.sin(a)] for d in DISTANCES for a in angles])
    pushed = np.repeat(np.arange(n), len(steps))
    targets = view.objects[pushed] + np.tile(steps, (n, 1))
    x, y = targets.T
    room = 1.6 * RADIUS
    deep = (x > FRONT_MOST) & (x < BACK_WALL_X - room)
    keep = deep & (np.abs(y) < SIDE_WALL_Y - room) & (pushed != view.goal)
    return pushed[keep], targets[keep]


def _segment_distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[P, N] distance of points [N, 2] to the segments a-b, each [P, 2] or [2]."""
    a, b = np.broadcast_arrays(a, b)
    a, b = np.atleast_2d(a)[:, None], np.atleast_2d(b)[:, None]
    ab = b - a
    t = ((points[None] - a) * ab).sum(-1) / np.maximum((ab**2).sum(-1), 1e-12)
    return np.linalg.norm(points[None] - a - np.clip(t, 0, 1)[..., None] * ab, axis=-1)


def _into_walls(ee: np.ndarray, yaw: np.ndarray, capsules: np.ndarray) -> np.ndarray:
    """[P] how far a hand at `ee` ([P, 2]), turned by `yaw` ([P]), is in a wall, m.

    `capsules` are [C, 2, 2] axes in the hand's frame of what is ahead of the wrist.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    rel = capsules - hand.EE_POINT
    x = ee[:, 0, None, None] + c[:, None, None] * rel[..., 0] - s[:, None, None] * rel[..., 1]
    y = ee[:, 1, None, None] + s[:, None, None] * rel[..., 0] + c[:, None, None] * rel[..., 1]
    over = np.maximum(np.abs(y) - SIDE_WALL_Y, x - BACK_WALL_X) + _FRONT_RADII[:, None]
    return np.clip(over.max((1, 2)), 0, None)


def _end_effector(pose: np.ndarray) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose[:2] + np.array([[c, -s], [s, c]]) @ hand.EE_POINT


def _wrap(angle: np.ndarray) -> np.ndarray:
    return np.arctan2(np.sin(angle), np.cos(angle))
