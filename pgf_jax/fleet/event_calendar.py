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
    instant does not take on another robot.
    """

    EXPIRY = 0
    ATTENDANCE = 1
    SERVICE_END = 2
    EXECUTION_END = 3
    ITERATION_END = 4
    WINDOW_CLOSE = 5
    NEW_TASK = 6


class ScheduledEvent(NamedTuple):
    """An entry of the calendar; entries compare by time, priority and robot."""

    time_ns: int
    priority: EventPriority
    robot: int
    serial: int  # unique, so that no comparison goes further
    work: Work | None  # its result must be delivered before the event can be handled


class Calendar:
    """Scheduled events in time order. Each robot (and `FLEET`, `OPERATORS`) has at most one.

    Attributes:
      horizon_ns: the horizon, whole ns, or inf; later events are not handled.
    """

    def __init__(self, horizon_ns: float) -> None:
        self.horizon_ns = horizon_ns
        self._heap: list[ScheduledEvent] = []
        self._valid: dict[int, int] = {}  # robot -> serial of its entry
        self._serial = 0

    def schedule(
        self, time_ns: int, priority: EventPriority, robot: int, work: Work | None = None
    ) -> None:
        """Set the robot's next event; it replaces the one before, if there was one."""
        self._serial += 1
        self._valid[robot] = self._serial
        heapq.heappush(self._heap, ScheduledEvent(time_ns, priority, robot, self._serial, work))

    def cancel(self, robot: int) -> None:
        """Remove the robot's next event, if it has one."""
        self._valid.pop(robot, None)

    def peek(self) -> ScheduledEvent | None:
        """The next event, or None."""
        while self._heap and self._valid.get(self._heap[0].robot) != self._heap[0].serial:
            heapq.heappop(self._heap)
        return self._heap[0] if self._heap else None

    def pop(self) -> ScheduledEvent:
        """Remove and return the next event; there must be one."""
        scheduled = self.peek()
        assert scheduled is not None
        heapq.heappop(self._heap)
        del self._valid[scheduled.robot]
        return scheduled
