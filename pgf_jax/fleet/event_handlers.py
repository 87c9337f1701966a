"""Event handlers of one fleet (Alg. 2).

`simulator.py` takes events from the calendar in time order, once the results that they need have
been delivered. A handler changes the robots' tasks and the operators, writes to the event log,
schedules further events and requests work.
"""

from typing import Any

from pgf_jax.fleet.allocator import AskOutcome, make_allocator
from pgf_jax.fleet.attendance import AttendanceSchedule
from pgf_jax.fleet.compute import ComputeModel
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.event_calendar import FLEET, Calendar, EventPriority, ScheduledEvent, nanoseconds
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.operator_pool import OperatorPool
from pgf_jax.fleet.policies import Discipline, make_policy
from pgf_jax.fleet.records import State, TaskRecord
from pgf_jax.fleet.robots import CheckResult, IterationResult, ReachResult, Robots, Work, WorkKind
from pgf_jax.fleet.service import ServiceTimes
from pgf_jax.fleet.task_run import TaskRun
from pgf_jax.fleet.work_tracker import WorkTracker
from pgf_jax.planning.types import NoInput, Push, Status


class EventHandlers:
    """The state of one fleet, and a handler for each kind of scheduled event (Alg. 2).

    Attributes:
      events: the event log so far, in order.
      records: one for each task that has ended, in order of their ends.
      now_ns: simulated time of the last event handled, ns.
      runs: robot -> its running task; no entry before its first task.
      operators: which operators are present, and whom they serve.
      starting: robots that start an iteration at this instant.
    """

    def __init__(
        self,
        config: FleetConfig,
        robots: Robots,
        calendar: Calendar,
        work: WorkTracker,
        *,
        service: ServiceTimes,
        compute: ComputeModel,
        attendance: AttendanceSchedule,
    ) -> None:
        """Schedule the first events; for the arguments see `Fleet`."""
        self.events: list[Event] = []
        self.records: list[TaskRecord] = []
        self.now_ns = 0
        self.runs: dict[int, TaskRun] = {}
        self.operators = OperatorPool(config.operators)
        self.starting: list[int] = []
        self._config = config
        self._robots = robots
        self._calendar = calendar
        self._work = work
        self._service = service
        self._compute = compute
        self._policy = make_policy(config)
        self._allocator = make_allocator(
            self._policy.discipline, seed=config.seed, robots=config.robots
        )
        self._rollout_ns = nanoseconds(config.rollout_time_s)
        self._push_ns = nanoseconds(config.push_execution_s)
        self._reach_ns = nanoseconds(config.reach_execution_s)
        self._retreat_ns = nanoseconds(config.retreat_s)
        self._next_task = [0] * config.robots
        self._attendance = attendance
        for robot in range(config.robots):
            self._calendar.schedule(0, EventPriority.NEW_TASK, robot)

    # --- events ---------------------------------------------------------------------------------

    def handle(self, scheduled: ScheduledEvent) -> None:
        """Handle an event; the result that it needs, if any, must have been delivered."""
        self.now_ns = scheduled.time_ns
        result = self._work.consume(scheduled.work)
        if scheduled.priority is EventPriority.WINDOW_CLOSE:
            self._on_window_close()
        elif scheduled.priority is EventPriority.ATTENDANCE:
            self._on_attendance()
        elif scheduled.priority is EventPriority.NEW_TASK:
            self._on_new_task(scheduled.robot)
        else:
            run = self.runs[scheduled.robot]
            if scheduled.priority is EventPriority.EXPIRY:
                self._on_expiry(run)
            elif scheduled.priority is EventPriority.SERVICE_END:
                assert result is None or isinstance(result, Push | NoInput)
                self._on_service_end(run, result, expired=scheduled.work is None)
            elif scheduled.priority is EventPriority.EXECUTION_END:
                assert result is None or isinstance(result, ReachResult)
                self._on_execution_end(run, scheduled.work, result)
            elif run.check is not None:
                assert result is None or isinstance(result, CheckResult)
                self._on_check_end(run, result)
            else:
                assert isinstance(result, IterationResult)
                self._on_iteration_end(run, result)

    def _on_new_task(self, robot: int) -> None:
        task = self._next_task[robot]
        self._next_task[robot] += 1
        deadline_ns = self.now_ns + nanoseconds(self._config.task_limit_s)
        real = self._robots.verified, self._robots.misses
        run = self.runs[robot] = TaskRun(robot, task, self.now_ns, deadline_ns, *real)
        self._robots.begin(robot, task)
        self._log(EventKind.TASK_START, run)
        self._ask_or_plan(run, self._policy.first_bid(run.progress(self.now_ns)))

    def _on_iteration_end(self, run: TaskRun, result: IterationResult) -> None:
        run.count_iteration(result)
        self._log(
            EventKind.ITERATION,
            run,
            iteration=run.last_iteration,
            gain=result.gain,
            object=run.push.object if run.push else None,
            outcome="feasible" if result.feasible else "stuck" if result.stuck else None,
        )
        # Feasibility is tested before the policy is asked whether to ask for help.
        if result.feasible and run.push is not None:
            self._execute_push(run)
        elif result.feasible:
            run.check = 0
            self._plan(run)
        elif run.push is not None:
            self._plan(run)
        else:
            self._after_infeasible_reach(run, result)

    def _on_check_end(self, run: TaskRun, check: CheckResult | None) -> None:
        if check is not None:
            run.count_check(check)
            outcome, gain = "passed" if check.passed else "missed", check.result.gain
            ended = run.last_iteration
            self._log(EventKind.CHECK, run, iteration=ended, gain=gain, outcome=outcome)
        if check is None or check.passed:  # None: checks have no outcome
            self._execute_reach(run)
        elif check.more:
            assert run.check is not None
            run.check += 1
            self._plan(run)
        else:
            run.check = None
            self._after_infeasible_reach(run, check.result)

    def _after_infeasible_reach(self, run: TaskRun, result: IterationResult) -> None:
        if self.now_ns + 2 * self._rollout_ns > run.deadline_ns:
            # Out of time. The robot does not ask: it would have no time left to use the input.
            # (On a shared computer an iteration may take even longer: see `_start_iteration`.)
            self._end_task(run, run.failure_status())
        else:
            self._ask_or_plan(run, self._policy.bid(result, run.progress(self.now_ns)))

    def _on_window_close(self) -> None:
        winners, losers = self._allocator.close_window(free=self.operators.free)
        self._log(EventKind.WINDOW_CLOSE)
        for robot in winners:
            self._grant(self.runs[robot])
        for robot in losers:
            self._refuse(self.runs[robot], "lost")

    def _on_attendance(self) -> None:
        _, operator, present = self._attendance.pop()
        self.operators.set_present(operator, present)
        kind = EventKind.OPERATOR_BACK if present else EventKind.OPERATOR_AWAY
        self._log(kind, operator=operator)
        self._serve_waiting()

    def _on_expiry(self, run: TaskRun) -> None:
        self._allocator.withdraw(run.robot)
        run.expired += 1
        self._log(EventKind.EXPIRED, run, request=run.request, outcome="limit")
        self._end_task(run, run.failure_status())

    def _on_service_end(self, run: TaskRun, given: Push | NoInput | None, *, expired: bool) -> None:
        operator = self.operators.release(run.robot)
        ending: dict[str, Any] = {"request": run.request, "operator": operator}
        if expired:
            self._work.cancel_open_input(run.robot)
            run.expired += 1
            self._log(EventKind.SERVICE_END, run, outcome="expired", **ending)
            self._end_task(run, run.failure_status())
        else:
            if isinstance(given, Push):
                ending |= {"object": given.object, "x": given.x, "y": given.y, "outcome": "push"}
            else:
                ending["outcome"] = "go_on" if given is None else given.value
            self._log(EventKind.SERVICE_END, run, **ending)
            run.count_input(given)
            if isinstance(given, Push):
                self._robots.start_push(run.robot, given)
                run.push = given
                run.push_deadline_ns = self.now_ns + nanoseconds(self._config.push_limit_s)
                run.pushes_planned += 1
                run.start_segment()
            elif run.nominal_done:
                self._robots.go_on(run.robot)
                run.stuck = False
                run.since_restart = 0
            self._plan(run)
        self._serve_waiting()

    def _on_execution_end(
        self, run: TaskRun, work: Work | None, reached: ReachResult | None
    ) -> None:
        pushed = run.push.object if run.push else None
        if work is not None and work.kind is WorkKind.RETREAT:
            self._log(EventKind.RETREAT_END, run, object=pushed)
            run.push = None
            run.start_segment()
            self._plan(run)
            return
        missed = reached is not None and not reached.grasped
        if run.push is None and not missed:
            self._log(EventKind.EXECUTION_END, run, outcome="reach")
            self._end_task(run, Status.SOLVED)
            return
        outcome = "missed" if missed else "push"
        self._log(EventKind.EXECUTION_END, run, object=pushed, outcome=outcome)
        end_ns = self.now_ns + self._retreat_ns
        if missed:
            # As a push does at its start, where it requests its retreat, too.
            run.deadline_ns += self._reach_ns + self._retreat_ns
            self._schedule(run, end_ns, EventPriority.EXECUTION_END, WorkKind.RETREAT)
        else:
            retreat = run.work(WorkKind.RETREAT)
            self._calendar.schedule(end_ns, EventPriority.EXECUTION_END, run.robot, retreat)

    # --- planning and execution -----------------------------------------------------------------

    def _plan(self, run: TaskRun) -> None:
        """Start the next iteration, or the final check, at the end of this instant.

        It does not start at once, because A, the number of robots planning, must not depend on the
        order in which simultaneous events are handled.
        """
        self._calendar.cancel(run.robot)  # the expiry of a robot that waited
        run.enter(State.PLANNING, self.now_ns)
        self.starting.append(run.robot)

    def start_iterations(self) -> None:
        """Start the iterations of the robots in `starting`, at the end of an instant."""
        starting, self.starting = sorted(self.starting), []
        planning = sum(run.state is State.PLANNING for run in self.runs.values())  # A
        for robot in starting:
            self._start_iteration(self.runs[robot], planning)

    def _start_iteration(self, run: TaskRun, planning: int) -> None:
        slowdown = self._compute.slowdown(run.robot, run.task, run.work_iterations, planning)

        def end_after(rollouts: int) -> int:
            # At least 1 ns, so that time advances with any compute model.
            return self.now_ns + max(1, round(rollouts * self._rollout_ns * slowdown))

        if run.check is not None:
            # A final check rolls one candidate out once more, on the same computer as the
            # iterations, so it is slowed too. No limit stops the first one.
            end_ns = end_after(1)
            if run.check > 0 and end_ns > run.deadline_ns:
                self._end_task(run, run.failure_status())
                return
            kind = WorkKind.CHECK if run.verified else None  # None: it has no outcome
            self._schedule(run, end_ns, EventPriority.ITERATION_END, kind)
            return
        # Iteration 0 is the nominal's rollout; a later one is K in parallel, then the winner's own.
        end_ns = end_after(2 if run.nominal_done else 1)
        if run.push is not None and end_ns > min(run.push_deadline_ns, run.deadline_ns):
            self._log(EventKind.PUSH_DROPPED, run, object=run.push.object)
            self._robots.drop_push(run.robot)
            run.push = None
            run.start_segment()
            end_ns = end_after(1)
        if end_ns > run.deadline_ns:
            self._end_task(run, run.failure_status())
            return
        self._schedule(run, end_ns, EventPriority.ITERATION_END, WorkKind.ITERATION)

    def _execute_push(self, run: TaskRun) -> None:
        run.successful_grants_at.append(run.grants_at[-1])
        run.enter(State.EXECUTING, self.now_ns)
        end_ns = self.now_ns + self._push_ns
        # The limit is on planning, waiting and interaction, so execution extends the deadline.
        run.deadline_ns += self._push_ns + self._retreat_ns
        # Requested now though needed only when reaching restarts, so that it can share a batch.
        self._request_work(run.work(WorkKind.RETREAT), end_ns + self._retreat_ns)
        self._calendar.schedule(end_ns, EventPriority.EXECUTION_END, run.robot)

    def _execute_reach(self, run: TaskRun) -> None:
        run.check = None
        run.attempts += 1
        run.enter(State.EXECUTING, self.now_ns)
        end_ns = self.now_ns + self._reach_ns
        kind = WorkKind.REACH if run.misses else None  # None: it cannot miss
        self._schedule(run, end_ns, EventPriority.EXECUTION_END, kind)

    def _end_task(self, run: TaskRun, status: Status) -> None:
        self.records.append(run.finish(status, self.now_ns))
        self._log(EventKind.TASK_END, run, outcome=status)
        more = self._next_task[run.robot] < self._config.tasks
        # A task that starts at the horizon would be cut off at once.
        if more and self.now_ns < self._calendar.horizon_ns:
            self._calendar.schedule(self.now_ns, EventPriority.NEW_TASK, run.robot)

    def censor(self, horizon_ns: int) -> None:
        """End all running tasks at the horizon, as censored."""
        self.now_ns = horizon_ns
        for robot, run in sorted(self.runs.items()):
            if run.state is State.IDLE:
                continue
            cut = {"request": run.request, "outcome": "censored"}
            if run.state in (State.IN_WINDOW, State.IN_LINE):
                self._log(EventKind.EXPIRED, run, **cut)
            elif run.state is State.SERVED:
                operator = self.operators.release(robot)
                self._log(EventKind.SERVICE_END, run, operator=operator, **cut)
            self._end_task(run, Status.CENSORED)
        self._work.clear()

    # --- asks and operators (Alg. 2) ------------------------------------------------------------

    def _ask_or_plan(self, run: TaskRun, bid: float | None) -> None:
        if bid is None:
            self._plan(run)
            return
        outcome = self._allocator.ask(run.robot, bid, free=self.operators.free)
        if outcome is AskOutcome.IGNORED:
            self._plan(run)
            return
        if outcome is AskOutcome.OPENS_WINDOW:
            self._log(EventKind.WINDOW_OPEN, run)
            close_ns = self.now_ns + nanoseconds(self._config.window_s)
            self._calendar.schedule(close_ns, EventPriority.WINDOW_CLOSE, FLEET)
        run.requests += 1
        if run.first_bid is None:
            run.first_bid = run.reach_iterations
        ended = run.last_iteration
        self._log(EventKind.BID, run, request=run.request, iteration=ended, gain=bid)
        if outcome is AskOutcome.REFUSED:
            self._refuse(run, "busy")
            return
        windows = self._policy.discipline is Discipline.WINDOW
        run.enter(State.IN_WINDOW if windows else State.IN_LINE, self.now_ns)
        self._calendar.schedule(run.deadline_ns, EventPriority.EXPIRY, run.robot)
        self._serve_waiting()

    def _serve_waiting(self) -> None:
        for robot in self._allocator.match(free=self.operators.free):
            self._grant(self.runs[robot])

    def _refuse(self, run: TaskRun, outcome: str) -> None:
        run.refusals += 1
        self._log(EventKind.REFUSED, run, request=run.request, outcome=outcome)
        self._plan(run)

    def _grant(self, run: TaskRun) -> None:
        operator, switched = self.operators.acquire(run.robot)
        run.grants_at.append(run.reach_iterations)
        self._log(EventKind.GRANT, run, request=run.request, operator=operator)
        seconds = self._service.seconds(run.robot, run.task, run.request)
        if switched and seconds is not None:
            seconds += self._config.context_switch_s
        run.enter(State.SERVED, self.now_ns)
        if seconds is None:
            self._work.request(run.work(WorkKind.INPUT), is_open=True)
            self._calendar.schedule(run.deadline_ns, EventPriority.SERVICE_END, run.robot)
            return
        end_ns = self.now_ns + nanoseconds(seconds)
        # A service that would go past the task's limit ends at the limit without an input: the
        # robot would have no time left to use it, and the operator is free for other robots. An
        # input exactly at the limit is in time.
        kind = WorkKind.INPUT if end_ns <= run.deadline_ns else None
        self._schedule(run, min(end_ns, run.deadline_ns), EventPriority.SERVICE_END, kind)

    # --- helpers --------------------------------------------------------------------------------

    def _schedule(
        self, run: TaskRun, end_ns: int, priority: EventPriority, kind: WorkKind | None
    ) -> None:
        """Schedule the robot's next event, and request the work whose result it needs, if any."""
        work = None if kind is None else run.work(kind)
        if work is not None:
            self._request_work(work, end_ns)
        self._calendar.schedule(end_ns, priority, run.robot, work)

    def _request_work(self, work: Work, needed_ns: int) -> None:
        """Request work, unless its result is needed only after the horizon."""
        if needed_ns <= self._calendar.horizon_ns:
            self._work.request(work)

    def _log(self, kind: EventKind, run: TaskRun | None = None, **columns) -> None:
        if run is not None:
            columns.update(robot=run.robot, task=run.task)
        self.events.append(Event(self.now_ns, kind, **columns))
