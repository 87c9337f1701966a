"""The operator `replay`: gives the inputs of a recorded session, when they were given.

Everything else in a fleet follows from its settings. So a session is repeated bit for bit by the
length and the input of each service, and by the times at which the operator came and left.
"""

import dataclasses
from collections.abc import Mapping

from pgf_jax.batching.requests import Coroutine, External
from pgf_jax.errors import BadInput
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.simulator import Attendance
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import UNANSWERED, NoInput, Push
from pgf_jax.tables.event_log import EventLog, digest

REPLAY, LIVE = "replay", "live"
_SERVICE = tuple[int, int, int]  # robot, task, request


@dataclasses.dataclass(frozen=True)
class Recording:
    """The operator of a recorded fleet; satisfies `ServiceTimes` and `RolloutOperator`.

    Attributes:
      inputs: of the services that ended with an answer, or without one: service -> length in ns,
        and the input. Others (cut off by a limit, by the end of the log, or because the robot found
        its way) never end.
      attendance: when the operator left and came back.
      end_ns: time of the last event.
      sha256: of the events.
    """

    inputs: Mapping[_SERVICE, tuple[int, Push | NoInput | None]]
    attendance: tuple[Attendance, ...]
    end_ns: int
    sha256: str

    name = REPLAY
    checked = True  # its inputs were, when they were given

    @classmethod
    def of(cls, log: EventLog) -> "Recording":
        """Read the operator of a log.

        Raises:
          BadInput: the events are no log of one fleet.
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
        """See `ServiceTimes.seconds`: the length in the recording."""
        service = self.inputs.get((robot, task, request))
        # Exact: a float of so few ns is the nearest one to their number over 1e9, and comes back.
        return None if service is None else service[0] / 1e9

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        """See `RolloutOperator.deliberate`: the input in the recording."""
        service = self.inputs.get((decision_key[1], decision_key[2], view.request))
        if service is None:
            return (yield [External(lambda done: None)])[0]  # an answer that never came
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
    """The input of a service that has ended; its outcome where it ended without one."""
    if event.outcome == "push":
        if event.object is None or event.x is None or event.y is None:
            raise BadInput(f"{where}: a push without its object or place")
        return Push(event.object, event.x, event.y)
    if event.outcome == UNANSWERED.value:
        return UNANSWERED
    if event.outcome == "go_on":
        return None
    if event.outcome in ("expired", "censored", "solved_meanwhile"):
        return event.outcome
    raise BadInput(f"{where}: unknown end of a service {event.outcome!r}")
