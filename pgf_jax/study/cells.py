"""A sweep's cells on disk: an immutable Parquet file each, named by what its results depend on.

`cells/KEY.parquet` is one row of two columns, `tasks` and `events`: the cell's tables, as lists of
structs. Its metadata says where it comes from. KEY is the digest of the cell's identity, so a cell
is finished when its file is there, wherever and by whomever it was computed. What varies from run
to run (host, times, retries) and the file's own digest stand beside it, in `KEY.json`, which is
written first.
"""

import contextlib
import dataclasses
import fcntl
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.files import read_file
from pgf_jax.guidance.tables import (
    LARGEST,
    TEMPORARY,
    decode_table,
    encode_table,
    provenance,
    write_atomically,
)
from pgf_jax.study import results
from pgf_jax.study.results import EVENT_SCHEMA, TASK_SCHEMA, json_bytes, sha256

FOLDER = "cells"
SESSION = ".session-"  # begins the names of files that are there while a sweep computes
TABLES = {"tasks": TASK_SCHEMA, "events": EVENT_SCHEMA}
_KEY = re.compile(r"[0-9a-f]{64}")


@dataclasses.dataclass(frozen=True)
class Content:
    """A cell's file.

    Attributes:
      tasks, events: its tables, of `TASK_SCHEMA` and `EVENT_SCHEMA`.
      about: where they come from: `identity`, `config`, and `provenance.environment()`.
    """

    tasks: pl.DataFrame
    events: pl.DataFrame
    about: Mapping[str, Any]

    def data(self) -> bytes:
        """The file; the same content gives the same bytes."""
        tables = {"tasks": self.tasks, "events": self.events}
        row = {name: frame.to_struct(name).implode() for name, frame in tables.items()}
        return encode_table(pl.DataFrame(row), self.about)


def key(identity: Mapping[str, Any]) -> str:
    """The name of a cell's file, without its ending: 64 hex digits."""
    return sha256(json.dumps(identity, sort_keys=True, separators=(",", ":")).encode())


def is_key(name: str) -> bool:
    """Whether a name may be a cell's."""
    return _KEY.fullmatch(name) is not None


def path(out: Path, name: str) -> Path:
    """The file of the cell with the key `name`."""
    return out / FOLDER / f"{name}.parquet"


def sidecar(file: Path) -> Path:
    """What varies from run to run, beside a cell's file."""
    return file.with_suffix(".json")


def write(file: Path, data: bytes, account: Mapping[str, Any]) -> None:
    """Write a finished cell, in place of an earlier one if there is any.

    Args:
      file: see `path`.
      data: see `Content.data`.
      account: how it came about: host, times, retries.

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


def read_account(file: Path) -> dict[str, Any]:
    """What is said beside a cell's file of how it came about.

    Raises:
      BadInput: one line that names the file: missing, truncated or corrupt.
    """
    return results.read_json(sidecar(file))


def inputs(file: Path) -> dict[str, Any]:
    """Where a cell's inputs lay when it was computed, as far as it is known; see `INPUTS`.

    Raises:
      BadInput: what stands beside the file is corrupt.
    """
    found = read_account(file).get("inputs") if sidecar(file).exists() else None
    return found if isinstance(found, dict) else {}


def check(file: Path) -> bytes:
    """The bytes of a cell's file, which are those that were written.

    A file alone will do: what stands beside it may have been lost. Then it is decoded here.

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
    """A cell's content.

    Raises:
      BadInput: one line that names the file, and the column: corrupt, or no cell at all.
    """
    frame, metadata = decode_table(data, file)
    about = provenance(metadata, file)
    if not isinstance(about.get("identity"), dict):
        raise BadInput(f"{file}: it does not say what it was computed from")
    tables = []
    for name, schema in TABLES.items():
        expected = pl.List(pl.Struct(schema))
        if len(frame) != 1 or frame.schema.get(name) != expected or frame[name].null_count():
            raise BadInput(f"{file}: expected one row with a list of structs, {name}")
        # An empty list explodes to one null, which is no row.
        rows = frame[name].explode(empty_as_null=False)
        if rows.null_count():
            raise BadInput(f"{file}: {name} has {rows.null_count()} empty rows")
        tables.append(results.conform(rows.struct.unnest(), file, schema))
    return Content(tables[0], tables[1], about)


def read(file: Path) -> Content:
    """Read a cell, checked against its name and the digest beside it.

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
    """Keys of the cells in a folder of results."""
    files = (out / FOLDER).glob("*.parquet")
    return {file.stem for file in files if is_key(file.stem) and file.is_file()}


@contextlib.contextmanager
def only_writer(out: Path) -> Iterator[None]:
    """Keep other sweeps out of a folder, and tidy up after one that was killed.

    Raises:
      BadInput: another one is at it, or the folder cannot be made.
    """
    folder = out / FOLDER
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
