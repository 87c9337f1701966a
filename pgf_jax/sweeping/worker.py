"""A worker's side of a sweep: computes a batch of cells, and stores or returns each of them.

The folder of the results is the channel to the sweep. A worker that sees the sweep's session file
in it writes each cell there as soon as it is finished, reports its progress in a file, and stops
when the session file is gone. A worker that does not see it, on a machine with other disks, returns
its cells with its result.
"""

import contextlib
import dataclasses
import datetime
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pgf_jax import cores, provenance
from pgf_jax.errors import BadInput
from pgf_jax.files import TEMPORARY
from pgf_jax.plugins.registry import require
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.cell_store import SESSION
from pgf_jax.sweeping.resolve import CellSpec
from pgf_jax.sweeping.run_cells import BatchStats, run_cells

REPORT_EVERY_S = 0.5  # progress; and how often a worker looks whether to go on


@dataclasses.dataclass(frozen=True)
class Batch:
    """Cells for one worker.

    Attributes:
      number: of the batch, unique in its session.
      session: of the sweep, as `open_session` named it.
      cells: to compute.
      kind: `provenance.kind()` of the process that sends it.
      attempt: 1, or more where workers have died of it before.
    """

    number: int
    session: str
    cells: tuple[CellSpec, ...]
    kind: Mapping[str, str]
    attempt: int = 1

    def is_finished(self, cell: CellSpec) -> bool:
        """Whether a cell's file exists and is of this session, not an older one to be replaced."""
        try:
            account = cell_file.read_account(cell.path) if cell.path.is_file() else {}
            return account.get("session") == self.session
        except BadInput:
            return False

    def rest(self, number: int) -> "Batch":
        """The cells that are not finished, as a new batch; an attempt is one that finished none."""
        cells = tuple(cell for cell in self.cells if not self.is_finished(cell))
        attempt = self.attempt + 1 if len(cells) == len(self.cells) else 1
        return dataclasses.replace(self, number=number, cells=cells, attempt=attempt)


class ReturnedCell(NamedTuple):
    """A finished cell that its worker could not write, as arguments of `cell_file.write`."""

    index: int  # in its batch
    data: bytes
    account: dict[str, Any]


class BatchResult(NamedTuple):
    """The result of a batch: the cells that could not be written where they were computed."""

    returned: tuple[ReturnedCell, ...]
    stats: BatchStats


def run_batch(
    batch: Batch,
    on_progress: Callable[["BatchProgress"], None] | None = None,
    *,
    threads: int = 1,
) -> BatchResult:
    """Compute a batch.

    Args:
      batch: the cells.
      on_progress: called with the progress, in place of a file in the folder.
      threads: calls of the engine at a time.

    Raises:
      BadInput: something it was given cannot be used, or a cell cannot be written; or this machine
        differs from the one that asks in something that decides on results.
      Stopped: the session has ended.
    """
    ours, here = provenance.kind(), f"worker on {provenance.host()['name']}"
    if ours != batch.kind:
        name = next(name for name in batch.kind if ours.get(name) != batch.kind[name])
        raise BadInput(f"{here}: has {name} {ours.get(name)}, expected {batch.kind[name]} as here")
    for plugin in {plugin for cell in batch.cells for plugin, _ in cell.plugins}:
        require(plugin, here)
    writer = CellWriter(batch, on_progress)
    # Some are finished where an executor sends a batch again by itself, after a worker's death.
    cells = [cell for cell in batch.cells if not batch.is_finished(cell)]
    stats = run_cells(cells, writer, threads=threads, stop=writer.has_ended)
    return BatchResult(tuple(writer.returned), stats)


# -- the session ---------------------------------------------------------------------------------


class BatchProgress(NamedTuple):
    """The progress of a batch; indices are those of its cells.

    Attributes:
      running: of each cell under way: index, tasks that have ended, its fleet's clock in ns.
      finished: cells whose files are written.
    """

    running: tuple[tuple[int, int, int], ...]
    finished: tuple[int, ...]


@contextlib.contextmanager
def open_session(folders: Sequence[Path], name: str) -> Iterator[Callable[[], None]]:
    """Open a session: workers that see the folders write into them until it ends.

    Yields:
      What ends it early, so that workers stop at their next look.

    Raises:
      BadInput: the folders cannot be written to.
    """
    tokens = [_token(folder, name) for folder in folders]

    def end() -> None:
        for token in tokens:
            with contextlib.suppress(OSError):  # read-only by now: workers find out themselves
                token.unlink(missing_ok=True)

    try:
        for token in tokens:
            try:
                token.touch()
            except OSError as error:
                raise BadInput(f"{token}: cannot be written ({error.strerror})") from error
        yield end
    finally:
        end()
        for token in tokens:
            for report in token.parent.glob(f"{token.name}.*"):
                with contextlib.suppress(OSError):
                    report.unlink()


def read_progress(batch: Batch) -> BatchProgress:
    """The progress that a batch's worker has reported; empty where it cannot be read."""
    indices = range(len(batch.cells))
    try:
        running, finished = json.loads(_progress_file(batch).read_bytes())
        read = BatchProgress(tuple((i, int(n), int(ns)) for i, n, ns in running), tuple(finished))
        if all(index in indices for index in (*(i for i, *_ in read.running), *read.finished)):
            return read
    except (OSError, TypeError, ValueError):
        pass
    return BatchProgress((), ())


def _token(folder: Path, session: str) -> Path:
    """The file that exists while a session is open."""
    return folder / cell_file.FOLDER / f"{SESSION}{session}"


def _progress_file(batch: Batch) -> Path:
    token = _token(batch.cells[0].out, batch.session)
    return token.with_name(f"{token.name}.{batch.number}")


class CellWriter:
    """Writes finished cells, or keeps them to be returned; reports progress; a `CellListener`.

    Attributes:
      returned: finished cells whose folder is not seen from here.
    """

    def __init__(self, batch: Batch, on_progress: Callable[[BatchProgress], None] | None) -> None:
        self.returned: list[ReturnedCell] = []
        self._batch, self._on_progress = batch, on_progress
        self._index = {cell: i for i, cell in enumerate(batch.cells)}
        self._running: dict[int, tuple[int, int, int]] = {}
        self._finished: list[int] = []
        self._began, self._start = _now(), time.perf_counter()
        self._looked = time.monotonic()
        folders = {cell.out for cell in batch.cells}
        self._shared = {out for out in folders if _token(out, batch.session).is_file()}

    def progress(self, cell: CellSpec, tasks: int, time_ns: int) -> None:
        """See `CellListener.progress`."""
        index = self._index[cell]
        self._running[index] = index, tasks, time_ns

    def finished(self, cell: CellSpec, content: cell_file.Content) -> None:
        """See `CellListener.finished`."""
        index = self._index[cell]
        account = {
            "cell": cell.name,
            "session": self._batch.session,
            "host": provenance.host(),
            "cores": cores.usable(),
            "began": self._began,
            "ended": _now(),
            "wall_s": round(time.perf_counter() - self._start, 3),
            "computed_together": len(self._batch.cells),
            "attempt": self._batch.attempt,
            "inputs": dict(cell.inputs),
        }
        data = content.data()
        if cell.out in self._shared:
            cell_file.write(cell.path, data, account)
            self._finished.append(index)
        else:
            self.returned.append(ReturnedCell(index, data, account))
        self._running.pop(index, None)
        self._report()

    def has_ended(self) -> bool:
        """Whether the session has ended."""
        now = time.monotonic()
        if self._on_progress is None and now - self._looked < REPORT_EVERY_S:
            return False
        self._looked = now
        self._report()
        return any(not _token(out, self._batch.session).is_file() for out in self._shared)

    def _report(self) -> None:
        progress = BatchProgress(tuple(self._running.values()), tuple(self._finished))
        if self._on_progress is not None:
            self._on_progress(progress)
        elif self._shared:
            file = _progress_file(self._batch)
            temporary = file.with_name(f"{file.name}{TEMPORARY}")
            # Where it cannot be written (a full disk, say), the sweep learns it from the cells.
            with contextlib.suppress(OSError):
                temporary.write_text(json.dumps(progress))
                os.replace(temporary, file)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
