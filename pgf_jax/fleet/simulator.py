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

With a person as operator the clock must not run ahead of them: `advance(until_ns)` follows the wall
clock, services are open (see `ServiceTimes`), and an input counts from the instant after the one
that the fleet has been advanced to. The log then says when, so the same inputs at the same times
make the same log again.
"""

import bisect
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from pgf_jax.fleet.allocator import Operators, Reply, make_allocator
from pgf_jax.fleet.clock import FLEET, OPERATORS, Calendar, Due, Order, nanoseconds
from pgf_jax.fleet.compute import ComputeModel, parse_compute
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.ledger import Ledger
from pgf_jax.fleet.policies import Discipline, make_policy
from pgf_jax.fleet.records import Run, State, TaskRecord
from pgf_jax.fleet.robots import IterationResult, Result, Robots, Work, WorkKind
from pgf_jax.fleet.service import LogNormal, ServiceTimes
from pgf_jax.planning.types import NoInput, Push, Status


class Attendance(NamedTuple):
    """An operator comes or leaves."""

    time_ns: int
    operator: int
    present: bool


def _time(change: Attendance) -> int:
    return change.time_ns


class Fleet:
    """R robots, their tasks, their operators and one clock (D4, D7, D8; Alg. 2).

    Attributes:
      config: as given.
      events: the log so far, in order.
      records: one per task that has ended, in order of their ends.
      now_ns: simulated time, ns.
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
        self.events: list[Event] = []
        self.records: list[TaskRecord] = []
        self.now_ns = 0
        self.done = False
        self._robots = robots
        self._policy = make_policy(config)
        self._allocator = make_allocator(
            self._policy.discipline, seed=config.seed, robots=config.robots
        )
        self._operators = Operators(config.operators)
        self._service = service or LogNormal(
            config.seed, config.service_mean_s, config.service_sd_s
        )
        self._compute = compute or parse_compute(config.compute, rollouts=config.rollouts)
        self._rollout_ns = nanoseconds(config.rollout_time_s)
        self._horizon_ns = None if config.horizon_s is None else nanoseconds(config.horizon_s)
        self._runs: dict[int, Run] = {}  # robot -> the task it is at
        self._next_task = [0] * config.robots
        self._starting: list[int] = []  # robots that start to plan at this instant
        self._ledger = Ledger()
        self._until_ns = 0  # the latest time that it has been advanced to
        self._calendar = Calendar()
        # Still to come; at one instant in the order given.
        self._attendance = sorted(attendance, key=_time)
        self._schedule_attendance()
        for robot in range(config.robots):
            self._calendar.schedule(0, Order.NEW_TASK, robot)

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
            if self._starting and (due is None or due.time_ns > self.now_ns):
                self._start_iterations()
            elif due is None:
                self.done = True
            elif until_ns is not None and until_ns < min(due.time_ns, self._last_ns):
                break
            elif due.time_ns > self._last_ns:
                self._censor(int(self._last_ns))
            elif self._ledger.lacks(due.work):
                break
            else:
                self._happen(self._calendar.pop())
        return self._ledger.hand_out()

    def deliver(self, work: Work, result: Result) -> None:
        """Hand in the result of a piece of work; nothing happens before the next `advance`.

        A result that comes after the fleet is done (its horizon cut the work off) is ignored. The
        input of an open service ends it at the first instant that has not been advanced to; one
        that comes after the task's limit is ignored, too.

        Raises:
          ValueError: the work was not handed out, or has been delivered before.
          TypeError: the result is not of the type that the work's kind asks for.
        """
        if not self._ledger.hand_in(work, result) or self.done:
            return
        if self._next_ns() <= self._runs[work.robot].deadline_ns:
            self._calendar.schedule(self._next_ns(), Order.SERVICE_END, work.robot, work)
        else:  # the task's limit has passed, though the fleet has not come to it yet
            self._ledger.use(work)

    def attend(self, operator: int, present: bool) -> None:
        """An operator comes or leaves at the first instant that has not been advanced to."""
        change = Attendance(self._next_ns(), operator, present)
        bisect.insort(self._attendance, change, key=_time)
        self._schedule_attendance()

    def stop(self) -> None:
        """The horizon is the first instant that has not been advanced to, if it was later."""
        self._horizon_ns = int(min(self._last_ns, self._next_ns()))

    # --- to look at -----------------------------------------------------------------------------

    def run(self, robot: int) -> Run | None:
        """A robot's task as it stands, not to be changed; None before its first."""
        return self._runs.get(robot)

    @property
    def operators(self) -> Operators:
        """Who is there, and busy with whom; not to be changed."""
        return self._operators

    @property
    def waits_for_ns(self) -> int | None:
        """Time of the next event, if it needs a result that is not there; else None."""
        due = self._calendar.peek()
        return due.time_ns if due is not None and self._ledger.lacks(due.work) else None

    @property
    def _last_ns(self) -> float:
        """Nothing happens after this."""
        return math.inf if self._horizon_ns is None else self._horizon_ns

    def _next_ns(self) -> int:
        return max(self._until_ns, self.now_ns) + 1

    # --- events ---------------------------------------------------------------------------------

    def _happen(self, due: Due) -> None:
        self.now_ns = due.time_ns
        result = self._ledger.use(due.work)
        if due.order is Order.WINDOW_CLOSE:
            self._on_window_close()
        elif due.order is Order.ATTENDANCE:
            self._on_attendance()
        elif due.order is Order.NEW_TASK:
            self._on_new_task(due.robot)
        else:
            run = self._runs[due.robot]
            if due.order is Order.EXPIRY:
                self._on_expiry(run)
            elif due.order is Order.SERVICE_END:
                assert not isinstance(result, IterationResult)
                self._on_service_end(run, result, expired=due.work is None)
            elif due.order is Order.EXECUTION_END:
                self._on_execution_end(run, retreated=due.work is not None)
            elif run.checking:
                self._execute_reach(run)
            else:
                assert isinstance(result, IterationResult)
                self._on_iteration_end(run, result)

    def _on_new_task(self, robot: int) -> None:
        task = self._next_task[robot]
        self._next_task[robot] += 1
        deadline_ns = self.now_ns + nanoseconds(self.config.task_limit_s)
        run = self._runs[robot] = Run(robot, task, self.now_ns, deadline_ns)
        self._robots.begin(robot, task)
        self._log(EventKind.TASK_START, run)
        self._ask_or_plan(run, self._policy.first_bid(run.progress(self.now_ns)))

    def _on_iteration_end(self, run: Run, result: IterationResult) -> None:
        iteration = run.work_iterations
        run.count(result)
        self._log(
            EventKind.ITERATION,
            run,
            iteration=iteration,
            gain=result.gain,
            object=run.push.object if run.push else None,
            outcome="feasible" if result.feasible else "stuck" if result.stuck else None,
        )
        # Feasibility is tested before anything is asked (D4).
        if result.feasible and run.push is not None:
            self._execute_push(run)
        elif result.feasible:
            run.checking = True
            self._plan(run)
        elif run.push is not None:
            self._plan(run)
        elif self.now_ns + 2 * self._rollout_ns > run.deadline_ns:
            # Out of time. It asks nothing: an operator's time would be spent on a robot that has
            # none left to plan with. (A shared computer may still turn out too slow: see below.)
            self._end_task(run, run.failure())
        else:
            self._ask_or_plan(run, self._policy.bid(result, run.progress(self.now_ns)))

    def _on_window_close(self) -> None:
        winners, losers = self._allocator.close(free=self._operators.free)
        self._log(EventKind.WINDOW_CLOSE)
        for robot in winners:
            self._grant(self._runs[robot])
        for robot in losers:
            self._refuse(self._runs[robot], "lost")

    def _on_attendance(self) -> None:
        _, operator, present = self._attendance.pop(0)
        self._operators.attend(operator, present)
        kind = EventKind.OPERATOR_BACK if present else EventKind.OPERATOR_AWAY
        self._log(kind, operator=operator)
        self._schedule_attendance()
        self._match()

    def _on_expiry(self, run: Run) -> None:
        self._allocator.withdraw(run.robot)
        run.expired += 1
        self._log(EventKind.EXPIRED, run, request=run.request, outcome="limit")
        self._end_task(run, run.failure())

    def _on_service_end(self, run: Run, given: Push | NoInput | None, *, expired: bool) -> None:
        operator = self._operators.release(run.robot)
        ending: dict[str, Any] = {"request": run.request, "operator": operator}
        if expired:
            self._ledger.close(run.robot)
            run.expired += 1
            self._log(EventKind.SERVICE_END, run, outcome="expired", **ending)
            self._end_task(run, run.failure())
        else:
            if isinstance(given, Push):
                ending |= {"object": given.object, "x": given.x, "y": given.y, "outcome": "push"}
            else:
                ending["outcome"] = "go_on" if given is None else given.value
            self._log(EventKind.SERVICE_END, run, **ending)
            run.answer(given)
            if isinstance(given, Push):
                self._robots.start_push(run.robot, given)
                run.push = given
                run.push_deadline_ns = self.now_ns + nanoseconds(self.config.push_limit_s)
                run.pushes_planned += 1
                run.new_segment()
            elif run.nominal_done:
                self._robots.go_on(run.robot)
                run.stuck = False
                run.since_restart = 0
            self._plan(run)
        self._match()

    def _on_execution_end(self, run: Run, *, retreated: bool) -> None:
        if run.push is None:
            self._log(EventKind.EXECUTION_END, run, outcome="reach")
            self._end_task(run, Status.SOLVED)
        elif not retreated:
            self._log(EventKind.EXECUTION_END, run, object=run.push.object, outcome="push")
            retreat = Work(run.robot, run.task, WorkKind.RETREAT, run.work_iterations)
            end_ns = self.now_ns + nanoseconds(self.config.retreat_s)
            self._calendar.schedule(end_ns, Order.EXECUTION_END, run.robot, retreat)
        else:
            self._log(EventKind.RETREAT_END, run, object=run.push.object)
            run.push = None
            run.new_segment()
            self._plan(run)

    # --- what robots do next --------------------------------------------------------------------

    def _plan(self, run: Run) -> None:
        """Start the next iteration, or the final check, once this instant is over.

        Not at once: A, the number of robots planning, must not depend on which of the robots that
        start at one instant is dealt with first.
        """
        self._calendar.cancel(run.robot)  # a waiting robot's expiry
        run.enter(State.PLANNING, self.now_ns)
        self._starting.append(run.robot)

    def _start_iterations(self) -> None:
        starting, self._starting = sorted(self._starting), []
        planning = sum(run.state is State.PLANNING for run in self._runs.values())  # A
        for robot in starting:
            self._start_iteration(self._runs[robot], planning)

    def _start_iteration(self, run: Run, planning: int) -> None:
        slowdown = self._compute.slowdown(run.robot, run.task, run.work_iterations, planning)

        def ends(rollouts: int) -> int:
            # At least 1 ns, so that the clock advances whatever a compute model says.
            return self.now_ns + max(1, round(rollouts * self._rollout_ns * slowdown))

        if run.checking:
            # The winner rolled out once more: time, but no new outcome. It runs on the same
            # computer as the iterations, so it is slowed like them; no limit stops it.
            self._calendar.schedule(ends(1), Order.ITERATION_END, run.robot)
            return
        # Iteration 0 is the nominal's rollout; a further one K in parallel, then the winner's own.
        end_ns = ends(2 if run.nominal_done else 1)
        if run.push is not None and end_ns > min(run.push_deadline_ns, run.deadline_ns):
            self._log(EventKind.PUSH_DROPPED, run, object=run.push.object)
            self._robots.drop_push(run.robot)
            run.push = None
            run.new_segment()
            end_ns = ends(1)
        if end_ns > run.deadline_ns:
            self._end_task(run, run.failure())
            return
        work = Work(run.robot, run.task, WorkKind.ITERATION, run.work_iterations)
        self._request(work, end_ns)
        self._calendar.schedule(end_ns, Order.ITERATION_END, run.robot, work)

    def _execute_push(self, run: Run) -> None:
        run.successful_grants_at.append(run.grants_at[-1])
        run.enter(State.EXECUTING, self.now_ns)
        end_ns = self.now_ns + nanoseconds(self.config.push_execution_s)
        retreat_ns = nanoseconds(self.config.retreat_s)
        # The limit is on planning, waiting and interaction (D4): execution puts it off.
        run.deadline_ns += nanoseconds(self.config.push_execution_s) + retreat_ns
        # Asked for now, needed when reaching restarts: it shares the batch of these four seconds.
        work = Work(run.robot, run.task, WorkKind.RETREAT, run.work_iterations)
        self._request(work, end_ns + retreat_ns)
        self._calendar.schedule(end_ns, Order.EXECUTION_END, run.robot)

    def _execute_reach(self, run: Run) -> None:
        run.checking = False
        run.enter(State.EXECUTING, self.now_ns)
        end_ns = self.now_ns + nanoseconds(self.config.reach_execution_s)
        self._calendar.schedule(end_ns, Order.EXECUTION_END, run.robot)

    def _end_task(self, run: Run, status: Status) -> None:
        self.records.append(run.record(status, self.now_ns))
        self._log(EventKind.TASK_END, run, outcome=status)
        more = self._next_task[run.robot] < self.config.tasks
        # A task that starts at the horizon would only be cut off.
        if more and (self._horizon_ns is None or self.now_ns < self._horizon_ns):
            self._calendar.schedule(self.now_ns, Order.NEW_TASK, run.robot)

    def _censor(self, horizon_ns: int) -> None:
        """The horizon has passed: what still runs is cut off there."""
        self.now_ns = horizon_ns
        for robot, run in sorted(self._runs.items()):
            if run.state is State.IDLE:
                continue
            cut = {"request": run.request, "outcome": "censored"}
            if run.state in (State.IN_WINDOW, State.IN_LINE):
                self._log(EventKind.EXPIRED, run, **cut)
            elif run.state is State.SERVED:
                operator = self._operators.release(robot)
                self._log(EventKind.SERVICE_END, run, operator=operator, **cut)
            self._end_task(run, Status.CENSORED)
        self._ledger.clear()
        self.done = True

    # --- asks and operators (Alg. 2) ------------------------------------------------------------

    def _ask_or_plan(self, run: Run, bid: float | None) -> None:
        free = self._operators.free
        reply = Reply.IGNORED
        if bid is not None:
            reply = self._allocator.ask(run.robot, bid, free=free)
        if bid is None or reply is Reply.IGNORED:
            self._plan(run)
            return
        if reply is Reply.OPENS:
            self._log(EventKind.WINDOW_OPEN, run)
            close_ns = self.now_ns + nanoseconds(self.config.window_s)
            self._calendar.schedule(close_ns, Order.WINDOW_CLOSE, FLEET)
        run.requests += 1
        if run.first_bid is None:
            run.first_bid = run.reach_iterations
        iteration = run.work_iterations - 1 if run.work_iterations else None
        self._log(EventKind.BID, run, request=run.request, iteration=iteration, gain=bid)
        if reply is Reply.REFUSED:
            self._refuse(run, "busy")
            return
        windows = self._policy.discipline is Discipline.WINDOW
        run.enter(State.IN_WINDOW if windows else State.IN_LINE, self.now_ns)
        self._calendar.schedule(run.deadline_ns, Order.EXPIRY, run.robot)
        self._match()

    def _match(self) -> None:
        for robot in self._allocator.match(free=self._operators.free):
            self._grant(self._runs[robot])

    def _refuse(self, run: Run, outcome: str) -> None:
        run.refusals += 1
        self._log(EventKind.REFUSED, run, request=run.request, outcome=outcome)
        self._plan(run)

    def _grant(self, run: Run) -> None:
        operator, switched = self._operators.take(run.robot)
        run.grants_at.append(run.reach_iterations)
        self._log(EventKind.GRANT, run, request=run.request, operator=operator)
        seconds = self._service.seconds(run.robot, run.task, run.request)
        if switched and seconds is not None:
            seconds += self.config.context_switch_s
        run.enter(State.SERVED, self.now_ns)
        if seconds is None:
            self._ledger.request(self._input(run), is_open=True)
            self._calendar.schedule(run.deadline_ns, Order.SERVICE_END, run.robot)
            return
        end_ns = self.now_ns + nanoseconds(seconds)
        # A service that would outlast the task's limit ends there, without an input: the robot has
        # no time left to use one, and the operator is free for the others. An input that comes at
        # the limit itself is in time.
        work = None
        if end_ns <= run.deadline_ns:
            work = self._input(run)
            self._request(work, end_ns)
        self._calendar.schedule(min(end_ns, run.deadline_ns), Order.SERVICE_END, run.robot, work)

    @staticmethod
    def _input(run: Run) -> Work:
        return Work(run.robot, run.task, WorkKind.INPUT, run.work_iterations, run.request)

    def _schedule_attendance(self) -> None:
        if self._attendance:
            self._calendar.schedule(self._attendance[0].time_ns, Order.ATTENDANCE, OPERATORS)

    # --- small helpers --------------------------------------------------------------------------

    def _request(self, work: Work, needed_ns: int) -> None:
        """Ask for work, unless the horizon comes before its result is needed."""
        if self._horizon_ns is None or needed_ns <= self._horizon_ns:
            self._ledger.request(work)

    def _log(self, kind: EventKind, run: Run | None = None, **columns) -> None:
        if run is not None:
            columns.update(robot=run.robot, task=run.task)
        self.events.append(Event(self.now_ns, kind, **columns))
