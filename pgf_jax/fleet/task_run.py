"""The running task of one robot."""

import dataclasses
import math

from pgf_jax.fleet.policies import Progress
from pgf_jax.fleet.records import NO_TERMS, State, TaskRecord
from pgf_jax.fleet.robots import IterationResult
from pgf_jax.planning.types import LOOK_AHEAD, NoInput, Push, Status


@dataclasses.dataclass
class TaskRun:
    """The running task of one robot; mutable, the simulator's own."""

    robot: int
    task: int
    start_ns: int
    deadline_ns: int  # the task's limit; execution, which it does not count, puts it off
    state: State = State.PLANNING
    since_ns: int = 0
    spent_ns: dict[State, int] = dataclasses.field(default_factory=lambda: dict.fromkeys(State, 0))

    # The segment being planned.
    push: Push | None = None  # None: reaching
    push_deadline_ns: int = 0
    nominal_done: bool = False  # its iteration 0 has ended
    stuck: bool = False  # after its last iteration
    checking: bool = False  # the final check of a feasible reach is under way

    work_iterations: int = 0  # all, iteration 0s included: the next one's number in `Work`
    iterations: int = 0
    reach_iterations: int = 0
    since_restart: int = 0  # reach iterations since the segment began or since the last input
    pushes_planned: int = 0
    requests: int = 0
    answered: int = 0
    unanswered: int = 0
    refusals: int = 0
    expired: int = 0  # the unanswered included
    first_bid: int | None = None
    grants_at: list[int] = dataclasses.field(default_factory=list)
    successful_grants_at: list[int] = dataclasses.field(default_factory=list)
    asked_cost: list[float] = dataclasses.field(default_factory=list)
    helped_cost: list[float] = dataclasses.field(default_factory=list)
    helped_until: int = 0  # reach iterations that still count for the last entry of `helped_cost`
    last_reach: IterationResult | None = None
    non_finite_at: list[int] = dataclasses.field(default_factory=list)
    saturated: int = 0

    def __post_init__(self) -> None:
        self.since_ns = self.start_ns

    def enter(self, state: State, now_ns: int) -> None:
        """Book the time since the last change and change state."""
        self.spent_ns[self.state] += now_ns - self.since_ns
        self.state, self.since_ns = state, now_ns

    def new_segment(self) -> None:
        """A new nominal, counter and history (D4)."""
        self.nominal_done = self.stuck = False
        self.since_restart = 0

    def count(self, result: IterationResult) -> None:
        """Book an iteration that has ended."""
        if result.non_finite:
            self.non_finite_at.append(self.work_iterations)
        self.saturated += result.saturated
        self.work_iterations += 1
        if self.nominal_done:
            self.iterations += 1
            self.reach_iterations += self.push is None
            self.since_restart += self.push is None
        self.nominal_done = True
        self.stuck = result.stuck
        if self.push is None:
            self.last_reach = result
            if self.helped_cost and self.reach_iterations <= self.helped_until:
                self.helped_cost[-1] = result.cost

    @property
    def request(self) -> int:
        """Number of the service that is asked for, or under way."""
        return self.answered + self.unanswered

    def answer(self, given: Push | NoInput | None) -> None:
        """Book an input that is given now: the cost before it, and that those after it count."""
        if isinstance(given, NoInput):
            self.unanswered += 1
            self.expired += 1
            return
        self.answered += 1
        self.asked_cost.append(self.last_reach.cost if self.last_reach else math.nan)
        self.helped_cost.append(math.nan)
        self.helped_until = self.reach_iterations + LOOK_AHEAD

    def progress(self, now_ns: int) -> Progress:
        """What a policy may know."""
        return Progress(
            self.robot,
            self.task,
            self.reach_iterations,
            len(self.grants_at),
            (self.deadline_ns - now_ns) / 1e9,
            self.since_restart,
        )

    def failure(self) -> Status:
        """How a task that has run out of time ended.

        The design names the statuses, not their order: a best trajectory that cannot be costed says
        more than the counter, which cannot be trusted then.
        """
        if self.last_reach is not None and not math.isfinite(self.last_reach.cost):
            return Status.NON_FINITE
        return Status.STUCK if self.stuck else Status.TIMED_OUT

    def record(self, status: Status, now_ns: int) -> TaskRecord:
        """The record of the task, which ends now."""
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
        )
