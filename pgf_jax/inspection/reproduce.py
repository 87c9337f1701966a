"""One iteration of a fleet that is done, once more: what each of its rollouts did.

A task's search follows from its scene, the seed, and what has happened in it; the fleet's event log
says what has happened. So a task is walked again alone, a call an iteration instead of a whole
fleet, and its way is held against the log: where results depend on the processor, one that goes
another way must not pass for the one that was logged.
"""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.batching.planner_service import make_planner_service as make_computer
from pgf_jax.batching.requests import Step, robot_key_path
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.guidance.operators.base import NoOperator
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.inspection.config import ReproduceConfig
from pgf_jax.inspection.iteration import Reproduction
from pgf_jax.planning.planner import Search
from pgf_jax.planning.types import Push
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.sweeping import cell_store
from pgf_jax.sweeping.cell_store import config_of, differences
from pgf_jax.sweeping.resolve import Setup, identity, prepare
from pgf_jax.tables import results


def reproduce(
    setup: Setup, cell: Cell, events: Iterable[Event], *, robot: int, task: int, iteration: int
) -> Reproduction:
    """An iteration of a fleet that is done, computed again.

    Args:
      setup: of the sweep.
      cell: the fleet.
      events: its event log.
      robot, task: which; 0-based.
      iteration: its number in the log.

    Raises:
      BadInput: one line: there is no such iteration in the log, or the events are none of such a
        fleet; or the task goes another way here, as the log was written by other code, on another
        processor or with another predictor.
    """
    way = _way(cell, events, robot, task, iteration)
    walk = _Walk(setup, cell, robot, task)
    for event in way[:-1]:
        walk.follow(event)
    before = walk.search
    walk.follow(way[-1])
    step = Step(before, robot_key_path(setup.config.seed, robot, task, iteration)(0))
    after, rolled = walk.planner_service.rolled(step)
    return Reproduction(robot, task, iteration, walk.scene, step.key_path, before, after, rolled)


def _way(cell: Cell, events: Iterable[Event], robot: int, task: int, iteration: int) -> list[Event]:
    """What happened in a task, up to the iteration."""
    if not 0 <= robot < cell.robots:
        raise BadInput(f"robot: expected 0..{cell.robots - 1} of cell {cell.name}, got {robot}")
    if not 0 <= task < cell.tasks:
        raise BadInput(f"task: expected 0..{cell.tasks - 1} of cell {cell.name}, got {task}")
    way: list[Event] = []
    ended = -1
    for event in events:
        if (event.robot, event.task) != (robot, task):
            continue
        way.append(event)
        if event.kind is EventKind.ITERATION and event.iteration is not None:
            ended = event.iteration
            if ended == iteration:
                return way
    whose = f"task {task} of robot {robot}"
    if not way:
        raise BadInput(f"task: {whose} is not in the log")
    there = "no iteration" if ended < 0 else f"iterations 0..{ended}"
    raise BadInput(f"iteration: {whose} has {there} in the log, got {iteration}")


class _Walk:
    """One task as its events tell it, computed again.

    Attributes:
      computer: with the lanes of the sweep: results are the same for the same lanes only.
      scene: its name.
    """

    def __init__(self, setup: Setup, cell: Cell, robot: int, task: int) -> None:
        self.planner_service = make_computer(*setup.compile_key())
        # Nobody is asked: the log says what was given.
        search_cache = SearchCache(
            self.planner_service, scenes=setup.scene, operator=NoOperator(), seed=setup.config.seed
        )
        predictor = setup.bidder_of(cell)
        # What help was worth was found out with the operator, by planning on; the other gains are
        # the one number in the log that follows from all there is of a search.
        self._gains = not isinstance(predictor, TrueGain)
        self._crew = PlannedRobots(
            search_cache,
            robots=robot + 1,
            tasks=task + 1,
            predictor=None if isinstance(predictor, TrueGain) else predictor,
        )
        self._crew.begin(robot, task)
        self.scene = self._crew.robots[robot].scene.name
        self._robot, self._task, self._iterations = robot, task, 0

    @property
    def search(self) -> Search:
        """As the task stands."""
        return self._crew.robots[self._robot].search

    def follow(self, event: Event) -> None:
        """Let an event of the task happen.

        Raises:
          BadInput: it cannot, or something else does.
        """
        pushing = bool(self.search.task.pushing)
        found = self.planner_service.planner.terminate(self.search)
        if event.kind is EventKind.ITERATION:
            if found:
                raise self._senseless("planning goes on with what is feasible")
            self._iterate(event)
        elif event.kind is EventKind.SERVICE_END and event.outcome not in ("expired", "censored"):
            if pushing:
                raise self._senseless("a service ends while a push is planned")
            self._give(event)
        elif event.kind is EventKind.PUSH_DROPPED:
            if not pushing or found:
                raise self._senseless("a push is dropped where none is planned")
            self._crew.drop_push(self._robot)
        elif event.kind is EventKind.RETREAT_END:
            if not (pushing and found):
                raise self._senseless("a retreat ends after no push")
            self._perform(WorkKind.RETREAT)

    def _iterate(self, event: Event) -> None:
        number = self._iterations
        if event.iteration != number:
            raise self._senseless(f"iteration {event.iteration} comes where {number} should")
        task = self.search.task
        self._hold("object", event.object, int(task.pushed) if task.pushing else None)
        result = self._perform(WorkKind.ITERATION)
        assert isinstance(result, IterationResult)
        outcome = "feasible" if result.feasible else "stuck" if result.stuck else None
        self._hold("outcome", event.outcome, outcome)
        if self._gains:
            self._hold("gain", _known(event.gain), _known(result.gain))
        self._iterations += 1

    def _give(self, event: Event) -> None:
        if event.outcome == "push":
            if event.object is None or event.x is None or event.y is None:
                raise self._senseless("a push without its object or place is given")
            self._crew.start_push(self._robot, Push(event.object, event.x, event.y))
        elif event.outcome not in ("go_on", "unanswered"):
            raise self._senseless(f"a service ends with {short_repr(event.outcome)}")
        elif self.search.iteration >= 0:  # otherwise there is nothing yet to go on with
            self._crew.go_on(self._robot)

    def _perform(self, kind: WorkKind) -> Any:
        results: list[Any] = []
        queue = BatchScheduler(self.planner_service)
        work = Work(self._robot, self._task, kind, self._iterations)
        queue.submit(self._crew.coroutine(work), results.append)
        while len(queue):
            queue.run_batch()
        return results[0]

    def _hold(self, what: str, logged: object, here: object) -> None:
        if logged != here:
            raise BadInput(
                f"robot {self._robot}, task {self._task}, iteration {self._iterations}: "
                f"{what} {short_repr(logged)} in the log, {short_repr(here)} here; the log was "
                "written by other code, on another processor or with another predictor"
            )

    def _senseless(self, what: str) -> BadInput:
        return BadInput(
            f"robot {self._robot}, task {self._task}, after {self._iterations} iterations: {what}; "
            "expected the log of the fleet"
        )


def _known(gain: float | None) -> float | None:
    return None if gain is None or math.isnan(gain) else gain


_INPUTS = ("scenes", "predictors", "log", "fleet", "planner", "physics", "engine", "lanes")


def find_and_reproduce(config: ReproduceConfig) -> Reproduction:
    """The iteration that `config` names, computed again.

    Raises:
      BadInput: the folder holds no such thing; or it does not come out again.
    """
    for file, content in _cells(config):
        where = _where(config, content)
        if where is not None:
            return _again(config, file, content, where)
    if config.iteration is None:
        raise BadInput(
            f"{config.folder}: every rollout that was asked about was finite; --policy, --robots, "
            "--robot, --task and --iteration name any other"
        )
    raise BadInput(
        f"{config.folder}: holds no fleet of {config.robots} robots under {config.policy}"
    )


def _cells(config: ReproduceConfig) -> Iterator[tuple[Path, cell_store.Content]]:
    """Fleets that are asked about."""
    if not (config.folder / cell_store.FOLDER).is_dir():
        raise BadInput(
            f"{config.folder}: holds no results of a sweep (no folder {cell_store.FOLDER})"
        )
    for key in sorted(cell_store.finished(config.folder)):
        file = cell_store.path(config.folder, key)
        content = cell_store.read(file)
        settings = content.about.get("config")
        settings = settings if isinstance(settings, dict) else {}
        if config.policy is not None and settings.get("policies") != [config.policy]:
            continue
        if config.robots is not None and settings.get("robots") != [config.robots]:
            continue
        yield file, content


def _where(config: ReproduceConfig, content: cell_store.Content) -> tuple[int, int, int] | None:
    """Robot, task and iteration: those named, or the first that is not finite."""
    if config.iteration is not None:
        assert config.robot is not None and config.task is not None
        return config.robot, config.task, config.iteration
    lost = content.tasks.filter(pl.col("non_finite_at").list.len() > 0)
    for name in ("robot", "task"):
        if getattr(config, name) is not None:
            lost = lost.filter(pl.col(name) == getattr(config, name))
    if lost.is_empty():
        return None
    row = lost.row(0, named=True)
    return row["robot"], row["task"], row["non_finite_at"][0]


def _again(
    config: ReproduceConfig, file: Path, content: cell_store.Content, where: tuple[int, int, int]
) -> Reproduction:
    sweep = config_of(content, cell_store.inputs(file), config.folder)
    setup = prepare(sweep)
    (cell,) = sweep.cells()
    old, new = content.about["identity"], identity(setup, cell)
    words = differences(*({name: each.get(name) for name in _INPUTS} for each in (old, new)))
    if words:
        raise BadInput(f"{file}: its inputs are not what they were ({words})")
    robot, task, iteration = where
    events = results.event_log(content.events)
    return reproduce(setup, cell, events, robot=robot, task=task, iteration=iteration)


def run(config: ReproduceConfig) -> None:
    """The command."""
    found = find_and_reproduce(config)
    if config.out is not None:
        found.save(config.out)
    print(found.text())
    if config.out is not None:
        print(f"arrays in {config.out}")
