"""Batches of cells on their way through an executor: sent, watched, sent again, brought home."""

import concurrent.futures
import pickle
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from typing import Any, Protocol

from pgf_jax.errors import BadInput, WorkersLost
from pgf_jax.parallel.local import WorkerDied
from pgf_jax.parallel.processes import jax_settings
from pgf_jax.provenance import kind
from pgf_jax.sweeping import cell_store
from pgf_jax.sweeping.resolve import Setup
from pgf_jax.sweeping.run_cells import BatchStats, Job, grouped
from pgf_jax.sweeping.worker import Batch, Progress, Result, open_session, read_progress, run_batch
from pgf_jax.sweeping.worker_entry import WorkerCall, compute

POLL_S = 0.25
ATTEMPTS = 3  # of which none finishes a cell: then it is the cells that kill the workers
TURNS = 4  # batches a worker, where there are enough cells that share nothing


class Listener(Protocol):
    """Hears how a sweep proceeds."""

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """So many tasks of a cell have ended; its fleet's clock stands at `time_ns`."""
        ...

    def finished(self, job: Job, account: Mapping[str, Any]) -> None:
        """Its file is there; `account` is what stands beside it."""
        ...

    def again(self, jobs: int, why: str) -> None:
        """So many cells are computed again."""
        ...


def dispatch(
    setups: Sequence[Setup],
    jobs: Sequence[Job],
    keys: Mapping[Job, str],
    listener: Listener,
    executor: Callable[[], tuple[Executor, int]] | None,
) -> list[BatchStats]:
    """Compute cells, and have their files in the folders of their sweeps.

    Args:
      setups: of the sweeps.
      jobs: cells whose files are not wanted as they are, or not there.
      keys: of the cells.
      listener: hears of it.
      executor: opens what computes: the executor, and how many workers it has; None: this process.

    Returns:
      What was taken, a batch each.

    Raises:
      BadInput: something cannot be used, or a file cannot be written.
      Lost: the workers died again and again, or whoever sends them work is gone.
    """
    session = secrets.token_hex(8)
    folders = list(dict.fromkeys(setups[job.sweep].config.out for job in jobs))
    with open_session(folders, session) as end_session:
        if executor is None:
            batch = _batch(0, session, setups, jobs, keys)
            told = _Told(listener)
            result = run_batch(batch, lambda progress: told.tell(batch, progress))
            told.settle(batch)
            return [result.effort]
        opened, workers = executor()
        parts = shares(setups, jobs, workers)
        batches = [_batch(i, session, setups, part, keys) for i, part in enumerate(parts)]
        try:
            return _Dispatch(opened, listener).run(batches)
        finally:
            end_session()
            opened.shutdown(wait=True, cancel_futures=True)


def shares(setups: Sequence[Setup], jobs: Sequence[Job], workers: int) -> list[list[Job]]:
    """Cells in batches, the largest first.

    Cells that share trees stay together where there are enough such families to go round: one of
    them is computed for little more than the largest.
    """
    families = grouped(jobs, lambda job: setups[job.sweep].lineage())
    count = min(len(families), TURNS * workers)
    if len(families) < workers:
        families = [[job] for job in jobs]
        count = min(len(families), workers)

    def tasks(family: list[Job]) -> int:
        return sum(cell.robots * cell.tasks for _, cell in family)

    parts: list[list[Job]] = [[] for _ in range(count)]
    load = [0] * count
    for family in sorted(families, key=tasks, reverse=True):
        least = load.index(min(load))
        parts[least] += family
        load[least] += tasks(family)
    return sorted(parts, key=tasks, reverse=True)


def _batch(
    number: int,
    session: str,
    setups: Sequence[Setup],
    jobs: Sequence[Job],
    keys: Mapping[Job, str],
) -> Batch:
    own = {job.sweep: setups[job.sweep] for job in jobs}
    names = tuple(keys[job] for job in jobs)
    return Batch(number, session, own, tuple(jobs), names, kind())


class _Told:
    """Tells a listener what it has not been told yet."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._finished: set[Job] = set()
        self._last: dict[Job, tuple[int, int]] = {}

    def tell(self, batch: Batch, progress: Progress) -> None:
        """What a batch's worker says; it may speak of files that a crash has taken since."""
        for place, tasks, time_ns in progress.running:
            job = batch.jobs[place]
            if job not in self._finished and self._last.get(job) != (tasks, time_ns):
                self._last[job] = tasks, time_ns
                self._listener.progress(job, tasks, time_ns)
        for place in progress.finished:
            self._tell_finished(batch, batch.jobs[place])

    def settle(self, batch: Batch) -> None:
        """Look for the cells themselves."""
        for job in batch.jobs:
            self._tell_finished(batch, job)

    def _tell_finished(self, batch: Batch, job: Job) -> None:
        if job not in self._finished and batch.is_finished(job):
            self._finished.add(job)
            self._listener.finished(job, cell_store.read_account(batch.file(job)))


class _Dispatch:
    def __init__(self, executor: Executor, listener: Listener) -> None:
        self._executor, self._listener = executor, listener
        # Workers that nobody has given cores find themselves some.
        self._claim = getattr(executor, "claim", False)
        self._told = _Told(listener)
        self._pending: dict[Future[Result], Batch] = {}
        self._efforts: list[BatchStats] = []
        self._sent = 0

    def run(self, batches: Sequence[Batch]) -> list[BatchStats]:
        for batch in batches:
            self._send(batch)
        while self._pending:
            done, _ = concurrent.futures.wait(
                self._pending, POLL_S, concurrent.futures.FIRST_COMPLETED
            )
            for future, batch in self._pending.items():
                if future not in done and future.running():
                    self._told.tell(batch, read_progress(batch))
            for future in done:
                self._settle(self._pending.pop(future), future)
        return self._efforts

    def _send(self, batch: Batch) -> None:
        self._sent += 1
        environment = {"NPROC": "1"} if _planar(batch) else {}
        order = WorkerCall(pickle.dumps(batch), jax_settings(), environment, self._claim)
        try:
            self._pending[self._executor.submit(compute, order)] = batch
        except RuntimeError as error:  # broken, or shut down
            raise self._lost(error) from error

    def _settle(self, batch: Batch, future: Future[Result]) -> None:
        try:
            result = future.result()
        except WorkerDied as error:
            self._again(batch, str(error))
            return
        except (BadInput, WorkersLost):
            raise
        except (concurrent.futures.BrokenExecutor, concurrent.futures.CancelledError) as error:
            raise self._lost(error) from error
        for handed in result.handed:
            cell_store.write(batch.file(handed.job), handed.data, handed.account)
        self._told.settle(batch)
        self._efforts.append(result.effort)

    def _again(self, batch: Batch, why: str) -> None:
        """What is left of a batch is sent once more."""
        self._told.settle(batch)
        rest = batch.rest(self._sent)
        if not rest.jobs:
            return
        if rest.attempt > ATTEMPTS:
            names = ", ".join(job.cell.name for job in rest.jobs[:3])
            more = f" and {len(rest.jobs) - 3} more" if len(rest.jobs) > 3 else ""
            raise WorkersLost(
                f"a worker has died {ATTEMPTS} times while computing {names}{more} ({why}); is "
                "there enough memory? What was finished is kept, --resume goes on from it"
            )
        self._listener.again(len(rest.jobs), why)
        self._send(rest)

    def _lost(self, error: BaseException) -> WorkersLost:
        why = str(error) or type(error).__name__
        return WorkersLost(
            f"the workers cannot be reached any more ({why}); what was finished is kept, --resume "
            "goes on from it"
        )


def _planar(batch: Batch) -> bool:
    return all(setup.config.engine == "planar" for setup in batch.setups.values())
