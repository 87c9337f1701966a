"""Settings of one fleet, and the cell of a sweep that it belongs to."""

import dataclasses
from typing import Annotated, Literal

from pgf_jax.errors import BadInput
from pgf_jax.fleet.compute import parse_compute
from pgf_jax.fleet.policies import Policy, check_policy
from pgf_jax.settings import Bounds, Count, Seconds, check_fields

# The simulated clock counts whole nanoseconds: a rollout of 0 ns would never let it advance.
ClockSeconds = Annotated[float, Bounds(1e-9, unit="seconds")]
# Options of the commands that simulate a fleet, in their order in the help.
CLOCK_OPTIONS = (
    *("task_limit", "push_limit", "rollout_time"),
    *("push_execution", "retreat", "reach_execution"),
)
Meanwhile = Literal["wait", "plan"]
MEANWHILE_OPTIONS = ("while_asking", "while_served")
INDEX_OPTIONS = ("reservation", "failure_cost")
Gain = Annotated[float, Bounds()]  # in units of cost


@dataclasses.dataclass(frozen=True)
class FleetConfig:
    """The settings of one fleet: sizes, policy, operators and simulated times.

    BadInput where a value is wrong. The paper does not state `rollout_time_s` and the service
    times; their defaults are assumptions.

    Attributes:
      robots: R.
      tasks: tasks of each robot.
      policy: a name registered in `policies.py`.
      operators: number of operators.
      window_s: T_window of Alg. 2, s.
      service_mean_s: mean of the log-normal service time, s.
      service_sd_s: its standard deviation, s; 0 makes it constant.
      context_switch_s: added to a service when the operator served another robot before, s.
      rollout_time_s: simulated time of one rollout, s; an iteration takes two, iteration 0 and the
        final check one each.
      rollouts: K, noisy rollouts of an iteration: the threads that one robot keeps busy.
      compute: `dedicated`, or `shared:C` with C cores.
      horizon_s: the fleet stops at this simulated time, s; None: when all tasks are done.
      bid_threshold: a gain must exceed it to be bid.
      task_limit_s: planning, waiting and interaction allowed in a task, s.
      push_limit_s: planning allowed for a push, s (and no more than remains of the task).
      push_execution_s, retreat_s, reach_execution_s: simulated times of execution, s.
      seed: seed of service times and ties.
      while_asking: what a robot does between its ask and the operator's turn: `wait`, or `plan` on;
        None: as its policy does.
      while_served: what it does until the operator's answer; likewise. Solved meanwhile, it
        withdraws its request. A push breaks its iteration off; a push that cannot be planned then
        gives back the search as it was.
      reservation: index that a robot must exceed to be served, in the unit of a policy that ranks
        by time; None: the policy's own.
      failure_cost_s: what a task that is not solved costs such a policy beside the time, s.
    """

    robots: Count = 1
    tasks: Count = 50
    policy: str = "pgf"
    operators: Count = 1
    window_s: Seconds = 2.0
    service_mean_s: Seconds = 8.0
    service_sd_s: Seconds = 4.0
    context_switch_s: Seconds = 0.0
    rollout_time_s: ClockSeconds = 1.5
    rollouts: Count = 8
    compute: str = "dedicated"
    horizon_s: ClockSeconds | None = None
    bid_threshold: Gain = 1.0
    task_limit_s: ClockSeconds = 180.0
    push_limit_s: Seconds = 30.0
    push_execution_s: Seconds = 3.0
    retreat_s: Seconds = 1.0
    reach_execution_s: Seconds = 3.0
    seed: Annotated[int, Bounds(0)] = 0
    while_asking: Meanwhile | None = None
    while_served: Meanwhile | None = None
    reservation: Annotated[float, Bounds()] | None = None
    failure_cost_s: Seconds = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.service_mean_s == 0 and self.service_sd_s > 0:
            raise BadInput(
                f"service_sd_s: expected 0 with service_mean_s 0, got {self.service_sd_s!r}"
            )
        parse_compute(self.compute, rollouts=self.rollouts)
        check_policy(self.policy)


def plans_meanwhile(config: FleetConfig, policy: Policy) -> tuple[bool, bool]:
    """Whether the robots of a fleet plan while they ask, and while they are served."""
    given = (config.while_asking, config.while_served)
    asking, served = (policy.plans_on if chosen is None else chosen == "plan" for chosen in given)
    return asking, served


@dataclasses.dataclass(frozen=True)
class Cell:
    """One fleet of a sweep: a policy, a fleet size and a seed; `summary.csv` has a row for each.

    Attributes:
      policy: its name.
      robots: R.
      tasks: tasks of each robot.
      seed: of scenes, planning noise, service times and ties.
    """

    policy: str
    robots: int
    tasks: int
    seed: int = 0

    @property
    def name(self) -> str:
        """Policy and size."""
        return f"{self.policy}_R{self.robots}"
