"""Compares candidates for `--predictor best` by cross-validation on the training forks.

    python experiments/choose_predictor.py [--data data/predictors/scale_1/train]

The scenes are split into folds. Each candidate is trained on all folds but one (with a validation
split of its own for early stopping) and bids on that fold. The held-out test data are not used. The
best candidate is written into `RECIPES` of `pgf_jax/training/train.py`.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import predictor_evaluation as ev
import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax import configure
from pgf_jax.guidance.predictors.features import FEATURES, STATE
from pgf_jax.tables.forks import Forks, forks_of, read_forks
from pgf_jax.tables.runs import Mode, runs_path
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.fit import fit
from pgf_jax.training.rows import Rows

SIZES = (2, 4, 8)
SPREAD = 30.0  # units of cost, at which asinh changes from linear to logarithmic
Bid = Callable[[Forks, np.ndarray], np.ndarray]  # training states, [B, S] states -> [B] bids


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    data: Path = Path("data/predictors/scale_1/train")
    folds: int = 4


def rows_of(forks: Forks, target: np.ndarray, names: tuple[str, ...]) -> Rows:
    """Rows of some features of the state."""
    rows = Rows(
        features=forks.state,
        target=target,
        unsolved=np.ones(len(target), bool),
        scene=forks.scene.astype(np.str_),
        iteration=forks.iteration,
        names=STATE,
    )
    return rows.only(names)


def direct(names: tuple[str, ...], squash: bool = False, **settings: object) -> Bid:
    """A candidate that predicts the gain (or its asinh) from some features of the state."""

    def bid(forks: Forks, states: np.ndarray) -> np.ndarray:
        target = np.arcsinh(forks.gain / SPREAD) if squash else forks.gain
        rows = rows_of(forks, target, names)
        return fit(jax.random.key(0), rows, _config(settings)).predictor.of_states(states)

    return bid


def difference(names: tuple[str, ...], **settings: object) -> Bid:
    """A candidate with a network for each of the paper's two costs, trained on the same forks."""

    def bid(forks: Forks, states: np.ndarray) -> np.ndarray:
        costs = []
        for i, target in enumerate((forks.alone, forks.helped)):
            rows = rows_of(forks, target.mean(axis=1), names)
            done = fit(jax.random.key(i), rows, _config(settings))
            costs.append(done.predictor.of_states(states))
        return costs[0] - costs[1]

    return bid


def _config(settings: dict) -> TrainConfig:
    return dataclasses.replace(TrainConfig(), **settings)


WITHOUT_N = tuple(name for name in STATE if name != "n_objects")
CANDIDATES: dict[str, Bid] = {
    "gain, the paper's inputs": direct(FEATURES, members=5),
    "gain": direct(WITHOUT_N, members=5),
    "gain, 1 member": direct(WITHOUT_N),
    "gain, 32-16 units": direct(WITHOUT_N, members=5, hidden=(32, 16)),
    "gain, 16-8 units": direct(WITHOUT_N, members=5, hidden=(16, 8)),
    "gain, 32-16 units, patience 10": direct(
        WITHOUT_N, members=5, hidden=(32, 16), learning_rate=3e-4, patience=10
    ),
    "gain, 32-16 units, 15 members": direct(WITHOUT_N, members=15, hidden=(32, 16)),
    "gain, dropout 0.2": direct(WITHOUT_N, members=5, dropout=0.2),
    "asinh of the gain, 32-16 units": direct(WITHOUT_N, squash=True, members=5, hidden=(32, 16)),
    "two costs, 32-16 units": difference(WITHOUT_N, members=5, hidden=(32, 16)),
}


def main(config: Config) -> None:
    """Cross-validate, and print the table."""
    configure()
    forks = forks_of(read_forks(runs_path(config.data, Mode.FORKS)))
    fold = np.random.default_rng(0).permutation(len(forks.scene)) % config.folds
    bids = {name: np.empty(len(forks.scene)) for name in CANDIDATES}
    for k in range(config.folds):
        train, test = forks.take(np.flatnonzero(fold != k)), np.flatnonzero(fold == k)
        for name, bid in CANDIDATES.items():
            bids[name][test] = bid(train, forks.state[test])
    bids["random"] = np.zeros(len(forks.scene))
    table = Table(title=f"{len(forks.scene)} states, {config.folds} folds")
    for column in ("bids by", "rank correlation", *(f"regret m = {m}, to random's" for m in SIZES)):
        table.add_column(column, justify="left" if column == "bids by" else "right")
    chosen = {m: ev.windows(bids, forks.gain, m, beside=("random",)) for m in SIZES}
    for name, bid in bids.items():
        regrets = [
            f"{chosen[m][name].regret} {chosen[m][name].to['random'].value:.2f}" for m in SIZES
        ]
        table.add_row(name, f"{ev.rank_correlation(bid, forks.gain):.2f}", *regrets)
    Console(width=150).print(table)


if __name__ == "__main__":
    main(tyro.cli(Config))
