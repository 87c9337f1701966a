"""Compute models (D8): how much longer an iteration takes than on a computer of its own."""

import dataclasses
from typing import Protocol

from pgf_jax.errors import BadInput


class ComputeModel(Protocol):
    """Stretches the simulated time of planning. `Fleet` takes any object with this method."""

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        """Factor on an iteration's time, asked once, at the iteration's start.

        Args:
          robot, task, iteration: which iteration starts, counted as in `Work`.
          planning: A, the number of robots that plan at this instant, this one included.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Dedicated:
    """Each robot has its own computer."""

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        """1, always."""
        return 1.0


@dataclasses.dataclass(frozen=True)
class Shared:
    """All robots share `cores` cores: max(1, K A / C), K threads a robot.

    With the paper's C = 96 and K = 8, 12 robots fill the computer and 30 oversubscribe it.
    """

    cores: int  # C
    rollouts: int  # K

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        """max(1, K A / C)."""
        return max(1.0, self.rollouts * planning / self.cores)


def parse_compute(text: str, *, rollouts: int = 8) -> ComputeModel:
    """The model that `dedicated` or `shared:C` names; BadInput for anything else."""
    if text == "dedicated":
        return Dedicated()
    name, _, cores = str(text).partition(":")
    # isdecimal alone lets other scripts' digits through; int() would take '1_0' and ' 3', and not
    # thousands of digits.
    is_number = cores.isascii() and cores.isdecimal() and len(cores) < 10
    if name == "shared" and is_number and int(cores) > 0:
        return Shared(int(cores), rollouts)
    raise BadInput(f"compute must be 'dedicated' or 'shared:C' with C cores, C >= 1, got {text!r}")
