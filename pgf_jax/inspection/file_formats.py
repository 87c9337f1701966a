"""Describes every file that the program writes: columns and keys, with their meanings and units.

    python -m pgf_jax.inspection.file_formats  # as Markdown

The meanings of columns are read from the docstrings of the classes whose fields they are.
"""

import inspect
import re
from collections.abc import Mapping
from typing import NamedTuple

import polars as pl

from pgf_jax.fleet.events import Event
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.metrics.summary import CellSummary
from pgf_jax.plans.execute import Execution
from pgf_jax.plans.execute_command import EXECUTION_SCHEMA
from pgf_jax.plans.file import Plan
from pgf_jax.sweeping.columns import TASK_SCHEMA, setting_texts
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.summary import FleetsSummary, Paired, paired_frame
from pgf_jax.tables.forks import FORK_COLUMNS, FUTURE_COLUMNS
from pgf_jax.tables.results import MERGED_EVENT_SCHEMA, with_extra
from pgf_jax.tables.runs import RUN_COLUMNS

_OF_A_CELL = {"policy": "of the cell: its policy", "robots": "of the cell: R, the fleet's size"}
_OF_AN_INTERVAL = {
    "low": "lower end of its 95 % interval",
    "high": "upper end of its 95 % interval",
    "n": "number of values it is over",
}


_INTRODUCTION = """\
A sweep's folder has `tasks.parquet`, `events.parquet`, `summary.csv`, `fleets.csv`, `paired.csv`,
`fig6.png`, `manifest.json`, `run.json`, and for each cell `cells/KEY.parquet` (one row of two
columns, `tasks` and `events`: lists of structs with the columns below up to `attempts` and
`outcome`, without `policy` and `robots`) and `cells/KEY.json`; and `scenes.json`, where scenes were
given as objects. A session's folder has `events.jsonl` (a line of JSON for each event, without what
does not apply), and at its end `events.parquet`, `tasks.parquet`, `summary.csv` and `session.json`.
Tables of tasks and of events end with a column for each setting that decides on them, the same in
all sweeps and sessions, so that they can be stacked; `pgf_jax.load_sweep` reads a sweep's.
Collected data are `autonomous/runs.parquet`, `human/runs.parquet`, `forks/forks.parquet` and
`futures/futures.parquet`, each beside a `collect.json` with its settings. The metadata of a Parquet
file, key `pgf_jax`, say where it comes from: settings, seed, versions, code. Checkpoints are in
[`checkpoints/README.md`](../checkpoints/README.md). What does not apply is null.

Some columns, and events of kind `check`, are there only where a fleet's final checks are real
rollouts or its reaches may miss: `checks`, `check_misses` and `attempts` of tasks; `first_attempt`,
`grasp_misses`, `checks` and `check_misses` of summaries. Others are there only where robots plan
while they ask or are served: `asking_s`, `served_s`, `lost_s` and `withdrawn` of tasks. Where only
some cells of a sweep have them, they are null in the others (in CSV files empty)."""


class Table(NamedTuple):
    """A table, Parquet or CSV.

    Attributes:
      name: of the file, within its folder.
      what: it holds.
      columns: column -> type and meaning.
    """

    name: str
    what: str
    columns: Mapping[str, tuple[str, str]]


class JsonFile(NamedTuple):
    """A file of JSON.

    Attributes:
      name: of the file, within its folder.
      what: it holds.
      keys: key -> meaning.
    """

    name: str
    what: str
    keys: Mapping[str, str]


def tables() -> list[Table]:
    """The tables, Parquet and CSV."""
    tasks = _OF_A_CELL | attributes(TaskRecord) | {"scene": "name of the task's scene"}
    tasks |= {term: f"{term} of `cost`" for term in ("c_d", "c_f", "c_b")}
    settings = setting_texts(attributes(SweepConfig))
    tasks |= {"task_time_s": attributes(CellSummary)["task_time_s"], **settings}
    events = _OF_A_CELL | attributes(Event)
    paired = attributes(Paired)
    paired |= {"mean": paired["difference"], **_OF_AN_INTERVAL}
    return [
        Table(
            "tasks.parquet",
            "one row for each task",
            _columns(with_extra(TASK_SCHEMA), tasks),
        ),
        Table(
            "events.parquet",
            "one row for each event; the columns of settings are those of `tasks.parquet`",
            _columns(MERGED_EVENT_SCHEMA, events),
        ),
        Table("summary.csv", "one row for each cell", _summary(CellSummary)),
        Table("fleets.csv", "one row for each policy and fleet size", _summary(FleetsSummary)),
        Table(
            "paired.csv",
            "one row for each fleet size, two policies and value",
            _columns(paired_frame([]).schema, paired),
        ),
        Table(
            "executions.parquet",
            "one row for each execution of a plan",
            _columns(EXECUTION_SCHEMA, attributes(Execution)),
        ),
        Table("runs.parquet", "one row for each iteration of each run", _texts(RUN_COLUMNS)),
        Table("forks.parquet", "one row for each state and key", _texts(FORK_COLUMNS)),
        Table(
            "futures.parquet",
            "one row for each state and key, with the columns of `forks.parquet`; the futures last "
            "until the reach is solved or the task's time is up, and the first without input is "
            "what the robot itself did",
            _texts({n: c for n, c in FUTURE_COLUMNS.items() if n not in FORK_COLUMNS}),
        ),
    ]


def scene_format() -> JsonFile:
    """The keys of a scene's file."""
    return JsonFile(
        "NAME.json",
        "a scene; all keys have to be there",
        {
            "version": "1",
            "name": "of the scene; names its plan",
            "goal": "index of the goal object, 0-based",
            "shelf": "width, between the side walls, and depth, from its front at x 0.20 m to the "
            "back wall, m",
            "objects": "of each object: x, y, radius, height (m), mass (kg), table_friction "
            "(coefficient on the table) and friction (with other bodies)",
        },
    )


def plan_format() -> JsonFile:
    """The keys of a plan's file."""
    keys = attributes(Plan)
    keys |= {
        "scene": "name of the scene",
        "objects": "[x, y, radius] of each object, m",
        "goal": "index of the goal object, 0-based",
        "scene_file": "where objects or shelf are not standard: the scene as its own file has it",
        "segments": "executed pushes, then the best reach: kind, duration_s (s), controls "
        "([vx, vy, wz] of each knot, m/s and rad/s, along the world axes), gripper (0 open .. 255 "
        "closed, at each knot's end)",
        "made_by": "versions, device, processor, code; and options and threads of XLA",
    }
    order = ["scene", "status", *(k for k in keys if k not in ("scene", "status"))]
    return JsonFile("NAME.plan.json", "a plan", {key: keys[key] for key in order})


_JSON = [
    JsonFile(
        "manifest.json",
        "what the results of a finished sweep are, and where they come from",
        {
            "format": "number of the format",
            "config": "settings of the sweep, without how and where it was computed",
            "cells": "policy, robots, tasks, seed, file and digest of each cell",
            "seed": "of scenes, noise, service times and ties; null where there are several",
            "engine": "physics engine",
            "lanes": "L, robots computed in one call",
            "rollouts": "K, noisy rollouts of an iteration",
            "physics": "constants of the physics; times in s",
            "planner": "settings of the planner and of the cost",
            "scenes": "class or folder of the scenes, and their number of objects",
            "predictors": "of each network: digest, training data, figures",
            "plugins": "of what plugins registered: module, version, digests",
            "versions": "of Python and of the packages",
            "device": "what JAX computed on",
            "processor": "type of the processor",
            "code": "commit, and a digest of the source",
            "origins": "types of processor and code that the cells were computed by",
            "files": "digests of the merged files",
        },
    ),
    JsonFile(
        "run.json",
        "how the sweep was run the last time; differs from run to run",
        {
            "out": "the folder",
            "host": "the computer and the process, with options and threads of XLA",
            "workers": "number of worker processes, or the scheduler",
            "batches": "number of batches of cells",
            "cells_kept": "names of the cells that were finished before",
            "cells_sent_again": "number of cells computed again after a worker's death",
            "wall_clock": "times, s",
            "iterations": "that robots requested, and that were computed",
            "occupancy": "work whose result was used, and work computed",
        },
    ),
    JsonFile(
        "cells/KEY.json",
        "how a cell was computed; differs from run to run",
        {
            "sha256": "digest of the cell's file",
            "bytes": "its size",
            "cell": "the cell's name",
            "session": "of the sweep, a random name",
            "host": "the computer and the process, with options and threads of XLA",
            "cores": "that the process could use",
            "began": "time at which its batch began, UTC",
            "ended": "time at which it was finished, UTC",
            "wall_s": "between the two, s",
            "computed_together": "number of cells in its batch",
            "attempt": "1, or more where workers had died of it",
            "inputs": "where scenes, predictor and log were",
        },
    ),
    JsonFile(
        "session.json",
        "what a session at the console depends on; also the first line of its events.jsonl",
        {
            "settings": "of the session; `speed` in simulated s a s, `patience` in s",
            "identity": "everything that its events depend on, but for the person",
            "environment": "versions, device, processor, code; and options and threads of XLA",
        },
    ),
]


def json_formats() -> list[JsonFile]:
    """The JSON files, by their keys."""
    return [scene_format(), plan_format(), *_JSON]


def markdown() -> str:
    """All formats, as Markdown."""
    parts = [_INTRODUCTION]
    for table in tables():
        rows = [f"| `{name}` | {kind} | {text} |" for name, (kind, text) in table.columns.items()]
        head = f"**`{table.name}`**, {table.what}:\n\n| column | type | meaning |\n|---|---|---|"
        parts.append("\n".join([head, *rows]))
    for file in json_formats():
        rows = [f"| `{name}` | {text} |" for name, text in file.keys.items()]
        head = f"**`{file.name}`**, {file.what}:\n\n| key | meaning |\n|---|---|"
        parts.append("\n".join([head, *rows]))
    return "\n\n".join(parts)


def attributes(cls: type) -> dict[str, str]:
    """Name -> text of the attributes in a class's docstring.

    Raises:
      ValueError: the docstring has none.
    """
    _, _, section = inspect.cleandoc(cls.__doc__ or "").partition("Attributes:\n")
    if not section:
        raise ValueError(f"{cls.__name__} describes no attributes")
    texts: dict[str, str] = {}
    for names, text in re.findall(r"^  (\w[\w, ]*): (.*(?:\n    .*)*)", section, re.M):
        for name in names.split(", "):
            texts[name] = " ".join(text.split()).rstrip(".")
    return texts


def _summary(kind_of_row: type) -> dict[str, tuple[str, str]]:
    """Columns of a summary: its fields, an interval as four columns."""
    texts, columns = attributes(kind_of_row), {}
    for name, kind in inspect.get_annotations(kind_of_row).items():
        columns[name] = ("Interval" if "Interval" in str(kind) else kind.__name__, texts[name])
    return {
        (f"{name}, {name}_low, {name}_high, {name}_n" if kind == "Interval" else name): (
            "mean, low, high, n" if kind == "Interval" else kind,
            text,
        )
        for name, (kind, text) in columns.items()
    }


def _columns(
    schema: Mapping[str, pl.DataType], texts: Mapping[str, str]
) -> dict[str, tuple[str, str]]:
    return {name: (str(dtype), texts[name]) for name, dtype in schema.items()}


def _texts(columns: Mapping[str, tuple[pl.DataType, str]]) -> dict[str, tuple[str, str]]:
    return {name: (str(dtype), text) for name, (dtype, text) in columns.items()}


if __name__ == "__main__":
    print(markdown())
