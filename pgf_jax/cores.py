"""The cores that this process may use; where the system does not say (not Linux), all there are."""

import os
from collections.abc import Sequence


def usable() -> list[int]:
    """Their numbers, ascending."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def pin(cores: Sequence[int]) -> None:
    """Keep this process to some cores, where the system can; before JAX and MuJoCo count them."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
