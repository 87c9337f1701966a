"""Fits one predictor to training rows (Papallas & Dogar 2022, Alg. 3).

Adam minimises the RMSE (or another loss) over batches of 50 rows; each epoch is one compiled scan.
Training stops early by the loss on held-out scenes, and the best weights are kept.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.network import Predictor, combine, forward, init
from pgf_jax.training.config import Loss, TrainConfig
from pgf_jax.training.rows import Rows, split_by_scene

# Mean squares below this have slope 0: at an exact fit the square root's slope would be infinite.
_MIN_SQUARE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Trained:
    """A trained predictor, and its losses.

    Attributes:
      predictor: with the weights of the best epoch.
      loss_train: [E] loss over all rows for training at the end of each epoch, in units of the
        target. `loss_train`, `loss_val` and `best_epoch` of an ensemble are its first member's.
      loss_val: [E] the same over the rows of the held-out scenes.
      best_epoch: the first epoch with the lowest `loss_val`, 0-based.
      kept_train: loss of `predictor` on the rows for training.
      kept_val: loss of `predictor` on the held-out rows.
      target_std_val: standard deviation of the held-out targets: the RMSE of a constant.
      scenes_train: scenes in the rows for training.
      scenes_val: scenes held out.
    """

    predictor: Predictor
    loss_train: np.ndarray  # [E]
    loss_val: np.ndarray  # [E]
    best_epoch: int
    kept_train: float
    kept_val: float
    target_std_val: float
    scenes_train: int
    scenes_val: int


class _State(NamedTuple):
    params: Any
    optimiser: Any


def rmse(predictor: Predictor, features: jax.Array, target: jax.Array) -> jax.Array:
    """Root mean squared error over rows: [M, F] and [M] -> [], in units of the target."""
    return _loss(_predict(predictor, features), target, jnp.ones_like(target), "rmse")


_loss_of = jax.jit(
    lambda predictor, x, y, loss: _loss(_predict(predictor, x), y, jnp.ones_like(y), loss),
    static_argnames=("loss",),
)


def _predict(predictor: Predictor, x: jax.Array) -> jax.Array:
    return jax.vmap(forward, in_axes=(None, 0))(predictor, x)


def _loss(output: jax.Array, y: jax.Array, weight: jax.Array, loss: Loss) -> jax.Array:
    if loss == "logistic":  # the output is log-odds, the target 0 or 1
        each = optax.sigmoid_binary_cross_entropy(output, y)
    elif loss == "mae":
        each = jnp.abs(output - y)
    else:
        each = (output - y) ** 2
    mean = jnp.sum(weight * each) / jnp.sum(weight)
    return jnp.sqrt(jnp.maximum(mean, _MIN_SQUARE)) if loss == "rmse" else mean


@functools.partial(jax.jit, static_argnames=("config",))
def _epoch(
    key: jax.Array,
    predictor: Predictor,
    optimiser: Any,
    x: jax.Array,  # [M, F]
    y: jax.Array,  # [M]
    *,
    config: TrainConfig,
) -> tuple[Predictor, Any]:
    """Do one pass over the rows in a new random order; the key is consumed."""
    rows = len(y)
    batches = -(-rows // config.batch)
    key_order, key_dropout = jax.random.split(key)
    # The last batch is filled up with rows of weight 0, so that every batch has one shape.
    order = jnp.resize(jax.random.permutation(key_order, rows), (batches, config.batch))
    weight = (jnp.arange(batches * config.batch) < rows).astype(x.dtype).reshape(order.shape)

    def output(params: Any, x: jax.Array, key: jax.Array) -> jax.Array:
        network = dataclasses.replace(predictor, params=params)
        if not config.dropout:
            return _predict(network, x)

        def one(x: jax.Array, key: jax.Array) -> jax.Array:
            return forward(network, x, dropout=config.dropout, key=key)

        return jax.vmap(one)(x, jax.random.split(key, len(x)))

    def step(state: _State, chosen: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[_State, None]:
        index, w, key = chosen

        def loss(params: Any) -> jax.Array:
            return _loss(output(params, x[index], key), y[index], w, config.loss)

        slope = jax.grad(loss)(state.params)
        with jax.numpy_dtype_promotion("standard"):  # optax raises a float to an integer power
            update, moments = optax.adam(config.learning_rate).update(slope, state.optimiser)
        return _State(optax.apply_updates(state.params, update), moments), None

    keys = jax.random.split(key_dropout, batches)
    state, _ = jax.lax.scan(step, _State(predictor.params, optimiser), (order, weight, keys))
    return dataclasses.replace(predictor, params=state.params), state.optimiser


def fit(key: jax.Array, rows: Rows, config: TrainConfig) -> Trained:
    """Train one predictor on rows; the same key, rows and config give the same bits.

    Args:
      key: for weights and batches; consumed. The split depends on `config.seed` alone.
      rows: training rows; split 80/20 by scene.
      config: settings.

    Raises:
      BadInput: the rows come from fewer than two scenes, or no epoch gave a finite loss.
    """
    train, val = split_by_scene(rows.scene, fraction=config.validation_fraction, seed=config.seed)
    members = []
    for key_member in jax.random.split(key, config.members):
        restarts = [
            _fit_once(key_restart, rows, train, val, config)
            for key_restart in jax.random.split(key_member, config.restarts)
        ]
        finite = [trained for trained in restarts if np.isfinite(trained.kept_val)]
        if not finite:
            raise BadInput(
                f"training diverged with learning_rate {config.learning_rate:g}, "
                "expected a smaller one"
            )
        members.append(min(finite, key=lambda trained: trained.kept_val))
    predictor = combine([member.predictor for member in members])
    kept = [float(_loss_of(predictor, *_to_jax(rows, part), config.loss)) for part in (train, val)]
    return dataclasses.replace(
        members[0], predictor=predictor, kept_train=kept[0], kept_val=kept[1]
    )


def _fit_once(
    key: jax.Array, rows: Rows, train: np.ndarray, val: np.ndarray, config: TrainConfig
) -> Trained:
    # Settings that `_epoch` does not use must not make it compile again.
    config = dataclasses.replace(config, seed=0, restarts=1, members=1)
    key_init, key = jax.random.split(key)
    predictor = init(
        key_init, rows.features[train], rows.target[train], hidden=config.hidden, names=rows.names
    )
    optimiser = optax.adam(config.learning_rate).init(predictor.params)
    x, y = _to_jax(rows, train)
    x_val, y_val = _to_jax(rows, val)

    best, best_epoch = predictor, -1
    loss_train: list[float] = []
    loss_val: list[float] = []
    for epoch in range(config.max_epochs):
        predictor, optimiser = _epoch(
            jax.random.fold_in(key, epoch),
            predictor,
            optimiser,
            x,
            y,
            config=config,
        )
        loss_train.append(float(_loss_of(predictor, x, y, config.loss)))
        loss_val.append(float(_loss_of(predictor, x_val, y_val, config.loss)))
        if best_epoch < 0 or loss_val[-1] < loss_val[best_epoch]:
            best, best_epoch = predictor, epoch
        elif epoch - best_epoch >= config.patience:
            break
    return Trained(
        predictor=best,
        loss_train=np.array(loss_train),
        loss_val=np.array(loss_val),
        best_epoch=best_epoch,
        kept_train=loss_train[best_epoch],
        kept_val=loss_val[best_epoch],
        target_std_val=float(rows.target[val].std()),
        scenes_train=len(np.unique(rows.scene[train])),
        scenes_val=len(np.unique(rows.scene[val])),
    )


def _to_jax(rows: Rows, index: np.ndarray) -> tuple[jax.Array, jax.Array]:
    return (
        jnp.asarray(rows.features[index], dtype=jnp.float32),
        jnp.asarray(rows.target[index], dtype=jnp.float32),
    )
