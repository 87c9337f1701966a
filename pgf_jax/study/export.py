"""Exports a study as a data set that others can use: Psych-DS, with all that a replay needs.

Psych-DS (psych-ds.github.io) is a convention of the behavioural sciences: tables of a study as CSV,
each column described in `dataset_description.json`. Times are since the participant's page was
there first, so that no row tells on which day somebody took part.
"""

import dataclasses
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.files import json_bytes, write_atomically
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.planning.types import Status
from pgf_jax.study.codebook import TABLES, variables
from pgf_jax.study.design import DESIGN, TEXTS, Design
from pgf_jax.study.records import Person, SessionRecord, read_people
from pgf_jax.sweeping.summary import csv
from pgf_jax.tables.event_log import digest

DESCRIPTION = "dataset_description.json"
_SECONDS = 4  # digits of times at the page
Row = dict[str, Any]


def table_file(table: str) -> str:
    """The name of a table's file."""
    return f"description-{table}_data.csv"


def export(design: Design, out: Path) -> dict[str, pl.DataFrame]:
    """Write the data set; returns its tables.

    An earlier one in the same folder is replaced, once the new one is whole.

    Raises:
      BadInput: a file of the study is damaged, or the folder holds something else.
    """
    if out.exists() and not (out / DESCRIPTION).is_file() and any(out.iterdir()):
        raise BadInput(f"{out}: is not empty, and no exported study; expected a new folder")
    people = read_people(design)
    tables = study_tables(design, people)
    part = out.with_name(out.name + ".part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        (part / "data").mkdir(parents=True)
        for name, frame in tables.items():
            write_atomically(part / "data" / table_file(name), csv(frame))
        _copy_materials(design, part / "materials")
        for person in people:
            for session in person.sessions:
                place = part / "data" / "raw" / f"participant-{person.number:03d}" / session.name
                place.mkdir(parents=True)
                shutil.copyfile(session.log.path, place / session.log.path.name)
        write_atomically(part / "README.md", _readme(design, tables).encode())
        write_atomically(part / DESCRIPTION, json_bytes(_description(design)))
        if out.exists():
            shutil.rmtree(out)
        part.rename(out)
    except OSError as error:
        raise BadInput(f"{out}: cannot be written: {error.strerror or error}") from None
    return tables


def study_tables(design: Design, people: Iterable[Person]) -> dict[str, pl.DataFrame]:
    """The tables of a study, by name; see `codebook.TABLES`."""
    rows: dict[str, list[Row]] = {name: [] for name in TABLES}
    for person in people:
        who = {"participant": person.number}
        rows["participants"].append(who | _participant(design, person))
        began_ms = next((event["at_ms"] for event in person.progress.events), 0)
        for event in person.progress.events:
            name = event["event"] if event["kind"] == "page" else event["kind"]
            place = {"step": event["step"], "step_name": event["name"]}
            at = {"server_s": _since(event["at_ms"], began_ms)}
            rows["visits"].append(who | {"visit_event": name} | place | at)
        for session in person.sessions:
            where = who | {
                "session": session.name,
                "block": session.block,
                "condition": session.condition,
                "scene_seed": session.scene_seed,
            }
            rows["sessions"].append(where | _session(session))
            rows["inputs"] += [where | dataclasses.asdict(one) for one in session.inputs]
            if session.tasks is not None:
                rows["tasks"] += [where | row for row in session.tasks.iter_rows(named=True)]
            rows["timing"] += [where | _timing(event, began_ms) for event in session.timing]
        for answered in person.answered:
            asked = design.questionnaires[answered.questionnaire]
            about = who | {"block": answered.block, "condition": answered.condition}
            about |= {"questionnaire": answered.questionnaire}
            score = asked.scored(answered.answers)
            rows["scores"].append(about | {"score": score, "took_s": answered.took_s})
            for item in asked.items:
                answer = answered.answers.get(item.name)
                given = {"item": item.name, "question": item.text}
                number = answer if item.kind == "scale" else None
                text = None if answer is None else str(answer)
                rows["answers"].append(about | given | {"answer": text, "answer_value": number})
    return {
        name: pl.DataFrame(
            [{column: row.get(column) for column in schema} for row in rows[name]],
            schema=dict(schema),
        ).with_columns(pl.col(pl.Float64).fill_nan(None))
        for name, (_, schema) in TABLES.items()
    }


def _participant(design: Design, person: Person) -> Row:
    conditions, blocks = list(design.conditions), person.progress.blocks
    gaps, gaps_s = person.gaps
    return {
        "order": " ".join(conditions[block.condition] for block in blocks),
        "scene_order": " ".join(str(design.blocks.scene_seeds[b.scenes]) for b in blocks),
        "finished": person.progress.finished,
        "attentive": person.attentive,
        "gaps": gaps,
        "gaps_s": gaps_s,
    }


def _session(session: SessionRecord) -> Row:
    records: list[TaskRecord] = session.task_records
    return {
        "ended": session.ended,
        "simulated_s": session.seconds,
        "tasks_ended": sum(record.status is not Status.CENSORED for record in records),
        "tasks_solved": sum(record.status is Status.SOLVED for record in records),
        "services": len(session.inputs),
        "events_sha256": digest(session.log.events),
    }


def _timing(event: Mapping[str, Any], began_ms: float) -> Row:
    server = event.get("server_ms")
    return {
        "page_event": event["event"],
        "browser_s": _since(event["client_ms"], began_ms),
        "server_s": None if server is None else _since(server, began_ms),
        "action": event.get("id"),
        **{name: event.get(name) for name in ("robot", "task", "request")},
        "round_trip_ms": event.get("rtt_ms"),
        "clock_offset_ms": event.get("offset_ms"),
    }


def _since(at_ms: float, began_ms: float) -> float:
    return round((at_ms - began_ms) / 1000, _SECONDS)


def _copy_materials(design: Design, folder: Path) -> None:
    (folder / "questionnaires").mkdir(parents=True)
    for name in (DESIGN, *(f"{text}.md" for text in TEXTS)):
        shutil.copyfile(design.folder / name, folder / name)
    for name in design.questionnaires:
        file = f"questionnaires/{name}.toml"
        shutil.copyfile(design.folder / file, folder / file)


def _description(design: Design) -> dict[str, Any]:
    about = design.dataset
    content: dict[str, Any] = {
        "@context": "https://schema.org/",
        "@type": "Dataset",
        "name": design.title,
        "description": about.description,
        "schemaVersion": "Psych-DS 0.4.0",
        "variableMeasured": variables(),
    }
    if about.authors:
        content["creator"] = [{"@type": "Person", "name": name} for name in about.authors]
    if about.license:
        content["license"] = about.license
    return content


def _readme(design: Design, tables: Mapping[str, pl.DataFrame]) -> str:
    lines = [f"| `data/{table_file(name)}` | {TABLES[name][0]} | {len(frame)} |"
             for name, frame in tables.items()]  # fmt: skip
    return f"""# {design.title}

{design.dataset.description}

| table | holds | rows |
| --- | --- | ---: |
{chr(10).join(lines)}

What each column means, and its unit, is in `{DESCRIPTION}`. An empty cell means that it does not
apply. `materials/` has what participants read and were asked. `data/raw/` has the event log of each
session, with its settings; with the program `pgf_jax` of the version that the log names,

    pgf-jax sweep --operator replay --log data/raw/participant-001/block1

repeats it bit for bit.
"""
