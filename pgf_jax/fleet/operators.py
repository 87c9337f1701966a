"""The operators of one fleet: when they leave and come back, and which robot each serves."""

import bisect
from collections.abc import Iterable
from typing import NamedTuple

from pgf_jax.fleet.event_calendar import OPERATORS, Calendar, EventPriority


class OperatorPool:
    """The operators of one fleet: which of them are present, and whom they serve."""

    def __init__(self, count: int) -> None:
        self._serving: list[int | None] = [None] * count  # [operators] robot, or None: nobody
        self._last: list[int | None] = [None] * count  # [operators] last robot served
        self._away = [False] * count

    @property
    def free(self) -> int:
        """Number of operators that are present and serve nobody."""
        return len(self._idle())

    def serving(self, operator: int) -> int | None:
        """The robot that an operator serves, or None."""
        return self._serving[operator]

    def is_present(self, operator: int) -> bool:
        """Whether an operator accepts robots."""
        return not self._away[operator]

    def set_present(self, operator: int, present: bool) -> None:
        """Mark an operator as present or away; a service that has begun goes on."""
        self._away[operator] = not present

    def acquire(self, robot: int) -> tuple[int, bool]:
        """Assign the free operator of lowest index to `robot`; returns (operator, switched).

        `switched`: the operator served another robot before. An operator's first service is no
        switch.
        """
        operator, switched = self._idle()[0], self.would_switch(robot)
        self._serving[operator] = self._last[operator] = robot
        return operator, switched

    def would_switch(self, robot: int) -> bool:
        """Whether the operator who would be assigned to `robot` now served another one before."""
        return self._last[self._idle()[0]] not in (None, robot)

    def release(self, robot: int) -> int:
        """Free the operator who serves `robot`; returns that operator."""
        operator = self._serving.index(robot)
        self._serving[operator] = None
        return operator

    def _idle(self) -> list[int]:
        pairs = enumerate(zip(self._serving, self._away, strict=True))
        return [i for i, (robot, away) in pairs if robot is None and not away]


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
