"""Service times: how long an operator takes to give one input."""

import dataclasses
import math
from typing import Protocol

from pgf_jax.streams import stream


class ServiceTimes(Protocol):
    """Draws service times. `Fleet` takes any object with this method."""

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        """Length in s, not negative, of service number `request` of a task.

        Must depend on the arguments alone. None: the service is open: it lasts until its input is
        delivered or the task's limit is reached, as with a person, whose answer time is unknown.
        """
        ...


@dataclasses.dataclass(frozen=True)
class LogNormal:
    """Log-normal service times of a given mean and standard deviation, in s.

    Each draw has its own stream, keyed by (seed, robot, task, request): the task's n-th input takes
    the same time under every policy, however often an ask was refused before. Paired differences
    need these common random numbers.
    """

    seed: int
    mean_s: float
    sd_s: float

    def seconds(self, robot: int, task: int, request: int) -> float:
        """Draw a service time: exp(mu + sigma z) with sigma^2 = ln(1 + (sd/mean)^2)."""
        if self.sd_s == 0:
            return self.mean_s
        variance = math.log1p((self.sd_s / self.mean_s) ** 2)
        z = stream(self.seed, "service", robot, task, request).standard_normal()
        return self.mean_s * math.exp(math.sqrt(variance) * z - variance / 2)
