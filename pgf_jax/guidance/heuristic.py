"""The `heuristic` operator (D5): a person's look at the shelf, in geometry; no rollouts.

It weighs every push of an object by a hand's breadth or two: short pushes of what stands at the
front, into the shelf, are the ones that work, if the hand fits behind the object and the goal is
not hit; then the next reach counts: how far the hand must turn, what stands in its corridor,
whether it fits beside the walls. Objects that stop the best trajectory so far (in the hand at its
end, pressed by hand or goal, jammed against a wall) count double. The cheapest push wins; after
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
    """How much each thing speaks against a push, in log-odds that the next reach succeeds.

    A logistic fit, with an intercept for each scene, to 832 pushes tried by rollouts (push,
    retreat, 5 reach iterations) in 52 sampled scenes (seeds 1000 to 1109) that planning alone had
    not solved after 3 iterations; `experiments/help_helps.py` is judged on other seeds.
    """

    forward: float = -1.7  # cosine between push and pointing direction: into the shelf is good
    sideways: float = -1.1  # 1 - its absolute value: so is sideways, beside pulling back
    depth: float = 6.5  # per m, x of the pushed object: those behind are hard to get at
    length: float = 7.3  # per m pushed
    near_goal: float = 3.2  # per m between object and goal, up to 0.25
    hits_goal: float = 0.7  # the object runs into the goal
    hand_at_goal: float = -0.8  # the hand's tip comes by the goal and loosens what is around it
    beside: float = -0.15  # per object that the hand shifts where it gets behind the pushed one
    room: float = -4.2  # per m from where the hand retracts to, to the goal
    angle: float = 2.5  # per rad of the next reach's turn
    blocker: float = 0.1  # per object in the next reach's corridor, twice for a culprit
    in_hand: float = 0.2  # per object in front of the hand where the push ends
    push_wall: float = 21.0  # per m that the hand would be in a wall while pushing
    reach_wall: float = 71.0  # per m that it would be in a wall at the goal


# Goals with less room to a side wall (m) are where a push does no better than going on does
# (`experiments/push_outcomes.py`); so many requests are declined there.
WALL_ROOM, WALL_PATIENCE = 0.10, 3
CORRIDOR = 0.065  # m, half-width (D2)
HALF_CLOSED, AHEAD = 0.055, 0.067  # the closed hand: half its breadth, its reach ahead of `ee`, m
DISTANCES = (0.06, 0.10, 0.15, 0.20)  # m
DIRECTIONS = 16
FRONT_MOST = 0.28  # m, x of targets: an object that the retreat drags off the front costs (c_e)
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
        """The best push, or None where none is possible, or worth it now.

        Every second time it lets the robot try for itself: a push costs as many iterations as it
        takes to see whether the last one has helped. A goal close to a side wall is hard with a
        push as well, and going on solves as many of these: there the first requests are declined.
        """
        room = SIDE_WALL_Y - abs(view.objects[view.goal, 1])
        declined = WALL_PATIENCE if room < WALL_ROOM else 0
        if view.request < declined or (view.request - declined) % 2:
            return None
        return self.best_push(view)

    def best_push(self, view: View) -> Push | None:
        """The best push that has not failed yet; None where no push is possible."""
        pushed, targets = candidates(view)
        if not len(pushed):
            return None
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
        x, y = targets[chosen[-1]]
        return Push(int(pushed[chosen[-1]]), float(x), float(y))

    def _cost(self, view: View, pushed: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """[P] cost of each candidate."""
        w, objects = self.weights, view.objects
        n = len(objects)
        yaw = view.hand[2] + hand.POINTING_YAW
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        start = objects[pushed]  # [P, 2]
        along = targets - start
        length = np.linalg.norm(along, axis=1)
        along = along / length[:, None]
        forward = along @ ahead
        behind, stop = start - PUSH_BEHIND * along, targets - PUSH_SHORT * along

        # The push itself.
        others = np.arange(n)[None] != pushed[:, None]  # [P, N]
        to_goal = np.linalg.norm(objects[view.goal] - start, axis=1)
        hits_goal = _segment_distance(objects, start, targets)[:, view.goal] < 2 * RADIUS
        tip = AHEAD * ahead
        hand_at_goal = _segment_distance(objects, behind + tip, stop + tip)[:, view.goal] < 0.085
        beside = _segment_distance(objects, behind - 0.1 * ahead, behind + tip) < HALF_CLOSED
        # An object in front of the hand at the end is a blocking cost.
        to = objects[None] - stop[:, None]
        bearing = _wrap(np.arctan2(to[..., 1], to[..., 0]) - yaw)
        in_front = (np.hypot(np.linalg.norm(to, axis=-1), 0.09 * bearing) < 0.085) & others
        yaws = np.full(len(pushed), view.hand[2])
        push_wall = _into_walls(behind, yaws, _CLOSED) + _into_walls(stop, yaws, _CLOSED)

        # Then the hand retracts, and reaches for the goal along a new corridor.
        after = np.broadcast_to(objects, (len(pushed), n, 2)).copy()
        after[np.arange(len(pushed)), pushed] = targets
        return (
            w.forward * forward
            + w.sideways * (1 - np.abs(forward))
            + w.depth * start[:, 0]
            + w.length * length
            + w.near_goal * np.minimum(to_goal, 0.25)
            + w.hits_goal * hits_goal
            + w.hand_at_goal * hand_at_goal
            + w.beside * (beside & others).sum(1)
            + w.in_hand * in_front.sum(1)
            + w.push_wall * push_wall
            + self._reach_cost(view, stop - RETREAT_M * ahead, yaw, after)
        )

    def _reach_cost(
        self, view: View, ee: np.ndarray, yaw: float, objects: np.ndarray
    ) -> np.ndarray:
        """[P] what speaks against a reach from `ee` ([P, 2]) among objects [P, N, 2]."""
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
        blockers = np.clip((CORRIDOR + RADIUS - aside) / CORRIDOR, 0, 1) * inside
        blockers[:, view.goal] = 0
        blockers = blockers * (1 + _culprits(view))
        # The reach nominal turns by half the goal's angle as seen from the base (D4).
        c, s = np.cos(view.hand[2]), np.sin(view.hand[2])
        seen = goal - ee + np.array([[c, -s], [s, c]]) @ hand.EE_POINT
        turn = 0.5 * _wrap(np.arctan2(seen[:, 1], seen[:, 0]) - yaw)
        wall = _into_walls(goal - REACH_SHORT * line, view.hand[2] + turn, _OPEN)
        return (
            w.room * length
            + w.angle * np.abs(turn)
            + w.blocker * blockers.sum(1)
            + w.reach_wall * wall
        )


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


def candidates(view: View) -> tuple[np.ndarray, np.ndarray]:
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
