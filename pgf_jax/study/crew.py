"""The robots of the fleets of one process: planners, operators and predictors behind `Work`.

A `Crew` is one fleet's robots (`fleet.Robots`). What they ask of the `Computer` that all crews of
the process share goes through its `Queue`.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.guidance import trials
from pgf_jax.guidance.operators import AnyOperator, View, consult
from pgf_jax.guidance.runs import RunLog
from pgf_jax.guidance.state import describe
from pgf_jax.guidance.trials import Bidder, Deliberation
from pgf_jax.physics.engine import World
from pgf_jax.planning.planner import Search, start_world
from pgf_jax.planning.types import Push
from pgf_jax.scene.scene import Scene, class_of
from pgf_jax.study.computer import Computer, Queue


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
    search: Search
    executed: list[Segment]
    log: RunLog
    reached_from: World | None = None  # while pushing: where reaching restarts if it is dropped
    dropped: int = 0  # pushes given since the shelf last changed that could not be planned
    last_reach: Search | None = None  # while pushing: the reach that was asked about

    @property
    def reach(self) -> Search:
        """The reach being planned, or the one that was planned before the push under way."""
        return self.last_reach if self.last_reach is not None else self.search


class Crew:
    """The robots of one fleet; satisfies `fleet.Robots`.

    Args:
      computer: shared by all crews of the process.
      scenes: (robot, task) -> scene.
      operator: gives the inputs.
      seed: of the noise.
      predictor: of what robots bid; None: every gain is nan, and nobody bids one.
      on_task_end: called with (robot index, Robot) when a robot takes its next task, and by
        `finish` for the last ones.
    """

    def __init__(
        self,
        computer: Computer,
        *,
        scenes: Callable[[int, int], Scene],
        operator: AnyOperator,
        seed: int,
        predictor: Bidder | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> None:
        self.computer, self.operator, self.seed = computer, operator, seed
        self.predictor = predictor
        self.robots: dict[int, Robot] = {}
        self._scenes, self._on_task_end = scenes, on_task_end

    # -- fleet.Robots -----------------------------------------------------------------------------

    def begin(self, robot: int, task: int) -> None:
        """See `fleet.Robots.begin`."""
        self._end_task(robot)
        scene = self._scenes(robot, task)
        n = self.computer.engine.n_objects
        if len(scene.objects) != n:
            raise BadInput(
                f"scene {scene.name}: has {len(scene.objects)} objects, the engine simulates {n}"
            )
        world = start_world(scene.positions)
        log = RunLog(scene=scene.name, seed=self.seed, scene_class=class_of(scene), n_objects=n)
        log.begin_segment("reach")
        search = self.computer.planner.begin_reach(world, scene.goal)
        self.robots[robot] = Robot(task, scene, search, [], log)

    def start_push(self, robot: int, push: Push) -> None:
        """See `fleet.Robots.start_push`."""
        r = self.robots[robot]
        r.log.begin_segment("push")
        r.last_reach, r.reached_from = r.search, r.search.start
        r.search = self.computer.planner.begin_push(r.search.start, r.scene.goal, push)

    def drop_push(self, robot: int) -> None:
        """See `fleet.Robots.drop_push`."""
        world = self.robots[robot].reached_from
        assert world is not None, "no push to drop"
        self.robots[robot].dropped += 1
        self._reach_from(robot, world)

    def go_on(self, robot: int) -> None:
        """See `fleet.Robots.go_on`."""
        r = self.robots[robot]
        r.search = self.computer.planner.go_on(r.search)

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
        words = trials.own_words(self.seed, work.robot, work.task, work.iteration)
        before = r.search
        (after,) = yield [trials.Step(before, words(0))]
        gain = math.nan
        if self.predictor is not None and not after.task.pushing:
            (gain,) = yield [trials.Gain(self.predictor, describe(after))]
        c_d, c_f, c_b = (float(x) for x in after.value.terms[:3])
        result = IterationResult(
            feasible=planner.terminate(after),
            stuck=planner.is_stuck(after),
            gain=gain,
            terms=(c_d, c_f, c_b),
            cost=float(after.value.total),
            non_finite=bool(after.non_finite > before.non_finite),
        )
        r.search = after
        r.log.add(result.terms, feasible=result.feasible)
        return result

    def _retreat(self, work: Work) -> Deliberation:
        r = self.robots[work.robot]
        (world,) = yield [trials.Retreat(r.search)]
        r.executed.append(self.segment(r.search))
        r.dropped = 0
        self._reach_from(work.robot, world)

    def _ask(self, work: Work) -> Deliberation:
        r = self.robots[work.robot]
        r.log.input_given()
        seen = View.of(r.search, work.request or 0, r.dropped)
        at = (self.seed, work.robot, work.task, work.iteration)
        return (yield from consult(self.operator, seen, r.search, self.computer.planner, at))

    def segment(self, search: Search) -> Segment:
        """The best of a search, as part of a plan."""
        kind = "push" if bool(search.task.pushing) else "reach"
        duration = self.computer.engine.physics.rollout_s
        return Segment(kind, duration, np.asarray(search.controls), np.asarray(search.gripper))

    def finish(self) -> None:
        """Report the tasks that no other task follows."""
        for robot in list(self.robots):
            self._end_task(robot)

    def _reach_from(self, robot: int, world: World) -> None:
        r = self.robots[robot]
        r.log.begin_segment("reach")
        r.search = self.computer.planner.begin_reach(world, r.scene.goal)
        r.last_reach = r.reached_from = None

    def _end_task(self, robot: int) -> None:
        ended = self.robots.pop(robot, None)
        if ended is not None and self._on_task_end is not None:
            self._on_task_end(robot, ended)


def drive(
    fleets: Iterable[tuple[Fleet, Crew]],
    computer: Computer,
    *,
    at_once: int | None = None,
    on_round: Callable[[], None] | None = None,
) -> None:
    """Run fleets to their ends, all their pending work in one queue.

    A round takes as many iterations off the queue as a call has lanes, first come first served;
    what they lead to joins the queue before the next, so that calls stay full while there is work.

    Args:
      fleets: with their crews; may be a generator, taken from as fleets end.
      computer: of all the crews.
      at_once: how many fleets are under way at a time; None: all.
      on_round: called after each round of calls.
    """
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
                    queue.add(crew.perform(work), functools.partial(fleet.deliver, work))
            if fleet.done:
                crew.finish()
            else:
                going.append(pair)
        running = going
        if not running:
            return
        queue.round()
        if on_round is not None:
            on_round()
