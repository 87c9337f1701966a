"""Operator `noisy`: gives the input of `heuristic`, with random errors.

A person who clicks on a picture of the shelf makes two errors: the wrong object, and the right
object to a place beside the one that was meant.
"""

import dataclasses
import math

import numpy as np

from pgf_jax.batching.requests import Coroutine
from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.heuristic import HeuristicOperator, target_bounds
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push
from pgf_jax.streams import stream


@dataclasses.dataclass(frozen=True)
class NoisyOperator:
    """Operator that decides as `HeuristicOperator` does, then makes errors at random.

    The errors are drawn by (seed, robot, task, iteration): the same decision has the same errors
    under every policy and at every fleet size. "Go on reaching" has no errors. The default rates
    are assumptions.

    Attributes:
      wrong: probability that another object is pushed, by the same displacement: the one nearest
        to the intended object, never the goal. Where there is none, the intended one stays.
      misplaced: probability that the target is displaced; independent of `wrong`.
      sd_m: standard deviation of that displacement, per axis, m.

    Raises:
      BadInput: a rate is no probability, or the standard deviation is negative.
    """

    wrong: float = 0.2
    misplaced: float = 0.3
    sd_m: float = 0.04

    name = "noisy"

    def __post_init__(self) -> None:
        for name in ("wrong", "misplaced"):
            value = getattr(self, name)
            if not (_is_number(value) and value <= 1):
                raise BadInput(f"{name}: expected a number within 0..1, got {value!r}")
        if not _is_number(self.sd_m):
            raise BadInput(f"sd_m: expected a number of metres, 0 or more, got {self.sd_m!r}")

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        """See `RolloutOperator.deliberate`."""
        intended = yield from HeuristicOperator().deliberate(view, search, planner, decision_key)
        return None if intended is None else self.with_errors(intended, view, decision_key)

    def with_errors(self, intended: Push, view: View, decision_key: DecisionKey) -> Push:
        """The push that the operator gives when it means `intended`."""
        uniform, normal = _draws(decision_key)
        pushed, target = intended.object, np.array([intended.x, intended.y])
        if uniform[0] < self.wrong:
            pushed = _neighbour(intended.object, view)
            moved = view.objects[pushed] - view.objects[intended.object]
            target = _on_shelf(target + moved, view, pushed)
        if uniform[1] < self.misplaced:
            target = _on_shelf(target + self.sd_m * normal, view, pushed)
        return Push(pushed, *map(float, target))


def _neighbour(pushed: int, view: View) -> int:
    """The object nearest to the pushed one, except the goal; the pushed one if there is none."""
    distance = np.linalg.norm(view.objects - view.objects[pushed], axis=1)  # [N]
    distance[[pushed, view.goal]] = np.inf
    nearest = int(np.argmin(distance))
    return nearest if np.isfinite(distance[nearest]) else pushed


def _on_shelf(target: np.ndarray, view: View, pushed: int) -> np.ndarray:
    """The nearest allowed target [2] of an object, m."""
    return np.clip(target, *target_bounds(view, pushed))


def _draws(decision_key: DecisionKey) -> tuple[np.ndarray, np.ndarray]:
    """Draw two numbers uniform on [0, 1), and two of the standard normal distribution.

    Every decision draws all four, so that one error does not depend on the rate of the other.
    """
    seed, *rest = decision_key
    # Raw bits: NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
    bits = stream(seed, "noisy", *rest).bit_generator.random_raw(4)
    u = (bits >> 11) * 2.0**-53  # the 53 bits that a float64 holds
    radius, angle = math.sqrt(-2 * math.log1p(-u[2])), 2 * math.pi * u[3]  # Box and Muller
    return u[:2], radius * np.array([math.cos(angle), math.sin(angle)])


def _is_number(value: object) -> bool:
    """Whether the value is a finite number, 0 or more."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return 0 <= value < math.inf
