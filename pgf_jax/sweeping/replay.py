"""Replays recorded sessions, and compares a replay with its log."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.settings import stored_settings
from pgf_jax.simulation.recorded_operator import REPLAY, Recording
from pgf_jax.simulation.robot import Robot
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.config import ADDED, SweepConfig
from pgf_jax.sweeping.resolve import resolve
from pgf_jax.tables.event_log import EventLog, first_difference, read_log


def replay(
    path: Path | str,
    *,
    on_task_end: Callable[[int, Robot], None] | None = None,
    operator: Callable[[Recording], AnyOperator] | None = None,
) -> tuple[FleetRunner, EventLog]:
    """Set up the replay of a recorded session, before its first event; returns its log too.

    Args:
      path: of its log, or its folder.
      on_task_end: see `PlannedRobots`.
      operator: makes of the recording who gives the inputs; None: it does itself.

    Raises:
      BadInput: it is no session's log, or its settings cannot be used here.
    """
    log = read_log(path)
    (cell,) = resolve(replay_config(SweepConfig(operator=REPLAY, log=Path(path)), log)).cells
    recording = cell.fleet.recording
    given_by = None if operator is None or recording is None else operator(recording)
    return FleetRunner.of(cell.fleet, on_task_end=on_task_end, operator=given_by), log


_OWN = ("operator", "log", "out", "resume", "workers")  # of a replay itself


def settings_of(config: Any) -> dict[str, Any]:
    """The settings of a fleet (a dataclass), as JSON has them."""
    settings = dataclasses.asdict(config)
    return {name: _plain(value) for name, value in settings.items() if name not in _OWN}


def replay_config(config: SweepConfig, log: EventLog) -> SweepConfig:
    """The configuration of the recorded fleet, to be replayed.

    Args:
      config: settings that it does not have to name again; those that it does must agree.
      log: the recording.

    Raises:
      BadInput: the log does not say what it was recorded with, or a setting differs from it.
    """
    recorded = log.settings
    if recorded is None:
        raise BadInput(f"{log.path}: does not say its settings, expected the log of a session")
    values = agreed_settings(settings_of(config), settings_of(SweepConfig()), recorded, log.path)
    try:
        replay = dataclasses.replace(config, **values)
        (cell,) = replay.cells()
    except (BadInput, TypeError, ValueError) as error:
        raise BadInput(f"{log.path}: settings that cannot be used: {error}") from None
    recording = Recording.of(log)
    for change in recording.attendance:
        if change.operator >= replay.operators:
            raise BadInput(
                f"{log.path}: operator {change.operator} of {replay.operators} leaves or comes back"
            )
    ended = sum(event.kind is EventKind.TASK_END for event in log.events)
    cut = any(event.outcome == "censored" for event in log.events)
    if cut or ended < cell.robots * cell.tasks:
        # It was stopped, or its server was killed: nothing is known of what came after.
        # At the horizon itself no task begins, which one may have done at a kill.
        replay = dataclasses.replace(replay, horizon=(recording.end_ns + (not cut)) / 1e9)
    return replay


def agreed_settings(
    ours: Mapping[str, Any], defaults: Mapping[str, Any], recorded: Mapping[str, Any], path: Path
) -> dict[str, Any]:
    """The recorded settings; ours must be the same or not given.

    A log may lack a setting that was added later: it was recorded with the default.

    Raises:
      BadInput: one that is given differs, or the log lacks one.
    """
    for name in ours:
        if name not in recorded and name not in ADDED:
            raise BadInput(f"{path}: its settings lack {name}")
    recorded = stored_settings(recorded)
    values = {name: recorded.get(name, defaults[name]) for name in ours}
    for name, value in ours.items():
        if value != defaults[name] and value != values[name]:
            raise BadInput(
                f"{name}: {short_repr(value)}, but {path} was recorded with "
                f"{short_repr(values[name])}; leave it out"
            )
    return values


def replay_difference(events: list[Event], log: EventLog) -> str | None:
    """The first difference between a replay and its log, in words; None: there is none."""
    number = first_difference(events, log.events)
    if number is None:
        return None
    identity = log.about.get("identity", {})
    made_with = dict(identity.get("versions", {}))
    if "engine" in identity:
        revision = identity.get("revisions", {}).get("engine", 1)
        made_with = {f"engine {identity['engine']}": revision} | made_with
    return f"{log.path}: the replay differs from event {number + 1} on; it was recorded with " + (
        ", ".join(f"{name} {version}" for name, version in made_with.items()) or "other versions"
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return list(value)
    return value if not isinstance(value, float) or math.isfinite(value) else str(value)
