"""Computes cells of sweeps in this process."""

import dataclasses
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, Protocol

from pgf_jax.batching.planner_service import make_planner_service, warm_up
from pgf_jax.parallel.local import Stopped
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.sweeping.cell_file import Content
from pgf_jax.sweeping.resolve import CellSpec
from pgf_jax.tables.results import events_frame, tasks_frame


@dataclasses.dataclass(frozen=True)
class BatchStats:
    """Time and work that a batch of cells took. It varies from run to run, so it is no result.

    Attributes:
      wall_s: in all, compilation included, s.
      compile_s: time of the first call of each program, compilation included, s; 0 where the
        process has made one before.
      engine_s: time spent in calls of the engine, the planner and the networks, s; of all threads.
      answering_s: that, and the time of the coroutines between calls (an operator's candidates), s.
      iterations: that robots requested.
      steps: iterations computed, those of the operators' trials included; fewer where fleets share
        their searches.
      calls: of the engine, one for iterations of up to L robots.
      used: work whose result was used, in the engine's units (see `PlannerService.occupancy`).
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


class CellListener(Protocol):
    """Is told how the cells of this process proceed."""

    def progress(self, cell: CellSpec, tasks: int, time_ns: int) -> None:
        """Of a cell, `tasks` tasks have ended; the clock of its fleet is at `time_ns`."""
        ...

    def finished(self, cell: CellSpec, content: Content) -> None:
        """A cell is finished, and `content` is what its file is to hold."""
        ...


def run_cells(
    cells: Sequence[CellSpec],
    listener: CellListener,
    *,
    threads: int = 1,
    stop: Callable[[], bool] = lambda: False,
) -> BatchStats:
    """Compute cells in this process.

    Cells with the same planner share a scheduler, and those with the same tasks their searches.

    Args:
      cells: in any company: no cell's results depend on the others.
      listener: told after every batch of requests.
      threads: calls of the engine at a time.
      stop: asked after every batch whether to give up.

    Raises:
      Stopped: `stop` said so; the listener has been given the finished cells.
    """
    stats = BatchStats()
    for alike in grouped(cells, lambda cell: cell.fleet.compile_key):
        stats += _run_alike(alike, listener, threads, stop)
    return stats


def _run_alike(
    cells: Sequence[CellSpec], listener: CellListener, threads: int, stop: Callable[[], bool]
) -> BatchStats:
    """Compute cells that run the same compiled programs."""
    start = time.perf_counter()
    service = make_planner_service(*cells[0].fleet.compile_key)
    caches: dict[Hashable, SearchCache] = {}
    for cell in cells:
        key = cell.fleet.cache_key
        if key not in caches:
            caches[key] = cell.fleet.search_cache(service)
    first = cells[0].fleet
    search = caches[first.cache_key].task(0, 0).root.search
    compile_s = warm_up(service, search, first.config.seed, checked=first.world is not None)
    running: dict[CellSpec, PlannedFleet] = {}
    for cell in cells:
        robots = cell.fleet.planned_robots(caches[cell.fleet.cache_key])
        running[cell] = PlannedFleet(cell.fleet.new_fleet(robots), robots, cell)

    def after_batch() -> None:
        for cell, (fleet, *_) in running.items():
            listener.progress(cell, len(fleet.records), fleet.now_ns)
        if stop():
            raise Stopped

    iterations = 0
    # An iterator, which forgets them: fleets that have ended are freed.
    fleets = iter([*running.values()])
    for fleet, robots, cell in run_fleets(fleets, service, threads=threads, on_batch=after_batch):
        tasks = tasks_frame(fleet.records, cell.fleet.scenes.name)
        listener.finished(cell, Content(tasks, events_frame(fleet.events), cell.about()))
        iterations += robots.iterations
        del running[cell]
    steps, calls = service.steps, service.calls
    return BatchStats(
        time.perf_counter() - start,
        compile_s,
        service.seconds,
        service.answering_s,
        iterations,
        steps,
        calls,
        *service.occupancy(),
    )


def grouped(items: Iterable[Any], key: Callable[[Any], Hashable]) -> list[list[Any]]:
    """Items of one key together, in the order of their first ones."""
    groups: dict[Hashable, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
