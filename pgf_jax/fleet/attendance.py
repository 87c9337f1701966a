"""When operators leave and come back."""

import bisect
from collections.abc import Iterable
from typing import NamedTuple

from pgf_jax.fleet.event_calendar import OPERATORS, Calendar, EventPriority


class Attendance(NamedTuple):
    """A change of an operator's presence at one time."""

    time_ns: int
    operator: int
    present: bool


def _by_time(change: Attendance) -> int:
    return change.time_ns


class AttendanceSchedule:
    """The changes of presence that are still to come; the next one is in the calendar.

    Simultaneous changes happen in the order given.
    """

    def __init__(self, changes: Iterable[Attendance], calendar: Calendar) -> None:
        self._changes = sorted(changes, key=_by_time)
        self._calendar = calendar
        self._schedule()

    def add(self, change: Attendance) -> None:
        """Add a change that is still to come."""
        bisect.insort(self._changes, change, key=_by_time)
        self._schedule()

    def pop(self) -> Attendance:
        """Remove and return the change that happens now."""
        change = self._changes.pop(0)
        self._schedule()
        return change

    def _schedule(self) -> None:
        if self._changes:
            self._calendar.schedule(self._changes[0].time_ns, EventPriority.ATTENDANCE, OPERATORS)
