"""Two idioms that keep XLA's loops over lanes simple and shared values computed once."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def written_out(one: jax.Array | int, values: Callable[[], Any]) -> Any:
    """Compute arrays, and write them to memory once, whoever reads them.

    XLA computes an intermediate again in every kernel that reads it, and `optimization_barrier`
    does not change that; only what leaves a loop stays. So this is a loop of one round.

    Args:
      one: 1, as a value that XLA does not know: a loop of one round is taken away. A Python number
        does nothing; it is for counting operations.
      values: computes a tree of arrays.
    """
    if isinstance(one, int):
        return values()
    zeros = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(values))
    return jax.lax.fori_loop(0, one, lambda _, before: values(), zeros)


def rows(array: jax.Array, index: np.ndarray) -> jax.Array:
    """Rows of an array at indices that are known when the program is compiled."""
    return array.at[index].get(mode="promise_in_bounds")
