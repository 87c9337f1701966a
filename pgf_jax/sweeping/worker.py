"""A batch of cells in a worker: computed together, and handed over one by one.

The folder of the results is the channel. A worker that finds the sweep's session in it writes each
cell there as soon as it is finished, says how far it is, and stops when the session is gone. One
that does not, on a machine that has other disks, brings its cells home with its result.
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
from pgf_jax.sweeping import cell_store
from pgf_jax.sweeping.resolve import Setup
from pgf_jax.sweeping.run_cells import BatchStats, Job, run_cells

SAY_EVERY_S = 0.5  # progress, and how often a worker looks whether it is still wanted


@dataclasses.dataclass(frozen=True)
class Batch:
    """Cells for one worker.

    Attributes:
      number: of the batch, in its session; no two that are sent have the same.
      session: of the sweep, as `open_session` named it.
      setups: of the jobs' sweeps, by number.
      jobs: the cells.
      keys: of each, as the parent has it.
      kind: `provenance.kind()` of the parent.
      attempt: 1, or more where workers have died of it before.
    """

    number: int
    session: str
    setups: Mapping[int, Setup]
    jobs: tuple[Job, ...]
    keys: tuple[str, ...]
    kind: Mapping[str, str]
    attempt: int = 1

    def file(self, job: Job) -> Path:
        """The file that a cell is to be."""
        return cell_store.path(self.setups[job.sweep].config.out, self.keys[self.jobs.index(job)])

    def is_finished(self, job: Job) -> bool:
        """Whether a cell's file is there, and of this session: not an older one to be replaced."""
        file = self.file(job)
        try:
            return file.is_file() and cell_store.read_account(file).get("session") == self.session
        except BadInput:
            return False

    def rest(self, number: int) -> "Batch":
        """What is left of it, as another batch; its attempts count those that finished no cell."""
        jobs = tuple(job for job in self.jobs if not self.is_finished(job))
        return dataclasses.replace(
            self,
            number=number,
            jobs=jobs,
            keys=tuple(self.keys[self.jobs.index(job)] for job in jobs),
            attempt=self.attempt + 1 if len(jobs) == len(self.jobs) else 1,
        )


class Handed(NamedTuple):
    """A cell that is brought home: what `cells.write` takes."""

    job: Job
    data: bytes
    account: dict[str, Any]


class Result(NamedTuple):
    """What comes of a batch: the cells that could not be written where they were computed."""

    handed: tuple[Handed, ...]
    effort: BatchStats


def run_batch(batch: Batch, on_progress: Callable[["Progress"], None] | None = None) -> Result:
    """Compute a batch.

    Args:
      batch: what.
      on_progress: called instead of saying in the folder how far it is.

    Raises:
      BadInput: something it was given cannot be used, or a cell cannot be written; or this machine
        is another kind than that which asked.
      Stopped: the session has ended.
    """
    ours = provenance.kind()
    if ours != batch.kind:
        name = next(name for name in batch.kind if ours.get(name) != batch.kind[name])
        raise BadInput(
            f"worker on {provenance.host()['name']}: has {name} {ours.get(name)}, expected "
            f"{batch.kind[name]} as here"
        )
    clerk = CellWriter(batch, on_progress)
    # Some are finished where an executor sends a batch again by itself, after a worker's death.
    jobs = [job for job in batch.jobs if not batch.is_finished(job)]
    effort = run_cells(batch.setups, jobs, clerk, stop=clerk.unwanted)
    return Result(tuple(clerk.handed), effort)


# -- the session ---------------------------------------------------------------------------------


class Progress(NamedTuple):
    """How far a batch is; indices are those of its jobs.

    Attributes:
      running: of each cell under way: index, tasks that have ended, its fleet's clock in ns.
      finished: cells whose files are written.
    """

    running: tuple[tuple[int, int, int], ...]
    finished: tuple[int, ...]


@contextlib.contextmanager
def open_session(folders: Sequence[Path], name: str) -> Iterator[Callable[[], None]]:
    """While this is open, workers that see the folders write into them.

    Yields:
      What ends it before, for the workers to stop at their next look.

    Raises:
      BadInput: nothing can be written there.
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
            for said in token.parent.glob(f"{token.name}.*"):
                with contextlib.suppress(OSError):
                    said.unlink()


def read_progress(batch: Batch) -> Progress:
    """What a batch's worker has said; nothing where it cannot be heard, or makes no sense."""
    places = range(len(batch.jobs))
    try:
        running, finished = json.loads(_said(batch).read_bytes())
        said = Progress(tuple((p, int(n), int(ns)) for p, n, ns in running), tuple(finished))
        if all(place in places for place in (*(p for p, *_ in said.running), *said.finished)):
            return said
    except (OSError, TypeError, ValueError):
        pass
    return Progress((), ())


def _token(folder: Path, session: str) -> Path:
    return folder / cell_store.FOLDER / f"{cell_store.SESSION}{session}"


def _said(batch: Batch) -> Path:
    """Where a batch's worker says how far it is."""
    folder = batch.setups[batch.jobs[0].sweep].config.out
    token = _token(folder, batch.session)
    return token.with_name(f"{token.name}.{batch.number}")


class CellWriter:
    """Hands cells over, and keeps in touch; a `Listener`."""

    def __init__(self, batch: Batch, on_progress: Callable[[Progress], None] | None) -> None:
        self.handed: list[Handed] = []
        self._batch, self._on_progress = batch, on_progress
        self._place = {job: i for i, job in enumerate(batch.jobs)}
        self._running: dict[int, tuple[int, int, int]] = {}
        self._finished: list[int] = []
        self._began, self._start = _now(), time.perf_counter()
        self._looked = time.monotonic()
        outs = {setup.config.out for setup in batch.setups.values()}
        self._shared = {out for out in outs if _token(out, batch.session).is_file()}

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """See `Listener.progress`."""
        place = self._place[job]
        self._running[place] = place, tasks, time_ns

    def finished(self, job: Job, content: cell_store.Content) -> None:
        """See `Listener.finished`."""
        setup, place = self._batch.setups[job.sweep], self._place[job]
        account = {
            "cell": job.cell.name,
            "session": self._batch.session,
            "host": provenance.host(),
            "cores": cores.usable(),
            "began": self._began,
            "ended": _now(),
            "wall_s": round(time.perf_counter() - self._start, 3),
            "computed_together": len(self._batch.jobs),
            "attempt": self._batch.attempt,
            "inputs": setup.config.inputs(),
        }
        data = content.data()
        if setup.config.out in self._shared:
            cell_store.write(self._batch.file(job), data, account)
            self._finished.append(place)
        else:
            self.handed.append(Handed(job, data, account))
        self._running.pop(place, None)
        self._say()

    def unwanted(self) -> bool:
        """Whether the session has ended."""
        now = time.monotonic()
        if self._on_progress is None and now - self._looked < SAY_EVERY_S:
            return False
        self._looked = now
        self._say()
        return any(not _token(out, self._batch.session).is_file() for out in self._shared)

    def _say(self) -> None:
        progress = Progress(tuple(self._running.values()), tuple(self._finished))
        if self._on_progress is not None:
            self._on_progress(progress)
        elif self._shared:
            said = _said(self._batch)
            temporary = said.with_name(f"{said.name}{TEMPORARY}")
            # Whoever cannot be told (the disk is full, say) will learn it from the cells.
            with contextlib.suppress(OSError):
                temporary.write_text(json.dumps(progress))
                os.replace(temporary, said)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
