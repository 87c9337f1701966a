"""`pgf_jax.load_sweep`: the results of a finished sweep, as Polars frames."""

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, is_folder, read_file, read_json
from pgf_jax.metrics.summary import CellSummary
from pgf_jax.sweeping import cell_file, columns
from pgf_jax.sweeping.cell_store import MANIFEST
from pgf_jax.sweeping.summary import summary_of
from pgf_jax.tables import results
from pgf_jax.tables.parquet import LARGEST, decode_table

_LARGEST_CSV = 64 * MIB


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedSweep:
    """The results of a finished sweep. `pgf_jax/README.md` explains every column.

    Attributes:
      folder: of the results.
      tasks: one row for each task; with a column for each setting that decides on it.
      events: one row for each event, with the same columns.
      summary: one row for each cell (policy, fleet size, seed): its metrics.
      fleets: one row for each policy and fleet size: means over fleets, with intervals; empty in
        results of versions that had none.
      paired: one row for each fleet size, two policies and value: differences on the same tasks.
      manifest: settings, seed, versions, code, and digests of cells and files.
    """

    folder: Path
    tasks: pl.DataFrame
    events: pl.DataFrame
    summary: pl.DataFrame
    fleets: pl.DataFrame
    paired: pl.DataFrame
    manifest: Mapping[str, Any]


def load_sweep(folder: Path | str) -> LoadedSweep:
    """Load the results of a finished sweep.

    Args:
      folder: of the results, as given to `sweep` with `out`.

    Raises:
      BadInput: one line that names the folder or the file: no finished sweep, or not as written.
    """
    folder = Path(folder)
    manifest = _manifest(folder)
    tables = {
        "tasks": _table(folder, "tasks", columns.TASK_SCHEMA),
        "events": _table(folder, "events", columns.EVENT_SCHEMA),
    }
    csvs = {name: _csv(folder / f"{name}.csv") for name in ("summary", "fleets", "paired")}
    return LoadedSweep(folder=folder, manifest=manifest, **tables, **csvs)


def _manifest(folder: Path) -> dict[str, Any]:
    if not is_folder(folder):
        raise BadInput(f"{folder}: no such folder, expected results of a sweep")
    if not (folder / MANIFEST).is_file():
        hint = ""
        if (folder / cell_file.FOLDER).is_dir():
            hint = "; it is not finished: the same sweep with --resume goes on"
        raise BadInput(f"{folder}: holds no finished sweep (no {MANIFEST}){hint}")
    return read_json(folder / MANIFEST)


def _table(folder: Path, name: str, schema: Mapping[str, pl.DataType]) -> pl.DataFrame:
    path = folder / f"{name}.parquet"
    frame, _ = decode_table(read_file(path, "results of a sweep", LARGEST), path)
    if "seed" in frame.columns:
        return results.conform(frame, path, schema)
    # Earlier versions merged their cells without the columns of settings; the cells have them.
    files = [cell_file.path(folder, key) for key in sorted(cell_file.finished(folder))]
    merged = columns.merged(map(cell_file.read, files), name)
    cells = frame.select("policy", "robots").unique(maintain_order=True)
    return cells.join(merged, on=["policy", "robots"], how="left", maintain_order="left_right")


def _csv(path: Path) -> pl.DataFrame:
    if not path.is_file():
        return pl.DataFrame()
    data = read_file(path, "results of a sweep", _LARGEST_CSV)
    try:
        return pl.read_csv(io.BytesIO(data), infer_schema_length=None, null_values="NaN")
    except pl.exceptions.PolarsError as error:
        raise BadInput(f"{path}: truncated or malformed, expected a CSV file ({error})") from None


def summaries_of(folder: Path | str) -> list[CellSummary]:
    """The metrics of the cells of a finished sweep, in the order of its configuration.

    Raises:
      BadInput: see `load_sweep`.
    """
    folder = Path(folder)
    listed = _manifest(folder).get("cells")
    names = [cell.get("file") for cell in listed if isinstance(cell, dict)] if listed else []
    keys = [Path(name).stem for name in names if isinstance(name, str)]
    if not keys or not all(map(cell_file.is_key, keys)):
        raise BadInput(f"{folder / MANIFEST}: edited: it does not list the cells")
    return [summary_of(cell_file.read(cell_file.path(folder, key))) for key in keys]
