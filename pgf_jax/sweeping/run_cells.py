"""Cells of sweeps, computed in this process."""

import dataclasses
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from pgf_jax.batching.planner_service import make_planner_service as make_computer
from pgf_jax.batching.planner_service import warm_up
from pgf_jax.fleet.config import Cell
from pgf_jax.parallel.processes import Stopped
from pgf_jax.simulation.loop import run_fleets
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.sweeping.cell_store import Content
from pgf_jax.sweeping.resolve import Setup, provenance
from pgf_jax.tables.results import events_frame, tasks_frame


class Job(NamedTuple):
    """A cell of one of the sweeps that are run together."""

    sweep: int  # number of its setup
    cell: Cell


@dataclasses.dataclass(frozen=True)
class BatchStats:
    """What a batch of cells took: of the wall clock, so not for the results.

    Attributes:
      wall_s: in all, compilation included, s.
      compile_s: time of the first call of each program, compilation included, s; 0 where the
        process has made one before.
      engine_s: time spent in calls of the engine, the planner and the networks, s.
      answering_s: that, and what is thought around it (an operator's candidates, say), s.
      iterations: that robots asked for.
      steps: iterations computed, those of the operators' trials included; fewer where fleets go
        the same way.
      calls: of the engine, one an iteration of up to L robots.
      used: work whose result was used, in the engine's units (see `Computer.occupancy`).
      computed: work done, empty lanes included.
    """

    wall_s: float = 0.0
    compile_s: float = 0.0
    engine_s: float = 0.0
    answering_s: float = 0.0
    iterations: int = 0
    steps: int = 0
    calls: int = 0
    used: int = 0
    computed: int = 0

    def __add__(self, other: "BatchStats") -> "BatchStats":
        mine, theirs = dataclasses.astuple(self), dataclasses.astuple(other)
        return BatchStats(*(a + b for a, b in zip(mine, theirs, strict=True)))


class Listener(Protocol):
    """Hears how cells proceed."""

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """So many tasks of a cell have ended; its fleet's clock stands at `time_ns`."""
        ...

    def finished(self, job: Job, content: Content) -> None:
        """A cell is finished: this is to be its file."""
        ...


def run_cells(
    setups: Mapping[int, Setup],
    jobs: Sequence[Job],
    listener: Listener,
    *,
    stop: Callable[[], bool] = lambda: False,
) -> BatchStats:
    """Compute cells in this process.

    Cells whose planners are alike share a queue, and those whose tasks are, their trees.

    Args:
      setups: of the sweeps, by number.
      jobs: in any company: no cell's results depend on the others.
      listener: told after every call of the engine.
      stop: asked after every call whether to give up.

    Raises:
      Stopped: `stop` said so; the listener has been given the finished cells.
    """
    effort = BatchStats()
    for alike in grouped(jobs, lambda job: setups[job.sweep].compile_key()):
        effort += _run_alike(setups, alike, listener, stop)
    return effort


def _run_alike(
    setups: Mapping[int, Setup], jobs: Sequence[Job], listener: Listener, stop: Callable[[], bool]
) -> BatchStats:
    start = time.perf_counter()
    planner_service = make_computer(*setups[jobs[0].sweep].compile_key())
    search_cache: dict[Hashable, SearchCache] = {}
    for job in jobs:
        setup = setups[job.sweep]
        if setup.cache_key() not in search_cache:
            search_cache[setup.cache_key()] = SearchCache(
                planner_service,
                scenes=setup.scene,
                operator=setup.operator(),
                seed=setup.config.seed,
            )
    setup = setups[jobs[0].sweep]
    compile_s = warm_up(
        planner_service, search_cache[setup.cache_key()].task(0, 0).root.search, setup.config.seed
    )
    planned_fleets, fleets = [], []
    for number, cell in jobs:
        setup = setups[number]
        planned = PlannedRobots(
            search_cache[setup.cache_key()],
            robots=cell.robots,
            tasks=cell.tasks,
            predictor=setup.bidder_of(cell),
        )
        planned_fleets.append(planned)
        fleets.append(setup.new_fleet(cell, planned))
    running = dict(zip(jobs, fleets, strict=True))

    def after_round() -> None:
        for job, fleet in list(running.items()):
            listener.progress(job, len(fleet.records), fleet.now_ns)
            if fleet.done:
                setup = setups[job.sweep]
                tasks = tasks_frame(fleet.records, setup.scene_name)
                events = events_frame(fleet.events)
                listener.finished(job, Content(tasks, events, provenance(setup, job.cell)))
                del running[job]
        if running and stop():
            raise Stopped

    iterations = run_fleets(
        zip(fleets, planned_fleets, strict=True), planner_service, on_round=after_round
    )
    after_round()  # the last ones end without another call
    steps, calls = planner_service.steps, planner_service.calls
    return BatchStats(
        time.perf_counter() - start,
        compile_s,
        planner_service.seconds,
        planner_service.answering_s,
        iterations,
        steps,
        calls,
        *planner_service.occupancy(),
    )


def grouped(items: Iterable[Any], key: Callable[[Any], Hashable]) -> list[list[Any]]:
    """Items of one key together, in the order of their first ones."""
    groups: dict[Hashable, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
