"""Tables of tasks and events of fleets: `tasks.parquet` and `events.parquet`.

A fleet's tables hold one row for each `TaskRecord` (by robot and task) and one for each `Event` (in
the order of the log). The merged tables of a sweep hold the rows of all cells, with the columns
`policy` and `robots` first, and those of other settings last. A value that does not apply is null.
Nothing in them depends on the speed of the computer.

Tables of tasks have the columns of `ATTEMPT_SCHEMA` only where some fleet's final checks are real
or its reaches may miss, and those of `REQUEST_SCHEMA` only where robots plan while they ask or are
served. They come after the columns of `TASK_SCHEMA`.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import polars as pl

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import read_file
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.planning.types import Status
from pgf_jax.tables.parquet import LARGEST, decode_table

# -- columns -----------------------------------------------------------------------------------

EVENT_SCHEMA: dict[str, pl.DataType] = {
    "time_ns": pl.Int64(),
    "kind": pl.String(),
    "robot": pl.Int64(),
    "task": pl.Int64(),
    "request": pl.Int64(),
    "operator": pl.Int64(),
    "iteration": pl.Int64(),
    "gain": pl.Float64(),
    "object": pl.Int64(),
    "x": pl.Float64(),
    "y": pl.Float64(),
    "outcome": pl.String(),
}

_TYPES = {int: pl.Int64(), float: pl.Float64(), str: pl.String()}
# Fields of `TaskRecord` of other types; `scene` is a column beside them, after `task`.
_OTHER_TYPES: dict[str, dict[str, pl.DataType]] = {
    "task": {"task": pl.Int64(), "scene": pl.String()},
    "status": {"status": pl.String()},
    "first_bid": {"first_bid": pl.Int64()},
    "first_grant": {"first_grant": pl.Int64()},
    "grants_at": {"grants_at": pl.List(pl.Int64())},
    "successful_grants_at": {"successful_grants_at": pl.List(pl.Int64())},
    "asked_cost": {"asked_cost": pl.List(pl.Float64())},
    "helped_cost": {"helped_cost": pl.List(pl.Float64())},
    "non_finite_at": {"non_finite_at": pl.List(pl.Int64())},
    "terms": {"c_d": pl.Float64(), "c_f": pl.Float64(), "c_b": pl.Float64()},
}
# Fields of `TaskRecord` that are None in most fleets.
ATTEMPT_SCHEMA: dict[str, pl.DataType] = {
    "checks": pl.Int64(),
    "check_misses": pl.Int64(),
    "attempts": pl.Int64(),
}
REQUEST_SCHEMA: dict[str, pl.DataType] = {
    "asking_s": pl.Float64(),
    "served_s": pl.Float64(),
    "lost_s": pl.Float64(),
    "withdrawn": pl.Int64(),
}
EXTRA_SCHEMA = ATTEMPT_SCHEMA | REQUEST_SCHEMA
TASK_SCHEMA: dict[str, pl.DataType] = {
    column: dtype
    for field in dataclasses.fields(TaskRecord)
    if field.name not in EXTRA_SCHEMA
    for column, dtype in (
        _OTHER_TYPES.get(field.name) or {field.name: _TYPES[field.type]}  # pyright: ignore[reportArgumentType]
    ).items()
}

_CELL_COLUMNS: dict[str, pl.DataType] = {"policy": pl.String(), "robots": pl.Int64()}
MERGED_TASK_SCHEMA = _CELL_COLUMNS | TASK_SCHEMA
MERGED_EVENT_SCHEMA = _CELL_COLUMNS | EVENT_SCHEMA

_TERMS = ("c_d", "c_f", "c_b")
_COUNTS = ("grants_at", "successful_grants_at", "non_finite_at")  # lists of whole numbers
_COSTS = ("asked_cost", "helped_cost")  # lists of numbers, of which some may be null
_OPTIONAL = {"first_bid", "first_grant", "cost", *_TERMS}  # columns of tasks that may be null


def with_extra(
    schema: Mapping[str, pl.DataType], columns: Iterable[str] = EXTRA_SCHEMA
) -> dict[str, pl.DataType]:
    """A schema of tasks, with the extra columns of most fleets' tables at their place.

    Args:
      schema: without them.
      columns: of a table; where one of `ATTEMPT_SCHEMA` or `REQUEST_SCHEMA` is among them, all of
        that schema are added.
    """
    place = list(schema).index(list(TASK_SCHEMA)[-1]) + 1
    rest, columns = list(schema.items()), set(columns)
    extra = [
        item
        for group in (ATTEMPT_SCHEMA, REQUEST_SCHEMA)
        if columns & set(group)
        for item in group.items()
    ]
    return dict([*rest[:place], *extra, *rest[place:]])


# -- rows --------------------------------------------------------------------------------------


def tasks_frame(
    records: Iterable[TaskRecord], scene_name: Callable[[int, int], str]
) -> pl.DataFrame:
    """Make a table of task records, by robot and task.

    Args:
      records: the records of one fleet, in any order.
      scene_name: (robot, task) -> name of the scene.

    Returns:
      The table, of `TASK_SCHEMA`; with those extra columns that the records have.
    """
    rows = []
    records = sorted(records, key=_key)
    for record in records:
        row = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
        row |= dict(zip(_TERMS, row.pop("terms"), strict=True))
        row |= {name: nan_to_null(row[name]) for name in ("cost", *_TERMS)}
        row |= {name: list(row[name]) for name in _COUNTS}
        row |= {name: list(map(nan_to_null, row[name])) for name in _COSTS}
        rows.append(row | {"status": record.status.value, "scene": scene_name(*_key(record))})
    frame = pl.DataFrame(rows, schema=with_extra(TASK_SCHEMA))
    present = {name for name in ("attempts", "withdrawn") if frame[name].count()}
    return frame.select(list(with_extra(TASK_SCHEMA, present)))


def task_records(tasks: pl.DataFrame) -> list[TaskRecord]:
    """The task records of a table that `tasks_frame` made."""
    records = []
    columns = list(with_extra(TASK_SCHEMA, tasks.columns))
    for row in tasks.select(columns).drop("scene").iter_rows(named=True):
        terms = [row.pop(name) for name in _TERMS]
        row["terms"] = tuple(map(_nan, terms))
        row["cost"] = _nan(row["cost"])
        row["status"] = Status(row["status"])
        row |= {name: tuple(row[name]) for name in _COUNTS}
        row |= {name: tuple(map(_nan, row[name])) for name in _COSTS}
        records.append(TaskRecord(**row))
    return records


def events_frame(events: Iterable[Event]) -> pl.DataFrame:
    """Make a table of an event log, in its order; a gain that is not known yet (nan) is null."""
    rows = [
        (
            *event[:1],
            event.kind.value,
            *event[2:7],
            nan_to_null(event.gain),
            *event[8:11],
            _text(event),
        )
        for event in events
    ]
    return pl.DataFrame(rows, schema=EVENT_SCHEMA, orient="row")


def event_log(events: pl.DataFrame) -> list[Event]:
    """The events of a table that `events_frame` made; an unknown gain is None."""
    rows = events.select(list(EVENT_SCHEMA)).iter_rows()
    return [Event(time_ns, EventKind(kind), *rest) for time_ns, kind, *rest in rows]


def merge(frames: Sequence[tuple[Cell, pl.DataFrame]]) -> pl.DataFrame:
    """Join the tables of all cells into one, with the columns `policy` and `robots` first."""
    return pl.concat(
        frame.select(
            pl.lit(cell.policy, pl.String()).alias("policy"),
            pl.lit(cell.robots, pl.Int64()).alias("robots"),
            pl.all(),
        )
        for cell, frame in frames
    )


def _key(record: TaskRecord) -> tuple[int, int]:
    return record.robot, record.task


def nan_to_null(value: float | None) -> float | None:
    """None in place of nan: a table has no value where nothing is known."""
    return None if value is None or math.isnan(value) else value


def _nan(value: float | None) -> float:
    return math.nan if value is None else value


def _text(event: Event) -> str | None:
    return None if event.outcome is None else str(event.outcome)  # a Status becomes its value


# -- files -------------------------------------------------------------------------------------


def read_results(path: Path | str, schema: Mapping[str, pl.DataType]) -> pl.DataFrame:
    """Read a results file (Parquet) and check its columns.

    Args:
      path: the file.
      schema: its columns: `MERGED_TASK_SCHEMA`, `EVENT_SCHEMA` ...

    Returns:
      The table with the schema's columns, in its order; see `conform`.

    Raises:
      BadInput: one line that names the file: missing, truncated, corrupt, or with other columns.
    """
    path = Path(path)
    return _decode(read_file(path, "results of a sweep", LARGEST), path, schema)


def _decode(data: bytes, path: Path, schema: Mapping[str, pl.DataType]) -> pl.DataFrame:
    return conform(decode_table(data, path)[0], path, schema)


def conform(
    frame: pl.DataFrame, path: Path, schema: Mapping[str, pl.DataType], *, others: bool = False
) -> pl.DataFrame:
    """Check a table's columns and values.

    Args:
      frame: the table.
      path: its file, for messages.
      schema: columns that it must have.
      others: keep its other columns, too.

    Returns:
      The table with the schema's columns, in its order. A table of tasks keeps its extra columns.

    Raises:
      BadInput: one line that names the file and the column: missing, of another type, or with a
        value that no row may have.
    """
    if "status" in schema:
        schema = with_extra(schema, frame.columns)
    for column, dtype in schema.items():
        if frame.schema.get(column) != dtype:
            found = frame.schema.get(column, "nothing")
            raise BadInput(f"{path}: column {column} must be {dtype}, got {found}")
    # In a table of tasks only `_OPTIONAL` columns may be null; in one of events all but these.
    of_tasks = {*_CELL_COLUMNS, *TASK_SCHEMA} - _OPTIONAL
    needed = ("time_ns", "kind", *_CELL_COLUMNS) if "kind" in schema else of_tasks
    for column in schema:
        nulls = frame[column].null_count()
        if column in _COUNTS:
            nulls += frame[column].list.eval(pl.element().is_null()).list.any().sum()
        if nulls and column in needed:
            raise BadInput(f"{path}: {column} is missing in {nulls} rows")
    for column, kinds in (("kind", EventKind), ("status", Status)):
        unknown = set(frame[column].unique()) - set(kinds) if column in schema else ()
        if unknown:
            what = "kind of event" if column == "kind" else column
            raise BadInput(f"{path}: unknown {what} {short_repr(min(unknown))}")
    return frame if others else frame.select(list(schema))
