"""Cells of a sweep, computed: in this process, or in several that each take whole cells."""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from pgf_jax.fleet import Fleet, Work, WorkKind
from pgf_jax.guidance.operators import make_operator
from pgf_jax.study.computer import Computer, Queue
from pgf_jax.study.computer import computer as make_computer
from pgf_jax.study.crew import Crew, drive
from pgf_jax.study.processes import Say, Stopped, run_in_processes
from pgf_jax.study.results import events_frame, tasks_frame, write_cell
from pgf_jax.study.sweep_config import Cell
from pgf_jax.study.sweep_setup import Setup, identity


@dataclasses.dataclass(frozen=True)
class Effort:
    """What a process took: of the wall clock, so for the manifest only.

    Attributes:
      calls: of the engine, one an iteration of up to L robots.
      used: work whose result was used, in the engine's units (see `Computer.occupancy`).
      computed: work done, empty lanes included.
      saturated: rollouts with a knot end at which every contact slot was in use.
      compile_s: time of the first call, compilation included, s.
    """

    calls: int
    used: int
    computed: int
    saturated: int
    compile_s: float


class Listener(Protocol):
    """Hears how cells proceed."""

    def progress(self, cell: Cell, tasks: int, time_ns: int) -> None:
        """So many tasks of a cell have ended; its fleet's clock stands at `time_ns`."""
        ...

    def finished(self, cell: Cell) -> None:
        """Its files are written."""
        ...


def run_cells(
    setup: Setup,
    cells: Sequence[Cell],
    listener: Listener,
    *,
    stop: Callable[[], bool] = lambda: False,
) -> Effort:
    """Compute cells in this process, their work in one queue; each is written when it is finished.

    Args:
      setup: of the sweep.
      cells: in any company: no cell's results depend on the others.
      listener: told after every call of the engine.
      stop: asked after every call whether to give up.

    Raises:
      Stopped: `stop` said so; finished cells have been written.
    """
    config = setup.config
    computer = make_computer(
        config.engine, config.physics, config.planner(), config.engine_lanes(), setup.n_objects
    )
    crew = functools.partial(
        Crew,
        computer,
        # Fleets of different policies ask for the same scenes: each is drawn once.
        scenes=functools.cache(setup.scene),
        operator=make_operator(config.operator),
        seed=config.seed,
    )
    compile_s = _warm_up(computer, crew())
    crews = [crew(predictor=setup.bidder_of(cell)) for cell in cells]
    fleets = [Fleet(config.fleet(cell), crew) for cell, crew in zip(cells, crews, strict=True)]
    running = dict(zip(cells, fleets, strict=True))

    def after_round() -> None:
        for cell, fleet in list(running.items()):
            listener.progress(cell, len(fleet.records), fleet.now_ns)
            if fleet.done:
                tasks = tasks_frame(fleet.records, setup.scene_name)
                events = events_frame(fleet.events)
                write_cell(config.out, cell, identity(setup, cell), tasks, events)
                listener.finished(cell)
                del running[cell]
        if running and stop():
            raise Stopped

    drive(zip(fleets, crews, strict=True), computer, on_round=after_round)
    after_round()  # the last ones end without another call
    calls = computer.calls
    return Effort(calls, *computer.occupancy(), computer.saturated, compile_s)


def _warm_up(computer: Computer, crew: Crew) -> float:
    """One iteration for nobody, so that its compilation is not mistaken for its time; s."""
    start = time.perf_counter()
    crew.begin(0, 0)
    queue = Queue(computer)
    queue.add(crew.perform(Work(0, 0, WorkKind.ITERATION, 0)), lambda result: None)
    queue.round()
    computer.occupancy()
    computer.saturated = 0
    return time.perf_counter() - start


# -- several processes -------------------------------------------------------------------------


def shares(cells: Sequence[Cell], workers: int) -> list[list[Cell]]:
    """Whole cells to each process: the largest first, to whoever has the fewest tasks so far."""
    parts: list[list[Cell]] = [[] for _ in range(min(workers, len(cells)))]
    load = [0] * len(parts)
    for cell in sorted(cells, key=lambda cell: -cell.robots * cell.tasks):
        least = load.index(min(load))
        parts[least].append(cell)
        load[least] += cell.robots * cell.tasks
    return parts


def run_cells_in_processes(
    setup: Setup, cells: Sequence[Cell], workers: int, listener: Listener
) -> list[Effort]:
    """Compute cells in processes of their own; see `run_cells` and `run_in_processes`."""

    def hear(message: tuple[str, tuple[Any, ...]]) -> None:
        kind, content = message
        (listener.progress if kind == "progress" else listener.finished)(*content)

    parts = [(setup, part) for part in shares(cells, workers)]
    return run_in_processes(_cells_of_a_process, parts, hear)


class _Sender:
    """A `Listener` that passes on to the parent process."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._told: dict[Cell, int] = {}

    def progress(self, cell: Cell, tasks: int, time_ns: int) -> None:
        if self._told.get(cell) != tasks:
            self._told[cell] = tasks
            self._say(("progress", (cell, tasks, time_ns)))

    def finished(self, cell: Cell) -> None:
        self._say(("finished", (cell,)))


def _cells_of_a_process(
    part: tuple[Setup, Sequence[Cell]], say: Say, stop: Callable[[], bool]
) -> Effort:
    setup, cells = part
    return run_cells(setup, cells, _Sender(say), stop=stop)
