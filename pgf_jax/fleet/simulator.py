"""Core 2: the fleet as an event-driven simulation. Events -> requests -> results.

    fleet = Fleet(config, robots)
    while not fleet.done:
        for work in fleet.advance():          # everything that can be computed now
            fleet.deliver(work, ...)          # in any order, alone or batched with other fleets'
    fleet.records, fleet.events

An iteration's end is known when it starts and its outcome is not, so the clock may run ahead of the
physics until an event needs an outcome that is not there yet (D8). Results depend on nothing but
each piece of work, so neither batching nor the order of delivery can change what happens.
`stub.drive` is the loop above for many fleets at once.

Here is when things happen: the next event is taken from the calendar (`clock.py`) as soon as the
ledger (`ledger.py`) has the result that it needs. What happens then is in `course.py`: each event
changes a robot's task or an operator, and schedules and requests what follows from it.

With a person as operator the clock must not run ahead of them: `advance(until_ns)` follows the wall
clock, services are open (see `ServiceTimes`), and an input counts from the instant after the one
that the fleet has been advanced to. The log then says when, so the same inputs at the same times
make the same log again.
"""

import math
from collections.abc import Iterable

from pgf_jax.fleet.compute import ComputeModel, parse_compute
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.event_calendar import Calendar, EventPriority, nanoseconds
from pgf_jax.fleet.event_handlers import Attendance, EventHandlers
from pgf_jax.fleet.operator_pool import OperatorPool
from pgf_jax.fleet.robots import Result, Robots, Work
from pgf_jax.fleet.service import LogNormal, ServiceTimes
from pgf_jax.fleet.task_run import TaskRun
from pgf_jax.fleet.work_tracker import WorkTracker


class Fleet:
    """R robots, their tasks, their operators and one clock (D4, D7, D8; Alg. 2).

    Attributes:
      config: as given.
      events: the log so far, in order.
      records: one per task that has ended, in order of their ends.
      done: nothing more will happen.
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
        """Set the fleet up; nothing happens before the first `advance`.

        Args:
          config: sizes, policy and times.
          robots: told which segment each robot plans.
          service: in place of the log-normal service times of the configuration.
          compute: in place of the compute model that the configuration names.
          attendance: when operators, all there at first, will leave and come back.
        """
        self.config = config
        self.done = False
        self._until_ns = 0  # the latest time that it has been advanced to
        self._calendar = Calendar(
            math.inf if config.horizon_s is None else nanoseconds(config.horizon_s)
        )
        self._work = WorkTracker()
        self._handlers = EventHandlers(
            config,
            robots,
            self._calendar,
            self._work,
            service=service or LogNormal(config.seed, config.service_mean_s, config.service_sd_s),
            compute=compute or parse_compute(config.compute, rollouts=config.rollouts),
            attendance=attendance,
        )
        self.events = self._handlers.events
        self.records = self._handlers.records

    # --- requests and results -------------------------------------------------------------------

    def advance(self, until_ns: int | None = None) -> list[Work]:
        """Process events in time order until one needs a result that is not there yet.

        Args:
          until_ns: no event after this time; None: no such limit.

        Returns:
          All work that has become known since the last call, by robot, at most one a robot. Empty
          when the fleet is done, or waits for work that it has handed out before.
        """
        if until_ns is not None:
            self._until_ns = max(self._until_ns, until_ns)
        while not self.done:
            due = self._calendar.peek()
            if self._handlers.starting and (due is None or due.time_ns > self.now_ns):
                self._handlers.start_iterations()
            elif due is None:
                self.done = True
            elif until_ns is not None and until_ns < min(due.time_ns, self._calendar.last_ns):
                break
            elif due.time_ns > self._calendar.last_ns:
                self._handlers.censor(int(self._calendar.last_ns))
                self.done = True
            elif self._work.is_missing(due.work):
                break
            else:
                self._handlers.handle(self._calendar.pop())
        return self._work.dispatch()

    def deliver(self, work: Work, result: Result) -> None:
        """Hand in the result of a piece of work; nothing happens before the next `advance`.

        A result that comes after the fleet is done (its horizon cut the work off) is ignored. The
        input of an open service ends it at the first instant that has not been advanced to; one
        that comes after the task's limit is ignored, too.

        Raises:
          ValueError: the work was not handed out, or has been delivered before.
          TypeError: the result is not of the type that the work's kind asks for.
        """
        if not self._work.deliver(work, result) or self.done:
            return
        if self._next_ns() <= self._handlers.runs[work.robot].deadline_ns:
            self._calendar.schedule(self._next_ns(), EventPriority.SERVICE_END, work.robot, work)
        else:  # the task's limit has passed, though the fleet has not come to it yet
            self._work.consume(work)

    def attend(self, operator: int, present: bool) -> None:
        """An operator comes or leaves at the first instant that has not been advanced to."""
        self._handlers.attend(Attendance(self._next_ns(), operator, present))

    def stop(self) -> None:
        """The horizon is the first instant that has not been advanced to, if it was later."""
        self._calendar.last_ns = min(self._calendar.last_ns, self._next_ns())

    # --- to look at -----------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """Simulated time, ns."""
        return self._handlers.now_ns

    def run(self, robot: int) -> TaskRun | None:
        """A robot's task as it stands, not to be changed; None before its first."""
        return self._handlers.runs.get(robot)

    @property
    def operators(self) -> OperatorPool:
        """Who is there, and busy with whom; not to be changed."""
        return self._handlers.operators

    @property
    def waits_for_ns(self) -> int | None:
        """Time of the next event, if it needs a result that is not there; else None."""
        due = self._calendar.peek()
        return due.time_ns if due is not None and self._work.is_missing(due.work) else None

    def _next_ns(self) -> int:
        return max(self._until_ns, self.now_ns) + 1
