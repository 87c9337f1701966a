"""Submits batches of cells to an executor, polls their progress, and retries after a death."""

import concurrent.futures
import pickle
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from typing import Any, Protocol

from pgf_jax.errors import BadInput, WorkersLost
from pgf_jax.jax_setup import one_engine
from pgf_jax.parallel.jax_settings import jax_settings
from pgf_jax.parallel.local import WorkerDied
from pgf_jax.physics.engine import calls_use_one_core
from pgf_jax.provenance import kind
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.resolve import CellSpec
from pgf_jax.sweeping.run_cells import BatchStats, grouped
from pgf_jax.sweeping.worker import (
    Batch,
    BatchProgress,
    BatchResult,
    open_session,
    read_progress,
    run_batch,
)
from pgf_jax.sweeping.worker_entry import WorkerCall, compute

POLL_S = 0.25
ATTEMPTS = 3  # of which none finishes a cell: then it is the cells that kill the workers
THREADS = 4  # of a process, at most: coroutines run in one thread, whatever their number
TURNS = 4  # batches for each worker, where there are enough cells that share nothing


class SweepListener(Protocol):
    """Is told how a sweep proceeds."""

    def progress(self, cell: CellSpec, tasks: int, time_ns: int) -> None:
        """Of a cell, `tasks` tasks have ended; the clock of its fleet is at `time_ns`."""
        ...

    def finished(self, cell: CellSpec, account: Mapping[str, Any]) -> None:
        """A cell's file exists; `account` says how it was computed."""
        ...

    def retried(self, cells: int, why: str) -> None:
        """So many cells are computed again."""
        ...


def dispatch(
    cells: Sequence[CellSpec],
    listener: SweepListener,
    executor: Callable[[], tuple[Executor, int]] | None,
) -> list[BatchStats]:
    """Compute cells, and have their files in the folders of their sweeps.

    Args:
      cells: whose files do not exist, or are to be replaced.
      listener: told of the progress.
      executor: opens what computes: the executor, and how many workers it has; None: this process.

    Returns:
      Time and work of each batch.

    Raises:
      BadInput: something cannot be used, or a file cannot be written.
      WorkersLost: the workers died again and again, or can no longer be reached.
    """
    session = secrets.token_hex(8)
    with open_session(list(dict.fromkeys(cell.out for cell in cells)), session) as end_session:
        if executor is None:
            batch = Batch(0, session, tuple(cells), kind())
            teller = _Teller(listener)
            result = run_batch(batch, lambda progress: teller.tell(batch, progress))
            teller.tell_finished(batch)
            return [result.stats]
        opened, workers = executor()
        parts = partition(cells, workers)
        batches = [Batch(i, session, tuple(part), kind()) for i, part in enumerate(parts)]
        try:
            return _Dispatcher(opened, listener).run(batches)
        finally:
            end_session()
            opened.shutdown(wait=True, cancel_futures=True)


def share_out(cells: Sequence[CellSpec], workers: int) -> tuple[int, int | None]:
    """Share out so many workers' cores to processes.

    Cells that share searches are computed in one process, on several cores where the engine's calls
    use one each. Several processes would each do most of the searches again.

    Returns:
      How many processes; and the cores that each has, None: what there is.
    """
    most = min(workers, len(cells))
    engine = one_engine(cell.fleet.engine for cell in cells)
    if engine is None or not calls_use_one_core(engine):
        return most, None
    families = len(grouped(cells, lambda cell: cell.fleet.cache_key))
    count = min(most, max(families, -(-workers // THREADS)))
    return count, min(workers // count, THREADS)


def partition(cells: Sequence[CellSpec], workers: int) -> list[list[CellSpec]]:
    """Partition cells into batches, the largest first.

    Cells that share searches stay together where there are enough such families for all workers: a
    family takes little more time than its largest cell.
    """
    families = grouped(cells, lambda cell: cell.fleet.cache_key)
    count = min(len(families), TURNS * workers)
    if len(families) < workers:
        families = [[cell] for cell in cells]
        count = min(len(families), workers)

    def tasks(family: list[CellSpec]) -> int:
        return sum(cell.tasks for cell in family)

    parts: list[list[CellSpec]] = [[] for _ in range(count)]
    load = [0] * count
    for family in sorted(families, key=tasks, reverse=True):
        least = load.index(min(load))
        parts[least] += family
        load[least] += tasks(family)
    return sorted(parts, key=tasks, reverse=True)


class _Teller:
    """Tells a listener what it has not been told yet."""

    def __init__(self, listener: SweepListener) -> None:
        self._listener = listener
        self._finished: set[CellSpec] = set()
        self._last: dict[CellSpec, tuple[int, int]] = {}

    def tell(self, batch: Batch, progress: BatchProgress) -> None:
        """Tell what a worker reports; a crash may have taken files of which it speaks."""
        for index, tasks, time_ns in progress.running:
            cell = batch.cells[index]
            if cell not in self._finished and self._last.get(cell) != (tasks, time_ns):
                self._last[cell] = tasks, time_ns
                self._listener.progress(cell, tasks, time_ns)
        for index in progress.finished:
            self._tell_finished(batch, batch.cells[index])

    def tell_finished(self, batch: Batch) -> None:
        """Tell which cells of a batch are finished, by their files."""
        for cell in batch.cells:
            self._tell_finished(batch, cell)

    def _tell_finished(self, batch: Batch, cell: CellSpec) -> None:
        if cell not in self._finished and batch.is_finished(cell):
            self._finished.add(cell)
            self._listener.finished(cell, cell_file.read_account(cell.path))


class _Dispatcher:
    def __init__(self, executor: Executor, listener: SweepListener) -> None:
        self._executor, self._listener = executor, listener
        # Workers without cores of their own have to claim some.
        self._claim = getattr(executor, "claim", False)
        self._cores = getattr(executor, "cores_each", 1)
        self._teller = _Teller(listener)
        self._pending: dict[Future[BatchResult], Batch] = {}
        self._stats: list[BatchStats] = []
        self._submitted = 0

    def run(self, batches: Sequence[Batch]) -> list[BatchStats]:
        for batch in batches:
            self._submit(batch)
        while self._pending:
            done, _ = concurrent.futures.wait(
                self._pending, POLL_S, concurrent.futures.FIRST_COMPLETED
            )
            for future, batch in self._pending.items():
                if future not in done and future.running():
                    self._teller.tell(batch, read_progress(batch))
            for future in done:
                self._collect(self._pending.pop(future), future)
        return self._stats

    def _submit(self, batch: Batch) -> None:
        self._submitted += 1
        engine = one_engine(cell.fleet.engine for cell in batch.cells)
        threads = self._cores if engine is not None and calls_use_one_core(engine) else 1
        call = WorkerCall(pickle.dumps(batch), jax_settings(), engine, self._claim, threads)
        try:
            self._pending[self._executor.submit(compute, call)] = batch
        except RuntimeError as error:  # broken, or shut down
            raise self._lost(error) from error

    def _collect(self, batch: Batch, future: Future[BatchResult]) -> None:
        try:
            result = future.result()
        except WorkerDied as error:
            self._retry(batch, str(error))
            return
        except (BadInput, WorkersLost):
            raise
        except (concurrent.futures.BrokenExecutor, concurrent.futures.CancelledError) as error:
            raise self._lost(error) from error
        for index, data, account in result.returned:
            cell_file.write(batch.cells[index].path, data, account)
        self._teller.tell_finished(batch)
        self._stats.append(result.stats)

    def _retry(self, batch: Batch, why: str) -> None:
        """Submit the rest of a batch once more."""
        self._teller.tell_finished(batch)
        rest = batch.rest(self._submitted)
        if not rest.cells:
            return
        if rest.attempt > ATTEMPTS:
            names = ", ".join(cell.name for cell in rest.cells[:3])
            more = f" and {len(rest.cells) - 3} more" if len(rest.cells) > 3 else ""
            raise WorkersLost(
                f"a worker has died {ATTEMPTS} times while computing {names}{more} ({why}); is "
                "there enough memory? What was finished is kept, --resume goes on from it"
            )
        self._listener.retried(len(rest.cells), why)
        self._submit(rest)

    def _lost(self, error: BaseException) -> WorkersLost:
        why = str(error) or type(error).__name__
        return WorkersLost(
            f"the workers cannot be reached any more ({why}); what was finished is kept, --resume "
            "goes on from it"
        )
