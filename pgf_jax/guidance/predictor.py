"""The predictors: what the cost will be, with help and without (Papallas & Dogar 2022, Alg. 3).

phi_auto and phi_human are two `Predictor`s of one kind: features of the last P = 3 iterations in,
the cost of the best trajectory l = 10 reach iterations on out (`rows` defines both). The gain that
a robot bids is the difference of the two.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from pgf_jax.guidance.rows import FEATURES, history_features

__all__ = ["HIDDEN", "LANES", "MLP", "Predictor", "forward", "gain", "history_features", "init"]

HIDDEN = (64, 32, 8)
# Rows evaluated in one call; a constant, so that there is one compiled program (see `predict`).
LANES = 32


class MLP(nn.Module):
    """Features in, one number out: ReLU layers of the given widths, then a linear unit."""

    hidden: tuple[int, ...] = HIDDEN

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """[10] normalised features -> [] cost."""
        # Full float32 precision: accelerators round the factors of a product otherwise.
        for width in self.hidden:
            x = nn.relu(nn.Dense(width, precision=jax.lax.Precision.HIGHEST)(x))
        return nn.Dense(1, precision=jax.lax.Precision.HIGHEST)(x)[0]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Predictor:
    """A trained network with the normalisation of its input; a pytree.

    Attributes:
      params: the network's parameters, `{"Dense_i": {"kernel": [in, out], "bias": [out]}}` float32.
      mean: [10] float32, subtracted from the features.
      scale: [10] float32, the features are divided by it; 1 where a feature never varied.
      hidden: widths of the hidden layers (static).
    """

    params: Mapping[str, Any]
    mean: jax.Array  # [10]
    scale: jax.Array  # [10]
    hidden: tuple[int, ...] = dataclasses.field(default=HIDDEN, metadata={"static": True})

    def predict(self, features: np.ndarray | jax.Array) -> np.ndarray:
        """Predicted costs; nan where a feature is not finite (no history yet, say).

        A row's prediction depends on that row alone, bit for bit: rows are evaluated one after
        another within one compiled program of fixed shape, whatever B is.

        Args:
          features: [B, 10], in the order of `rows.FEATURES`.

        Returns:
          [B] float32, not clipped.
        """
        rows = np.asarray(features, dtype=np.float32)
        if rows.ndim != 2 or rows.shape[1] != len(FEATURES):
            raise ValueError(f"features must be [B, {len(FEATURES)}], got shape {rows.shape}")
        padded = np.zeros((-(-len(rows) // LANES) * LANES, rows.shape[1]), np.float32)
        padded[: len(rows)] = rows
        parts = [
            np.asarray(_predict_lanes(self, padded[i : i + LANES]))
            for i in range(0, len(padded), LANES)
        ]
        cost = np.concatenate([np.zeros(0, np.float32), *parts])[: len(rows)]
        return np.where(np.isfinite(rows).all(axis=1), cost, np.float32(np.nan))


def forward(predictor: Predictor, features: jax.Array) -> jax.Array:
    """[10] features of one robot -> [] predicted cost; traceable, `vmap` it for more."""
    x = (features - predictor.mean) / predictor.scale
    cost = MLP(predictor.hidden).apply({"params": predictor.params}, x)
    assert isinstance(cost, jax.Array)
    return cost


@jax.jit
def _predict_lanes(predictor: Predictor, features: jax.Array) -> jax.Array:
    # `map`, not `vmap`: a batched matrix product may sum a row differently at another position.
    return jax.lax.map(lambda row: forward(predictor, row), features)


def gain(auto: Predictor, human: Predictor, features: np.ndarray | jax.Array) -> np.ndarray:
    """What help is predicted to be worth: phi_auto - phi_human, each clipped at 0.

    Args:
      auto: phi_auto, the cost without help.
      human: phi_human, the cost after help.
      features: [B, 10], in the order of `rows.FEATURES`.

    Returns:
      [B] float32, in units of cost; nan where a feature is not finite (no history yet, say).
    """
    return np.maximum(auto.predict(features), np.float32(0)) - np.maximum(
        human.predict(features), np.float32(0)
    )


def normalisation(features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and scale (the standard deviation, 1 where that is zero) of features.

    Args:
      features: [M, 10].

    Returns:
      Two [10] float32 arrays.
    """
    x = np.asarray(features, dtype=np.float64)
    mean, deviation = x.mean(axis=0), x.std(axis=0)
    # The computed deviation of a constant is rounding error, not always an exact zero.
    constant = deviation <= 1e-9 * np.maximum(np.abs(mean), 1e-30)
    return mean.astype(np.float32), np.where(constant, 1.0, deviation).astype(np.float32)


@functools.partial(jax.jit, static_argnums=1)
def _init_params(key: jax.Array, hidden: tuple[int, ...]) -> dict[str, Any]:
    return dict(MLP(hidden).init(key, jnp.zeros(len(FEATURES), jnp.float32))["params"])


def init(
    key: jax.Array, features: np.ndarray, target: np.ndarray, *, hidden: tuple[int, ...] = HIDDEN
) -> Predictor:
    """An untrained predictor that is right about the mean and the spread of its target.

    The last layer's initial weights are scaled by the target's standard deviation and its bias is
    the target's mean: costs are in the hundreds, and Adam would spend its epochs getting there.

    Args:
      key: consumed.
      features: [M, 10] rows for training.
      target: [M] their targets.
      hidden: widths of the hidden layers.
    """
    mean, scale = normalisation(features)
    y = np.asarray(target, dtype=np.float64)
    params = _init_params(key, hidden)
    last = f"Dense_{len(hidden)}"
    spread = np.float32(y.std()) if y.std() > 0 else np.float32(1)
    params[last] = {
        "kernel": params[last]["kernel"] * spread,
        "bias": jnp.full(1, y.mean(), jnp.float32),
    }
    return Predictor(params=params, mean=jnp.asarray(mean), scale=jnp.asarray(scale), hidden=hidden)
