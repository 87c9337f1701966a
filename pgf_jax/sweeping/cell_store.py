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

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import TEMPORARY, json_bytes, read_file, read_json, sha256, write_atomically
from pgf_jax.fleet.config import Cell
from pgf_jax.sweeping import cell_store
from pgf_jax.sweeping.config import INPUTS, SweepConfig
from pgf_jax.sweeping.resolve import Setup, identity
from pgf_jax.tables import results
from pgf_jax.tables.parquet import LARGEST, decode_table, encode_table, provenance
from pgf_jax.tables.results import EVENT_SCHEMA, TASK_SCHEMA

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
    return read_json(sidecar(file))


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


MANIFEST, RUN = "manifest.json", "run.json"


RESULTS = ("tasks.parquet", "events.parquet", "summary.csv", "paired.csv", "fig6.png")


def keys_of(setup: Setup) -> dict[Cell, str]:
    """The names of a sweep's cells."""
    return {cell: cell_store.key(identity(setup, cell)) for cell in setup.config.cells()}


def check_folder(setup: Setup, keys: Mapping[Cell, str]) -> set[Cell]:
    """Compare the results in a sweep's folder, if any, with its configuration.

    Returns:
      The cells that are finished and to be kept: none unless the configuration says `resume`.

    Raises:
      BadInput: the folder holds results of another configuration, or something that is neither;
        or, on resuming, a file that is not as it was written.
    """
    config, out = setup.config, setup.config.out
    if not out.exists():
        return set()
    if not out.is_dir():
        raise BadInput(f"out: {out} is a file, expected a folder")
    folder = out / cell_store.FOLDER
    old = sorted(folder.glob("*/cell.json"))
    if old:
        raise _foreign(old[0], "of an older version of pgf_jax", out)
    known = {key: cell for cell, key in keys.items()}
    found: set[Cell] = set()
    for key in sorted(cell_store.finished(out)):
        file = cell_store.path(out, key)
        if key not in known:
            raise _other(setup, file)
        found.add(known[key])
        if config.resume:
            cell_store.check(file)
    leftover = [name for name in (*RESULTS, MANIFEST) if (out / name).exists()]
    if leftover and not found:
        # Their cells are gone, and only they could say what these were computed from.
        raise _foreign(out / leftover[0], "without the cells they were merged from", out)
    return found if config.resume else set()


def check_writable(out: Path) -> None:
    """That a folder cannot be written should not turn up after hours.

    Raises:
      BadInput: it cannot.
    """
    for folder in (out, out / cell_store.FOLDER):
        if not os.access(folder, os.W_OK | os.X_OK):
            raise BadInput(f"out: {out} cannot be written to")


def reopen(out: Path) -> None:
    """Take away what was made from the cells: there will be others, and it is made again.

    So there is a manifest where a sweep is finished, and only there.

    Raises:
      BadInput: it cannot be taken away.
    """
    for name in (MANIFEST, RUN, *RESULTS):
        try:
            (out / name).unlink(missing_ok=True)
        except OSError as error:
            raise BadInput(f"{out / name}: cannot be replaced ({error.strerror})") from error


def _other(setup: Setup, file: Path) -> BadInput:
    """What to say about a cell that is none of this sweep's."""
    out = setup.config.out
    theirs = cell_store.decode(cell_store.check(file), file).about["identity"]
    fleet = theirs.get("fleet")
    for cell in setup.config.cells():
        if isinstance(fleet, dict) and (fleet.get("policy"), fleet.get("robots")) == (
            cell.policy,
            cell.robots,
        ):
            words = differences(theirs, identity(setup, cell)) or "by its name"
            return _foreign(file, f"of another configuration ({words})", out)
    what = "an unknown cell"
    if isinstance(fleet, dict):
        policy, robots = (short_repr(fleet.get(name), 40) for name in ("policy", "robots"))
        what = f"{policy} with {robots} robots, a cell"
    return _foreign(file, f"of {what} that this configuration has not", out)


def _foreign(file: Path, what: str, out: Path) -> BadInput:
    return BadInput(f"{file}: results {what}; choose another folder with --out, or delete {out}")


def differences(theirs: Any, ours: Mapping[str, Any]) -> str:
    """Where two identities differ, in words; empty where they do not."""
    if not isinstance(theirs, dict):
        return "it does not say which"
    words = []
    for key in [*ours, *(key for key in theirs if key not in ours)]:
        a, b = theirs.get(key), ours.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            inner = differences(a, b)
            words += [inner] if inner else []
        elif a != b or (key in theirs) != (key in ours):
            words.append(f"{_short(key)} {_short(a)}, now {_short(b)}")
    return "; ".join(words)


def _short(value: object) -> str:
    text = value if isinstance(value, str) and value.isprintable() else short_repr(value, 40)
    return text if len(text) <= 40 else text[:37] + "..."


def config_of(content: cell_store.Content, inputs: Mapping[str, Any], out: Path) -> SweepConfig:
    """The sweep of one cell alone.

    Args:
      content: the cell.
      inputs: where scenes, checkpoints and log lie, see `INPUTS`.
      out: folder for the results.

    Raises:
      BadInput: what the cell says of its configuration cannot be one.
    """
    settings = content.about.get("config")
    if not isinstance(settings, dict):
        raise BadInput("it does not say what its configuration was")
    known = {field.name for field in dataclasses.fields(SweepConfig)}
    unknown = sorted(settings.keys() - known)
    if unknown:
        raise BadInput(f"its configuration has {unknown[0]}, which a sweep has not")
    given: dict[str, Any] = {**settings, "out": out}
    for name in ("robots", "policies"):
        if isinstance(given.get(name), list):
            given[name] = tuple(given[name])
    for name in INPUTS:
        if inputs.get(name) is not None:
            given[name] = inputs[name] if name == "predictor" else Path(inputs[name])
    return SweepConfig(**given)
