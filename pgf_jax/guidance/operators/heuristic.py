"""Operator `heuristic`: weighs pushes by geometry, then simulates the best ones without noise.

First it weighs every push of an object over 0.06 to 0.20 m by geometry. Short pushes of objects at
the front, into the shelf, work best, if the hand fits behind the object and the goal is not hit.
Then the next reach counts: how far the hand must turn, which objects stand in its corridor, and
whether it fits beside the walls. Objects that stop the best trajectory so far (in the hand at its
end, pressed by hand or goal, jammed against a wall) count double.

Then it simulates each of the best pushes once, without noise: the straight push, the retreat and
the straight reach after it. Where none of these reaches would grasp, a second push is imagined
after the best of the first ones. It gives the push whose reach ends best, if that end is better
than what the robot has; else it says "go on reaching". So might a person look at the shelf and
imagine.
"""

import dataclasses

import numpy as np

from pgf_jax.batching.requests import Coroutine, KeyPaths, Memoised, robot_key_path
from pgf_jax.guidance.geometry import (
    CLOSED,
    OPEN,
    culprits,
    into_walls,
    segment_distance,
    wrap,
)
from pgf_jax.guidance.trials import simulate_input
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.physics import hand
from pgf_jax.planning.nominal import PUSH_BEHIND, PUSH_SHORT, REACH_SHORT
from pgf_jax.planning.planner import RETREAT_M, BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push
from pgf_jax.scene.shelf import RADIUS
from pgf_jax.scene.statistics import CORRIDOR_HALF_WIDTH


@dataclasses.dataclass(frozen=True)
class Weights:
    """Weights of a push's cost; the cost lowers the log-odds that the next reach succeeds.

    A logistic fit, with an intercept for each scene, to 832 pushes tried by rollouts (push,
    retreat, 5 reach iterations) in 52 sampled scenes (seeds 1000 to 1109) that planning alone had
    not solved after 3 iterations; `experiments/help_helps.py` is judged on other seeds.
    """

    forward: float = -1.7  # cosine between push and pointing direction: into the shelf is good
    sideways: float = -1.1  # 1 - its absolute value: so is sideways, beside pulling back
    depth: float = 6.5  # per m, x of the pushed object: objects behind are hard to get at
    length: float = 7.3  # per m pushed
    near_goal: float = 3.2  # per m between object and goal, up to 0.25
    hits_goal: float = 0.7  # the object runs into the goal
    hand_at_goal: float = -0.8  # the hand's tip passes the goal and loosens what is around it
    beside: float = -0.15  # per object that the hand shifts where it gets behind the pushed one
    room: float = -4.2  # per m from the retracted hand to the goal
    angle: float = 2.5  # per rad of the next reach's turn
    blocker: float = 0.1  # per object in the next reach's corridor, twice for a culprit
    in_hand: float = 0.2  # per object in front of the hand where the push ends
    push_wall: float = 21.0  # per m that the hand would be in a wall while pushing
    reach_wall: float = 71.0  # per m that it would be in a wall at the goal


SIMULATED = 32  # pushes that are simulated, the best by geometry
# Of these, so many are imagined with a second push, and so many second pushes after each.
FIRST, SECOND = 6, 6
# After this many requests of a task the operator gives a push at every second request, even if
# going on looks better; at the requests between it sees whether the last push has helped.
PATIENCE = 3
HALF_CLOSED, AHEAD = 0.055, 0.067  # the closed hand: half its breadth, its reach ahead of `ee`, m
DISTANCES = (0.06, 0.10, 0.15, 0.20)  # m
DIRECTIONS = 16
FRONT_MOST = 0.28  # m, x of targets: an object that the retreat drags off the front costs (c_e)
# m from the walls to the targets of standard objects: a little more than their radius.
FROM_WALLS = 1.6 * RADIUS


class HeuristicOperator:
    """Operator that chooses among pushes of every object in 16 directions over 4 distances."""

    name = "heuristic"

    def __init__(self, weights: Weights | None = None) -> None:
        self.weights = weights or Weights()

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        """See `RolloutOperator.deliberate`."""
        # None, going on, comes first: of equals the first is taken.
        inputs: list[Push | None] = [None, *self.ranked(view, SIMULATED)]
        imagine = _Imagination(view, planner, robot_key_path(*decision_key))
        trials = yield [imagine.trial(search, one) for one in inputs]
        ends = [
            trial.total if trial.pushed or given is None else np.inf
            for trial, given in zip(trials, inputs, strict=True)
        ]
        best = [int(i) for i in np.argsort(ends, kind="stable") if trials[i].pushed][:FIRST]
        if not any(trials[i].solved for i in (0, *best)):
            after = [
                (i, second)
                for i in best
                for second in self.ranked(View.of(trials[i].reach), SECOND)
            ]
            deeper = yield [
                imagine.trial(trials[i].reach, second, after=inputs[i]) for i, second in after
            ]
            for (i, _), trial in zip(after, deeper, strict=True):
                if trial.pushed:
                    ends[i] = min(ends[i], trial.total)
        must_push = view.request >= PATIENCE and (view.request - PATIENCE) % 2 == 0
        if must_push and np.isfinite(ends[1:]).any():
            ends[0] = np.inf
        return inputs[int(np.argmin(ends))]

    def ranked(self, view: View, count: int) -> list[Push]:
        """Return the `count` best pushes by geometry (or all, if there are fewer), best first.

        No two of them are alike: where one push cannot be planned, a similar one cannot either. So
        each pushes another object than those before it, or the same object to another place.
        """
        pushed, targets = candidates(view)
        chosen: list[int] = []
        for c in np.argsort(self._cost(view, pushed, targets), kind="stable"):
            if len(chosen) == count:
                break
            alike = [
                k
                for k in chosen
                if pushed[k] == pushed[c] and np.linalg.norm(targets[k] - targets[c]) < 0.08
            ]
            if not alike:
                chosen.append(int(c))
        return [Push(int(pushed[c]), *map(float, targets[c])) for c in chosen]

    def _cost(self, view: View, pushed: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """[P] cost of each candidate, by geometry."""
        w, objects, radii, larger = self.weights, view.objects, view.radii, view.larger
        n = len(objects)
        yaw = view.hand[2] + hand.POINTING_YAW
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        start = objects[pushed]  # [P, 2]
        along = targets - start
        length = np.linalg.norm(along, axis=1)
        along = along / length[:, None]
        forward = along @ ahead
        more = larger[pushed, None]
        behind, stop = start - (PUSH_BEHIND + more) * along, targets - (PUSH_SHORT + more) * along

        # The push itself.
        others = np.arange(n)[None] != pushed[:, None]  # [P, N]
        to_goal = np.linalg.norm(objects[view.goal] - start, axis=1)
        touching = radii[pushed] + radii[view.goal]
        hits_goal = segment_distance(objects, start, targets)[:, view.goal] < touching
        tip = AHEAD * ahead
        by_goal = 0.085 + larger[view.goal]
        hand_at_goal = segment_distance(objects, behind + tip, stop + tip)[:, view.goal] < by_goal
        breadth = HALF_CLOSED + larger
        beside = segment_distance(objects, behind - 0.1 * ahead, behind + tip) < breadth
        # An object in front of the hand at the end is a blocking cost.
        to = objects[None] - stop[:, None]
        bearing = wrap(np.arctan2(to[..., 1], to[..., 0]) - yaw)
        away = np.hypot(np.linalg.norm(to, axis=-1), 0.09 * bearing)
        in_front = (away < 0.085 + larger) & others
        yaws = np.full(len(pushed), view.hand[2])
        push_wall = into_walls(view, behind, yaws, CLOSED) + into_walls(view, stop, yaws, CLOSED)

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
        """[P] cost of a reach from `ee` ([P, 2]) among objects [P, N, 2]."""
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
        reaching = CORRIDOR_HALF_WIDTH + view.radii
        blockers = np.clip((reaching - aside) / CORRIDOR_HALF_WIDTH, 0, 1) * inside
        blockers[:, view.goal] = 0
        blockers = blockers * (1 + culprits(view))
        # The reach nominal turns by half the goal's angle as seen from the base (`nominal.reach`).
        c, s = np.cos(view.hand[2]), np.sin(view.hand[2])
        seen = goal - ee + np.array([[c, -s], [s, c]]) @ hand.EE_POINT
        turn = 0.5 * wrap(np.arctan2(seen[:, 1], seen[:, 0]) - yaw)
        short = REACH_SHORT + view.larger[view.goal]
        wall = into_walls(view, goal - short * line, view.hand[2] + turn, OPEN)
        return (
            w.room * length
            + w.angle * np.abs(turn)
            + w.blocker * blockers.sum(1)
            + w.reach_wall * wall
        )


class _Imagination:
    """Simulates inputs without noise, each given to a reach of its own.

    Nominals only: no noise is drawn, so the keys do not matter, and a push from a shelf gives the
    same whenever it is imagined. So it is computed once for a shelf, where that is kept.
    """

    def __init__(self, view: View, planner: BatchPlanner, key_paths: KeyPaths) -> None:
        self._planner, self._key_paths = planner, key_paths
        self._cache = {} if view.imagined is None else view.imagined

    def trial(self, search: Search, given: Push | None, after: Push | None = None) -> Memoised:
        """Request for the `Trial` of an input; `after` is the push that came before it.

        Going on takes a reach under way as it stands, so it is of that reach, not of the shelf.
        """

        def make() -> Coroutine:
            # A push that was not found leads nowhere: the reach is kept, so nothing is rolled out.
            return simulate_input(
                self._planner,
                search,
                given,
                self._key_paths,
                push_limit=0,
                reach_limit=0,
                keep=True,
            )

        return Memoised({} if given is None else self._cache, (after, given), make)


def candidates(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Pushed object [P] and target [P, 2] of every push that the operator considers."""
    n = len(view.objects)
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    steps = np.array([[d * np.cos(a), d * np.sin(a)] for d in DISTANCES for a in angles])
    pushed = np.repeat(np.arange(n), len(steps))
    targets = view.objects[pushed] + np.tile(steps, (n, 1))
    low, high = target_bounds(view, pushed)
    allowed = ((targets > low) & (targets < high)).all(1)
    keep = allowed & (pushed != view.goal)
    return pushed[keep], targets[keep]


def target_bounds(view: View, pushed: int | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (x, y) of targets of an object, or of [P] objects: [2] or [P, 2], m."""
    away = FROM_WALLS + view.larger[pushed]
    side = view.side_y - away
    low = np.stack([np.full_like(side, FRONT_MOST), -side], axis=-1)
    return low, np.stack([view.back_x - away, side], axis=-1)
