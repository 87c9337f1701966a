"""Trains the predictors on a folder of collected data (Papallas & Dogar 2022, Alg. 3)."""

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl
from matplotlib.figure import Figure

from pgf_jax.errors import BadInput
from pgf_jax.files import png, write_atomically
from pgf_jax.guidance.predictors import checkpoint as ckpt
from pgf_jax.jax_setup import configure_early
from pgf_jax.settings import check_type
from pgf_jax.tables.forks import read_forks, read_futures
from pgf_jax.tables.runs import Mode, read_runs, runs_path
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.fit import Trained, fit
from pgf_jax.training.rows import (
    Rows,
    autonomous_rows,
    failure_rows,
    gain_rows,
    hazard_rows,
    human_rows,
)

FIGURE = "fig3.png"


@dataclasses.dataclass(frozen=True)
class Recipe:
    """Recipe for training a network.

    Attributes:
      mode: the kind of data that the network is trained on.
      read: reads the file of data.
      rows: makes training rows of the data.
      settings: settings that replace those of the configuration.
      optional: the network is left out where its data do not exist.
    """

    mode: Mode
    read: Callable[[Path], pl.DataFrame]
    rows: Callable[[pl.DataFrame], Rows]
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    optional: bool = False


def _read_autonomous(path: Path) -> pl.DataFrame:
    return read_runs(path, mode=Mode.AUTONOMOUS)


def _alone(frame: pl.DataFrame) -> Rows:
    return hazard_rows(frame, "alone")


def _helped(frame: pl.DataFrame) -> Rows:
    return hazard_rows(frame, "helped")


BEST = {"members": 15, "hidden": (32, 16)}
HAZARD = {"members": 5, "hidden": (32, 16), "loss": "logistic", "batch": 250}
RECIPES = {
    "phi_auto": Recipe(Mode.AUTONOMOUS, _read_autonomous, autonomous_rows),
    "phi_human": Recipe(Mode.HUMAN, read_runs, human_rows),
    "failure": Recipe(Mode.AUTONOMOUS, _read_autonomous, failure_rows, {"loss": "logistic"}),
    "gain": Recipe(Mode.FORKS, read_forks, gain_rows, BEST, optional=True),
    "time_alone": Recipe(Mode.FUTURES, read_futures, _alone, HAZARD, optional=True),
    "time_helped": Recipe(Mode.FUTURES, read_futures, _helped, HAZARD, optional=True),
}


def train(data_dir: Path | str, out_dir: Path | str, config: TrainConfig) -> dict[str, Any]:
    """Train all networks on collected data, and write their checkpoints and figure 3.

    Args:
      data_dir: holds `autonomous/runs.parquet` and `human/runs.parquet`, and, for `gain`,
        `forks/forks.parquet`, and for the networks of time `futures/futures.parquet`.
      out_dir: gets a checkpoint of each network and `fig3.png` once all are trained.
      config: settings; a network's own settings (`RECIPES`) replace them.

    Returns:
      For each network: runs (scenes with data), scenes (with rows), rows, rows left out
      (`non_finite`, `short`), `loss_train`, `loss_val`, `target_std_val`, `epochs`, `best_epoch`
      and `data_sha256`; and the list of `files`. Plain numbers and strings, fit for JSON.

    Raises:
      BadInput: a file is missing or malformed, or has rows of fewer than two scenes.
    """
    check_type("config", config, TrainConfig)
    configure_early(None)
    rows: dict[str, Rows] = {}
    report: dict[str, Any] = {}
    for network, recipe in RECIPES.items():
        path = runs_path(data_dir, recipe.mode)
        if recipe.optional and not path.exists():
            continue
        frame = recipe.read(path)
        rows[network] = recipe.rows(frame)
        scenes = len(np.unique(rows[network].scene))
        if scenes < 2:
            raise BadInput(
                f"{path}: rows from {scenes} scenes, expected at least 2 "
                f"(training and validation share none)"
            )
        report[network] = {
            "runs": frame.select("scene", "seed").n_unique(),
            "data_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }

    out = Path(out_dir)
    results = {network: fit_network(network, rows[network], config) for network in rows}
    for network, done in results.items():
        report[network] |= report_of(done, rows[network])
        save(out, network, done, report[network], config)
    pair = {network: done for network, done in results.items() if network in ckpt.PAIR}
    write_atomically(out / FIGURE, draw_losses({name: [done] for name, done in pair.items()}))
    names = [*(ckpt.checkpoint_name(network) for network in results), FIGURE]
    report["files"] = [str(out / name) for name in names]
    return report


def fit_network(network: str, rows: Rows, config: TrainConfig) -> Trained:
    """Train one network by its recipe; the seed of `config` decides all random draws."""
    settings = dataclasses.replace(config, **RECIPES[network].settings)
    key = jax.random.fold_in(jax.random.key(config.seed), ckpt.NETWORKS.index(network))
    return fit(key, rows, settings)


def report_of(done: Trained, rows: Rows) -> dict[str, Any]:
    """Counts and losses of a trained network, fit for JSON; see `train`."""
    return {
        "scenes": done.scenes_train + done.scenes_val,
        "rows": len(rows.target),
        "non_finite": rows.non_finite,
        "short": rows.short,
        "loss_train": done.kept_train,
        "loss_val": done.kept_val,
        "target_std_val": done.target_std_val,
        "epochs": len(done.loss_val),
        "best_epoch": done.best_epoch,
    }


def save(
    out: Path, network: str, done: Trained, about: dict[str, Any], config: TrainConfig
) -> None:
    """Write the checkpoint of a network; `about` is its part of the report of `train`."""
    settings = dataclasses.replace(config, **RECIPES[network].settings)
    figures = ("loss_train", "loss_val", "target_std_val", "epochs", "best_epoch")
    checkpoint = ckpt.Checkpoint(
        network=network,
        predictor=done.predictor,
        data_sha256=about["data_sha256"],
        scenes=about["scenes"],
        rows=about["rows"],
        config={name: str(value) for name, value in dataclasses.asdict(settings).items()},
        figures={name: float(about[name]) for name in figures},
    )
    ckpt.save(out / ckpt.checkpoint_name(network), checkpoint)


def draw_losses(results: dict[str, Sequence[Trained]]) -> bytes:
    """Draw figure 3, training and validation loss by epoch, as a PNG.

    Args:
      results: each network, trained with one seed or several; the first one's best is marked.
    """
    figure = Figure(figsize=(4.2 * len(results), 3.4), layout="constrained")
    axes = figure.subplots(1, len(results), squeeze=False)[0]
    for ax, (network, runs) in zip(axes, results.items(), strict=True):
        for i, done in enumerate(runs):
            epochs, faint = np.arange(1, len(done.loss_val) + 1), 1.0 if i == 0 else 0.3
            labels = (None, None) if i else ("training", "validation")
            ax.plot(epochs, done.loss_train, color="C0", alpha=faint, label=labels[0])
            ax.plot(epochs, done.loss_val, color="C1", alpha=faint, label=labels[1])
        kept = runs[0].best_epoch
        label = f"kept: RMSE {runs[0].loss_val[kept]:.1f}"
        ax.axvline(kept + 1, color="0.6", linestyle=":", label=label)
        ax.set(title=network, xlabel="epoch", ylabel="RMSE (units of cost)")
        ax.set_ylim(bottom=0)
        ax.legend()
    return png(figure)
