"""Writes the log of a session as sessions did before their tables named their fleet."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pgf_jax.fleet.events import Event
from pgf_jax.tables.parquet import write_table
from pgf_jax.tables.results import events_frame


def write_log(path: Path, events: Iterable[Event], about: Mapping[str, Any]) -> None:
    """Write a table of events, with its header as provenance."""
    write_table(path, events_frame(events), about)
