"""The fleet's static configuration: one cell of a sweep."""

import dataclasses
import math

from pgf_jax.errors import BadInput
from pgf_jax.fleet.compute import parse_compute
from pgf_jax.fleet.policies import check_policy
from pgf_jax.settings import check_fields


@dataclasses.dataclass(frozen=True)
class FleetConfig:
    """One fleet: sizes, policy, operators and simulated times (D4, D5, D7, D8). BadInput if wrong.

    Attributes:
      robots: R.
      tasks: tasks of each robot.
      policy: a name registered in `policies.py`.
      operators: how many people help.
      window_s: T_window of Alg. 2, s.
      service_mean_s: mean of the log-normal service time, s.
      service_sd_s: its standard deviation, s; 0 makes it constant.
      context_switch_s: added to a service when the operator served another robot before, s.
      rollout_time_s: simulated time of one rollout, s; an iteration takes two, iteration 0 and the
        final check one each.
      rollouts: K, noisy rollouts of an iteration: the threads that one robot keeps busy.
      compute: `dedicated`, or `shared:C` with C cores.
      horizon_s: when the fleet stops, s of simulated time; None: when all tasks are done.
      bid_threshold: a gain must exceed it to be bid.
      task_limit_s: planning, waiting and interaction allowed in a task, s.
      push_limit_s: planning allowed for a push, s (and no more than remains of the task).
      push_execution_s, retreat_s, reach_execution_s: simulated times of execution, s.
      seed: of service times and ties.
    """

    robots: int = 1
    tasks: int = 50
    policy: str = "pgf"
    operators: int = 1
    window_s: float = 2.0
    service_mean_s: float = 8.0
    service_sd_s: float = 4.0
    context_switch_s: float = 0.0
    rollout_time_s: float = 1.5
    rollouts: int = 8
    compute: str = "dedicated"
    horizon_s: float | None = None
    bid_threshold: float = 1.0
    task_limit_s: float = 180.0
    push_limit_s: float = 30.0
    push_execution_s: float = 3.0
    retreat_s: float = 1.0
    reach_execution_s: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("robots", "tasks", "operators", "rollouts"):
            _whole(name, getattr(self, name), 1)
        _whole("seed", self.seed, 0)
        for name in (
            "window_s",
            "service_mean_s",
            "service_sd_s",
            "context_switch_s",
            "push_limit_s",
            "push_execution_s",
            "retreat_s",
            "reach_execution_s",
        ):
            value = getattr(self, name)
            if not (_is_number(value) and value >= 0):
                raise BadInput(f"{name} must be a number of seconds, 0 or more, got {value!r}")
        for name in ("rollout_time_s", "task_limit_s", "horizon_s"):
            value = getattr(self, name)
            if name == "horizon_s" and value is None:
                continue
            # The clock counts whole nanoseconds; a rollout of 0 ns would never let it advance.
            if not (_is_number(value) and value >= 1e-9):
                raise BadInput(f"{name} must be a positive number of seconds, got {value!r}")
        if self.service_mean_s == 0 and self.service_sd_s > 0:
            raise BadInput(
                f"service_sd_s must be 0 when service_mean_s is 0, got {self.service_sd_s!r}"
            )
        if not _is_number(self.bid_threshold):
            raise BadInput(f"bid_threshold must be a finite number, got {self.bid_threshold!r}")
        parse_compute(self.compute, rollouts=self.rollouts)
        check_policy(self.policy)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _whole(name: str, value: object, least: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise BadInput(f"{name} must be a whole number, {least} or more, got {value!r}")


@dataclasses.dataclass(frozen=True)
class Cell:
    """One fleet of a sweep: a policy and a fleet size; what a row of `summary.csv` is about.

    Attributes:
      policy: its name.
      robots: R.
      tasks: of each robot.
    """

    policy: str
    robots: int
    tasks: int

    @property
    def name(self) -> str:
        """Names the folder of its files."""
        return f"{self.policy}_R{self.robots}"
