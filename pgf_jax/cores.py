"""The cores that this process may use; where the system does not say (not Linux), all there are."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path


def usable() -> list[int]:
    """Their numbers, ascending."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def pin(cores: Sequence[int]) -> None:
    """Keep this process to some cores, where the system can; before JAX and MuJoCo count them."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


_claimed: tuple[int, int] | None = None  # the core, and the open file that says so


def claim() -> int | None:
    """Keep this thread, and those it starts, to a core that no other process has claimed.

    For processes that know nothing of each other, as the workers of a cluster: a file a core is
    locked for as long as this process lives. Claimed once, the same core is kept to every time.

    Returns:
      The core; None where there is none left, or no saying: then nothing changes.
    """
    global _claimed
    if _claimed is None:
        folder = Path(tempfile.gettempdir()) / f"pgf_jax_cores_{os.getuid()}"
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, exist_ok=True)
            for core in usable():
                flags = os.O_CREAT | os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
                descriptor = os.open(folder / str(core), flags, 0o600)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except OSError:
                    os.close(descriptor)
                    continue
                _claimed = core, descriptor
                break
    if _claimed is None:
        return None
    pin([_claimed[0]])
    return _claimed[0]
