"""Robot states, and the record of a task that has ended."""

import dataclasses
import enum
import math

from pgf_jax.planning.types import Status

NO_TERMS = (math.nan, math.nan, math.nan)


class State(enum.StrEnum):
    """What a robot does; its time is booked under exactly one state at a time."""

    IDLE = "idle"
    PLANNING = "planning"  # iterations of reaching and pushing, and final checks
    IN_WINDOW = "in_window"  # waiting, from its bid to the window's end
    IN_LINE = "in_line"  # waiting for an operator in the queue
    SERVED = "served"
    EXECUTING = "executing"  # a push and its retreat, or a reach and the retreat after a miss


@dataclasses.dataclass(frozen=True)
class TaskRecord:
    """The metrics of one task: one row of `tasks.parquet`.

    Planning, line waits, interaction and execution add up to end - start. Times are in s, unless
    their name ends in `_ns`. Reach iterations are counted over the whole task without iteration
    0s: 0 means before or at the nominal's own rollout.

    Attributes:
      robot: the robot, 0-based.
      task: the robot's task, 0-based.
      status: how the task ended.
      planning_time_s: the main metric: time of iterations of reaching and pushing, first rollouts,
        final checks and window waits, s; not of line waits, interaction, execution or retreat.
      waiting_s: time waiting in windows and in line, s.
      window_wait_s: time waiting in windows, s.
      interaction_s: time being served, s.
      execution_s: time executing pushes, reaches and retreats, s.
      start_ns: simulated time of the task's start, ns.
      end_ns: simulated time of the task's end, ns.
      iterations: iterations of reaching and pushing that have ended, without iteration 0s.
      reach_iterations: iterations of reaching that have ended, without iteration 0s.
      pushes_planned: pushes whose planning began.
      pushes_succeeded: pushes found feasible, and executed.
      requests: asks made: answered, refused, expired or cut off by the horizon.
      answered: inputs that operators gave.
      grants: services that began.
      refusals: asks refused, those that lost in a window included.
      expired: asks that ended with the task, in line, in a window or while being served, and
        services in which the operator did not answer.
      first_bid: reach iterations at the first ask, or None.
      first_grant: reach iterations at the first grant, or None.
      grants_at: reach iterations at each grant.
      successful_grants_at: reach iterations at each grant whose push succeeded.
      asked_cost: for each answered input, the total cost of the best reach trajectory when it was
        given; nan where nothing had been rolled out yet (`always`).
      helped_cost: for each answered input, the total cost of the best reach trajectory after the
        last reach iteration, iteration 0s included, that ended within the next `LOOK_AHEAD` reach
        iterations, before the next answered input and before the task's end; nan where none did.
        After a push that was dropped it is the cost of the reach that restarted.
      cost: total cost of the best reach trajectory after the last reach iteration that has ended;
        nan before the first.
      terms: (c_d, c_f, c_b) of the same trajectory.
      non_finite: iterations in which some rollout's cost was not finite.
      non_finite_at: numbers of these iterations, in order, as in `Work` and in ITERATION events.
      saturated: rollouts with a knot end at which every contact slot was in use.
      checks: final checks that have ended; only in fleets whose checks are real rollouts, else
        None.
      check_misses: those that missed; as `checks`.
      attempts: executions of a reach that began; only in fleets whose checks are real or whose
        reaches may miss, else None. The last one grasped if the task is solved.
      asking_s: time that requests waited, whatever the robot did meanwhile, s; only in fleets whose
        robots plan while they ask or are served, else None. There `waiting_s` and `interaction_s`
        are the times that the robot stood still for it.
      served_s: time that operators spent on the task, s; as `asking_s`.
      lost_s: time of iterations and checks that were broken off, s; as `asking_s`.
      withdrawn: requests withdrawn because the robot solved the task meanwhile; as `asking_s`.
    """

    robot: int
    task: int
    status: Status
    planning_time_s: float
    waiting_s: float
    window_wait_s: float
    interaction_s: float
    execution_s: float
    start_ns: int
    end_ns: int
    iterations: int
    reach_iterations: int
    pushes_planned: int
    pushes_succeeded: int
    requests: int
    answered: int
    grants: int
    refusals: int
    expired: int
    first_bid: int | None
    first_grant: int | None
    grants_at: tuple[int, ...]
    successful_grants_at: tuple[int, ...]
    asked_cost: tuple[float, ...]
    helped_cost: tuple[float, ...]
    cost: float
    terms: tuple[float, float, float]
    non_finite: int
    non_finite_at: tuple[int, ...]
    saturated: int
    checks: int | None = None
    check_misses: int | None = None
    attempts: int | None = None
    asking_s: float | None = None
    served_s: float | None = None
    lost_s: float | None = None
    withdrawn: int | None = None

    @property
    def first_attempt(self) -> bool:
        """Whether the first reach that was executed solved the task; False without `attempts`."""
        return self.status is Status.SOLVED and self.attempts == 1

    @property
    def grasp_misses(self) -> int | None:
        """Reaches that were executed and missed, or None; one cut off by the horizon counts."""
        if self.attempts is None:
            return None
        return self.attempts - (self.status is Status.SOLVED)

    @property
    def task_time_s(self) -> float:
        """Time in the task, execution apart: planning, waiting and being served, s."""
        return (self.end_ns - self.start_ns) / 1e9 - self.execution_s
