"""The robots of the fleets of one process: planners, operators and predictors behind `Work`.

A `Crew` is one fleet's robots (`fleet.Robots`); the `Computer` is what all crews of the process
share: an engine, a planner and the predictors. It turns pending work of any crews into fixed-shape
calls of L lanes, so that no robot's result depends on who shares its call (D8).
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.guidance.operators import Operator, View
from pgf_jax.guidance.predictor import Predictor, gain
from pgf_jax.guidance.rows import history_features
from pgf_jax.guidance.runs import RunLog
from pgf_jax.physics.engine import Engine, World
from pgf_jax.planning.config import Planner as PlannerConfig
from pgf_jax.planning.planner import BatchPlanner, Search, start_world
from pgf_jax.planning.types import Push
from pgf_jax.scene.scene import Scene

NOISE = 0  # purpose of a key; other draws of an iteration would take other numbers


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


class Computer:
    """Engine, planner and predictors of one process.

    Args:
      engine: rolls out L lanes of K rollouts at a time.
      config: of the planner.
      predictors: (phi_auto, phi_human); None: every gain is nan, and nobody bids one.
    """

    def __init__(
        self,
        engine: Engine,
        config: PlannerConfig | None = None,
        predictors: tuple[Predictor, Predictor] | None = None,
    ) -> None:
        self.engine, self.predictors = engine, predictors
        self.planner = BatchPlanner(engine, config)
        self.calls = 0  # iteration calls made
        self.lanes_used = 0  # lanes in them that held work
        self.saturated = 0  # rollouts in which contacts may have been dropped (no slot left)
        self._keys = jax.jit(jax.vmap(_key))

    def occupancy(self) -> tuple[int, int]:
        """(work whose result was used, work computed) since this was last called.

        In the units of an engine that leaves lanes out and counts what it does; else in lanes of
        iteration calls.
        """
        own = getattr(self.engine, "occupancy", None)
        used, computed = self.lanes_used, self.calls * self.engine.lanes
        self.calls = self.lanes_used = 0
        return (used, computed) if own is None else own()

    def compute(self, batch: Sequence[tuple["Crew", Work]]) -> list[Any]:
        """Results of pending work, in order: `IterationResult`, None (a retreat) or an input."""
        results: list[Any] = [None] * len(batch)
        by_kind = {kind: [] for kind in WorkKind}
        for i, (crew, work) in enumerate(batch):
            by_kind[work.kind].append((i, crew, work))
        for i, crew, work in by_kind[WorkKind.INPUT]:
            results[i] = crew.ask(work)
        for part in _parts(by_kind[WorkKind.RETREAT], self.engine.lanes):
            pushes = [crew.robots[work.robot].search for _, crew, work in part]
            worlds = self.planner.retreat(pushes)
            for (_, crew, work), world in zip(part, worlds, strict=True):
                crew.pushed(work.robot, world)
        for part in _parts(by_kind[WorkKind.ITERATION], self.engine.lanes):
            done = self._iterate([(crew, work) for _, crew, work in part])
            for (i, _, _), result in zip(part, done, strict=True):
                results[i] = result
        return results

    def _iterate(self, part: Sequence[tuple["Crew", Work]]) -> list[IterationResult]:
        self.calls += 1
        self.lanes_used += len(part)
        words = [(crew.seed, work.robot, work.task, work.iteration, NOISE) for crew, work in part]
        words += [words[0]] * (self.engine.lanes - len(part))
        keys = np.asarray(self._keys(np.array(words, np.uint32)))[: len(part)]
        before = [crew.robots[work.robot].search for crew, work in part]
        after = self.planner.step(before, list(keys))
        gains = self._gains(after)
        results = []
        for (crew, work), old, new, g in zip(part, before, after, gains, strict=True):
            c_d, c_f, c_b = (float(x) for x in new.value.terms[:3])
            result = IterationResult(
                feasible=self.planner.terminate(new),
                stuck=self.planner.is_stuck(new),
                gain=float(g),
                terms=(c_d, c_f, c_b),
                cost=float(new.value.total),
                non_finite=bool(new.non_finite > old.non_finite),
            )
            self.saturated += int(new.saturated - old.saturated)
            crew.iterated(work.robot, new, result)
            results.append(result)
        return results

    def _gains(self, searches: Sequence[Search]) -> np.ndarray:
        """[len] phi_auto - phi_human; nan while pushing, without history or without predictors."""
        if self.predictors is None:
            return np.full(len(searches), math.nan)
        features = np.stack([history_features(self.engine.n_objects, s.history) for s in searches])
        pushing = np.array([bool(s.task.pushing) for s in searches])
        return np.where(pushing, math.nan, gain(*self.predictors, features))


class Crew:
    """The robots of one fleet; satisfies `fleet.Robots`.

    Args:
      computer: shared by all crews of the process.
      scenes: (robot, task) -> scene.
      operator: gives the inputs.
      seed: of the noise.
      on_task_end: called with (robot index, Robot) when a robot takes its next task, and by
        `finish` for the last ones.
    """

    def __init__(
        self,
        computer: Computer,
        *,
        scenes: Callable[[int, int], Scene],
        operator: Operator,
        seed: int,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> None:
        self.computer, self.operator, self.seed = computer, operator, seed
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
        log = RunLog(scene=scene.name, seed=self.seed, scene_class=_class_of(scene), n_objects=n)
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

    # -- results of work --------------------------------------------------------------------------

    def iterated(self, robot: int, search: Search, result: IterationResult) -> None:
        """Take an iteration's outcome."""
        r = self.robots[robot]
        r.search = search
        r.log.add(result.terms, feasible=result.feasible)

    def pushed(self, robot: int, world: World) -> None:
        """The push planned last was executed; reaching restarts in `world`."""
        self.robots[robot].executed.append(self.segment(self.robots[robot].search))
        self.robots[robot].dropped = 0
        self._reach_from(robot, world)

    def ask(self, work: Work) -> Push | None:
        """The operator's input."""
        r = self.robots[work.robot]
        r.log.input_given()
        return self.operator.decide(view(r.search, work.request or 0, r.dropped))

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
    queue: list[tuple[Fleet, Crew, Work]] = []
    while True:
        going: list[tuple[Fleet, Crew]] = []
        source = itertools.chain(running, waiting)
        while at_once is None or len(going) < at_once:
            pair = next(source, None)
            if pair is None:
                break
            fleet, crew = pair
            pending = fleet.advance()
            if fleet.done:
                crew.finish()
                continue
            going.append(pair)
            queue += [(fleet, crew, work) for work in pending]
        running = going
        if not running:
            return
        iterations = [item for item in queue if item[2].kind is WorkKind.ITERATION]
        batch = [item for item in queue if item[2].kind is not WorkKind.ITERATION]
        batch += iterations[: computer.engine.lanes]
        queue = iterations[computer.engine.lanes :]
        results = computer.compute([(crew, work) for _, crew, work in batch])
        for (fleet, _, work), result in zip(batch, results, strict=True):
            fleet.deliver(work, result)
        if on_round is not None:
            on_round()


def view(search: Search, request: int, dropped: int) -> View:
    """What an operator sees of a search."""
    return View(
        objects=np.asarray(search.start.objects),
        goal=int(search.task.goal),
        hand=np.asarray(search.start.hand),
        gripper=float(search.start.gripper),
        path=np.asarray(search.best.objects),
        hands=np.asarray(search.best.hand),
        force=np.asarray(search.best.force),
        bodies=np.asarray(search.best.bodies),
        terms=np.asarray(search.value.terms),
        request=request,
        dropped=dropped,
    )


def _key(words: jax.Array) -> jax.Array:
    key = jax.random.key(0)
    for word in words:
        key = jax.random.fold_in(key, word)
    return jax.random.key_data(key).astype(jnp.uint32)


def _class_of(scene: Scene) -> str:
    head = scene.name.split("_")[0]
    return head if head in ("tight", "medium", "wide") else "file"


def _parts(items: Sequence, size: int) -> list:
    return [items[i : i + size] for i in range(0, len(items), size)]
