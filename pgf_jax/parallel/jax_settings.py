"""JAX's settings that worker processes adopt from the process that starts them."""

from collections.abc import Mapping
from typing import Any

import jax

from pgf_jax.jax_setup import as_caller, has_options

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
_OPTIONS = "xla_options"  # whether XLA has the options of `jax_setup`


def jax_settings() -> dict[str, Any]:
    """The settings of this process."""
    return {name: getattr(jax.config, name) for name in _NAMES} | {_OPTIONS: has_options()}


def adopt(settings: Mapping[str, Any]) -> None:
    """Set this process's settings to those of another."""
    as_caller(settings.get(_OPTIONS, True))
    for name, value in settings.items():
        if name != _OPTIONS and getattr(jax.config, name) != value:
            jax.config.update(name, value)
