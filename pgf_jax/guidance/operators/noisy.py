"""The `noisy` operator (D5): it sees what `heuristic` sees, and errs in what it says.

Two errors of somebody who clicks on a picture of the shelf: the wrong object, and the right object
to a place beside the one that was meant.
"""

import dataclasses
import math

import numpy as np

from pgf_jax.batching.requests import Coroutine
from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.heuristic import TARGETS_HIGH, TARGETS_LOW, HeuristicOperator
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import Push
from pgf_jax.streams import stream


@dataclasses.dataclass(frozen=True)
class NoisyOperator:
    """Decides as `HeuristicOperator` does, then errs. The default rates are assumptions.

    The errors are drawn by (seed, robot, task, iteration): the same turn has the same ones under
    every policy and at every fleet size. "Go on reaching" stays so.

    Attributes:
      wrong: probability that the push is of another object, by the same displacement: of the one
        nearest to the intended object, never the goal. Where there is none, the intended one stays.
      misplaced: probability that the target is somewhere else; independent of `wrong`.
      sd_m: standard deviation, per axis, of where it is then, m.

    Raises:
      BadInput: a rate that is no probability, or a standard deviation that is negative.
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
        self, view: View, search: Search, planner: BatchPlanner, at: DecisionKey
    ) -> Coroutine:
        """See `operators.Deliberate.deliberate`."""
        intended = yield from HeuristicOperator().deliberate(view, search, planner, at)
        return None if intended is None else self.err(intended, view, at)

    def err(self, intended: Push, view: View, at: DecisionKey) -> Push:
        """What it says when it means `intended`."""
        uniform, normal = _draws(at)
        pushed, target = intended.object, np.array([intended.x, intended.y])
        if uniform[0] < self.wrong:
            pushed = _neighbour(intended.object, view)
            moved = view.objects[pushed] - view.objects[intended.object]
            target = _on_shelf(target + moved)
        if uniform[1] < self.misplaced:
            target = _on_shelf(target + self.sd_m * normal)
        return Push(pushed, *map(float, target))


def _neighbour(pushed: int, view: View) -> int:
    """The object nearest to the pushed one, other than the goal; itself where there is none."""
    distance = np.linalg.norm(view.objects - view.objects[pushed], axis=1)  # [N]
    distance[[pushed, view.goal]] = np.inf
    nearest = int(np.argmin(distance))
    return nearest if np.isfinite(distance[nearest]) else pushed


def _on_shelf(target: np.ndarray) -> np.ndarray:
    """[2] the nearest place where a target may be, m."""
    return np.clip(target, TARGETS_LOW, TARGETS_HIGH)


def _draws(at: DecisionKey) -> tuple[np.ndarray, np.ndarray]:
    """Two numbers of the uniform distribution on [0, 1), and two of the standard normal one.

    All four at every turn, so that which error is made does not depend on the other's rate.
    """
    # Raw bits: NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
    bits = stream(at[0], "noisy", *at[1:]).bit_generator.random_raw(4)
    u = (bits >> 11) * 2.0**-53  # the 53 bits that a float64 holds
    radius, angle = math.sqrt(-2 * math.log1p(-u[2])), 2 * math.pi * u[3]  # Box and Muller
    return u[:2], radius * np.array([math.cos(angle), math.sin(angle)])


def _is_number(value: object) -> bool:
    """Whether it is a finite number, 0 or more."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return 0 <= value < math.inf
