"""The discipline `index`: whenever an operator is free, the robots that plan are ranked.

There is no window and no bid that waits. Decisions come once an instant, after all iterations and
services that end then; free operators take the robots of highest index. A fleet-wide policy says
how high each is (`IndexPolicy`); it sees all robots that may be helped.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from pgf_jax.fleet.policies import TaskProgress
from pgf_jax.fleet.robots import IterationResult
from pgf_jax.streams import stream


class RobotState(NamedTuple):
    """What a fleet-wide policy sees of a robot that may be helped now.

    It plans a reach, and neither checks a solution nor waits; and it has iterated since it was
    served last.

    Attributes:
      progress: of its task.
      result: of its last iteration.
      unhelped_s: since its last service in the task ended, or else since the task began, s.
    """

    progress: TaskProgress
    result: IterationResult
    unhelped_s: float


class IndexPolicy(Protocol):
    """Ranks robots; without a state, as every policy. See `policies.Policy` for the rest."""

    def index(self, robots: Sequence[RobotState]) -> Sequence[float | None]:
        """The index of each robot, a number in a unit of the policy's own.

        The highest are served. None: not to be served, for instance because its history is short.
        A policy with a reservation value gives None below it.
        """
        ...


def ranking(
    policy: IndexPolicy, robots: Sequence[RobotState], *, seed: int, decision: int
) -> list[tuple[int, float]]:
    """The robots that are to be served, best first: (robot, index).

    Args:
      policy: ranks them.
      robots: that may be helped.
      seed: of the fleet.
      decision: number of the decision. Ties are broken by a random key of (seed, decision, robot).
    """
    found = policy.index(robots)
    number = 1 + max((state.progress.robot for state in robots), default=0)
    keys = stream(seed, "index", decision).random(number)
    ranked = [
        (state.progress.robot, float(value))
        for state, value in zip(robots, found, strict=True)
        if value is not None
    ]
    return sorted(ranked, key=lambda one: (-one[1], keys[one[0]]))
