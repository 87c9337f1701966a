"""Configures JAX for the engines: an option of XLA, its threads, and the cache of its programs.

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

# XLA's CPU backend makes one kernel of a loop whose data are smaller than this, in bytes, in place
# of a kernel for each step of it. `planar`, a loop of short steps, is half as fast again.
OPTION = "xla_cpu_small_while_loop_byte_threshold"
FLAG = f"--xla_backend_extra_options={OPTION}=1000000000"
# Releases of jaxlib with which results are equal to the last bit with and without the option. XLA
# says nothing of an option that it does not know, and a value that it cannot read fails every call.
TESTED = ("0.10.2",)
CACHE = ("JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
VARIABLES = ("XLA_FLAGS", "NPROC", *CACHE)


def configure(engine: str | None = "planar") -> None:
    """Make JAX fast for an engine; call it before the first computation.

    It sets an option of XLA, keeps compiled programs in `~/.cache/pgf_jax`, and keeps XLA from
    starting threads for `planar`, whose short kernels would only wait for them. What the user has
    set stays: `XLA_FLAGS` (the option is added), `NPROC` and the variables of JAX's cache. No
    result changes. Where JAX has started already, a warning says what that costs, and compiled
    programs are kept all the same. `pgf_jax.plan`, `sweep`, `collect`, `train` and the commands
    configure JAX themselves, unless it has started.

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


def configure_early(engine: str | None) -> None:
    """Do what `configure` does where JAX has not started; else nothing, and without a word."""
    if started():
        return
    flags = os.environ.get("XLA_FLAGS", "").strip()
    # What does not begin with a dash is the name of a file of flags: the user's, and left alone.
    if OPTION not in flags and (not flags or flags[0] == "-") and _is_tested():
        os.environ["XLA_FLAGS"] = f"{flags} {FLAG}".strip()
    if engine == "planar":
        os.environ.setdefault("NPROC", "1")
    _keep_compiled()


def one_engine(engines: Iterable[str]) -> str | None:
    """The engine that all have; None where they have several, or there are none."""
    names = set(engines)
    return names.pop() if len(names) == 1 else None


def started() -> bool:
    """Whether JAX's backend has started in this process; does not start it."""
    # JAX's public functions that look at backends start them: only this private one asks.
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bridge.backends_are_initialized()


def in_force() -> dict[str, int | None]:
    """What XLA was started with, whatever the environment says by now; after JAX has started.

    Returns:
      `small_while_loop_byte_threshold`: the value of the option, None without; `threads`: of XLA's
      pool, None where that cannot be seen (not Linux).
    """
    from jaxlib.xla_client import CompileOptions

    # A serialized map of the options: its key, then the tag and the length of the value.
    found = re.search(OPTION.encode() + rb"\x12.(\d+)", CompileOptions().SerializeAsString(), re.S)
    names = [_name(thread) for thread in Path("/proc/self/task").glob("*/comm")]
    return {
        OPTION.removeprefix("xla_cpu_"): int(found[1]) if found else None,
        "threads": names.count("tf_XLAEigen") if names else None,
    }


def _name(thread: Path) -> str:
    try:
        return thread.read_text().strip()
    except OSError:  # it has ended
        return ""


def _missing(engine: str | None) -> list[str]:
    """The variables that would have had to be set before JAX started."""
    force = in_force()
    option = force["small_while_loop_byte_threshold"] is None and _is_tested()
    threads = engine == "planar" and "NPROC" not in os.environ and force["threads"] not in (None, 1)
    return [f"XLA_FLAGS={FLAG}"] * option + ["NPROC=1"] * threads


@functools.cache  # it says so once
def _is_tested() -> bool:
    version = importlib.metadata.version("jaxlib")
    if version not in TESTED:
        warnings.warn(
            f"pgf_jax: jaxlib {version} runs without XLA's option {OPTION}, which was tested with "
            f"{', '.join(TESTED)}: planar is slower",
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
