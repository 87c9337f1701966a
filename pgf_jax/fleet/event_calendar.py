"""The simulated clock (D8): integer nanoseconds and a calendar with a fixed order of ties."""

import enum
import heapq
from typing import NamedTuple

from pgf_jax.fleet.robots import Work

# In place of a robot, for what concerns all of them.
FLEET = -1
OPERATORS = -2


def nanoseconds(seconds: float) -> int:
    """Seconds to the nearest whole nanosecond."""
    return round(seconds * 1e9)


class EventPriority(enum.IntEnum):
    """Who goes first at one instant: the order of D8, then the robot's index.

    D8 does not place the limit of a waiting robot. Here it comes first, so that no operator turns
    to a robot at the instant at which it has no time left. Nor does it place the coming and going
    of operators: one who leaves with an answer takes on nobody at that instant.
    """

    EXPIRY = 0
    ATTENDANCE = 1
    SERVICE_END = 2
    EXECUTION_END = 3
    ITERATION_END = 4
    WINDOW_CLOSE = 5
    NEW_TASK = 6


class ScheduledEvent(NamedTuple):
    """An entry of the calendar; compares by time, order, robot."""

    time_ns: int
    priority: EventPriority
    robot: int
    serial: int  # unique, so that no comparison goes further
    work: Work | None  # must be delivered before this can happen


class Calendar:
    """What happens when. Each robot (and `FLEET`, `OPERATORS`) has at most one entry: its next.

    Attributes:
      last_ns: the horizon, whole ns, or inf: what comes later does not happen.
    """

    def __init__(self, last_ns: float) -> None:
        self.last_ns = last_ns
        self._heap: list[ScheduledEvent] = []
        self._valid: dict[int, int] = {}  # robot -> serial of its entry
        self._serial = 0

    def schedule(
        self, time_ns: int, order: EventPriority, robot: int, work: Work | None = None
    ) -> None:
        """Set the robot's next event, in place of the one it had."""
        self._serial += 1
        self._valid[robot] = self._serial
        heapq.heappush(self._heap, ScheduledEvent(time_ns, order, robot, self._serial, work))

    def cancel(self, robot: int) -> None:
        """Take the robot's next event out, if it has one."""
        self._valid.pop(robot, None)

    def peek(self) -> ScheduledEvent | None:
        """The next event, or None."""
        while self._heap and self._valid.get(self._heap[0].robot) != self._heap[0].serial:
            heapq.heappop(self._heap)
        return self._heap[0] if self._heap else None

    def pop(self) -> ScheduledEvent:
        """Take the next event out; there must be one."""
        due = self.peek()
        assert due is not None
        heapq.heappop(self._heap)
        del self._valid[due.robot]
        return due
