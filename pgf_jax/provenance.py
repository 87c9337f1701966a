"""Provenance of results: versions, code, device and processor; and the host.

Results may depend on all of these except the host.
"""

import functools
import hashlib
import importlib.metadata
import os
import platform
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax

from pgf_jax import jax_setup

PACKAGES = ("pgf_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "flax", "numpy")
# Results of another release of these may differ in the last bits, and then in everything else.
DECISIVE = ("pgf_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx")


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    packages = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"python": platform.python_version()} | packages


@functools.cache
def device() -> str:
    """The device that JAX computes on: backend and kind."""
    return f"{jax.default_backend()}: {jax.devices()[0].device_kind}"


@functools.cache
def xla() -> dict[str, str | int | None]:
    """What XLA was started with, see `jax_setup.in_force`."""
    device()  # starts it
    return jax_setup.in_force()


@functools.cache
def processor() -> str:
    """The type of the processor; on one type, results are equal to the last bit."""
    name = platform.processor()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    except OSError:  # not Linux
        pass
    return f"{name or 'unknown'} ({platform.machine()}, {sys.byteorder} endian)"


@functools.cache
def code() -> dict[str, Any]:
    """The code that runs: its commit, if known, and a digest of its source.

    Returns:
      `git`: see `git_commit`; `source_sha256`: digest of the package's modules and their names.
    """
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(package).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return {"git": git_commit(package.parent), "source_sha256": digest.hexdigest()}


def git_commit(root: Path) -> dict[str, Any] | None:
    """The commit checked out in a folder, and whether files are modified; None if unknown."""
    if not (root / ".git").exists():  # installed: a repository around it is another project's
        return None
    try:
        commit, status = (
            subprocess.run(
                ["git", "-C", str(root), *words],
                capture_output=True,
                text=True,
                check=True,
                timeout=10,
            ).stdout
            # Untracked files do not count: they may be results.
            for words in (["rev-parse", "HEAD"], ["status", "--porcelain", "-uno"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit.strip(), "modified": bool(status.strip())}


def environment() -> dict[str, Any]:
    """Everything here that results may depend on, and what XLA was started with, as JSON."""
    return {**origin(), "xla": xla()}


def origin() -> dict[str, Any]:
    """Everything here that results may depend on, as JSON: the same in all workers of a sweep."""
    return {
        "versions": versions(),
        "device": device(),
        "processor": processor(),
        "code": code(),
    }


def kind() -> dict[str, str]:
    """What a worker and its caller must have in common, so that results are the same."""
    decisive = {name: versions()[name] for name in DECISIVE}
    return {
        **decisive,
        "device": device(),
        "source": code()["source_sha256"],
        "xla options": "on" if jax_setup.has_options() else "off",
    }


def host() -> dict[str, Any]:
    """The computer and the process; results do not depend on them."""
    return {
        "name": socket.gethostname(),
        "pid": os.getpid(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "xla": xla(),
    }
