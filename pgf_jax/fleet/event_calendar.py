"""The event calendar: simulated time in integer nanoseconds, and a fixed order of ties."""

import enum
import heapq
from typing import NamedTuple

from pgf_jax.fleet.robots import Work

# Stand in place of a robot, for events of the whole fleet and of the operators.
FLEET = -1
OPERATORS = -2


def nanoseconds(seconds: float) -> int:
    """Seconds to the nearest whole nanosecond."""
    return round(seconds * 1e9)


class EventPriority(enum.IntEnum):
    """Priority of simultaneous events; ties break by robot index.

    A bid made at the instant at which the window closes is still inside it. The limit of a waiting
    robot comes first, so that no operator turns to a robot that has no time left. An operator who
    leaves comes before the end of a service, so that an operator who leaves and answers at one
    instant does not take on another robot. The service of a robot that plans meanwhile ends after
    the robot's iteration.
    """

    EXPIRY = 0
    ATTENDANCE = 1
    SERVICE_END = 2
    EXECUTION_END = 3
    ITERATION_END = 4
    LATE_SERVICE_END = 5
    WINDOW_CLOSE = 6
    NEW_TASK = 7


SERVICE_ENDS = (EventPriority.SERVICE_END, EventPriority.LATE_SERVICE_END)
_OF_REQUESTS = (EventPriority.EXPIRY, *SERVICE_ENDS)


class ScheduledEvent(NamedTuple):
    """An entry of the calendar; entries compare by time, priority and robot."""

    time_ns: int
    priority: EventPriority
    robot: int
    serial: int  # unique, so that no comparison goes further
    work: Work | None  # its result must be delivered before the event can be handled


class Calendar:
    """Scheduled events in time order.

    Each robot has at most one event of what it does and one of its request; `FLEET` and `OPERATORS`
    have at most one.

    Attributes:
      horizon_ns: the horizon, whole ns, or inf; later events are not handled.
    """

    def __init__(self, horizon_ns: float) -> None:
        self.horizon_ns = horizon_ns
        self._heap: list[ScheduledEvent] = []
        # (robot, whether of its request) -> its entry
        self._valid: dict[tuple[int, bool], ScheduledEvent] = {}
        self._serial = 0

    def schedule(
        self, time_ns: int, priority: EventPriority, robot: int, work: Work | None = None
    ) -> None:
        """Set the next event of the robot, or of its request; it replaces the one before."""
        self._serial += 1
        entry = ScheduledEvent(time_ns, priority, robot, self._serial, work)
        self._valid[_whose(entry)] = entry
        heapq.heappush(self._heap, entry)

    def cancel(self, robot: int) -> ScheduledEvent | None:
        """Remove and return the next event of what the robot does, if there is one."""
        return self._valid.pop((robot, False), None)

    def cancel_request(self, robot: int) -> ScheduledEvent | None:
        """Remove and return the next event of the robot's request, if there is one."""
        return self._valid.pop((robot, True), None)

    def peek(self) -> ScheduledEvent | None:
        """The next event, or None."""
        while self._heap and self._valid.get(_whose(self._heap[0])) is not self._heap[0]:
            heapq.heappop(self._heap)
        return self._heap[0] if self._heap else None

    def pop(self) -> ScheduledEvent:
        """Remove and return the next event; there must be one."""
        scheduled = self.peek()
        assert scheduled is not None
        heapq.heappop(self._heap)
        del self._valid[_whose(scheduled)]
        return scheduled


def _whose(entry: ScheduledEvent) -> tuple[int, bool]:
    return entry.robot, entry.priority in _OF_REQUESTS
