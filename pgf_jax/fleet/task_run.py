"""The running task of one robot."""

import dataclasses
import math
from typing import Any

from pgf_jax.fleet.policies import TaskProgress
from pgf_jax.fleet.records import NO_TERMS, State, TaskRecord
from pgf_jax.fleet.robots import CheckResult, IterationResult, Work, WorkKind
from pgf_jax.planning.types import LOOK_AHEAD, NoInput, Push, Status


def _nothing_booked() -> dict[State, int]:
    return dict.fromkeys(State, 0)


@dataclasses.dataclass
class TaskRun:
    """The state and the counters of one robot's running task; only the simulator changes it."""

    robot: int
    task: int
    start_ns: int
    deadline_ns: int  # the task's limit; execution does not count, so it moves the limit
    verified: bool = False  # see `Robots`
    misses: bool = False  # see `Robots`
    plans_on: bool = False  # while it asks or is served
    state: State = State.PLANNING
    since_ns: int = 0
    spent_ns: dict[State, int] = dataclasses.field(default_factory=_nothing_booked)

    # The segment being planned.
    push: Push | None = None  # None: reaching
    push_deadline_ns: int = 0
    nominal_done: bool = False  # the segment's iteration 0 has ended
    reach_nominal_done: bool = False  # that of the reach from which the push took over
    stuck: bool = False  # after its last iteration
    check: int | None = None  # number of the final check under way, within its iteration
    started_ns: int = 0  # when the iteration or check under way began
    go_on_given: bool = False  # by an operator, during the iteration or check under way

    # The request: it waits, or is served, whatever the robot does meanwhile.
    request_state: State | None = None
    request_since_ns: int = 0
    request_ns: dict[State, int] = dataclasses.field(default_factory=_nothing_booked)

    helped_ns: int = 0  # when the last service with an answer ended, or the task's start
    helped_at: int = 0  # iterations of the task that had ended then

    work_iterations: int = 0  # iteration 0s included: the next iteration's number in `Work`
    iterations: int = 0
    reach_iterations: int = 0
    since_restart: int = 0  # reach iterations since the segment began or since the last input
    checks: int = 0  # with an outcome, that have ended
    check_misses: int = 0
    attempts: int = 0  # executions of a reach that began
    pushes_planned: int = 0
    requests: int = 0
    answered: int = 0
    unanswered: int = 0
    refusals: int = 0
    expired: int = 0  # the unanswered included
    withdrawn: int = 0
    broken_off: int = 0  # iterations and checks
    lost_ns: int = 0  # time of these
    first_bid: int | None = None
    grants_at: list[int] = dataclasses.field(default_factory=list)
    successful_grants_at: list[int] = dataclasses.field(default_factory=list)
    asked_cost: list[float] = dataclasses.field(default_factory=list)
    helped_cost: list[float] = dataclasses.field(default_factory=list)
    helped_from: int = 0  # iterations before the last input; its `helped_cost` needs one after it
    helped_until: int = 0  # reach iterations that still count for the last entry of `helped_cost`
    last_reach: IterationResult | None = None
    non_finite_at: list[int] = dataclasses.field(default_factory=list)
    saturated: int = 0

    def __post_init__(self) -> None:
        self.since_ns = self.helped_ns = self.start_ns

    def enter(self, state: State, now_ns: int) -> None:
        """Book the time since the last change of state, and change the state."""
        self.spent_ns[self.state] += now_ns - self.since_ns
        self.state, self.since_ns = state, now_ns

    def enter_request(self, state: State | None, now_ns: int) -> None:
        """Book the time of the request, and change what it does; None: there is none."""
        if self.request_state is not None:
            self.request_ns[self.request_state] += now_ns - self.request_since_ns
        self.request_state, self.request_since_ns = state, now_ns

    @property
    def may_be_helped(self) -> bool:
        """Whether a free operator could take it: it plans a reach, and not just after a service."""
        plans = self.state is State.PLANNING and self.push is None and self.check is None
        iterated = self.nominal_done and self.work_iterations > self.helped_at
        return plans and iterated and self.request_state is None and self.last_reach is not None

    def start_segment(self, *, nominal_done: bool = False) -> None:
        """Start a segment with a new stuck counter; with a new nominal and history unless said."""
        self.nominal_done, self.stuck, self.go_on_given = nominal_done, False, False
        self.since_restart = 0

    def count_iteration(self, result: IterationResult) -> None:
        """Count an iteration that has ended."""
        if result.non_finite:
            self.non_finite_at.append(self.work_iterations)
        self.saturated += result.saturated
        self.work_iterations += 1
        if self.nominal_done:
            self.iterations += 1
            self.reach_iterations += self.push is None
            self.since_restart += self.push is None
        self.nominal_done = True
        self._take_outcome(result)

    def count_check(self, check: CheckResult) -> None:
        """Count a check that has ended; the last iteration's outcome is now what the check says."""
        self.checks += 1
        self.check_misses += not check.passed
        self._take_outcome(check.result)

    def _take_outcome(self, result: IterationResult) -> None:
        self.stuck = result.stuck
        if self.push is None:
            self.last_reach = result
            since_input = self.work_iterations > self.helped_from
            if self.helped_cost and since_input and self.reach_iterations <= self.helped_until:
                self.helped_cost[-1] = result.cost

    @property
    def last_iteration(self) -> int | None:
        """Number of the last iteration that has ended, as in `Work`; None before the first."""
        return self.work_iterations - 1 if self.work_iterations else None

    def work(self, kind: WorkKind) -> Work:
        """The task's next work item of a kind."""
        number, request, check = self.work_iterations, None, None
        if kind is WorkKind.INPUT:
            request = self.request
        elif kind is WorkKind.CHECK:
            number, check = number - 1, self.check
        return Work(self.robot, self.task, kind, number, request, check, self.broken_off)

    @property
    def request(self) -> int:
        """Number of the present service, or else of the next one, as in `Work`."""
        return self.answered + self.unanswered

    def count_input(self, given: Push | NoInput | None) -> None:
        """Count an input that comes now, and record the cost before it.

        The costs of the following reach iterations then go into `helped_cost`.
        """
        if isinstance(given, NoInput):
            self.unanswered += 1
            self.expired += 1
            return
        self.answered += 1
        self.asked_cost.append(self.last_reach.cost if self.last_reach else math.nan)
        self.helped_cost.append(math.nan)
        self.helped_from = self.work_iterations
        self.helped_until = self.reach_iterations + LOOK_AHEAD

    def progress(self, now_ns: int) -> TaskProgress:
        """The task's progress, as policies see it."""
        return TaskProgress(
            self.robot,
            self.task,
            self.reach_iterations,
            len(self.grants_at),
            (self.deadline_ns - now_ns) / 1e9,
            self.since_restart,
        )

    def failure_status(self) -> Status:
        """The status of a task that has run out of time.

        NON_FINITE goes before STUCK: with a best cost that is not finite, the stuck counter cannot
        be trusted.
        """
        if self.last_reach is not None and not math.isfinite(self.last_reach.cost):
            return Status.NON_FINITE
        return Status.STUCK if self.stuck else Status.TIMED_OUT

    def finish(self, status: Status, now_ns: int) -> TaskRecord:
        """End the task now; returns its record."""
        self.enter(State.IDLE, now_ns)
        spent = {state: ns / 1e9 for state, ns in self.spent_ns.items()}
        window_ns = self.spent_ns[State.IN_WINDOW]
        return TaskRecord(
            robot=self.robot,
            task=self.task,
            status=status,
            # Sums in ns: two floats added could differ in the last bit from their exact sum.
            planning_time_s=(self.spent_ns[State.PLANNING] + window_ns) / 1e9,
            waiting_s=(self.spent_ns[State.IN_LINE] + window_ns) / 1e9,
            window_wait_s=spent[State.IN_WINDOW],
            interaction_s=spent[State.SERVED],
            execution_s=spent[State.EXECUTING],
            start_ns=self.start_ns,
            end_ns=now_ns,
            iterations=self.iterations,
            reach_iterations=self.reach_iterations,
            pushes_planned=self.pushes_planned,
            pushes_succeeded=len(self.successful_grants_at),
            requests=self.requests,
            answered=self.answered,
            grants=len(self.grants_at),
            refusals=self.refusals,
            expired=self.expired,
            first_bid=self.first_bid,
            first_grant=self.grants_at[0] if self.grants_at else None,
            grants_at=tuple(self.grants_at),
            successful_grants_at=tuple(self.successful_grants_at),
            asked_cost=tuple(self.asked_cost),
            helped_cost=tuple(self.helped_cost),
            cost=self.last_reach.cost if self.last_reach else math.nan,
            terms=self.last_reach.terms if self.last_reach else NO_TERMS,
            non_finite=len(self.non_finite_at),
            non_finite_at=tuple(self.non_finite_at),
            saturated=self.saturated,
            checks=self.checks if self.verified else None,
            check_misses=self.check_misses if self.verified else None,
            attempts=self.attempts if self.verified or self.misses else None,
            **self._request_account(),
        )

    def _request_account(self) -> dict[str, Any]:
        """What a record holds of requests that went on beside planning."""
        if not self.plans_on:
            return {}
        asked_ns = self.request_ns[State.IN_WINDOW] + self.request_ns[State.IN_LINE]
        return {
            "asking_s": asked_ns / 1e9,
            "served_s": self.request_ns[State.SERVED] / 1e9,
            "lost_s": self.lost_ns / 1e9,
            "withdrawn": self.withdrawn,
        }
