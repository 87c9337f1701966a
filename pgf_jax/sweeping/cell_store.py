"""The cells of a sweep in its folder of results: which are finished, and whose the folder is."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import TEMPORARY
from pgf_jax.fleet.config import Cell
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.resolve import ResolvedSweep, differences

MANIFEST, RUN = "manifest.json", "run.json"
RESULTS = ("tasks.parquet", "events.parquet", "summary.csv", "paired.csv", "fig6.png")
SESSION = ".session-"  # begins the names of files that exist while a sweep computes


class CellStore:
    """The cells of one sweep on disk.

    Nothing is written before `open`.

    Attributes:
      sweep: the sweep.
      kept: its cells that are finished and will not be computed again.
      missing: its other cells.

    Raises:
      BadInput: the folder holds results of another configuration, or files of unknown origin; or,
        on resuming, a file that is not as it was written.
    """

    def __init__(self, sweep: ResolvedSweep) -> None:
        self.sweep = sweep
        found = _finished_cells(sweep)
        keep = sweep.config.resume
        self.kept = tuple(cell for cell in sweep.cells if keep and cell.key in found)
        self.missing = tuple(cell for cell in sweep.cells if not (keep and cell.key in found))

    @property
    def out(self) -> Path:
        """The folder."""
        return self.sweep.config.out

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Make the folder, and keep other sweeps out of it meanwhile.

        Raises:
          BadInput: another sweep computes in it, or it cannot be made or written to.
        """
        with only_writer(self.out):
            for folder in (self.out, self.out / cell_file.FOLDER):
                if not os.access(folder, os.W_OK | os.X_OK):
                    raise BadInput(f"out: {self.out} cannot be written to")
            yield

    def remove_merged(self) -> None:
        """Remove the merged results, which are made again when all cells are finished.

        So a folder has a manifest when its sweep is finished, and only then.

        Raises:
          BadInput: one cannot be removed.
        """
        for name in (MANIFEST, RUN, *RESULTS):
            try:
                (self.out / name).unlink(missing_ok=True)
            except OSError as error:
                raise BadInput(
                    f"{self.out / name}: cannot be replaced ({error.strerror})"
                ) from error

    def read_all(self) -> dict[Cell, cell_file.Content]:
        """Read all cells, in the order of the configuration.

        Raises:
          BadInput: one line that names a file: missing, or not as it was written.
        """
        return {spec.cell: cell_file.read(spec.path) for spec in self.sweep.cells}


def _finished_cells(sweep: ResolvedSweep) -> set[str]:
    """Keys of the finished cells in a sweep's folder; BadInput where it is not the sweep's."""
    config, out = sweep.config, sweep.config.out
    if not out.exists():
        return set()
    if not out.is_dir():
        raise BadInput(f"out: {out} is a file, expected a folder")
    old = sorted((out / cell_file.FOLDER).glob("*/cell.json"))
    if old:
        raise _foreign(old[0], "of an older version of pgf_jax", out)
    known = {cell.key for cell in sweep.cells}
    found = cell_file.finished(out)
    for key in sorted(found):
        file = cell_file.path(out, key)
        if key not in known:
            raise _unknown_cell(sweep, file)
        if config.resume:
            cell_file.check(file)
    leftover = [name for name in (*RESULTS, MANIFEST) if (out / name).exists()]
    if leftover and not found:
        # Their cells are gone, and only they could say what these were computed from.
        raise _foreign(out / leftover[0], "without the cells they were merged from", out)
    return found


def _unknown_cell(sweep: ResolvedSweep, file: Path) -> BadInput:
    """The message about a cell that is not one of the sweep's."""
    out = sweep.config.out
    theirs = cell_file.decode(cell_file.check(file), file).about["identity"]
    fleet = theirs.get("fleet")
    for ours in sweep.cells:
        name = (ours.cell.policy, ours.cell.robots)
        if isinstance(fleet, dict) and (fleet.get("policy"), fleet.get("robots")) == name:
            words = differences(theirs, ours.identity) or "by its name"
            return _foreign(file, f"of another configuration ({words})", out)
    what = "an unknown cell"
    if isinstance(fleet, dict):
        policy, robots = (short_repr(fleet.get(name), 40) for name in ("policy", "robots"))
        what = f"{policy} with {robots} robots, a cell"
    return _foreign(file, f"of {what} that this configuration has not", out)


def _foreign(file: Path, what: str, out: Path) -> BadInput:
    return BadInput(f"{file}: results {what}; choose another folder with --out, or delete {out}")


@contextlib.contextmanager
def only_writer(out: Path) -> Iterator[None]:
    """Keep other sweeps out of a folder, and remove what a killed one has left half-written.

    Raises:
      BadInput: another sweep is at it, or the folder cannot be made.
    """
    folder = out / cell_file.FOLDER
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise BadInput(f"out: {out} cannot be made ({error.strerror})") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BadInput(f"out: {out} is in use by another sweep") from None
        except OSError:  # a file system without locks: the user's care has to do
            pass
        half_written = *folder.glob(f".*{TEMPORARY}"), *out.glob(f".*{TEMPORARY}")
        for leftover in (*half_written, *folder.glob(f"{SESSION}*")):
            with contextlib.suppress(OSError):
                leftover.unlink()
        yield
    finally:
        os.close(descriptor)
