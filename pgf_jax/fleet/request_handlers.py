"""Event handlers of what the robots of one fleet ask, and of the operators who serve them."""

from typing import Any, Protocol

from pgf_jax.fleet.allocator import AskOutcome, make_allocator
from pgf_jax.fleet.event_calendar import FLEET, EventPriority, nanoseconds
from pgf_jax.fleet.events import EventKind
from pgf_jax.fleet.fleet_state import FleetState
from pgf_jax.fleet.index import RobotState, ranking
from pgf_jax.fleet.operators import AttendanceSchedule, OperatorPool
from pgf_jax.fleet.policies import Discipline
from pgf_jax.fleet.records import State
from pgf_jax.fleet.robots import Work, WorkKind
from pgf_jax.fleet.service import ServiceTimes
from pgf_jax.fleet.task_run import TaskRun
from pgf_jax.planning.types import NoInput, Push, Status


class Planning(Protocol):
    """What these handlers need of those of what robots do."""

    def plan(self, run: TaskRun) -> None:
        """Start the next iteration, or the final check, at the end of this instant."""
        ...

    def break_off(self, run: TaskRun) -> None:
        """Stop the robot's iteration or check."""
        ...

    def take_input(self, run: TaskRun, given: Push | NoInput | None) -> None:
        """Plan with the input that an operator has given."""
        ...

    def end_task(self, run: TaskRun, status: Status) -> None:
        """End a task."""
        ...


class RequestHandlers:
    """Handlers of asks, windows, services and the operators' presence (Alg. 2).

    A robot that plans while it asks or is served has its request beside what it does; then limits
    end the request alone, and the robot sees for itself that it has no time left.

    Attributes:
      operators: which operators are present, and whom they serve.
      undecided: under the discipline `index`: something has happened since the last decision.
    """

    def __init__(
        self,
        state: FleetState,
        planning: Planning,
        service: ServiceTimes,
        attendance: AttendanceSchedule,
    ) -> None:
        config = state.config
        self.operators = OperatorPool(config.operators)
        self._state = state
        self._planning = planning
        self._service = service
        self._attendance = attendance
        self._allocator = make_allocator(
            state.policy.discipline, seed=config.seed, robots=config.robots
        )
        windows = state.policy.discipline is Discipline.WINDOW
        self._ranks = state.policy.discipline is Discipline.INDEX
        self.undecided = False
        self._decisions = 0
        self._waiting = State.IN_WINDOW if windows else State.IN_LINE

    # --- events ---------------------------------------------------------------------------------

    def on_window_close(self) -> None:
        """Serve the highest bids."""
        winners, losers = self._allocator.close_window(free=self.operators.free)
        self._state.log(EventKind.WINDOW_CLOSE)
        for robot in winners:
            self._grant(self._state.runs[robot])
        for robot in losers:
            run = self._state.runs[robot]
            self._refuse(run, "lost")
            if run.state is State.IN_WINDOW:
                self._planning.plan(run)

    def on_attendance(self) -> None:
        """An operator leaves or comes back."""
        _, operator, present = self._attendance.pop()
        self.operators.set_present(operator, present)
        kind = EventKind.OPERATOR_BACK if present else EventKind.OPERATOR_AWAY
        self._state.log(kind, operator=operator)
        self.serve_waiting()

    def on_expiry(self, run: TaskRun) -> None:
        """A robot's time is up while it waits."""
        self.end(run, "limit")
        if run.state is self._waiting:
            self._planning.end_task(run, run.failure_status())

    def on_service_end(self, run: TaskRun, given: Push | NoInput | None, *, expired: bool) -> None:
        """The operator has answered, or the robot's time is up."""
        if expired:
            self.end(run, "limit")
            if run.state is State.SERVED:
                self._planning.end_task(run, run.failure_status())
        else:
            ending: dict[str, Any] = {}
            if isinstance(given, Push):
                ending |= {"object": given.object, "x": given.x, "y": given.y, "outcome": "push"}
            else:
                ending["outcome"] = "go_on" if given is None else given.value
            self._end_service(run, **ending)
            run.count_input(given)
            run.helped_ns, run.helped_at = self._state.now_ns, run.work_iterations
            self._planning.take_input(run, given)
        self.serve_waiting()

    # --- asks and operators ---------------------------------------------------------------------

    def ask_or_plan(self, run: TaskRun, bid: float | None) -> None:
        """Ask with a bid, or plan on where it is None."""
        state, now_ns = self._state, self._state.now_ns
        if bid is None:
            self._planning.plan(run)
            return
        outcome = self._allocator.ask(run.robot, bid, free=self.operators.free)
        if outcome is AskOutcome.IGNORED:
            self._planning.plan(run)
            return
        if outcome is AskOutcome.OPENS_WINDOW:
            state.log(EventKind.WINDOW_OPEN, run)
            close_ns = now_ns + nanoseconds(state.config.window_s)
            state.calendar.schedule(close_ns, EventPriority.WINDOW_CLOSE, FLEET)
        self._ask(run, bid)
        if outcome is AskOutcome.REFUSED:
            self._refuse(run, "busy")
            self._planning.plan(run)
            return
        if state.plans_while_asking:
            self._planning.plan(run)
        else:
            run.enter(self._waiting, now_ns)
        state.calendar.schedule(run.deadline_ns, EventPriority.EXPIRY, run.robot)
        self.serve_waiting()

    def end(self, run: TaskRun, why: str) -> None:
        """End the request of a robot, if it has one, without an input; serves nobody else yet.

        Args:
          run: the robot's task.
          why: `limit` (of the task), `solved_meanwhile` (by itself), or `censored` (the horizon).
        """
        if run.request_state is None:
            return
        run.withdrawn += why == "solved_meanwhile"
        run.expired += why == "limit"
        served = run.request_state is State.SERVED
        if why != "censored":  # then all work and all requests end at once
            entry = self._state.calendar.cancel_request(run.robot)
            if not served:
                self._allocator.withdraw(run.robot)
            elif entry is not None and entry.work is not None:
                self._state.discard_work(entry.work)
            else:
                self._state.work.cancel_open_input(run.robot)
        if served:
            self._end_service(run, outcome="expired" if why == "limit" else why)
        else:
            self._state.log(EventKind.EXPIRED, run, request=run.request, outcome=why)
            run.enter_request(None, self._state.now_ns)

    def _ask(self, run: TaskRun, bid: float) -> None:
        run.requests += 1
        if run.first_bid is None:
            run.first_bid = run.reach_iterations
        ended = run.last_iteration
        self._state.log(EventKind.BID, run, request=run.request, iteration=ended, gain=bid)
        run.enter_request(self._waiting, self._state.now_ns)

    def serve_waiting(self) -> None:
        """Let the operators who are free turn to robots that wait in line."""
        for robot in self._allocator.match(free=self.operators.free):
            self._grant(self._state.runs[robot])

    def _refuse(self, run: TaskRun, outcome: str) -> None:
        run.refusals += 1
        self._state.calendar.cancel_request(run.robot)
        run.enter_request(None, self._state.now_ns)
        self._state.log(EventKind.REFUSED, run, request=run.request, outcome=outcome)

    def _grant(self, run: TaskRun) -> None:
        state = self._state
        operator, switched = self.operators.acquire(run.robot)
        run.grants_at.append(run.reach_iterations)
        state.log(EventKind.GRANT, run, request=run.request, operator=operator)
        seconds = self._service.seconds(run.robot, run.task, run.request)
        if switched and seconds is not None:
            seconds += state.config.context_switch_s
        run.enter_request(State.SERVED, state.now_ns)
        work = run.work(WorkKind.INPUT)  # from the search as it is after the last iteration
        if not state.plans_while_served:
            self._planning.break_off(run)
            run.enter(State.SERVED, state.now_ns)
        elif run.state is not State.PLANNING:
            self._planning.plan(run)
        if seconds is None:
            state.request_work(work, is_open=True)
            self._schedule_end(run, run.deadline_ns, None)
            return
        end_ns = state.now_ns + nanoseconds(seconds)
        # A service that would go past the task's limit ends at the limit without an input: the
        # robot would have no time left to use it, and the operator is free for other robots.
        if self._in_time(run, end_ns):
            state.request_work(work, end_ns)
            self._schedule_end(run, end_ns, work)
        else:
            self._schedule_end(run, run.deadline_ns, None)

    # --- the discipline `index` -----------------------------------------------------------------

    def note_event(self) -> None:
        """Something has happened, so that there may be another to serve."""
        self.undecided = self._ranks

    def decide(self) -> None:
        """Let the operators who are free take the robots of highest index, if there are any."""
        self.undecided = False
        runs, free = self._state.runs, self.operators.free
        if not free:
            return
        robots = [self._seen(run) for _, run in sorted(runs.items()) if run.may_be_helped]
        if not robots:
            return
        policy: Any = self._state.policy
        seed, decision = self._state.config.seed, self._decisions
        self._decisions += 1
        for robot, index in ranking(policy, robots, seed=seed, decision=decision)[:free]:
            self._ask(runs[robot], index)
            self._grant(runs[robot])

    def _seen(self, run: TaskRun) -> RobotState:
        now_ns = self._state.now_ns
        assert run.last_reach is not None
        switch_s = self._state.config.context_switch_s * self.operators.would_switch(run.robot)
        unhelped_s = (now_ns - run.helped_ns) / 1e9
        return RobotState(run.progress(now_ns), run.last_reach, unhelped_s, switch_s)

    # --- services -------------------------------------------------------------------------------

    def answer(self, end_ns: int, work: Work) -> None:
        """Let the open service of a robot end with an input that has been delivered."""
        run = self._state.runs[work.robot]
        if self._in_time(run, end_ns):
            self._schedule_end(run, end_ns, work)
        else:  # after the task's limit, whose event has not been handled yet
            self._state.discard_work(work)

    def _in_time(self, run: TaskRun, end_ns: int) -> bool:
        """Whether an answer comes before the task's limit ends the service.

        One that comes exactly then is in time for a robot that waits for it. For one that plans the
        limit comes first, as its own iteration or check may end at that instant too.
        """
        before = run.deadline_ns - self._state.plans_while_served
        return end_ns <= before

    def _schedule_end(self, run: TaskRun, end_ns: int, work: Work | None) -> None:
        late = run.state is State.PLANNING and work is not None
        priority = EventPriority.LATE_SERVICE_END if late else EventPriority.SERVICE_END
        self._state.calendar.schedule(end_ns, priority, run.robot, work)

    def _end_service(self, run: TaskRun, **ending: Any) -> None:
        operator, request = self.operators.release(run.robot), run.request
        run.enter_request(None, self._state.now_ns)
        self._state.log(EventKind.SERVICE_END, run, request=request, operator=operator, **ending)
