"""Policies of studies of one robot: when a person is asked is set, not decided by need.

They are ordinary policies (`fleet.policies`), registered under names that carry their numbers.
"""

import dataclasses
import math

from pgf_jax.errors import BadInput, shown
from pgf_jax.fleet.policies import (
    Discipline,
    Policy,
    Progress,
    Silent,
    policy_names,
    register_policy,
)
from pgf_jax.fleet.robots import IterationResult


@dataclasses.dataclass(frozen=True)
class After(Silent):
    """`after:N`: asks once N reach iterations have passed since the restart or the last input."""

    iterations: int
    discipline: Discipline = Discipline.REFUSE  # at once: the operator is all this robot's

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """+inf from iteration N of each stretch on."""
        return math.inf if progress.since_restart >= self.iterations else None


@dataclasses.dataclass(frozen=True)
class Once(Silent):
    """`once-after:N`: asks once in a task, after its reach iteration N."""

    iterations: int
    discipline: Discipline = Discipline.REFUSE

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """+inf from iteration N on, until it is granted."""
        asks = progress.grants == 0 and progress.reach_iterations >= self.iterations
        return math.inf if asks else None


def after(iterations: int) -> str:
    """The name under which `After(iterations)` is registered."""
    return _named(f"after:{iterations}", After(iterations))


def once_after(iterations: int) -> str:
    """The name under which `Once(iterations)` is registered."""
    return _named(f"once-after:{iterations}", Once(iterations))


def _named(name: str, policy: Policy) -> str:
    if name not in policy_names():
        register_policy(name, lambda config: policy)
    return name


def check_ask(text: str) -> int:
    """The N of `after:N`, 0 for `stuck`, `gain` and `never`; BadInput for anything else."""
    if text in ("stuck", "gain", "never"):
        return 0
    name, _, number = str(text).partition(":")
    # isdecimal alone lets other scripts' digits through; int() would take '1_0' and ' 3'.
    # More digits would not be read as a number, nor be reached.
    if name == "after" and number.isascii() and number.isdecimal() and len(number) < 19:
        return int(number)
    raise BadInput(f"ask: expected stuck, gain, never or after:N with N >= 0, got {shown(text)}")
