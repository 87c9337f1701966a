"""Compute models: how much slower an iteration is than on a dedicated computer."""

import dataclasses
from typing import Protocol

from pgf_jax.errors import BadInput, short_repr


class ComputeModel(Protocol):
    """Slows simulated planning down. `Fleet` takes any object with this method."""

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        """Factor on the time of an iteration or final check; called once, when it starts.

        Args:
          robot, task, iteration: which iteration starts, counted as in `Work`; a final check has
            the number of the iteration that would come next.
          planning: A, the number of robots that plan at this instant, including this robot.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Dedicated:
    """Each robot has its own computer."""

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        """Always 1."""
        return 1.0


@dataclasses.dataclass(frozen=True)
class Shared:
    """All robots share `cores` cores: the factor is max(1, K A / C), with K threads a robot.

    With C = 96 (Papallas & Dogar 2022) and K = 8, 12 robots use the whole computer and 30
    oversubscribe it.
    """

    cores: int  # C
    rollouts: int  # K

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        """max(1, K A / C)."""
        return max(1.0, self.rollouts * planning / self.cores)


def parse_compute(text: str, *, rollouts: int = 8) -> ComputeModel:
    """Parse `dedicated` or `shared:C`.

    Args:
      text: the name.
      rollouts: K, threads that one robot uses.

    Raises:
      BadInput: `text` is neither.
    """
    if text == "dedicated":
        return Dedicated()
    name, _, cores = str(text).partition(":")
    # isdecimal alone accepts digits of other scripts; int() accepts '1_0' and ' 3', and fails on
    # thousands of digits.
    is_number = cores.isascii() and cores.isdecimal() and len(cores) < 10
    if name == "shared" and is_number and int(cores) > 0:
        return Shared(int(cores), rollouts)
    raise BadInput(f"compute: expected dedicated, or shared:C with C cores, got {short_repr(text)}")
