"""Networks that predict costs and gains from a robot's features (Papallas & Dogar 2022, Alg. 3).

The paper has two, phi_auto and phi_human. Their inputs are features of the last P = 3 iterations
(`features.FEATURES`); their outputs are the cost of the best trajectory l = 10 reach iterations on,
without help and with it (`training.rows` defines these targets). A `Predictor` is such a network.

Robots bid what a `GainPredictor` says: the paper's `CostDifference` of these two networks, or
`GainNetwork` and `FailureClassifier`, which have one network each.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from pgf_jax.guidance.predictors.features import FEATURES, STATE

HIDDEN = (64, 32, 8)  # widths of the paper's hidden layers
LANES = 32  # rows in one call; a constant, so that there is one compiled program (see `predict`)


class MLP(nn.Module):
    """The paper's network: ReLU layers of the given widths, then a linear unit; one number out."""

    hidden: tuple[int, ...] = HIDDEN
    dropout: float = 0.0  # share of the units dropped after each hidden layer, where a key is given

    @nn.compact
    def __call__(self, x: jax.Array, train: bool = False) -> jax.Array:
        """[F] normalised features -> [] cost."""
        # Full float32 precision: accelerators round the factors of a product otherwise.
        for width in self.hidden:
            x = nn.relu(nn.Dense(width, precision=jax.lax.Precision.HIGHEST)(x))
            x = nn.Dropout(self.dropout, deterministic=not train)(x)
        return nn.Dense(1, precision=jax.lax.Precision.HIGHEST)(x)[0]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Predictor:
    """A trained network with the normalisation of its input; a pytree.

    It may be an ensemble of E networks (members); its prediction is the mean of theirs.

    Attributes:
      params: parameters, `{"Dense_i": {"kernel": [E, in, out], "bias": [E, out]}}` float32.
      mean: [F] float32, subtracted from the features.
      scale: [F] float32, the features are divided by it; 1 where a feature never varied.
      hidden: widths of the hidden layers (static).
      features: names of its inputs, among `features.STATE` (static).
    """

    params: Mapping[str, Any]
    mean: jax.Array  # [F]
    scale: jax.Array  # [F]
    hidden: tuple[int, ...] = dataclasses.field(default=HIDDEN, metadata={"static": True})
    features: tuple[str, ...] = dataclasses.field(default=FEATURES, metadata={"static": True})

    def predict(self, features: np.ndarray | jax.Array) -> np.ndarray:
        """Predict one number for each row of features; nan where a feature is not finite.

        A row's prediction depends on that row alone, bit for bit: rows are evaluated one after
        another within one compiled program of fixed shape, whatever B is.

        Args:
          features: [B, F], in the order of `self.features`.

        Returns:
          [B] float32, not clipped.
        """
        rows = np.asarray(features, dtype=np.float32)
        if rows.ndim != 2 or rows.shape[1] != len(self.features):
            raise ValueError(f"features must be [B, {len(self.features)}], got shape {rows.shape}")
        padded = np.zeros((-(-len(rows) // LANES) * LANES, rows.shape[1]), np.float32)
        padded[: len(rows)] = rows
        parts = [
            np.asarray(_predict_lanes(self, padded[i : i + LANES]))
            for i in range(0, len(padded), LANES)
        ]
        cost = np.concatenate([np.zeros(0, np.float32), *parts])[: len(rows)]
        return np.where(np.isfinite(rows).all(axis=1), cost, np.float32(np.nan))

    def of_states(self, states: np.ndarray) -> np.ndarray:
        """Predict from whole states: [B, S] -> [B]; the network takes its own features of them."""
        return self.predict(states[:, [STATE.index(name) for name in self.features]])


def forward(
    predictor: Predictor,
    features: jax.Array,
    *,
    dropout: float = 0.0,
    key: jax.Array | None = None,
) -> jax.Array:
    """Predict from the features of one robot: [F] -> []; traceable, `vmap` it for more robots.

    Args:
      predictor: the network.
      features: of one robot.
      dropout: share of the hidden units that is dropped in training, where there is a `key`.
      key: consumed.
    """
    x = (features - predictor.mean) / predictor.scale
    network = MLP(predictor.hidden, dropout)
    rngs = None if key is None else {"dropout": key}

    def member(params: Any) -> jax.Array:
        cost = network.apply({"params": params}, x, train=key is not None, rngs=rngs)
        assert isinstance(cost, jax.Array)
        return cost

    return jax.vmap(member)(predictor.params).mean()


@jax.jit
def _predict_lanes(predictor: Predictor, features: jax.Array) -> jax.Array:
    # `map`, not `vmap`: a batched matrix product may sum a row differently at another position.
    return jax.lax.map(lambda row: forward(predictor, row), features)


def normalisation(features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the mean and the scale (standard deviation, 1 where it is zero) of features.

    Args:
      features: [M, F].

    Returns:
      Two [F] float32 arrays.
    """
    x = np.asarray(features, dtype=np.float64)
    mean, deviation = x.mean(axis=0), x.std(axis=0)
    # The computed deviation of a constant is rounding error, not always an exact zero.
    constant = deviation <= 1e-9 * np.maximum(np.abs(mean), 1e-30)
    return mean.astype(np.float32), np.where(constant, 1.0, deviation).astype(np.float32)


@functools.partial(jax.jit, static_argnums=(1, 2))
def _init_params(key: jax.Array, hidden: tuple[int, ...], features: int) -> dict[str, Any]:
    return dict(MLP(hidden).init(key, jnp.zeros(features, jnp.float32))["params"])


def init(
    key: jax.Array,
    features: np.ndarray,
    target: np.ndarray,
    *,
    hidden: tuple[int, ...] = HIDDEN,
    names: tuple[str, ...] = FEATURES,
) -> Predictor:
    """Make an untrained predictor with the mean and the spread of its target.

    The last layer's initial weights are scaled by the target's standard deviation and its bias is
    the target's mean: costs are in the hundreds, and Adam would need many epochs to get there.

    Args:
      key: consumed.
      features: [M, F] rows for training.
      target: [M] their targets.
      hidden: widths of the hidden layers.
      names: of the features.
    """
    mean, scale = normalisation(features)
    y = np.asarray(target, dtype=np.float64)
    params = _init_params(key, hidden, len(names))
    last = f"Dense_{len(hidden)}"
    spread = np.float32(y.std()) if y.std() > 0 else np.float32(1)
    params[last] = {
        "kernel": params[last]["kernel"] * spread,
        "bias": jnp.full(1, y.mean(), jnp.float32),
    }
    return Predictor(
        params=jax.tree.map(lambda leaf: leaf[None], params),
        mean=jnp.asarray(mean),
        scale=jnp.asarray(scale),
        hidden=hidden,
        features=names,
    )


def combine(members: Sequence[Predictor]) -> Predictor:
    """Combine predictors that were trained on the same rows into one ensemble."""
    params = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *(m.params for m in members))
    return dataclasses.replace(members[0], params=params)


@dataclasses.dataclass(frozen=True, eq=False)
class CostDifference:
    """The paper's gain predictor: predicts two costs, whose difference is the gain."""

    auto: Predictor
    human: Predictor

    def gain(self, states: np.ndarray) -> np.ndarray:
        """phi_auto - phi_human, each clipped at 0, in units of cost; see `GainPredictor.gain`."""
        zero = np.float32(0)
        auto, human = (phi.of_states(states) for phi in (self.auto, self.human))
        return np.maximum(auto, zero) - np.maximum(human, zero)


@dataclasses.dataclass(frozen=True, eq=False)
class GainNetwork:
    """Gain predictor with one network, which was trained on the true gains of forks."""

    network: Predictor

    def gain(self, states: np.ndarray) -> np.ndarray:
        """Predicted gain, in units of cost; see `GainPredictor.gain`."""
        return self.network.of_states(states)


@dataclasses.dataclass(frozen=True, eq=False)
class FailureClassifier:
    """Predicts failure: the probability of being unsolved 10 iterations on without help.

    The number of iterations is `planning.types.LOOK_AHEAD`.
    """

    network: Predictor  # of the log-odds

    def gain(self, states: np.ndarray) -> np.ndarray:
        """Predicted probability, which is bid in place of a gain; see `GainPredictor.gain`."""
        # The logistic function in a form that does not overflow.
        return 0.5 * (1 + np.tanh(0.5 * self.network.of_states(states)))
