"""JAX's settings that worker processes adopt from the process that starts them."""

from collections.abc import Mapping
from typing import Any

import jax

from pgf_jax.jax_setup import AS_CALLER, as_caller, for_workers

# Those that decide on numbers, or results would depend on which process computed them; and those of
# the compilation cache.
_NAMES = (
    "jax_platforms",
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)


def jax_settings() -> dict[str, Any]:
    """The settings of this process."""
    return {name: getattr(jax.config, name) for name in _NAMES} | {AS_CALLER: for_workers()}


def adopt(settings: Mapping[str, Any]) -> None:
    """Set this process's settings to those of another."""
    as_caller(settings[AS_CALLER])
    for name, value in settings.items():
        if name != AS_CALLER and getattr(jax.config, name) != value:
            jax.config.update(name, value)
