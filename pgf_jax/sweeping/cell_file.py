"""The file of a finished cell: immutable, and named by everything that its results depend on.

`cells/KEY.parquet` has one row of two columns, `tasks` and `events`: the cell's tables, as lists of
structs. Its metadata says where it comes from. KEY is the digest of the cell's identity. So a cell
is finished when its file exists, wherever and by whomever it was computed. What varies from run to
run (host, times, retries) and the file's own digest are in `KEY.json` beside it, which is written
first.
"""

import dataclasses
import functools
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.files import json_bytes, read_file, read_json, sha256, write_atomically
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.sweeping.config import SCENES
from pgf_jax.tables import results
from pgf_jax.tables.parquet import LARGEST, decode_table, encode_table, provenance
from pgf_jax.tables.results import EVENT_SCHEMA, TASK_SCHEMA, with_extra

FOLDER = "cells"
TABLES = {"tasks": TASK_SCHEMA, "events": EVENT_SCHEMA}
_KEY = re.compile(r"[0-9a-f]{64}")


@dataclasses.dataclass(frozen=True)
class Content:
    """The content of a cell's file.

    Attributes:
      tasks, events: its tables, of `TASK_SCHEMA` (where the fleet has them with the columns of
        `EXTRA_SCHEMA`) and `EVENT_SCHEMA`.
      about: where they come from: `identity`, `config`, and `provenance.origin()`.
    """

    tasks: pl.DataFrame
    events: pl.DataFrame
    about: Mapping[str, Any]

    @functools.cached_property
    def records(self) -> list[TaskRecord]:
        """The task records of the table of tasks."""
        return results.task_records(self.tasks)

    def data(self) -> bytes:
        """The bytes of the file; the same content gives the same bytes."""
        tables = {"tasks": self.tasks, "events": self.events}
        row = {name: frame.to_struct(name).implode() for name, frame in tables.items()}
        return encode_table(pl.DataFrame(row), self.about)


def key(identity: Mapping[str, Any]) -> str:
    """The key of a cell: 64 hex digits, the digest of its identity."""
    return sha256(json.dumps(identity, sort_keys=True, separators=(",", ":")).encode())


def is_key(name: str) -> bool:
    """Whether a text has the form of a cell's key."""
    return _KEY.fullmatch(name) is not None


def path(out: Path, key: str) -> Path:
    """The file of a cell in the folder `out` of results."""
    return out / FOLDER / f"{key}.parquet"


def sidecar(file: Path) -> Path:
    """The file beside a cell's that holds what varies from run to run."""
    return file.with_suffix(".json")


def write(file: Path, data: bytes, account: Mapping[str, Any]) -> None:
    """Write the file of a finished cell; an earlier one is replaced.

    Args:
      file: see `path`.
      data: see `Content.data`.
      account: how it was computed: host, times, retries.

    Raises:
      BadInput: it cannot be written.
    """
    record = {"sha256": sha256(data), "bytes": len(data)} | dict(account)
    try:
        file.unlink(missing_ok=True)  # what is beside it will be of the new one
    except OSError as error:
        raise BadInput(f"{file}: cannot be replaced ({error.strerror})") from error
    write_atomically(sidecar(file), json_bytes(record))
    write_atomically(file, data)


def remove(file: Path) -> None:
    """Remove a cell's file, and the one beside it.

    Raises:
      BadInput: it cannot be removed.
    """
    try:
        file.unlink(missing_ok=True)
        sidecar(file).unlink(missing_ok=True)
    except OSError as error:
        raise BadInput(f"{file}: cannot be removed ({error.strerror})") from error


def read_account(file: Path) -> dict[str, Any]:
    """How a cell was computed, from the file beside it.

    Raises:
      BadInput: one line that names the file: missing, truncated or corrupt.
    """
    return read_json(sidecar(file))


def inputs(file: Path) -> dict[str, Any]:
    """Where a cell's inputs were when it was computed (see `INPUTS`); empty if unknown.

    Scenes that were saved beside the results are where the results are now.

    Raises:
      BadInput: the file beside it is corrupt.
    """
    found = read_account(file).get("inputs") if sidecar(file).exists() else None
    if not isinstance(found, dict):
        return {}
    saved = file.parent.parent / SCENES
    if saved.is_file() and Path(str(found.get("scenes"))).name == SCENES:
        return found | {"scenes": str(saved)}
    return found


def check(file: Path) -> bytes:
    """Read the bytes of a cell's file, and check that they are those that were written.

    The file beside it may have been lost. Then the cell is checked by decoding it.

    Raises:
      BadInput: one line that names the file: missing, or not as it was written.
    """
    data = read_file(file, "results of a sweep", LARGEST)
    if not sidecar(file).exists():
        decode(data, file)
    elif read_account(file).get("sha256") != sha256(data):
        raise BadInput(
            f"{file}: truncated or edited, its digest is not the one in {sidecar(file).name}; "
            "delete the two to compute the cell again"
        )
    return data


def decode(data: bytes, file: Path) -> Content:
    """Decode the bytes of a cell's file.

    Raises:
      BadInput: one line that names the file, and the column: corrupt, or no cell at all.
    """
    frame, metadata = decode_table(data, file)
    about = provenance(metadata, file)
    if not isinstance(about.get("identity"), dict):
        raise BadInput(f"{file}: it does not say what it was computed from")
    tables = []
    for name, schema in TABLES.items():
        found = frame.schema.get(name)
        if name == "tasks" and isinstance(found, pl.List) and isinstance(found.inner, pl.Struct):
            schema = with_extra(schema, [field.name for field in found.inner.fields])
        expected = pl.List(pl.Struct(schema))
        if len(frame) != 1 or found != expected or frame[name].null_count():
            raise BadInput(f"{file}: expected one row with a list of structs, {name}")
        # An empty list explodes to one null, which is no row.
        rows = frame[name].explode(empty_as_null=False)
        if rows.null_count():
            raise BadInput(f"{file}: {name} has {rows.null_count()} empty rows")
        tables.append(results.conform(rows.struct.unnest(), file, schema))
    return Content(tables[0], tables[1], about)


def read(file: Path) -> Content:
    """Read a cell, and check it against its name and the digest beside it.

    Raises:
      BadInput: one line that names the file: missing, truncated, edited, or of another name.
    """
    content = decode(check(file), file)
    if key(content.about["identity"]) != file.stem:
        raise BadInput(
            f"{file}: edited, or of another name: by what it says it is "
            f"{key(content.about['identity'])}"
        )
    return content


def finished(out: Path) -> set[str]:
    """Keys of the finished cells in a folder of results."""
    files = (out / FOLDER).glob("*.parquet")
    return {file.stem for file in files if is_key(file.stem) and file.is_file()}
