"""Reading and writing of Parquet tables with fixed columns, whole or not at all."""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, parse_json, read_file, write_atomically
from pgf_jax.tables.decoder import Undecodable, decode

PROVENANCE = "pgf_jax"  # key of the provenance in a file's metadata
LARGEST = 512 * MIB  # largest size of a table's file; a sweep of 1000 robots takes about 100


def write_table(path: Path | str, frame: pl.DataFrame, about: Mapping[str, Any] | None) -> None:
    """Write a table; the same table gives the same bytes.

    Args:
      path: the file.
      frame: the table.
      about: its provenance, stored as JSON in the file's metadata; None: nothing.

    Raises:
      BadInput: it cannot be written there.
    """
    write_atomically(path, encode_table(frame, about))


def encode_table(frame: pl.DataFrame, about: Mapping[str, Any] | None = None) -> bytes:
    """The bytes of the file that `write_table` writes."""
    buffer = io.BytesIO()
    metadata = None if about is None else {PROVENANCE: json.dumps(about, sort_keys=True)}
    frame.write_parquet(buffer, metadata=metadata)
    return buffer.getvalue()


def read_table(path: Path | str, schema: Mapping[str, pl.DataType], what: str) -> pl.DataFrame:
    """Read a table and check its columns.

    Args:
      path: the file.
      schema: its columns; none may have nulls. Other columns are left out.
      what: what the file should hold, for the message.

    Raises:
      BadInput: the file is missing, not a whole Parquet file, empty, or lacks a column.
    """
    data = read_file(path, f"{what} (Parquet)", LARGEST)
    return check_columns(decode_table(data, path)[0], schema, str(path))


def decode_table(data: bytes, path: Path | str) -> tuple[pl.DataFrame, dict[str, str]]:
    """The table in the bytes of a Parquet file, and the file's metadata.

    Raises:
      BadInput: one line that names the file: truncated, corrupt, or no Parquet file at all.
    """
    try:
        return decode(data)
    except Undecodable as error:
        raise BadInput(
            f"{path}: truncated or corrupt, not a readable Parquet file ({error})"
        ) from None


def read_provenance(path: Path | str) -> dict[str, Any]:
    """Read a table's provenance: the `about` of `write_table`.

    Raises:
      BadInput: the file has none, or cannot be read.
    """
    data = read_file(path, "a table (Parquet)", LARGEST)
    return provenance(decode_table(data, path)[1], path)


def provenance(metadata: Mapping[str, str], path: Path | str) -> dict[str, Any]:
    """The provenance in the metadata that `decode_table` returns; see `read_provenance`."""
    try:
        about = parse_json(metadata.get(PROVENANCE, ""))
    except ValueError:
        about = None
    if not isinstance(about, dict):
        raise BadInput(f"{path}: does not say where it comes from")
    return about


def check_columns(
    frame: pl.DataFrame, schema: Mapping[str, pl.DataType], name: str
) -> pl.DataFrame:
    """The columns of `schema`; BadInput with `name` in the message if they are not as it says."""
    for column, dtype in schema.items():
        if column not in frame.columns:
            raise BadInput(f"{name}: column {column} is missing, expected {', '.join(schema)}")
        if frame.schema[column] != dtype:
            raise BadInput(
                f"{name}: column {column} has type {frame.schema[column]}, expected {dtype}"
            )
        if frame[column].null_count():
            raise BadInput(
                f"{name}: column {column} has {frame[column].null_count()} nulls, expected none"
            )
    if frame.is_empty():
        raise BadInput(f"{name}: holds no rows, expected one or more")
    return frame.select(list(schema))
