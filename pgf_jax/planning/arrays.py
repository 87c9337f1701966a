"""Small functions on trees of arrays: lanes stacked, padded and taken apart again."""

from collections.abc import Sequence

import jax
import numpy as np


def flat(x):
    """Merge the first two axes: [L, k, ...] -> [L k, ...]."""
    return np.asarray(x).reshape(-1, *np.shape(x)[2:])


def pad(items: Sequence, lanes: int) -> list:
    """Fill lanes up with copies of the first item.

    Raises:
      ValueError: no item, or more than lanes.
    """
    if not 0 < len(items) <= lanes:
        raise ValueError(f"{len(items)} lanes of work for an engine of {lanes}")
    return [*items, *[items[0]] * (lanes - len(items))]


def as_float32(tree):
    """Make arrays of float64 such of float32."""
    return jax.tree.map(
        lambda x: x.astype(np.float32) if getattr(x, "dtype", None) == np.float64 else x, tree
    )


def to_host(tree):
    """Make arrays NumPy's."""
    return jax.tree.map(np.asarray, tree)


def stack(trees: Sequence):
    """Stack the arrays of trees along a new first axis."""
    return jax.tree.map(lambda *xs: np.stack(xs), *trees)


def unstack(tree, count: int) -> list:
    """Take the first `count` trees out of a stack."""
    return [jax.tree.map(lambda x, i=i: x[i], tree) for i in range(count)]
