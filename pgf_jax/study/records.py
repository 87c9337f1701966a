"""What participants have done, read from their folders: nothing is written, also while they go on.

A session's inputs come from its event log, which has simulated time. When the person saw a request
and what they did is of `timing.jsonl`, by the clock of their browser; the two are matched by robot,
task and request.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.files import MIB, is_file, parse_json, read_file
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.study.block import TIMING
from pgf_jax.study.design import Design
from pgf_jax.study.progress import Progress, Step, participants
from pgf_jax.tables.event_log import JOURNAL, TABLE, EventLog, read_log
from pgf_jax.tables.results import MERGED_TASK_SCHEMA, read_results, task_records

PRACTICE = "practice"
_LARGEST = 256 * MIB


@dataclasses.dataclass(frozen=True)
class Input:
    """One service: a robot asked, and was served.

    Attributes:
      robot, task, request: of the service, 0-based.
      asked_s: simulated time of the ask, s.
      granted_s: simulated time from which the robot was served, s.
      ended_s: simulated time of the service's end, s; None: it has none yet.
      outcome: push or go_on: the answer; else why there was none.
      object: that was to be pushed, 0-based.
      x, y: where its centre was to come to, m.
      reorientation_s: from when the page showed the request to the first click or key, s.
      interaction_s: from the first click or key to the answer, s.
      acknowledgement_s: from the answer to the word that it is recorded, s.
      clicks: clicks and keys before the answer.
      acknowledged: whether the page has shown that word.
    """

    robot: int
    task: int
    request: int
    asked_s: float
    granted_s: float
    ended_s: float | None
    outcome: str | None
    object: int | None
    x: float | None
    y: float | None
    reorientation_s: float | None
    interaction_s: float | None
    acknowledgement_s: float | None
    clicks: int
    acknowledged: bool


@dataclasses.dataclass(frozen=True, eq=False)
class SessionRecord:
    """The practice, or a block, that a participant has begun.

    Attributes:
      name: practice, block1, block2, ...
      block: its number in the participant's order, from 1; None: the practice.
      condition: its name; practice.
      scene_seed: of its scenes.
      folder: where it is recorded.
      ended: whether it has ended; else it can still go on.
    """

    name: str
    block: int | None
    condition: str
    scene_seed: int
    folder: Path
    ended: bool

    @functools.cached_property
    def log(self) -> EventLog:
        """Its event log."""
        return read_log(self.folder / (TABLE if self.ended else JOURNAL))

    @functools.cached_property
    def timing(self) -> list[dict[str, Any]]:
        """What happened at the page; a line that was cut off is left out."""
        path = self.folder / TIMING
        if not is_file(path):
            return []
        lines = read_file(path, "times of a page", _LARGEST).splitlines()
        return [event for line in lines if (event := _parsed(line)) is not None]

    @functools.cached_property
    def tasks(self) -> pl.DataFrame | None:
        """Its tasks; None: it has not ended."""
        if not self.ended:
            return None
        return read_results(self.folder / "tasks.parquet", MERGED_TASK_SCHEMA)

    @functools.cached_property
    def task_records(self) -> list[TaskRecord]:
        """Records of its tasks; none where it has not ended."""
        return [] if self.tasks is None else task_records(self.tasks)

    @property
    def seconds(self) -> float:
        """Its simulated time so far, s."""
        events = self.log.events
        return events[-1].time_ns / 1e9 if events else 0.0

    @functools.cached_property
    def inputs(self) -> list[Input]:
        """Its services, in the order in which they began."""
        return inputs_of(self.log.events, self.timing)


@dataclasses.dataclass(frozen=True, eq=False)
class Answers:
    """A questionnaire that was answered.

    Attributes:
      questionnaire: its name.
      block: the block that it follows, from 1; None: none.
      condition: of that block.
      answers: item -> answer.
      took_s: time on the page, s.
    """

    questionnaire: str
    block: int | None
    condition: str | None
    answers: Mapping[str, Any]
    took_s: float


@dataclasses.dataclass(frozen=True, eq=False)
class Person:
    """A participant, as recorded.

    Attributes:
      number: from 1, in the order of arrival.
      progress: where they are, and what has happened.
      sessions: that have begun, in order.
      answered: questionnaires, in order.
    """

    number: int
    progress: Progress
    sessions: tuple[SessionRecord, ...]
    answered: tuple[Answers, ...]

    @property
    def blocks(self) -> tuple[SessionRecord, ...]:
        """The blocks that have ended."""
        return tuple(one for one in self.sessions if one.block is not None and one.ended)

    @property
    def attentive(self) -> bool:
        """Whether every attention check so far was answered rightly."""
        return all(event.get("attentive", True) for event in self.progress.events)

    @property
    def gaps(self) -> tuple[int, float]:
        """How often the page was lost before the end, and for how long in all, s.

        A server that was killed has not noted it: then the time is from the last event before.
        """
        count, gaps_ms = 0, 0
        lost_ms: int | None = None
        before_ms: int | None = None
        for event in self.progress.events:
            kind, at_ms = event["kind"], event["at_ms"]
            if kind == "reached_the_end":
                break
            if kind == "connected" and before_ms is not None:
                since_ms = before_ms if lost_ms is None else lost_ms
                count, gaps_ms, lost_ms = count + 1, gaps_ms + at_ms - since_ms, None
            elif kind == "lost":
                lost_ms = at_ms
            before_ms = at_ms
        return count, gaps_ms / 1000


def read_people(design: Design) -> list[Person]:
    """The participants of a study, in the order of arrival.

    Raises:
      BadInput: one line that names the file.
    """
    return [_person(design, Progress(design, folder)) for folder in participants(design.folder)]


def _person(design: Design, progress: Progress) -> Person:
    conditions = list(design.conditions)

    def of_block(step: Step) -> tuple[int | None, str | None]:
        if step.block is None:
            return None, None
        return step.block + 1, conditions[progress.blocks[step.block].condition]

    sessions, answered = [], []
    for step in progress.steps:
        block, condition = of_block(step)
        folder = progress.session(step)
        if step.kind in ("practice", "block") and is_file(folder / JOURNAL):
            seed = design.practice.seed
            if step.block is not None:
                seed = design.blocks.scene_seeds[progress.blocks[step.block].scenes]
            ended = is_file(folder / TABLE)
            sessions.append(
                SessionRecord(folder.name, block, condition or PRACTICE, seed, folder, ended)
            )
    for event in progress.events:
        if event["kind"] == "done" and isinstance(event.get("answers"), dict):
            step = progress.steps[event["step"]]
            took_s = float(event.get("took_s", math.nan))
            answered.append(Answers(step.name, *of_block(step), event["answers"], took_s))
    return Person(progress.number + 1, progress, tuple(sessions), tuple(answered))


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        event = parse_json(line)
    except ValueError:
        return None
    known = isinstance(event, dict) and isinstance(event.get("event"), str)
    return event if known and isinstance(event.get("client_ms"), int | float) else None


_Service = tuple[Any, Any, Any]  # robot, task, request


def inputs_of(events: Sequence[Event], timing: Sequence[Mapping[str, Any]]) -> list[Input]:
    """The services of a session, in the order in which they began.

    Args:
      events: its log.
      timing: what happened at the page, if there was one.
    """
    asked: dict[_Service, Event] = {}
    granted: dict[_Service, Event] = {}
    ended: dict[_Service, Event] = {}
    for event in events:
        service = event.robot, event.task, event.request
        if event.kind is EventKind.BID:
            asked[service] = event
        elif event.kind is EventKind.GRANT:
            granted[service] = event
        elif event.kind is EventKind.SERVICE_END:
            ended[service] = event
    of_service: dict[_Service, list[Mapping[str, Any]]] = {}
    for seen in timing:
        service = seen.get("robot"), seen.get("task"), seen.get("request")
        of_service.setdefault(service, []).append(seen)
    return [
        _input(grant, asked.get(service, grant), ended.get(service), of_service.get(service, []))
        for service, grant in granted.items()
    ]


def _input(grant: Event, bid: Event, end: Event | None, seen: Sequence[Mapping[str, Any]]) -> Input:
    assert grant.robot is not None and grant.task is not None and grant.request is not None
    at: dict[str, float] = {}
    clicks = 0
    for event in seen:
        name, ms = event["event"], float(event["client_ms"])
        if name in ("shown", "first_input"):
            at.setdefault(name, ms)
        else:
            at[name] = ms  # an answer that was refused is given again
        clicks += name == "click"

    def between(first: str, last: str) -> float | None:
        if first not in at or last not in at or at[last] < at[first]:
            return None
        return round((at[last] - at[first]) / 1000, 4)

    return Input(
        robot=grant.robot,
        task=grant.task,
        request=grant.request,
        asked_s=bid.time_ns / 1e9,
        granted_s=grant.time_ns / 1e9,
        ended_s=None if end is None else end.time_ns / 1e9,
        outcome=None if end is None else end.outcome,
        object=None if end is None else end.object,
        x=None if end is None else end.x,
        y=None if end is None else end.y,
        reorientation_s=between("shown", "first_input"),
        interaction_s=between("first_input", "submit"),
        acknowledgement_s=between("submit", "acknowledged"),
        clicks=clicks,
        acknowledged="acknowledged" in at,
    )
