"""Cells of a sweep, computed: in this process, or in several that each take whole cells."""

import contextlib
import copy
import dataclasses
import functools
import multiprocessing
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Protocol

import jax

from pgf_jax.cores import pin, usable
from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet, Work, WorkKind
from pgf_jax.guidance.operators import make_operator
from pgf_jax.physics.config import PHYSICS, Physics
from pgf_jax.physics.engine import make_engine
from pgf_jax.planning.config import Planner
from pgf_jax.study.crew import Computer, Crew, drive
from pgf_jax.study.results import events_frame, tasks_frame, write_cell
from pgf_jax.study.sweep_config import Cell
from pgf_jax.study.sweep_setup import Setup, identity

# JAX's settings that a new process takes over: those of numbers, or results would depend on which
# process computed them, and those of the compilation cache.
_JAX_SETTINGS = (
    "jax_platforms",
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
_STOP_S = 60.0  # a process that is told to stop finishes its round first


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


class Stopped(Exception):
    """The process was told to stop."""


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
    computer = _computer(setup)
    crew = functools.partial(
        Crew,
        computer,
        # Fleets of different policies ask for the same scenes: each is drawn once.
        scenes=functools.cache(setup.scene),
        operator=make_operator(config.operator),
        seed=config.seed,
    )
    compile_s = _warm_up(computer, crew())
    crews = [crew() for _ in cells]
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


def _computer(setup: Setup) -> Computer:
    config = setup.config
    kept = _compiled(
        config.engine,
        PHYSICS[config.physics],
        config.planner(),
        config.engine_lanes(),
        setup.n_objects,
    )
    computer = copy.copy(kept)  # its own predictors and counters
    computer.predictors = setup.predictors
    return computer


@functools.lru_cache(maxsize=4)
def _compiled(
    engine: str, physics: Physics, planner: Planner, lanes: int, n_objects: int
) -> Computer:
    """Kept: a second sweep of the same settings in one process compiles nothing again."""
    return Computer(make_engine(engine, physics=physics, n_objects=n_objects, lanes=lanes), planner)


def _warm_up(computer: Computer, crew: Crew) -> float:
    """One iteration for nobody, so that its compilation is not mistaken for its time; s."""
    start = time.perf_counter()
    crew.begin(0, 0)
    computer.compute([(crew, Work(0, 0, WorkKind.ITERATION, 0))])
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


def run_in_processes(
    setup: Setup, cells: Sequence[Cell], workers: int, listener: Listener
) -> list[Effort]:
    """Compute cells in processes of their own; see `run_cells`.

    Engines, policies and operators of the user's own are found there if they are registered where
    the processes come by: in the main script outside its `if __name__ == "__main__"`.

    Raises:
      BadInput: as it was raised in a process.
      RuntimeError: a process failed, or ended before its cells were finished.
    """
    parts = shares(cells, workers)
    context = multiprocessing.get_context("spawn")  # JAX's threads do not survive a fork
    stop = context.Event()
    settings = {name: getattr(jax.config, name) for name in _JAX_SETTINGS}
    available = usable()
    processes, pending, efforts = [], {}, []
    try:
        for number, part in enumerate(parts):
            # Cores of its own: the threads of several processes would only wait for each other.
            pinned = available[number :: len(parts)] or [available[number % len(available)]]
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(
                target=_work, args=(setup, part, theirs, stop, settings, pinned), daemon=True
            )
            with _uninterruptible():
                process.start()
            theirs.close()  # so that its end is seen here as the end of the file
            processes.append(process)
            pending[ours] = process
        while pending:
            for connection in wait(list(pending)):
                assert isinstance(connection, Connection)
                effort = _listen(connection, pending[connection], listener)
                if effort is not None:
                    efforts.append(effort)
                    del pending[connection]
    finally:
        stop.set()
        for process in processes:
            process.join(_STOP_S)
            if process.is_alive():
                process.terminate()
                process.join()
    return efforts


@contextlib.contextmanager
def _uninterruptible() -> Iterator[None]:
    """Processes started in here never see Ctrl-C, which goes to all of them: the parent decides."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _listen(connection: Connection, process: BaseProcess, listener: Listener) -> Effort | None:
    """Take one message of a process; its effort if it was the last."""
    try:
        kind, *content = connection.recv()
    except EOFError:
        process.join(_STOP_S)
        raise RuntimeError(
            f"a process of the sweep ended early (exit code {process.exitcode}); "
            "its finished cells are kept"
        ) from None
    if kind == "progress":
        listener.progress(*content)
    elif kind == "finished":
        listener.finished(*content)
    elif kind == "bad input":
        raise BadInput(*content)
    elif kind == "failed":
        raise RuntimeError("a process of the sweep failed:\n" + content[0])
    else:
        return content[0]
    return None


class _Sender:
    """A `Listener` that passes on to the parent process."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._told: dict[Cell, int] = {}

    def progress(self, cell: Cell, tasks: int, time_ns: int) -> None:
        if self._told.get(cell) != tasks:
            self._told[cell] = tasks
            self._connection.send(("progress", cell, tasks, time_ns))

    def finished(self, cell: Cell) -> None:
        self._connection.send(("finished", cell))


def _work(
    setup: Setup,
    cells: Sequence[Cell],
    connection: Connection,
    stop: Any,
    settings: dict[str, Any],
    cores: Sequence[int],
) -> None:
    """The main function of a process."""
    pin(cores)
    for name, value in settings.items():
        jax.config.update(name, value)
    parent = multiprocessing.parent_process()

    def stopping() -> bool:
        return stop.is_set() or (parent is not None and not parent.is_alive())

    with contextlib.suppress(BrokenPipeError, Stopped):
        try:
            effort = run_cells(setup, cells, _Sender(connection), stop=stopping)
            connection.send(("done", effort))
        except (Stopped, BrokenPipeError):
            raise
        except BadInput as error:
            connection.send(("bad input", str(error)))
        except Exception:
            connection.send(("failed", traceback.format_exc()))
