"""`pgf-jax reproduce`: one iteration of a sweep, found among its results and computed again.

A task's search follows from its scene, the seed, and what has happened in it; the fleet's event log
says what has happened. So a task is repeated alone, in one call for each iteration, and compared
with the log. Where results depend on the processor, a task that goes another way is refused.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.batching.planner_service import make_planner_service
from pgf_jax.batching.requests import Step, robot_key_path
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.config import Cell, plans_meanwhile
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.policies import make_policy
from pgf_jax.fleet.robots import CheckResult, IterationResult, Work, WorkKind
from pgf_jax.guidance.operators.base import NoOperator
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.inspection.config import ReproduceConfig
from pgf_jax.inspection.iteration import Reproduction
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push
from pgf_jax.simulation.fleet_spec import FleetSpec
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.resolve import CellSpec, config_of, differences, resolve
from pgf_jax.sweeping.stored_fleet import CellChoice, stored_cells
from pgf_jax.tables import results

_INPUTS = (
    *("scenes", "predictors", "log", "plugins", "revisions"),
    *("fleet", "planner", "physics", "engine", "lanes", "world"),
)


def reproduce(
    spec: CellSpec, events: Iterable[Event], *, robot: int, task: int, iteration: int
) -> Reproduction:
    """Compute an iteration of a finished fleet again.

    Args:
      spec: the fleet's cell.
      events: its event log.
      robot, task: which; 0-based.
      iteration: its number in the log.

    Raises:
      BadInput: one line: there is no such iteration in the log, or the events are not of such a
        fleet; or the task goes another way here, as the log was written by other code, on another
        processor or with another predictor.
    """
    found = _events_of(spec.cell, events, robot, task, iteration)
    repeat = _RepeatedTask(spec.fleet, robot, task)
    for event in found[:-1]:
        repeat.follow(event)
    before = repeat.search
    repeat.follow(found[-1])
    step = Step(before, robot_key_path(spec.fleet.config.seed, robot, task, iteration)(0))
    after, rolled = repeat.rolled(step)
    scene = spec.fleet.scenes.name(robot, task)
    return Reproduction(robot, task, iteration, scene, step.key_path, before, after, rolled)


def _events_of(
    cell: Cell, events: Iterable[Event], robot: int, task: int, iteration: int
) -> list[Event]:
    """The events of a task, up to the iteration."""
    if not 0 <= robot < cell.robots:
        raise BadInput(f"robot: expected 0..{cell.robots - 1} of cell {cell.name}, got {robot}")
    if not 0 <= task < cell.tasks:
        raise BadInput(f"task: expected 0..{cell.tasks - 1} of cell {cell.name}, got {task}")
    found: list[Event] = []
    ended = -1
    for event in events:
        if (event.robot, event.task) != (robot, task):
            continue
        found.append(event)
        if event.kind is EventKind.ITERATION and event.iteration is not None:
            ended = event.iteration
            if ended == iteration:
                return found
    whose = f"task {task} of robot {robot}"
    if not found:
        raise BadInput(f"task: {whose} is not in the log")
    there = "no iteration" if ended < 0 else f"iterations 0..{ended}"
    raise BadInput(f"iteration: {whose} has {there} in the log, got {iteration}")


class _RepeatedTask:
    """One task, computed again as its events tell."""

    def __init__(self, spec: FleetSpec, robot: int, task: int) -> None:
        # With the lanes of the sweep: results are the same for the same lanes only.
        self._service = make_planner_service(*spec.compile_key)
        # No operator is asked: the log says what was given.
        cache = spec.search_cache(self._service, NoOperator())
        # A true gain was found with the operator, by planning on. The other gains are the one
        # number in the log that follows from all there is of a search.
        self._gains = not isinstance(spec.predictor, TrueGain)
        self._robots = PlannedRobots(
            cache,
            robots=robot + 1,
            tasks=task + 1,
            predictor=None if isinstance(spec.predictor, TrueGain) else spec.predictor,
            misses=spec.misses,
        )
        self._robots.begin(robot, task)
        self._robot, self._task, self._iterations = robot, task, 0
        _, self._plans = plans_meanwhile(
            spec.config, make_policy(spec.config)
        )  # while it is served
        self._go_on_given = False  # while an iteration or a check was under way
        self._checks = 0  # of the iteration that has ended last
        self._missed = False  # the reach that was executed last

    @property
    def search(self) -> Search:
        """The search at the event that was followed last."""
        return self._robots.robots[self._robot].search

    def rolled(self, step: Step) -> tuple[Search, Any]:
        """See `PlannerService.rolled`."""
        return self._service.rolled(step)

    def follow(self, event: Event) -> None:
        """Repeat an event of the task.

        Raises:
          BadInput: it cannot happen here, or something else happens.
        """
        pushing = bool(self.search.task.pushing)
        found = self._service.planner.terminate(self.search)
        if event.kind is EventKind.ITERATION:
            if found or self._to_check:
                raise self._impossible("planning goes on with what is feasible")
            self._iterate(event)
        elif event.kind is EventKind.CHECK:
            if not self._to_check:
                raise self._impossible("a check is made where nothing is to be checked")
            self._check_candidate(event)
        elif event.kind is EventKind.EXECUTION_END and event.outcome == "missed":
            if pushing or not found or not self._robots.misses:
                raise self._impossible("a reach misses where none is executed")
            self._missed = not self._perform(WorkKind.REACH).grasped
            self._compare("outcome", event.outcome, "missed" if self._missed else "reach")
        elif event.kind is EventKind.SERVICE_END and event.outcome not in (
            *("expired", "censored", "solved_meanwhile"),
        ):
            if pushing:
                raise self._impossible("a service ends while a push is planned")
            self._give(event)
        elif event.kind is EventKind.PUSH_DROPPED:
            if not pushing or found:
                raise self._impossible("a push is dropped where none is planned")
            self._robots.drop_push(self._robot, keep=self._plans)
        elif event.kind is EventKind.RETREAT_END:
            if not (self._missed or (pushing and found)):
                raise self._impossible("a retreat ends after no push")
            self._missed = False
            self._perform(WorkKind.RETREAT)

    @property
    def _to_check(self) -> bool:
        return self._robots.robots[self._robot].node.candidates is not None

    def _iterate(self, event: Event) -> None:
        number = self._iterations
        if event.iteration != number:
            raise self._impossible(f"iteration {event.iteration} comes where {number} should")
        task = self.search.task
        self._compare("object", event.object, int(task.pushed) if task.pushing else None)
        result = self._perform(WorkKind.ITERATION)
        assert isinstance(result, IterationResult)
        outcome = "feasible" if result.feasible else "stuck" if result.stuck else None
        self._compare("outcome", event.outcome, outcome)
        self._compare_gain(event, result)
        self._iterations += 1
        self._checks = 0
        if not (result.feasible or task.pushing):
            self._take_go_on()

    def _check_candidate(self, event: Event) -> None:
        number = self._iterations - 1
        if event.iteration != number:
            raise self._impossible(f"a check is of iteration {event.iteration}, not of {number}")
        result = self._perform(WorkKind.CHECK, number, self._checks)
        assert isinstance(result, CheckResult)
        self._compare("outcome", event.outcome, "passed" if result.passed else "missed")
        self._compare_gain(event, result.result)
        self._checks += 1
        if not (result.passed or result.more):
            self._take_go_on()

    def _compare_gain(self, event: Event, result: IterationResult) -> None:
        if self._gains:
            logged, here = (results.nan_to_null(gain) for gain in (event.gain, result.gain))
            self._compare("gain", logged, here)

    def _give(self, event: Event) -> None:
        if event.outcome == "push":
            if event.object is None or event.x is None or event.y is None:
                raise self._impossible("a push without its object or place is given")
            self._robots.start_push(self._robot, Push(event.object, event.x, event.y))
            self._go_on_given = False
        elif event.outcome not in ("go_on", "unanswered"):
            raise self._impossible(f"a service ends with {short_repr(event.outcome)}")
        elif self._plans or self._to_check:
            self._go_on_given = True
        elif self.search.iteration >= 0:  # otherwise there is nothing yet to go on with
            self._robots.go_on(self._robot)

    def _take_go_on(self) -> None:
        if self._go_on_given:
            self._robots.go_on(self._robot)
        self._go_on_given = False

    def _perform(
        self, kind: WorkKind, iteration: int | None = None, check: int | None = None
    ) -> Any:
        iteration = self._iterations if iteration is None else iteration
        work = Work(self._robot, self._task, kind, iteration, check=check)
        self._robots.request(work)
        result = BatchScheduler(self._service).run(self._robots.coroutine(work))
        self._robots.end(work)
        return result

    def _compare(self, what: str, logged: object, here: object) -> None:
        if logged != here:
            raise BadInput(
                f"robot {self._robot}, task {self._task}, iteration {self._iterations}: "
                f"{what} {short_repr(logged)} in the log, {short_repr(here)} here; the log was "
                "written by other code, on another processor or with another predictor"
            )

    def _impossible(self, what: str) -> BadInput:
        return BadInput(
            f"robot {self._robot}, task {self._task}, after {self._iterations} iterations: {what}; "
            "expected the log of the fleet"
        )


def find_and_reproduce(config: ReproduceConfig) -> Reproduction:
    """Compute the iteration that `config` names again.

    Raises:
      BadInput: the folder holds no such iteration; or it goes another way here.
    """
    chosen = CellChoice(config.policy, config.robots, config.seed)
    for file, content in stored_cells(config.folder, chosen):
        where = _where(config, content)
        if where is not None:
            return _reproduce_stored(config, file, content, where)
    if config.iteration is None:
        raise BadInput(
            f"{config.folder}: every rollout that was asked about was finite; --policy, --robots, "
            "--robot, --task and --iteration name any other"
        )
    raise BadInput(
        f"{config.folder}: holds no fleet of {config.robots} robots under {config.policy}"
    )


def _where(config: ReproduceConfig, content: cell_file.Content) -> tuple[int, int, int] | None:
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


def _reproduce_stored(
    config: ReproduceConfig, file: Path, content: cell_file.Content, where: tuple[int, int, int]
) -> Reproduction:
    (spec,) = resolve(config_of(content.about, cell_file.inputs(file), config.folder)).cells
    identities = (content.about["identity"], spec.identity)
    words = differences(*({name: each.get(name) for name in _INPUTS} for each in identities))
    if words:
        raise BadInput(f"{file}: its inputs are not what they were ({words})")
    robot, task, iteration = where
    events = results.event_log(content.events)
    return reproduce(spec, events, robot=robot, task=task, iteration=iteration)


def run(config: ReproduceConfig) -> None:
    """Run the command: print the iteration, and save its arrays."""
    found = find_and_reproduce(config)
    if config.out is not None:
        found.save(config.out)
    print(found.text())
    if config.out is not None:
        print(f"arrays in {config.out}")
