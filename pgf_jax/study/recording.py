"""`replay`: what a recorded operator said, and when, as an operator of a fleet.

Everything else in a fleet follows from its settings, so these few facts bring a session back bit
for bit: for each service its length and its input, and when the operator came and left.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgf_jax.errors import BadInput, shown
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.simulator import Attendance
from pgf_jax.guidance.operators import At, View
from pgf_jax.guidance.trials import Deliberation, Later
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import UNANSWERED, NoInput, Push
from pgf_jax.study.event_log import EventLog, digest, first_difference
from pgf_jax.study.sweep_config import SweepConfig

REPLAY, LIVE = "replay", "live"
_SERVICE = tuple[int, int, int]  # robot, task, request


@dataclasses.dataclass(frozen=True)
class Recording:
    """The operator of a recorded fleet; satisfies `ServiceTimes` and `Deliberate`.

    Attributes:
      inputs: of the services that ended with an answer, or without one: service -> length in ns,
        and what was said. Others (cut off by a limit, or by the end of the log) are open for ever.
      attendance: when the operator left and came back.
      end_ns: time of the last event.
      sha256: of the events.
    """

    inputs: Mapping[_SERVICE, tuple[int, Push | NoInput | None]]
    attendance: tuple[Attendance, ...]
    end_ns: int
    sha256: str

    name = REPLAY

    @classmethod
    def of(cls, log: EventLog) -> "Recording":
        """The operator of a log.

        Raises:
          BadInput: the events of the log do not make a log of one fleet.
        """
        inputs: dict[_SERVICE, tuple[int, Push | NoInput | None]] = {}
        granted: dict[_SERVICE, int] = {}
        attendance: list[Attendance] = []
        events = log.events
        for number, event in enumerate(events):
            where = f"{log.path}: event {number + 1}"
            if event.kind is EventKind.GRANT:
                granted[_service(event, where)] = event.time_ns
            elif event.kind is EventKind.SERVICE_END:
                service = _service(event, where)
                if service not in granted:
                    raise BadInput(f"{where}: a service ends that did not begin")
                given = _given(event, where)
                if not isinstance(given, str):
                    inputs[service] = event.time_ns - granted[service], given
            elif event.kind in (EventKind.OPERATOR_AWAY, EventKind.OPERATOR_BACK):
                if event.operator is None:
                    raise BadInput(f"{where}: expected which operator, got none")
                present = event.kind is EventKind.OPERATOR_BACK
                attendance.append(Attendance(event.time_ns, event.operator, present))
        end_ns = events[-1].time_ns if events else 0
        return cls(inputs, tuple(attendance), end_ns, digest(events))

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        """See `ServiceTimes.seconds`: as long as it took."""
        service = self.inputs.get((robot, task, request))
        # Exact: a float of so few ns is the nearest one to their number over 1e9, and comes back.
        return None if service is None else service[0] / 1e9

    def deliberate(self, view: View, search: Search, planner: BatchPlanner, at: At) -> Deliberation:
        """See `Deliberate.deliberate`: what was said then."""
        service = self.inputs.get((at[1], at[2], view.request))
        if service is None:
            return (yield [Later(lambda done: None)])[0]  # an answer that never came
        given = service[1]
        if isinstance(given, Push) and given.object >= len(view.objects):
            raise BadInput(
                f"log: a push of object {given.object} on a shelf with {len(view.objects)} objects"
            )
        return given


def _service(event: Event, where: str) -> _SERVICE:
    if event.robot is None or event.task is None or event.request is None:
        raise BadInput(f"{where}: a service without its robot, task or request")
    return event.robot, event.task, event.request


def _given(event: Event, where: str) -> Push | NoInput | str | None:
    """The input of a service that has ended; the outcome where none was to come any more."""
    if event.outcome == "push":
        if event.object is None or event.x is None or event.y is None:
            raise BadInput(f"{where}: a push without its object or place")
        return Push(event.object, event.x, event.y)
    if event.outcome == UNANSWERED.value:
        return UNANSWERED
    if event.outcome == "go_on":
        return None
    if event.outcome in ("expired", "censored"):
        return event.outcome
    raise BadInput(f"{where}: unknown end of a service {event.outcome!r}")


# -- settings ------------------------------------------------------------------------------------

_OWN = ("operator", "log", "out", "resume", "workers")  # of a replay itself


def settings_of(config: Any) -> dict[str, Any]:
    """The settings of a fleet (a dataclass), as JSON has them."""
    settings = dataclasses.asdict(config)
    return {name: _plain(value) for name, value in settings.items() if name not in _OWN}


def replaying(config: SweepConfig, log: EventLog) -> SweepConfig:
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
    values = agreed(settings_of(config), settings_of(SweepConfig()), recorded, log.path)
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


def agreed(
    ours: Mapping[str, Any], defaults: Mapping[str, Any], recorded: Mapping[str, Any], path: Path
) -> dict[str, Any]:
    """Recorded settings, where ours are the same or not given.

    Raises:
      BadInput: one that is given differs, or the log lacks one.
    """
    for name, value in ours.items():
        if name not in recorded:
            raise BadInput(f"{path}: its settings lack {name}")
        if value != defaults[name] and value != recorded[name]:
            raise BadInput(
                f"{name}: {shown(value)}, but {path} was recorded with {shown(recorded[name])}; "
                "leave it out"
            )
    return {name: recorded[name] for name in ours}


def compare(events: list[Event], log: EventLog) -> str | None:
    """Where a replay went another way than its log, in words; None: nowhere."""
    number = first_difference(events, log.events)
    if number is None:
        return None
    versions = log.about.get("identity", {}).get("versions", {}).items()
    return f"{log.path}: the replay differs from event {number + 1} on; it was recorded with " + (
        ", ".join(f"{name} {version}" for name, version in versions) or "other versions"
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return list(value)
    return value if not isinstance(value, float) or math.isfinite(value) else str(value)
