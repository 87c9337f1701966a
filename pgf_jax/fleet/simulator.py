"""The simulator: a fleet as a discrete-event simulation without physics.

    fleet = Fleet(config, robots)
    while not fleet.done:
        for work in fleet.advance():          # all work that can be computed now
            fleet.deliver(work, ...)          # in any order, alone or in a batch of several fleets
    fleet.records, fleet.events

When an iteration starts, its end is known and its outcome is not. So simulated time may run ahead
of the physics until an event needs an outcome that has not been delivered. A result depends on its
work item alone, so neither batching nor the order of delivery can change a fleet. `stub.drive` is
the loop above for several fleets at once.

The simulator takes the next event from the calendar (`event_calendar.py`) as soon as the work
tracker (`work_tracker.py`) has the result that the event needs. The event handlers
(`event_handlers.py`) change robots, tasks and operators, schedule further events and request work.

With a person as operator, simulated time must not run ahead of that person: `advance(until_ns)`
follows the wall clock, services are open (see `ServiceTimes`), and an input takes effect 1 ns after
the time that the fleet has been advanced to. The event log records that time, so the same inputs at
the same times give the same log again.
"""

import math
from collections.abc import Iterable

from pgf_jax.fleet.compute import ComputeModel, parse_compute
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.event_calendar import Calendar, nanoseconds
from pgf_jax.fleet.event_handlers import EventHandlers
from pgf_jax.fleet.fleet_state import FleetState
from pgf_jax.fleet.operators import Attendance, AttendanceSchedule, OperatorPool
from pgf_jax.fleet.robots import Result, Robots, Work
from pgf_jax.fleet.service import LogNormal, ServiceTimes
from pgf_jax.fleet.task_run import TaskRun
from pgf_jax.fleet.work_tracker import WorkTracker


class Fleet:
    """One simulated fleet: R robots, their tasks and their operators (Alg. 2).

    Attributes:
      config: its settings.
      events: the event log so far, in order.
      records: one for each task that has ended, in order of their ends.
      done: no event is left.
    """

    def __init__(
        self,
        config: FleetConfig,
        robots: Robots,
        *,
        service: ServiceTimes | None = None,
        compute: ComputeModel | None = None,
        attendance: Iterable[Attendance] = (),
    ) -> None:
        """Set the fleet up; no event is handled before the first `advance`.

        Args:
          config: sizes, policy and times.
          robots: its robots; the fleet tells them which segment to plan.
          service: replaces the log-normal service times of the configuration.
          compute: replaces the compute model that the configuration names.
          attendance: when operators leave and come back; all are present at first.
        """
        self.config = config
        self.done = False
        self._until_ns = 0  # the latest time that the fleet has been advanced to
        self._calendar = Calendar(
            math.inf if config.horizon_s is None else nanoseconds(config.horizon_s)
        )
        self._work = WorkTracker()
        self._attendance = AttendanceSchedule(attendance, self._calendar)
        self._state = FleetState(config, robots, self._calendar, self._work)
        self._handlers = EventHandlers(
            self._state,
            service=service or LogNormal(config.seed, config.service_mean_s, config.service_sd_s),
            compute=compute or parse_compute(config.compute, rollouts=config.rollouts),
            attendance=self._attendance,
        )
        self.events = self._state.events
        self.records = self._state.records

    # --- requests and results -------------------------------------------------------------------

    def advance(self, until_ns: int | None = None) -> list[Work]:
        """Handle events in time order until one needs a result that has not been delivered.

        Args:
          until_ns: handle no event after this time; None: no such limit.

        Returns:
          All work requested since the last call, by robot. Empty when the fleet is done, or waits
          for results of earlier calls.
        """
        if until_ns is not None:
            self._until_ns = max(self._until_ns, until_ns)
        while not self.done:
            scheduled, horizon_ns = self._calendar.peek(), self._calendar.horizon_ns
            if self._handlers.has_pending and (
                scheduled is None or scheduled.time_ns > self.now_ns  # this instant is over
            ):
                self._handlers.end_instant()
            elif scheduled is None:
                self.done = True
            elif until_ns is not None and until_ns < min(scheduled.time_ns, horizon_ns):
                break
            elif scheduled.time_ns > horizon_ns:
                self._handlers.censor(int(horizon_ns))
                self.done = True
            elif self._work.is_missing(scheduled.work):
                break
            else:
                self._handlers.handle(self._calendar.pop())
        return self._work.dispatch()

    def deliver(self, work: Work, result: Result) -> None:
        """Deliver the result of a work item; no event is handled before the next `advance`.

        A result that comes after the fleet is done (the horizon cut the work off) is ignored. The
        input of an open service ends the service at the first instant that the fleet has not been
        advanced to; an input after the task's limit is ignored, too.

        Raises:
          ValueError: the work was not dispatched, or has been delivered before.
          TypeError: the result has not the type that this kind of work has.
        """
        if not self._work.deliver(work, result) or self.done:
            return
        self._handlers.requests.answer(self._next_instant_ns(), work)

    def set_attendance(self, operator: int, present: bool) -> None:
        """Let an operator come or leave at the first instant not advanced to."""
        self._attendance.add(Attendance(self._next_instant_ns(), operator, present))

    def stop(self) -> None:
        """End the fleet early: the horizon becomes the first instant not advanced to."""
        self._calendar.horizon_ns = min(self._calendar.horizon_ns, self._next_instant_ns())

    # --- read-only views ------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """Simulated time, ns."""
        return self._state.now_ns

    def task_run(self, robot: int) -> TaskRun | None:
        """A robot's running task, for reading only; None before its first task."""
        return self._state.runs.get(robot)

    @property
    def operators(self) -> OperatorPool:
        """Which operators are present, and whom they serve; for reading only."""
        return self._handlers.requests.operators

    @property
    def blocked_at_ns(self) -> int | None:
        """Time of the next event if its result has not been delivered; else None."""
        scheduled = self._calendar.peek()
        if scheduled is None or not self._work.is_missing(scheduled.work):
            return None
        return scheduled.time_ns

    def _next_instant_ns(self) -> int:
        """The first instant that the fleet has not been advanced to."""
        return max(self._until_ns, self.now_ns) + 1
