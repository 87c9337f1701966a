"""Robots that really plan: planner, operator and predictor behind the fleet's `Work`.

`PlannedRobots` are the robots of one fleet. Each robot is at a node of its task's memoised search
(`search_cache.py`). A piece of work becomes a coroutine, whose requests the scheduler of the
process computes together with those of all other robots.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pgf_jax.batching import places, requests
from pgf_jax.batching.requests import Coroutine, GainPredictor, TimePredictor
from pgf_jax.fleet.robots import (
    CheckResult,
    IterationResult,
    ReachResult,
    Result,
    TimeLeft,
    Work,
    WorkKind,
)
from pgf_jax.guidance.operators.base import ask_operator
from pgf_jax.guidance.predictors.features import state_features
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.scene.sampling import class_of
from pgf_jax.simulation.robot import Robot, Segment
from pgf_jax.simulation.search_cache import Node, SearchCache
from pgf_jax.simulation.true_time import TrueTime
from pgf_jax.tables.run_log import RunLog


class _Asked(NamedTuple):
    """What a robot's work is computed from: its state when the work was requested."""

    node: Node
    inputs: int
    dropped: int


class _Foreseen(NamedTuple):
    """What is predicted of a reach, or known."""

    gain: float = math.nan
    time_left: TimeLeft | None = None


_NOTHING = _Foreseen()
AnyPredictor = GainPredictor | TrueGain | TimePredictor | TrueTime

# The result of work, and what changes in the robot when the work ends in simulated time.
_Ended = tuple[Result, Callable[[], None]]


class PlannedRobots:
    """The robots of one fleet; satisfies `fleet.Robots`.

    Args:
      cache: of searches; shared by the fleets whose tasks, noise and operator are the same.
      robots, tasks: how many robots, and tasks of each.
      predictor: of what robots bid, or are ranked by; None: every gain is nan, and nobody bids one.
      on_task_end: called with (robot index, Robot) when a robot takes its next task, and by
        `finish` for the last ones.
      misses: see `fleet.Robots.misses`.

    Attributes:
      robots: robot index -> its task, the last one once all have ended.
      iterations: that have been requested so far.
    """

    def __init__(
        self,
        cache: SearchCache,
        *,
        robots: int = 1,
        tasks: int = 1,
        predictor: AnyPredictor | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
        misses: bool = False,
    ) -> None:
        self.misses = misses
        self.cache, self.planner_service, self.predictor = cache, cache.planner_service, predictor
        self.robots: dict[int, Robot] = {}
        self.iterations = 0
        self._requested: dict[Work, _Asked] = {}
        self._computed: dict[Work, Callable[[], None]] = {}
        self._discarded: set[Work] = set()  # under way
        self._to_do = {robot: range(tasks) for robot in range(robots)}  # not begun yet
        self._on_task_end = on_task_end
        cache.retain(robots, tasks)

    # -- fleet.Robots -----------------------------------------------------------------------------

    @property
    def verified(self) -> bool:
        """See `fleet.Robots.verified`."""
        return self.cache.worlds is not None

    def begin(self, robot: int, task: int) -> None:
        """See `fleet.Robots.begin`."""
        self._end_task(robot)
        cached = self.cache.task(robot, task)
        self._to_do[robot] = self._to_do[robot][1:]
        scene = cached.scene
        log = RunLog(
            scene=scene.name,
            seed=self.cache.seed,
            scene_class=class_of(scene),
            n_objects=len(scene.objects),
        )
        log.begin_segment("reach")
        self.robots[robot] = Robot(task, scene, cached.root, [], log, worlds=cached.worlds)

    def start_push(self, robot: int, push: Push) -> None:
        """See `fleet.Robots.start_push`."""
        r, planner = self.robots[robot], self.planner_service.planner
        r.log.begin_segment("push")
        reach = r.reach_node = r.node
        r.node = reach.child(
            push,
            lambda: planner.begin_push(reach.search.start, r.scene.goal, push, reach.search.shelf),
        )

    def drop_push(self, robot: int, *, keep: bool = False) -> None:
        """See `fleet.Robots.drop_push`."""
        r, planner = self.robots[robot], self.planner_service.planner
        assert r.reach_node is not None, "no push to drop"
        at, goal = r.reach_node.search, r.scene.goal
        r.dropped += 1
        if keep:
            again = r.node.child("give back", lambda: planner.go_on(at))
        else:
            again = r.node.child("drop", lambda: planner.begin_reach(at.start, goal, at.shelf))
        self._reach(r, again)

    def go_on(self, robot: int) -> None:
        """See `fleet.Robots.go_on`."""
        r = self.robots[robot]
        search = r.search
        r.node = r.node.child("go on", lambda: self.planner_service.planner.go_on(search))

    def request(self, work: Work) -> None:
        """See `fleet.Robots.request`."""
        r = self.robots[work.robot]
        self._requested[work] = _Asked(r.node, r.inputs, r.dropped)

    def end(self, work: Work) -> None:
        """See `fleet.Robots.end`."""
        self._computed.pop(work)()

    def discard(self, work: Work) -> None:
        """See `fleet.Robots.discard`."""
        if self._requested.pop(work, None) is None and self._computed.pop(work, None) is None:
            self._discarded.add(work)

    # -- work -------------------------------------------------------------------------------------

    def coroutine(self, work: Work) -> Coroutine:
        """The coroutine of a piece of work that was requested; returns the work's result."""
        if work.kind is WorkKind.ITERATION:
            self.iterations += 1
        does = {
            WorkKind.ITERATION: self._iterate,
            WorkKind.CHECK: self._check,
            WorkKind.INPUT: self._ask,
            WorkKind.REACH: self._execute_reach,
            WorkKind.RETREAT: self._retreat,
        }
        r, asked = self.robots[work.robot], self._requested.pop(work)

        def compute() -> Coroutine:
            ended: _Ended = yield from does[work.kind](r, asked, work)
            result, end = ended
            if work in self._discarded:
                self._discarded.remove(work)
            else:
                self._computed[work] = end
            return result

        return compute()

    def _iterate(self, r: Robot, asked: _Asked, work: Work) -> Coroutine:
        before = asked.node.search
        (node,) = yield [self.cache.iterated(asked.node, work.robot, work.task, work.iteration)]
        after, to_check = node.search, node.candidates is not None
        # Nothing is bid for a candidate that is to be checked.
        foreseen = _NOTHING
        if not to_check:
            foreseen = yield from self._foresee(r, asked._replace(node=node), work)
        result = self._result(after, foreseen)

        def end() -> None:
            r.node = node
            r.log.add(result.terms, feasible=result.feasible)

        outcome = dataclasses.replace(
            result,
            feasible=result.feasible or to_check,
            non_finite=bool(after.non_finite > before.non_finite),
            saturated=int(after.saturated - before.saturated),
        )
        return outcome, end

    def _check(self, r: Robot, asked: _Asked, work: Work) -> Coroutine:
        planner = self.planner_service.planner
        place = r.checked_at(asked.node)
        assert place is not None, "nothing to check"
        (node,) = yield [self.cache.checked(asked.node, place)]
        passed, more = planner.terminate(node.search), node.candidates is not None
        foreseen = _NOTHING
        if not (passed or more):
            foreseen = yield from self._foresee(r, asked._replace(node=node), work)
        result = self._result(node.search, foreseen)

        def end() -> None:
            r.node = node
            r.log.amend(result.terms, feasible=passed)

        return CheckResult(passed, more, result), end

    def _result(self, after: Search, foreseen: "_Foreseen") -> IterationResult:
        planner = self.planner_service.planner
        c_d, c_f, c_b = (float(x) for x in after.value.terms[:3])
        return IterationResult(
            feasible=planner.terminate(after),
            stuck=planner.is_stuck(after),
            gain=foreseen.gain,
            time_left=foreseen.time_left,
            terms=(c_d, c_f, c_b),
            cost=float(after.value.total),
        )

    def _execute_reach(self, r: Robot, asked: _Asked, work: Work) -> Coroutine:
        planner = self.planner_service.planner
        search, place = asked.node.search, r.acts_at(asked.node)

        def execute() -> Coroutine:
            goal = int(search.task.goal)
            (executed,) = yield [places.segment(planner, place, search, goal=goal, keep=True)]
            return executed

        (executed,) = yield [asked.node.memoised("reach", execute)]

        def end() -> None:
            if not executed.grasped:
                r.node = asked.node.child("missed", lambda: search, executed.state)

        return ReachResult(executed.grasped, executed.distance), end

    def _retreat(self, r: Robot, asked: _Asked, work: Work) -> Coroutine:
        planner, search = self.planner_service.planner, asked.node.search

        def retreat() -> Coroutine:
            if r.worlds is None:
                (world,) = yield [requests.Retreat(search)]
                return Node(planner.begin_reach(world, r.scene.goal, search.shelf))
            place = r.acts_at(asked.node)
            if search.task.pushing:
                place = yield from places.execute_and_retreat(planner, place, search)
            else:  # a reach has missed, and the node's state is that at its end
                place = yield from places.retreat(*place)
            again = planner.begin_reach(place.seen, r.scene.goal, search.shelf)
            return Node(again, place.state)

        (after,) = yield [asked.node.memoised("retreat", retreat)]

        def end() -> None:
            r.executed.append(self.segment(search))
            r.dropped = 0
            self._reach(r, after)

        return None, end

    def _ask(self, r: Robot, asked: _Asked, work: Work) -> Coroutine:
        (given,) = yield [self._input(r, asked, (*self._task_key(work), work.iteration))]

        def end() -> None:
            r.inputs += 1
            if given is not UNANSWERED:
                r.log.input_given()

        return given, end

    # -- requests that a node memoises ------------------------------------------------------------

    def _task_key(self, work: Work) -> tuple[int, int, int]:
        return self.cache.seed, work.robot, work.task

    def _input(self, r: Robot, asked: _Asked, decision_key: DecisionKey) -> requests.Memoised:
        """Request for the input that the operator would give now."""
        node = asked.node
        search, place = node.search, r.checked_at(node)
        view = View.of(search, asked.inputs, asked.dropped, place, node.imagined)
        planner, operator = self.planner_service.planner, self.cache.operator
        return node.memoised(
            ("input", asked.inputs),
            lambda: ask_operator(operator, view, search, planner, decision_key),
        )

    def _foresee(self, r: Robot, asked: _Asked, work: Work) -> Coroutine:
        """What a policy may rank by after an iteration or a check of a reach; a `_Foreseen`."""
        search, predictor = asked.node.search, self.predictor
        if predictor is None or search.task.pushing:
            return _NOTHING
        decision_key, place = (*self._task_key(work), work.iteration + 1), r.checked_at(asked.node)

        def predict() -> Coroutine:
            if isinstance(predictor, TrueGain):
                planner, request = self.planner_service.planner, self._input(r, asked, decision_key)
                gain = yield from predictor.simulate_gain(
                    search, request, planner, decision_key, place
                )
                return _Foreseen(gain)
            if isinstance(predictor, TrueTime):
                request = self._input(r, asked, decision_key)
                left = yield from predictor.simulate(
                    self.cache, asked.node, request, decision_key, place
                )
                return _Foreseen(time_left=left)
            state = state_features(search)
            if isinstance(predictor, TimePredictor):
                (times,) = yield [requests.PredictTimes(predictor, state)]
                known = bool(np.isfinite(times).all())
                return _Foreseen(time_left=TimeLeft(*map(tuple, times)) if known else None)
            (gain,) = yield [requests.PredictGain(predictor, state)]
            return _Foreseen(gain)

        key = ("predicted", predictor, asked.inputs)
        (foreseen,) = yield [asked.node.memoised(key, predict)]
        return foreseen

    def segment(self, search: Search) -> Segment:
        """The best trajectory of a search, as a segment of a plan."""
        kind = "push" if bool(search.task.pushing) else "reach"
        duration = self.planner_service.engine.physics.rollout_s
        return Segment(kind, duration, np.asarray(search.controls), np.asarray(search.gripper))

    def finish(self) -> None:
        """Report the tasks that no other task follows, and release those that will never begin."""
        to_do, self._to_do = self._to_do, {}
        for robot, tasks in to_do.items():
            self._end_task(robot)
            for task in tasks:
                self.cache.release(robot, task)

    @staticmethod
    def _reach(r: Robot, node: Node) -> None:
        """Go on reaching from a node, after a push that was executed or dropped."""
        r.log.begin_segment("reach")
        r.node, r.reach_node = node, None

    def _end_task(self, robot: int) -> None:
        ended = self.robots.get(robot)
        if ended is None:
            return
        self.cache.release(robot, ended.task)
        if self._on_task_end is not None:
            self._on_task_end(robot, ended)
