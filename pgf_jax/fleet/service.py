"""Service times (D5): how long an operator takes to give one input."""

import dataclasses
import math
from typing import Protocol

from pgf_jax.streams import stream


class ServiceTimes(Protocol):
    """Draws service times. `Fleet` takes any object with this method."""

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        """Length in s, not negative, of service number `request` of a task.

        Must depend on the arguments alone. None: it lasts until its input is delivered, or the
        task's limit has come, as with a person whose answer nobody can foretell.
        """
        ...


@dataclasses.dataclass(frozen=True)
class LogNormal:
    """Log-normal service times of a given mean and standard deviation, in s.

    Each draw has its own stream, keyed by (seed, robot, task, request): whichever policy asks, and
    however often it was refused before, the task's n-th input takes the same time. These are the
    common random numbers that paired differences rest on.
    """

    seed: int
    mean_s: float
    sd_s: float

    def seconds(self, robot: int, task: int, request: int) -> float:
        """The draw; exp(mu + sigma z) with sigma^2 = ln(1 + (sd/mean)^2)."""
        if self.sd_s == 0:
            return self.mean_s
        variance = math.log1p((self.sd_s / self.mean_s) ** 2)
        z = stream(self.seed, "service", robot, task, request).standard_normal()
        return self.mean_s * math.exp(math.sqrt(variance) * z - variance / 2)
