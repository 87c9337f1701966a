"""The cells of a sweep in its folder of results: which are finished, and whose the folder is."""

import contextlib
import fcntl
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import TEMPORARY
from pgf_jax.fleet.config import Cell
from pgf_jax.scene.file import save_scenes
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.config import SCENES
from pgf_jax.sweeping.resolve import CellSpec, ResolvedSweep, differences

MANIFEST, RUN = "manifest.json", "run.json"
RESULTS = (
    *("tasks.parquet", "events.parquet", "summary.csv", "fleets.csv", "paired.csv"),
    "fig6.png",
)
SESSION = ".session-"  # begins the names of files that exist while a sweep computes


class CellStore:
    """The cells of one sweep on disk.

    Nothing is written before `open`.

    Attributes:
      sweep: the sweep.
      kept: its cells that are finished and will not be computed again.
      missing: its other cells.
      changed: of these, the ones of which there is a file of another version of a plugin.

    Raises:
      BadInput: the folder holds results of another configuration, or files of unknown origin; or,
        on resuming, a file that is not as it was written.
    """

    def __init__(self, sweep: ResolvedSweep) -> None:
        self.sweep = sweep
        found, self._old = _finished_cells(sweep)
        self.changed = tuple(self._old.values())
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
            scenes = self.sweep.config.scenes
            if isinstance(scenes, tuple):
                save_scenes(self.out / SCENES, scenes)
            yield

    def remove_changed(self) -> None:
        """Remove the files of another version of a plugin, when what replaces them is there.

        Raises:
          BadInput: one cannot be removed.
        """
        for file in self._old:
            cell_file.remove(file)

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


def _finished_cells(sweep: ResolvedSweep) -> tuple[set[str], dict[Path, CellSpec]]:
    """The finished cells in a sweep's folder.

    Returns:
      Their keys; and the files of those that differ in the version of a plugin alone.

    Raises:
      BadInput: the folder is not the sweep's.
    """
    config, out = sweep.config, sweep.config.out
    old: dict[Path, CellSpec] = {}
    if not out.exists():
        return set(), old
    if not out.is_dir():
        raise BadInput(f"out: {out} is a file, expected a folder")
    oldest = sorted((out / cell_file.FOLDER).glob("*/cell.json"))
    if oldest:
        raise _foreign(oldest[0], "of an older version of pgf_jax", out)
    known = {cell.key for cell in sweep.cells}
    found = cell_file.finished(out)
    for key in sorted(found):
        file = cell_file.path(out, key)
        if key not in known:
            old[file] = _changed_cell(sweep, file)
        elif config.resume:
            cell_file.check(file)
    leftover = [name for name in (*RESULTS, MANIFEST) if (out / name).exists()]
    if leftover and not found:
        # Their cells are gone, and only they could say what these were computed from.
        raise _foreign(out / leftover[0], "without the cells they were merged from", out)
    return found & known, old


def _changed_cell(sweep: ResolvedSweep, file: Path) -> CellSpec:
    """The sweep's cell that a file holds, made by another version of a plugin.

    Raises:
      BadInput: it holds none; the message leads with the setting that differs.
    """
    out = sweep.config.out
    theirs = cell_file.decode(cell_file.check(file), file).about["identity"]
    closest = None
    for ours in sweep.cells:
        if _without(theirs, "plugins") == _without(ours.identity, "plugins"):
            return ours
        words = differences(theirs, ours.identity)
        if _fleet(theirs, "policy", "robots") == _fleet(ours.identity, "policy", "robots"):
            closest = min(closest or words, words, key=lambda w: w.count(";"))
    if not closest:
        policy, robots = (short_repr(value, 40) for value in _fleet(theirs, "policy", "robots"))
        closest = f"{policy} with {robots} robots, which this sweep has not"
    raise BadInput(
        f"{closest}: {out} holds results of other settings ({file.name}); choose another folder "
        f"with --out, or delete {out}"
    )


def _fleet(identity: Mapping[str, Any], *names: str) -> tuple[Any, ...]:
    """Settings of the fleet of an identity."""
    fleet = identity.get("fleet")
    return tuple(fleet.get(name) if isinstance(fleet, dict) else None for name in names)


def _without(identity: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in identity.items() if key != name}


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
