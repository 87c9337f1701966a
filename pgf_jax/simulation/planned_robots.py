"""The robots of the fleets of one process: planners, operators and predictors behind `Work`.

A `Crew` is one fleet's robots (`fleet.Robots`). Each of them stands at a node of its task's tree
(`trees.py`); what it asks of the `Computer` that all crews of the process share goes through its
`Queue`.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from pgf_jax.batching import requests
from pgf_jax.batching.requests import Coroutine, GainPredictor
from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.guidance.operators.base import ask_operator
from pgf_jax.guidance.predictors.features import state_features
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import Search
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.scene.scene import Scene, class_of
from pgf_jax.simulation.search_cache import Node, SearchCache
from pgf_jax.tables.runs import RunLog


@dataclasses.dataclass(frozen=True)
class Segment:
    """A part of a plan that was, or can be, executed."""

    kind: str  # "push" or "reach"
    duration_s: float
    controls: np.ndarray  # [T, 3] m/s, m/s, rad/s along the world axes
    gripper: np.ndarray  # [T] 0 open .. 255 closed


@dataclasses.dataclass
class Robot:
    """One robot's task as it stands; changed only by its crew."""

    task: int
    scene: Scene
    node: Node
    executed: list[Segment]
    log: RunLog
    inputs: int = 0  # services that have ended, those without an answer included
    dropped: int = 0  # pushes given since the shelf last changed that could not be planned
    reach_node: Node | None = None  # while pushing: the reach that was asked about

    @property
    def search(self) -> Search:
        """The segment being planned."""
        return self.node.search

    @property
    def reach(self) -> Search:
        """The reach being planned, or the one that was planned before the push under way."""
        return (self.reach_node or self.node).search


class PlannedRobots:
    """The robots of one fleet; satisfies `fleet.Robots`.

    Args:
      trees: of the tasks; shared by the crews whose tasks, noise and operator are the same.
      robots, tasks: how many robots, and tasks of each.
      predictor: of what robots bid; None: every gain is nan, and nobody bids one.
      on_task_end: called with (robot index, Robot) when a robot takes its next task, and by
        `finish` for the last ones.
    """

    def __init__(
        self,
        search_cache: SearchCache,
        *,
        robots: int = 1,
        tasks: int = 1,
        predictor: GainPredictor | TrueGain | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> None:
        self.search_cache, self.planner_service, self.predictor = (
            search_cache,
            search_cache.planner_service,
            predictor,
        )
        self.robots: dict[int, Robot] = {}
        self._to_do = {robot: range(tasks) for robot in range(robots)}  # not begun yet
        self._on_task_end = on_task_end
        search_cache.retain(robots, tasks)

    # -- fleet.Robots -----------------------------------------------------------------------------

    def begin(self, robot: int, task: int) -> None:
        """See `fleet.Robots.begin`."""
        self._end_task(robot)
        tree = self.search_cache.task(robot, task)
        self._to_do[robot] = self._to_do[robot][1:]
        scene = tree.scene
        log = RunLog(
            scene=scene.name,
            seed=self.search_cache.seed,
            scene_class=class_of(scene),
            n_objects=len(scene.objects),
        )
        log.begin_segment("reach")
        self.robots[robot] = Robot(task, scene, tree.root, [], log)

    def start_push(self, robot: int, push: Push) -> None:
        """See `fleet.Robots.start_push`."""
        r, planner = self.robots[robot], self.planner_service.planner
        r.log.begin_segment("push")
        reach = r.reach_node = r.node
        r.node = reach.child(
            push, lambda: planner.begin_push(reach.search.start, r.scene.goal, push)
        )

    def drop_push(self, robot: int) -> None:
        """See `fleet.Robots.drop_push`."""
        r, planner = self.robots[robot], self.planner_service.planner
        assert r.reach_node is not None, "no push to drop"
        start = r.reach_node.search.start
        r.dropped += 1
        self._reach(r, r.node.child("drop", lambda: planner.begin_reach(start, r.scene.goal)))

    def go_on(self, robot: int) -> None:
        """See `fleet.Robots.go_on`."""
        r = self.robots[robot]
        search = r.search
        r.node = r.node.child("go on", lambda: self.planner_service.planner.go_on(search))

    # -- work -------------------------------------------------------------------------------------

    def coroutine(self, work: Work) -> Coroutine:
        """What a piece of work asks of the computer; returns the work's result."""
        if work.kind is WorkKind.ITERATION:
            return (yield from self._iterate(work))
        if work.kind is WorkKind.INPUT:
            return (yield from self._ask(work))
        return (yield from self._retreat(work))

    def _iterate(self, work: Work) -> Coroutine:
        r, planner = self.robots[work.robot], self.planner_service.planner
        before = r.search

        def step() -> Coroutine:
            words = requests.robot_key_path(
                self.search_cache.seed, work.robot, work.task, work.iteration
            )
            (after,) = yield [requests.Step(before, words(0))]
            return Node(after)

        (r.node,) = yield [r.node.memoised("iteration", step)]
        after = r.search
        gain = math.nan
        if self.predictor is not None and not after.task.pushing:
            (gain,) = yield [self._gain(r, (*self._whose(work), work.iteration + 1))]
        c_d, c_f, c_b = (float(x) for x in after.value.terms[:3])
        result = IterationResult(
            feasible=planner.terminate(after),
            stuck=planner.is_stuck(after),
            gain=gain,
            terms=(c_d, c_f, c_b),
            cost=float(after.value.total),
            non_finite=bool(after.non_finite > before.non_finite),
            saturated=int(after.saturated - before.saturated),
        )
        r.log.add(result.terms, feasible=result.feasible)
        return result

    def _retreat(self, work: Work) -> Coroutine:
        r, planner = self.robots[work.robot], self.planner_service.planner
        search = r.search

        def retreat() -> Coroutine:
            (world,) = yield [requests.Retreat(search)]
            return Node(planner.begin_reach(world, r.scene.goal))

        (after,) = yield [r.node.memoised("retreat", retreat)]
        r.executed.append(self.segment(search))
        r.dropped = 0
        self._reach(r, after)

    def _ask(self, work: Work) -> Coroutine:
        r = self.robots[work.robot]
        (given,) = yield [self._input(r, (*self._whose(work), work.iteration))]
        r.inputs += 1
        if given is not UNANSWERED:
            r.log.input_given()
        return given

    # -- what follows from a node -----------------------------------------------------------------

    def _whose(self, work: Work) -> tuple[int, int, int]:
        return self.search_cache.seed, work.robot, work.task

    def _input(self, r: Robot, at: DecisionKey) -> requests.Memoised:
        """What the operator would say now."""
        search, view = r.search, View.of(r.search, r.inputs, r.dropped)
        planner, operator = self.planner_service.planner, self.search_cache.operator
        return r.node.memoised(
            ("input", r.inputs), lambda: ask_operator(operator, view, search, planner, at)
        )

    def _gain(self, r: Robot, at: DecisionKey) -> requests.Memoised:
        """What the robot may bid now."""
        search, predictor = r.search, self.predictor
        assert predictor is not None

        def predict() -> Coroutine:
            if isinstance(predictor, TrueGain):
                return (
                    yield from predictor.deliberate(
                        search, self._input(r, at), self.planner_service.planner, at
                    )
                )
            (gain,) = yield [requests.PredictGain(predictor, state_features(search))]
            return gain

        return r.node.memoised(("gain", predictor, r.inputs), predict)

    def segment(self, search: Search) -> Segment:
        """The best of a search, as part of a plan."""
        kind = "push" if bool(search.task.pushing) else "reach"
        duration = self.planner_service.engine.physics.rollout_s
        return Segment(kind, duration, np.asarray(search.controls), np.asarray(search.gripper))

    def finish(self) -> None:
        """Report the tasks that no other task follows, and leave those that will never begin."""
        for robot, tasks in self._to_do.items():
            self._end_task(robot)
            for task in tasks:
                self.search_cache.release(robot, task)

    @staticmethod
    def _reach(r: Robot, node: Node) -> None:
        """Reach from a node: a push has been executed, or dropped."""
        r.log.begin_segment("reach")
        r.node, r.reach_node = node, None

    def _end_task(self, robot: int) -> None:
        ended = self.robots.pop(robot, None)
        if ended is None:
            return
        self.search_cache.release(robot, ended.task)
        if self._on_task_end is not None:
            self._on_task_end(robot, ended)
