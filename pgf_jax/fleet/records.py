"""One robot's run through one task: what is counted while it lasts, and the record it leaves."""

import dataclasses
import enum
import math

from pgf_jax.planning.types import Status

NO_TERMS = (math.nan, math.nan, math.nan)


class State(enum.StrEnum):
    """What a robot does (D8); its time is booked under exactly one of these."""

    IDLE = "idle"
    PLANNING = "planning"  # iterations of reaching and pushing, and the final check
    IN_WINDOW = "in_window"  # waiting, from its bid to the window's end
    IN_LINE = "in_line"  # waiting for an operator
    SERVED = "served"
    EXECUTING = "executing"  # a push and its retreat, or the reach


@dataclasses.dataclass(frozen=True)
class TaskRecord:
    """One row of `tasks.parquet`: the metrics of D9 for one task.

    Planning, line waits, interaction and execution add up to end - start; times are s, unless named
    `_ns`. Reach iterations are cumulative over the task and leave iteration 0s out: 0 is before or
    at the nominal's own rollout.

    Attributes:
      robot, task: which; 0-based.
      status: how it ended.
      planning_time_s: the headline: iterations of reaching and pushing, first rollouts, the final
        check and window waits; not line waits, interaction, execution or retreat.
      waiting_s: in windows and in line.
      window_wait_s: the part of it spent in windows.
      interaction_s: being served.
      execution_s: executing pushes, retreats and the reach.
      start_ns, end_ns: simulated times.
      iterations: of reaching and pushing that have ended, iteration 0s left out.
      reach_iterations: those of reaching.
      pushes_planned: pushes whose planning began.
      pushes_succeeded: those found feasible, and executed.
      requests: asks made: answered, refused, expired or cut off by the horizon.
      answered: inputs given.
      grants: services begun.
      refusals: asks refused, in windows lost too.
      expired: asks that ended with the task, in line, in a window or while being served, and
        services in which the operator did not answer.
      first_bid, first_grant: reach iterations at the first of each, or None.
      grants_at: reach iterations at each grant.
      successful_grants_at: the same, for grants whose push succeeded.
      asked_cost: for each answered input, the total cost of the best reach trajectory when it was
        given; nan where nothing had been rolled out yet (`always`).
      helped_cost: for each answered input, the total cost of the best reach trajectory after the
        last reach iteration, iteration 0s included, that ended within the next `LOOK_AHEAD` reach
        iterations, before the next answered input and before the task's end; nan where none did.
        After a push that was dropped it is the cost of the reach that restarted.
      cost, terms: total and (c_d, c_f, c_b) of the best reach trajectory after the last reach
        iteration that has ended; nan before the first.
      non_finite: iterations in which some rollout's cost was not finite.
      non_finite_at: which, in order: numbers as in `Work`, those of ITERATION events.
      saturated: rollouts with a knot end at which every contact slot was in use.
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
