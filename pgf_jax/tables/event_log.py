"""Event logs on disk, in one format for people and simulated operators.

A session writes the journal `events.jsonl` while it runs: a first line (the header) with everything
that the session depends on, then one line for each event, with the columns that apply. The table
`events.parquet` holds the same events, with columns that say which fleet they are of. Sweeps write
such tables too, of many fleets.
"""

import contextlib
import dataclasses
import fcntl
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import (
    MIB,
    is_file,
    is_folder,
    open_file,
    parse_json,
    read_file,
    sha256,
    write_atomically,
)
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.tables.parquet import LARGEST, decode_table, provenance
from pgf_jax.tables.results import (
    EVENT_SCHEMA,
    MERGED_EVENT_SCHEMA,
    conform,
    event_log,
)

JOURNAL, TABLE = "events.jsonl", "events.parquet"
FORMAT = 1
_KIND = "pgf_jax session"
_LONGEST_LINE = 1 << 20  # bytes, more than any header has
_LARGEST_JOURNAL = 256 * MIB  # 30 robots with 50 tasks each write about 20
_EXPECTED = "an event log"


@dataclasses.dataclass(frozen=True, eq=False)
class EventLog:
    """The content of an event log.

    Attributes:
      path: the file.
      fleets: the events of each fleet, in order; a session has one fleet.
      about: the header of the session that wrote the log, with `settings` and `identity`; empty for
        the log of a sweep.
      size: number of bytes that could be read: the last line may be cut off where a process was
        killed.
    """

    path: Path
    fleets: list[list[Event]]
    about: Mapping[str, Any]
    size: int = 0

    @property
    def settings(self) -> dict[str, Any] | None:
        """The settings of the session; None in the log of a sweep."""
        return self.about.get("settings")

    @property
    def events(self) -> list[Event]:
        """The events of the only fleet.

        Raises:
          BadInput: the log is not of one fleet.
        """
        if len(self.fleets) != 1:
            raise BadInput(f"{self.path}: expected the log of one fleet, got {len(self.fleets)}")
        return self.fleets[0]


def read_log(path: Path | str) -> EventLog:
    """Read an event log.

    Args:
      path: `events.jsonl`, `events.parquet`, or the folder of a session or of a sweep.

    Raises:
      BadInput: one line that names the file: missing, corrupt, or no event log. A last line that
        was cut off is no error: the session was killed, and the line is left out.
    """
    path = Path(path)
    if is_folder(path):
        # A running session has no table yet; the events at a session's end are in the table only.
        found = [path / name for name in (TABLE, JOURNAL) if is_file(path / name)]
        if not found:
            raise BadInput(f"{path}: expected a folder with {TABLE} or {JOURNAL}")
        path = found[0]
    if path.suffix == ".jsonl":
        return _read_journal(path)
    frame, metadata = _read_table(path)
    about = _provenance(metadata, path)
    # The other columns say which fleet a row is of: policy, size, seed, and other settings.
    of_fleet = [name for name in frame.columns if name not in EVENT_SCHEMA]
    parts = frame.partition_by(of_fleet, maintain_order=True) if of_fleet else [frame]
    fleets = [event_log(part) for part in parts]
    for events in fleets:
        for number, event in enumerate(events):
            _check(event, events[number - 1] if number else None, f"{path}: row {number + 1}")
    return EventLog(path, fleets, about)


def first_difference(events: Sequence[Event], log: Sequence[Event]) -> int | None:
    """Index of the first event of `log` that differs from `events`; None if there is none."""
    for number, theirs in enumerate(log):
        if number == len(events) or line(events[number]) != line(theirs):
            return number
    return None


def digest(events: Iterable[Event]) -> str:
    """The digest of a log's events; it does not depend on how they are stored."""
    return sha256("".join(map(line, events)).encode())


# -- lines ---------------------------------------------------------------------------------------


def line(event: Event) -> str:
    """An event as a line of JSON with its newline; columns that are None or nan are left out."""
    columns = {}
    for name, value in zip(Event._fields, event, strict=True):
        if value is None or (isinstance(value, float) and math.isnan(value)):
            continue
        # JSON has no infinity, which a stuck robot bids.
        columns[name] = "inf" if value == math.inf else value
    return json.dumps(columns) + "\n"


def _event(columns: Any, where: str) -> Event:
    if not isinstance(columns, dict):
        raise BadInput(f"{where}: expected an event (a JSON object), got {short_repr(columns)}")
    columns = dict(columns)
    for name in columns:
        if name not in Event._fields:
            raise BadInput(f"{where}: {short_repr(name)} is no column of an event")
    if columns.get("gain") == "inf":
        columns["gain"] = math.inf
    for name in ("gain", "x", "y"):
        if type(columns.get(name)) is int and abs(columns[name]) < 2**53:
            columns[name] = float(columns[name])
    for name in ("time_ns", "kind"):
        if name not in columns:
            raise BadInput(f"{where}: expected an event with {name}, got none")
    if not isinstance(columns["kind"], str) or columns["kind"] not in set(EventKind):
        raise BadInput(f"{where}: unknown kind of event {short_repr(columns['kind'])}")
    for name, value in columns.items():
        wanted = {pl.Int64(): int, pl.Float64(): float, pl.String(): str}[EVENT_SCHEMA[name]]
        if type(value) is not wanted:
            raise BadInput(f"{where}: {name} must be {EVENT_SCHEMA[name]}, got {short_repr(value)}")
    return Event(**(columns | {"kind": EventKind(columns["kind"])}))


def _check(event: Event, before: Event | None, where: str) -> None:
    """Check the values of an event, and that it is not earlier than the one before."""
    for name in ("time_ns", "robot", "task", "request", "operator", "iteration", "object"):
        value = getattr(event, name)
        # Before the first iteration has ended, `iteration` is None and not -1.
        if value is not None and not 0 <= value < 2**62:
            raise BadInput(f"{where}: {name} must be 0 or more, got {value}")
    for name in ("x", "y"):
        value = getattr(event, name)
        if value is not None and not math.isfinite(value):
            raise BadInput(f"{where}: {name} must be a finite number, got {value}")
    if before is not None and event.time_ns < before.time_ns:
        raise BadInput(
            f"{where}: time_ns {event.time_ns} is before the {before.time_ns} of the one above"
        )


def _read_journal(path: Path) -> EventLog:
    about: dict[str, Any] = {}
    events: list[Event] = []
    size = 0
    try:
        with open_file(path, _EXPECTED, _LARGEST_JOURNAL) as file:
            for number, text in enumerate(iter(lambda: file.readline(_LONGEST_LINE), b"")):
                where = f"{path}: line {number + 1}"
                if not text.endswith(b"\n"):
                    if len(text) == _LONGEST_LINE:
                        raise BadInput(f"{where}: is longer than that of any event")
                    break  # cut off
                content = _json(text, where)
                if number == 0:
                    about = _header(content, where)
                else:
                    event = _event(content, where)
                    _check(event, events[-1] if events else None, where)
                    events.append(event)
                size += len(text)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}), expected {_EXPECTED}") from None
    if not about:
        raise BadInput(f"{path}: is empty, expected {_EXPECTED}")
    return EventLog(path, [events], about, size)


def _json(text: bytes, where: str) -> Any:
    try:
        return parse_json(text)
    except ValueError:
        raise BadInput(f"{where}: expected JSON, got {short_repr(text)}") from None


def _header(content: Any, where: str) -> dict[str, Any]:
    if not isinstance(content, dict) or content.get("what") != _KIND:
        raise BadInput(f"{where}: expected the head of an event log, got {short_repr(content)}")
    if content.get("format") != FORMAT:
        raise BadInput(f"{where}: format {short_repr(content.get('format'))}, expected {FORMAT}")
    return _checked(content, where)


def _checked(about: dict[str, Any], where: str) -> dict[str, Any]:
    """Check the header of a session."""
    for name in ("settings", "identity"):
        if not isinstance(about.get(name), dict):
            raise BadInput(f"{where}: expected {name} of the session, got none")
    if not isinstance(about["identity"].get("versions"), dict):
        raise BadInput(f"{where}: expected versions in the session's identity, got none")
    return about


def _read_table(path: Path) -> tuple[pl.DataFrame, Mapping[str, str]]:
    frame, metadata = decode_table(read_file(path, _EXPECTED, LARGEST), path)
    schema = MERGED_EVENT_SCHEMA if "policy" in frame.columns else EVENT_SCHEMA
    return conform(frame, path, schema, others=True), metadata


def _provenance(metadata: Mapping[str, str], path: Path) -> Mapping[str, Any]:
    try:
        about = provenance(metadata, path)
    except BadInput:  # the table of a sweep's cell has none
        return {}
    return _checked(about, str(path)) if "settings" in about else {}


# -- the journal ---------------------------------------------------------------------------------


class Journal:
    """Writes `events.jsonl` while a session runs.

    Events are on the disk when `append` returns, so that they are not lost when the process is
    killed or the computer is switched off.
    """

    def __init__(self, path: Path, about: Mapping[str, Any] | None, *, keep: int = 0) -> None:
        """Begin a new journal, or continue an old one.

        Args:
          path: the file.
          about: the header of a new journal, with `settings` and `identity`; None: continue.
          keep: number of bytes of the old journal that could be read; the rest is cut off.

        Raises:
          BadInput: the file cannot be written, or exists although it should be new.
        """
        self.path = path
        if about is not None:
            with self._writing():
                exists = path.exists()
            if exists:
                raise BadInput(f"{path}: exists; expected a new folder, or --resume")
            head = json.dumps({"what": _KIND, "format": FORMAT, **about}) + "\n"
            write_atomically(path, head.encode())  # a part of a header could not be read
            keep = len(head.encode())
        with self._writing():
            self._file: io.BufferedIOBase = path.open("r+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise BadInput(f"{path}: another server writes it; stop that one first") from None
        with self._writing():
            self._file.truncate(keep)
            self._file.seek(keep)
            os.fsync(self._file.fileno())

    def append(self, events: Sequence[Event]) -> None:
        """Write events to the disk before this returns.

        Raises:
          BadInput: they could not be written.
        """
        if not events:
            return
        with self._writing():
            self._file.write("".join(map(line, events)).encode())
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        with self._writing():
            self._file.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise BadInput(f"{self.path}: cannot be written ({error.strerror})") from None
