"""The robots of the fleets of one process: planners, operators and predictors behind `Work`.

A `Crew` is one fleet's robots (`fleet.Robots`). Each of them stands at a node of its task's tree
(`trees.py`); what it asks of the `Computer` that all crews of the process share goes through its
`Queue`.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable

import numpy as np

from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.guidance import trials
from pgf_jax.guidance.operators import At, View, consult
from pgf_jax.guidance.runs import RunLog
from pgf_jax.guidance.state import describe
from pgf_jax.guidance.trials import Bidder, Deliberation
from pgf_jax.guidance.true_gain import TrueGain
from pgf_jax.planning.planner import Search
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.scene.scene import Scene, class_of
from pgf_jax.study.computer import Computer, Queue
from pgf_jax.study.trees import Node, Trees


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
    at: Node
    executed: list[Segment]
    log: RunLog
    inputs: int = 0  # services that have ended, those without an answer included
    dropped: int = 0  # pushes given since the shelf last changed that could not be planned
    reached: Node | None = None  # while pushing: the reach that was asked about

    @property
    def search(self) -> Search:
        """The segment being planned."""
        return self.at.search

    @property
    def reach(self) -> Search:
        """The reach being planned, or the one that was planned before the push under way."""
        return (self.reached or self.at).search


class Crew:
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
        trees: Trees,
        *,
        robots: int = 1,
        tasks: int = 1,
        predictor: Bidder | TrueGain | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> None:
        self.trees, self.computer, self.predictor = trees, trees.computer, predictor
        self.robots: dict[int, Robot] = {}
        self._to_do = {robot: range(tasks) for robot in range(robots)}  # not begun yet
        self._on_task_end = on_task_end
        trees.join(robots, tasks)

    # -- fleet.Robots -----------------------------------------------------------------------------

    def begin(self, robot: int, task: int) -> None:
        """See `fleet.Robots.begin`."""
        self._end_task(robot)
        tree = self.trees.tree(robot, task)
        self._to_do[robot] = self._to_do[robot][1:]
        scene = tree.scene
        log = RunLog(
            scene=scene.name,
            seed=self.trees.seed,
            scene_class=class_of(scene),
            n_objects=len(scene.objects),
        )
        log.begin_segment("reach")
        self.robots[robot] = Robot(task, scene, tree.root, [], log)

    def start_push(self, robot: int, push: Push) -> None:
        """See `fleet.Robots.start_push`."""
        r, planner = self.robots[robot], self.computer.planner
        r.log.begin_segment("push")
        reach = r.reached = r.at
        r.at = reach.after(push, lambda: planner.begin_push(reach.search.start, r.scene.goal, push))

    def drop_push(self, robot: int) -> None:
        """See `fleet.Robots.drop_push`."""
        r, planner = self.robots[robot], self.computer.planner
        assert r.reached is not None, "no push to drop"
        start = r.reached.search.start
        r.dropped += 1
        self._reach(r, r.at.after("drop", lambda: planner.begin_reach(start, r.scene.goal)))

    def go_on(self, robot: int) -> None:
        """See `fleet.Robots.go_on`."""
        r = self.robots[robot]
        search = r.search
        r.at = r.at.after("go on", lambda: self.computer.planner.go_on(search))

    # -- work -------------------------------------------------------------------------------------

    def perform(self, work: Work) -> Deliberation:
        """What a piece of work asks of the computer; returns the work's result."""
        if work.kind is WorkKind.ITERATION:
            return (yield from self._iterate(work))
        if work.kind is WorkKind.INPUT:
            return (yield from self._ask(work))
        return (yield from self._retreat(work))

    def _iterate(self, work: Work) -> Deliberation:
        r, planner = self.robots[work.robot], self.computer.planner
        before = r.search

        def step() -> Deliberation:
            words = trials.own_words(self.trees.seed, work.robot, work.task, work.iteration)
            (after,) = yield [trials.Step(before, words(0))]
            return Node(after)

        (r.at,) = yield [r.at.once("iteration", step)]
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

    def _retreat(self, work: Work) -> Deliberation:
        r, planner = self.robots[work.robot], self.computer.planner
        search = r.search

        def retreat() -> Deliberation:
            (world,) = yield [trials.Retreat(search)]
            return Node(planner.begin_reach(world, r.scene.goal))

        (after,) = yield [r.at.once("retreat", retreat)]
        r.executed.append(self.segment(search))
        r.dropped = 0
        self._reach(r, after)

    def _ask(self, work: Work) -> Deliberation:
        r = self.robots[work.robot]
        (given,) = yield [self._input(r, (*self._whose(work), work.iteration))]
        r.inputs += 1
        if given is not UNANSWERED:
            r.log.input_given()
        return given

    # -- what follows from a node -----------------------------------------------------------------

    def _whose(self, work: Work) -> tuple[int, int, int]:
        return self.trees.seed, work.robot, work.task

    def _input(self, r: Robot, at: At) -> trials.Once:
        """What the operator would say now."""
        search, view = r.search, View.of(r.search, r.inputs, r.dropped)
        planner, operator = self.computer.planner, self.trees.operator
        return r.at.once(("input", r.inputs), lambda: consult(operator, view, search, planner, at))

    def _gain(self, r: Robot, at: At) -> trials.Once:
        """What the robot may bid now."""
        search, predictor = r.search, self.predictor
        assert predictor is not None

        def predict() -> Deliberation:
            if isinstance(predictor, TrueGain):
                return (
                    yield from predictor.deliberate(
                        search, self._input(r, at), self.computer.planner, at
                    )
                )
            (gain,) = yield [trials.Gain(predictor, describe(search))]
            return gain

        return r.at.once(("gain", predictor, r.inputs), predict)

    def segment(self, search: Search) -> Segment:
        """The best of a search, as part of a plan."""
        kind = "push" if bool(search.task.pushing) else "reach"
        duration = self.computer.engine.physics.rollout_s
        return Segment(kind, duration, np.asarray(search.controls), np.asarray(search.gripper))

    def finish(self) -> None:
        """Report the tasks that no other task follows, and leave those that will never begin."""
        for robot, tasks in self._to_do.items():
            self._end_task(robot)
            for task in tasks:
                self.trees.leave(robot, task)

    @staticmethod
    def _reach(r: Robot, node: Node) -> None:
        """Reach from a node: a push has been executed, or dropped."""
        r.log.begin_segment("reach")
        r.at, r.reached = node, None

    def _end_task(self, robot: int) -> None:
        ended = self.robots.pop(robot, None)
        if ended is None:
            return
        self.trees.leave(robot, ended.task)
        if self._on_task_end is not None:
            self._on_task_end(robot, ended)


def drive(
    fleets: Iterable[tuple[Fleet, Crew]],
    computer: Computer,
    *,
    at_once: int | None = None,
    on_round: Callable[[], None] | None = None,
) -> int:
    """Run fleets to their ends, all their pending work in one queue.

    A round takes as many iterations off the queue as a call has lanes, first come first served;
    what they lead to joins the queue before the next, so that calls stay full while there is work.

    Args:
      fleets: with their crews; may be a generator, taken from as fleets end.
      computer: of all the crews.
      at_once: how many fleets are under way at a time; None: all.
      on_round: called after each round of calls.

    Returns:
      Iterations that robots asked for.
    """
    iterations = 0
    waiting = iter(fleets)
    running: list[tuple[Fleet, Crew]] = []
    queue = Queue(computer)
    while True:
        going: list[tuple[Fleet, Crew]] = []
        source = itertools.chain(running, waiting)
        while at_once is None or len(going) < at_once:
            pair = next(source, None)
            if pair is None:
                break
            fleet, crew = pair
            # An input may be there at once, and the fleet go on with it.
            while pending := fleet.advance():
                for work in pending:
                    iterations += work.kind is WorkKind.ITERATION
                    queue.add(crew.perform(work), functools.partial(fleet.deliver, work))
            if fleet.done:
                crew.finish()
            else:
                going.append(pair)
        running = going
        if not running:
            computer.answering_s += queue.seconds
            return iterations
        queue.round()
        if on_round is not None:
            on_round()
