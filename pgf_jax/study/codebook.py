"""The tables of an exported study: each column with its meaning, its type and its unit.

A column of one name means the same in all tables, as Psych-DS wants it.
"""

import dataclasses
from collections.abc import Mapping

import polars as pl

from pgf_jax.fleet.records import TaskRecord
from pgf_jax.inspection.file_formats import attributes
from pgf_jax.study.records import Input
from pgf_jax.tables.results import EXTRA_SCHEMA, TASK_SCHEMA

_INT, _FLOAT, _TEXT, _BOOL = pl.Int64(), pl.Float64(), pl.String(), pl.Boolean()
Schema = Mapping[str, pl.DataType]

_WHO: Schema = {"participant": _INT}
_WHERE: Schema = {
    **_WHO,
    "session": _TEXT,
    "block": _INT,
    "condition": _TEXT,
    "scene_seed": _INT,
}
_TYPES = {int: _INT, float: _FLOAT, bool: _BOOL}
# Of a task what is one value; the event logs have everything.
_OF_TASKS = {n: t for n, t in {**TASK_SCHEMA, **EXTRA_SCHEMA}.items() if t.is_numeric()}
_OF_TASKS = {"robot": _INT, "task": _INT, "scene": _TEXT, "status": _TEXT, **_OF_TASKS}
_OF_INPUTS = {
    f.name: _TEXT if f.name == "outcome" else _TYPES.get(f.type) or _FLOAT  # pyright: ignore[reportArgumentType, reportCallIssue]
    for f in dataclasses.fields(Input)
} | {"object": _INT}

TABLES: Mapping[str, tuple[str, Schema]] = {
    "participants": (
        "a row for each participant",
        {
            **_WHO,
            "order": _TEXT,
            "scene_order": _TEXT,
            "finished": _BOOL,
            "attentive": _BOOL,
            "gaps": _INT,
            "gaps_s": _FLOAT,
        },
    ),
    "sessions": (
        "a row for each practice and block that has begun",
        {
            **_WHERE,
            "ended": _BOOL,
            "simulated_s": _FLOAT,
            "tasks_ended": _INT,
            "tasks_solved": _INT,
            "services": _INT,
            "events_sha256": _TEXT,
        },
    ),
    "inputs": ("a row for each time that a robot was served", {**_WHERE, **_OF_INPUTS}),
    "tasks": ("a row for each task of a session that has ended", {**_WHERE, **_OF_TASKS}),
    "answers": (
        "a row for each item of each questionnaire that was answered",
        {
            **_WHO,
            "block": _INT,
            "condition": _TEXT,
            "questionnaire": _TEXT,
            "item": _TEXT,
            "question": _TEXT,
            "answer": _TEXT,
            "answer_value": _FLOAT,
        },
    ),
    "scores": (
        "a row for each questionnaire that was answered",
        {
            **_WHO,
            "block": _INT,
            "condition": _TEXT,
            "questionnaire": _TEXT,
            "score": _FLOAT,
            "took_s": _FLOAT,
        },
    ),
    "timing": (
        "a row for each thing that happened at a page while a session ran",
        {
            **_WHERE,
            "page_event": _TEXT,
            "browser_s": _FLOAT,
            "server_s": _FLOAT,
            "action": _INT,
            "robot": _INT,
            "task": _INT,
            "request": _INT,
            "round_trip_ms": _FLOAT,
            "clock_offset_ms": _FLOAT,
        },
    ),
    "visits": (
        "a row for each time that a page was there, lost, out of sight, or a step was done",
        {**_WHO, "visit_event": _TEXT, "step": _INT, "step_name": _TEXT, "server_s": _FLOAT},
    ),
}

_TEXTS = {
    "participant": "number of the participant, from 1, in the order of arrival",
    "session": "practice, or block1, block2, ... in the participant's own order",
    "block": "number of the block in the participant's own order, from 1; empty: of no block",
    "condition": "name of the condition, as in study.toml; practice: of the practice",
    "scene_seed": "seed of the session's scenes and planners; the same for all who had this set",
    "order": "the conditions in the participant's own order, with spaces between them",
    "scene_order": "the scene seeds of the blocks in that order, with spaces between them",
    "finished": "whether the participant has come to the code at the end",
    "attentive": "whether every attention check so far was answered rightly",
    "gaps": "how often the page was lost, or the server stopped, before the end",
    "gaps_s": "for how long in all; the clock of a session stands meanwhile",
    "ended": "whether the session has ended; else it can still go on",
    "simulated_s": "time of the session's clock",
    "tasks_ended": "tasks that ended by themselves",
    "tasks_solved": "those of them that were solved",
    "services": "times that a robot was served",
    "events_sha256": "digest of the session's events, which a replay repeats",
    "questionnaire": "name of the questionnaire; it is in materials/questionnaires",
    "item": "name of the question",
    "question": "what was asked",
    "answer": "as given",
    "answer_value": "the answer to a scale, as a number",
    "score": "of the scales together, as the questionnaire says; empty: it has none",
    "took_s": "time on the page",
    "page_event": "shown: a request; first_input, click, submit: clicks and keys; told: what came "
    "of one; acknowledged: the answer is recorded; clock: the two clocks were compared",
    "visit_event": "connected, lost; focus_lost, focus_back, hidden, visible; paused, unpaused; "
    "ended_by_experimenter: the session; done: the step; reached_the_end",
    "browser_s": "by the browser's clock, since the participant's page was there first",
    "server_s": "by the server's clock, since the participant's page was there first",
    "action": "number of the click or key since the page was loaded",
    "round_trip_ms": "time of a message to the server and back",
    "clock_offset_ms": "by how much the server's clock was ahead of the browser's",
    "step": "number of the participant's step, from 0",
    "step_name": "its name: of a text, a questionnaire or a condition",
    "scene": "name of the task's scene",
    "c_d": "term of the cost: distance of the goal",
    "c_f": "term of the cost: contact force",
    "c_b": "term of the cost: objects off their places",
}
# What the docstrings of records say of their fields.
TEXTS: Mapping[str, str] = attributes(TaskRecord) | attributes(Input) | _TEXTS


def unit(column: str) -> str:
    """The unit of a column; empty: it has none."""
    for ending, name in (("_ns", "ns"), ("_ms", "ms"), ("_s", "s")):
        if column.endswith(ending):
            return name
    return "m" if column in ("x", "y") else ""


def variables() -> list[dict[str, str]]:
    """All columns, as schema.org's PropertyValue."""
    names = dict.fromkeys(name for _, schema in TABLES.values() for name in schema)
    described = []
    for name in names:
        about = {"@type": "PropertyValue", "name": name, "description": TEXTS[name]}
        described.append(about | ({"unitText": unit(name)} if unit(name) else {}))
    return described
