"""Processor cores: which cores this process may use, and how it is kept to some of them."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path


def usable() -> list[int]:
    """Numbers of the cores that this process may use, ascending; not on Linux: all cores."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def pin(cores: Sequence[int]) -> None:
    """Keep this process to some cores, where the system can.

    Call it before JAX and MuJoCo count the cores.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


_claimed: tuple[int, int] | None = None  # the core, and the descriptor of its lock file


def claim() -> int | None:
    """Keep this thread, and the threads it starts, to a core that no other process has claimed.

    It serves processes that do not know of each other, such as the workers of a cluster. Each core
    has a lock file, which this process locks as long as it lives. Later calls use the same core.

    Returns:
      The core; None if no core is left or lock files cannot be written: then nothing changes.
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
