"""Training of the predictors on collected runs (Papallas & Dogar 2022, Alg. 3).

Adam on the RMSE of batches of 50 rows, an epoch at a time in one compiled scan; early stopping on
the held-out scenes, with the best weights kept.
"""

import dataclasses
import functools
import hashlib
import io
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from matplotlib.figure import Figure

from pgf_jax.errors import BadInput
from pgf_jax.guidance import checkpoint as ckpt
from pgf_jax.guidance.predictor import Predictor, forward, init
from pgf_jax.guidance.rows import Rows, autonomous_rows, human_rows, split_by_scene
from pgf_jax.guidance.runs import Mode, read_runs, runs_path, write_atomically
from pgf_jax.guidance.train_config import TrainConfig

FIGURE = "fig3.png"
# Below this the square root's slope is taken as 0: at an exact fit it would be infinite.
_MIN_SQUARE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Trained:
    """A trained predictor and how it got there.

    Attributes:
      predictor: with the weights of the best epoch.
      loss_train: [E] RMSE over all rows for training at the end of each epoch, units of cost.
      loss_val: [E] the same over the rows of the held-out scenes.
      best_epoch: 0-based; the first epoch with the lowest `loss_val`.
      target_std_val: standard deviation of the held-out targets, what a constant would score.
      scenes_train: scenes in the rows for training.
      scenes_val: scenes held out.
    """

    predictor: Predictor
    loss_train: np.ndarray  # [E]
    loss_val: np.ndarray  # [E]
    best_epoch: int
    target_std_val: float
    scenes_train: int
    scenes_val: int

    @property
    def rmse_train(self) -> float:
        """RMSE of the returned weights on the rows for training."""
        return float(self.loss_train[self.best_epoch])

    @property
    def rmse_val(self) -> float:
        """RMSE of the returned weights on the held-out rows."""
        return float(self.loss_val[self.best_epoch])


class _State(NamedTuple):
    params: Any
    optimiser: Any


def rmse(predictor: Predictor, features: jax.Array, target: jax.Array) -> jax.Array:
    """Root mean squared error over rows, [M, 10] and [M] -> [], units of cost."""
    return _rmse(predictor, features, target, jnp.ones_like(target))


_rmse_jit = jax.jit(rmse)


def _rmse(predictor: Predictor, x: jax.Array, y: jax.Array, weight: jax.Array) -> jax.Array:
    error = jax.vmap(forward, in_axes=(None, 0))(predictor, x) - y
    square = jnp.sum(weight * error**2) / jnp.sum(weight)
    return jnp.sqrt(jnp.maximum(square, _MIN_SQUARE))


@functools.partial(jax.jit, static_argnames=("batch",))
def _epoch(
    key: jax.Array,
    predictor: Predictor,
    optimiser: Any,
    x: jax.Array,  # [M, 10]
    y: jax.Array,  # [M]
    *,
    batch: int,
    learning_rate: jax.Array | float,
) -> tuple[Predictor, Any]:
    """One pass over the rows in a fresh order; the key is consumed."""
    rows = len(y)
    batches = -(-rows // batch)
    # The last batch is filled up with rows of weight 0, so that every batch has one shape.
    order = jnp.resize(jax.random.permutation(key, rows), (batches, batch))
    weight = (jnp.arange(batches * batch) < rows).astype(x.dtype).reshape(batches, batch)

    def step(state: _State, chosen: tuple[jax.Array, jax.Array]) -> tuple[_State, None]:
        index, w = chosen

        def loss(params: Any) -> jax.Array:
            return _rmse(dataclasses.replace(predictor, params=params), x[index], y[index], w)

        slope = jax.grad(loss)(state.params)
        with jax.numpy_dtype_promotion("standard"):  # optax raises a float to an integer power
            update, moments = optax.adam(learning_rate).update(slope, state.optimiser)
        return _State(optax.apply_updates(state.params, update), moments), None

    state, _ = jax.lax.scan(step, _State(predictor.params, optimiser), (order, weight))
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
    attempts = [
        _fit_once(restart, rows, train, val, config)
        for restart in jax.random.split(key, config.restarts)
    ]
    finite = [attempt for attempt in attempts if np.isfinite(attempt.rmse_val)]
    if not finite:
        raise BadInput(
            f"training diverged with learning_rate {config.learning_rate:g}, expected a smaller one"
        )
    return min(finite, key=lambda attempt: attempt.rmse_val)


def _fit_once(
    key: jax.Array, rows: Rows, train: np.ndarray, val: np.ndarray, config: TrainConfig
) -> Trained:
    key_init, key = jax.random.split(key)
    predictor = init(key_init, rows.features[train], rows.target[train], hidden=config.hidden)
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
            batch=config.batch,
            learning_rate=config.learning_rate,
        )
        loss_train.append(float(_rmse_jit(predictor, x, y)))
        loss_val.append(float(_rmse_jit(predictor, x_val, y_val)))
        if best_epoch < 0 or loss_val[-1] < loss_val[best_epoch]:
            best, best_epoch = predictor, epoch
        elif epoch - best_epoch >= config.patience:
            break
    return Trained(
        predictor=best,
        loss_train=np.array(loss_train),
        loss_val=np.array(loss_val),
        best_epoch=best_epoch,
        target_std_val=float(rows.target[val].std()),
        scenes_train=len(np.unique(rows.scene[train])),
        scenes_val=len(np.unique(rows.scene[val])),
    )


def _to_jax(rows: Rows, index: np.ndarray) -> tuple[jax.Array, jax.Array]:
    return (
        jnp.asarray(rows.features[index], dtype=jnp.float32),
        jnp.asarray(rows.target[index], dtype=jnp.float32),
    )


def train(data_dir: Path | str, out_dir: Path | str, config: TrainConfig) -> dict[str, Any]:
    """Train phi_auto and phi_human on collected runs and write what comes of it.

    Args:
      data_dir: holds `autonomous/runs.parquet` and `human/runs.parquet`.
      out_dir: gets `phi_auto.msgpack`, `phi_human.msgpack` and `fig3.png` once both are trained.
      config: settings.

    Returns:
      For `phi_auto` and `phi_human` each: runs, scenes, rows, rows left out (`non_finite`,
      `short`), `rmse_train`, `rmse_val`, `target_std_val`, `epochs`, `best_epoch` and
      `data_sha256`; and the list of `files`. Plain numbers and strings, fit for JSON.

    Raises:
      BadInput: a file of runs is missing or malformed, or has rows of fewer than two scenes.
    """
    sources = {
        "phi_auto": (runs_path(data_dir, Mode.AUTONOMOUS), Mode.AUTONOMOUS, autonomous_rows),
        "phi_human": (runs_path(data_dir, Mode.HUMAN), Mode.HUMAN, human_rows),
    }
    data: dict[str, tuple[Rows, dict[str, Any]]] = {}
    for network, (path, mode, to_rows) in sources.items():
        frame = read_runs(path, mode=mode)
        rows = to_rows(frame)
        if len(np.unique(rows.scene)) < 2:
            raise BadInput(
                f"{path}: rows from {len(np.unique(rows.scene))} scenes, expected at least 2 "
                f"(training and validation share none)"
            )
        data[network] = (
            rows,
            {
                "runs": frame.select("scene", "seed").n_unique(),
                "data_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            },
        )

    results: dict[str, Trained] = {}
    report: dict[str, Any] = {}
    key = jax.random.key(config.seed)
    for purpose, (network, (rows, about)) in enumerate(data.items()):
        results[network] = done = fit(jax.random.fold_in(key, purpose), rows, config)
        report[network] = {
            **about,
            "scenes": done.scenes_train + done.scenes_val,
            "rows": len(rows.target),
            "non_finite": rows.non_finite,
            "short": rows.short,
            "rmse_train": done.rmse_train,
            "rmse_val": done.rmse_val,
            "target_std_val": done.target_std_val,
            "epochs": len(done.loss_val),
            "best_epoch": done.best_epoch,
        }

    out = Path(out_dir)
    figures = ("rmse_train", "rmse_val", "target_std_val", "epochs", "best_epoch")
    for network, done in results.items():
        about = report[network]
        ckpt.save(
            out / ckpt.checkpoint_name(network),
            ckpt.Checkpoint(
                network=network,
                predictor=done.predictor,
                data_sha256=about["data_sha256"],
                scenes=about["scenes"],
                rows=about["rows"],
                figures={name: float(about[name]) for name in figures},
            ),
        )
    write_atomically(out / FIGURE, draw_losses(results))
    names = [*(ckpt.checkpoint_name(network) for network in results), FIGURE]
    report["files"] = [str(out / name) for name in names]
    return report


def draw_losses(results: dict[str, Trained]) -> bytes:
    """Figure 3: training and validation loss of each network by epoch, as a PNG."""
    figure = Figure(figsize=(4.2 * len(results), 3.4), layout="constrained")
    axes = figure.subplots(1, len(results), squeeze=False)[0]
    for ax, (network, done) in zip(axes, results.items(), strict=True):
        epochs = np.arange(1, len(done.loss_val) + 1)
        ax.plot(epochs, done.loss_train, label="training")
        ax.plot(epochs, done.loss_val, label="validation")
        ax.axvline(
            done.best_epoch + 1,
            color="0.6",
            linestyle=":",
            label=f"kept: RMSE {done.rmse_val:.1f}",
        )
        ax.set(title=network, xlabel="epoch", ylabel="RMSE (units of cost)")
        ax.set_ylim(bottom=0)
        ax.legend()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return buffer.getvalue()
