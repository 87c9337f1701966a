"""Configures JAX for the engines: options of XLA, its threads, and the cache of its programs.

Nothing else in the project sets these. Importing this imports no JAX: XLA reads its options and the
number of its threads from the environment, once, when its backend starts.
"""

import functools
import importlib.metadata
import os
import re
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path

# XLA's CPU backend makes one kernel of a loop whose data are smaller than the threshold, in bytes,
# in place of a kernel for each step of it. And LLVM unrolls short loops over lanes altogether, and
# then finds no vectors in them. `planar`, many short loops, is three times as fast with both.
OPTIONS = {
    "xla_cpu_small_while_loop_byte_threshold": "1000000000",
    "xla_cpu_disable_loop_unrolling": "true",
}
FLAG = "--xla_backend_extra_options"
# Releases of jaxlib with which results were compared with and without the options: `native` and
# `mjx` equal to the last bit, `planar` but for it, as XLA rounds products in sums once or twice
# as its kernels are cut. So `planar` without them is another revision of it (`sweeping.resolve`).
# XLA says nothing of an option that it does not know, and a wrong value fails every call.
TESTED = ("0.10.2",)
CACHE = ("JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
VARIABLES = ("XLA_FLAGS", "NPROC", *CACHE)
AS_CALLER = "xla"  # the key under which a worker is told what its caller has, see `as_caller`

_wanted = True  # the options, see `as_caller`
_own_nproc: str | None = None  # the value that NPROC was set to here


def configure(engine: str | None = "planar") -> None:
    """Make JAX fast for an engine; call it before the first computation.

    It sets options of XLA, keeps compiled programs in `~/.cache/pgf_jax`, and keeps XLA from
    starting threads for `planar`, whose short kernels would only wait for them. What the user has
    set stays: `XLA_FLAGS` (options are added), `NPROC` and the variables of JAX's cache.
    Results of `planar` change in their last bits with the options, others do not. Where JAX has
    started already, a warning says what that costs, and compiled programs are kept all the same.
    `pgf_jax.plan`, `sweep`, `collect`, `train` and the commands configure JAX themselves, unless it
    has started.

    Args:
      engine: what will be computed with; None: several, or none.
    """
    if started():
        missing = _missing(engine)
        if missing:
            warnings.warn(
                f"pgf_jax.configure(): JAX has started already: without {' and '.join(missing)} "
                "computations are slower; call it before the first one",
                RuntimeWarning,
                stacklevel=2,
            )
        _keep_compiled()
    else:
        configure_early(engine)


def configure_early(engine: str | None, threads: int = 1) -> None:
    """Do what `configure` does where JAX has not started; else nothing, and without a word.

    Args:
      engine: see `configure`.
      threads: of this process that will call `planar` side by side, each on a thread of XLA.
    """
    global _own_nproc
    if started():
        return
    flags = os.environ.get("XLA_FLAGS", "").strip()
    # What does not begin with a dash is the name of a file of flags: the user's, and left alone.
    ours = ",".join(f"{name}={value}" for name, value in OPTIONS.items() if name not in flags)
    if ours and _wanted and (not flags or flags[0] == "-") and _is_tested():
        os.environ["XLA_FLAGS"] = f"{flags} {FLAG}={ours}".strip()
    if engine == "planar" and os.environ.get("NPROC", _own_nproc) == _own_nproc:
        os.environ["NPROC"] = _own_nproc = str(threads)
    _keep_compiled()


def for_workers() -> tuple[bool, str | None]:
    """What a worker is told of this process: whether it has the options; NPROC, if set here."""
    return has_options(), _own_nproc


def as_caller(told: tuple[bool, str | None]) -> None:
    """Leave XLA's options out in this process if its caller is without them.

    Called before JAX starts: with the same options, results are the same. The caller's NPROC was
    inherited, and is for the caller.
    """
    global _wanted, _own_nproc
    _wanted, _own_nproc = told


def has_options() -> bool:
    """Whether XLA has all of the options as `configure` sets them, or will have."""
    force = in_force()
    return all(force[name.removeprefix("xla_cpu_")] == value for name, value in OPTIONS.items())


def one_engine(engines: Iterable[str]) -> str | None:
    """The engine that all have; None where they have several, or there are none."""
    names = set(engines)
    return names.pop() if len(names) == 1 else None


def started() -> bool:
    """Whether JAX's backend has started in this process; does not start it."""
    # JAX's public functions that look at backends start them: only this private one asks.
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bridge.backends_are_initialized()


def in_force() -> dict[str, str | int | None]:
    """What XLA was started with, whatever the environment says by now; after JAX has started.

    Returns:
      The value of each of `OPTIONS`, None without it; and `threads`: of XLA's pool, None where that
      cannot be seen (not Linux).
    """
    from jaxlib.xla_client import CompileOptions

    serialized = CompileOptions().SerializeAsString()
    names = [_name(thread) for thread in Path("/proc/self/task").glob("*/comm")]
    values: dict[str, str | int | None] = {}
    for name in OPTIONS:
        # A serialized map of the options: its key, then the tag, length and text of the value.
        found = re.search(name.encode() + rb"\x12(.)", serialized, re.S)
        text = serialized[found.end() : found.end() + found[1][0]].decode() if found else None
        values[name.removeprefix("xla_cpu_")] = text
    return {**values, "threads": names.count("tf_XLAEigen") if names else None}


def _name(thread: Path) -> str:
    try:
        return thread.read_text().strip()
    except OSError:  # it has ended
        return ""


def _missing(engine: str | None) -> list[str]:
    """The variables that would have had to be set before JAX started."""
    force = in_force()
    absent = [name for name in OPTIONS if force[name.removeprefix("xla_cpu_")] is None]
    flags = f"XLA_FLAGS={FLAG}=" + ",".join(f"{name}={OPTIONS[name]}" for name in absent)
    threads = engine == "planar" and "NPROC" not in os.environ and force["threads"] not in (None, 1)
    return [flags] * bool(absent and _is_tested()) + ["NPROC=1"] * threads


@functools.cache  # it says so once
def _is_tested() -> bool:
    version = importlib.metadata.version("jaxlib")
    if version not in TESTED:
        warnings.warn(
            f"pgf_jax: jaxlib {version} runs without XLA's options {', '.join(OPTIONS)}, "
            f"which were tested with {', '.join(TESTED)}: planar is slower",
            RuntimeWarning,
            stacklevel=3,
        )
    return version in TESTED


def _keep_compiled() -> None:
    """Keep compiled programs between processes, also between those that are started from here."""
    # Also small programs: there are several on the way to a first result.
    values = (str(Path.home() / ".cache" / "pgf_jax"), 0.05)
    untouched = (None, 1.0)  # JAX's defaults: who imported it may have set others by its functions
    jax = sys.modules.get("jax")
    for name, value, default in zip(CACHE, values, untouched, strict=True):
        if name in os.environ:
            continue
        if jax is not None:  # it has read its environment
            if getattr(jax.config, name.lower()) != default:
                continue
            jax.config.update(name.lower(), value)
        os.environ[name] = str(value)
