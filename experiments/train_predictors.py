"""Makes the checkpoints: collects data, trains, judges on held-out data, and writes all files.

    python experiments/train_predictors.py [--scale 0.1] [--out DIR] [--tight]

Data that are already in `--data` are kept, and an interrupted collection is continued. The commands
that collect are printed, and can be given by hand. Training data and held-out data have different
seeds. The held-out data are 250 scenes of each class planned alone, 250 with input, 125 forked. All
figures of `checkpoints/README.md` come from this script.
"""

import dataclasses
import hashlib
import json
import time
from pathlib import Path

import jax
import predictor_report as report
import tyro
from predictor_data import Data, collect, collections, load
from rich.console import Console

from pgf_jax import configure
from pgf_jax.batching.requests import GainPredictor
from pgf_jax.files import write_atomically
from pgf_jax.guidance.predictors import checkpoint as ckpt
from pgf_jax.guidance.predictors.network import CostDifference, FailureClassifier, GainNetwork
from pgf_jax.guidance.predictors.registry import predictor_spec
from pgf_jax.tables.runs import runs_path
from pgf_jax.training import train as training
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.fit import Trained, fit
from pgf_jax.training.rows import Rows

SEEDS = 5
LAST_ONLY = ("n_objects", "c_d[t-0]", "c_f[t-0]", "c_b[t-0]")  # P = 1


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scale: float = 1.0  # of the numbers of scenes
    data: Path = Path("data/predictors")  # of collected data, with a folder for each scale
    out: Path = Path("checkpoints")
    tight: bool = False  # also train the paper's pair on tight scenes alone, for comparison


def published_fit(network: str, rows: Rows, seed: int) -> Trained:
    """Train as the published code does: 16 units in the third layer, mean absolute error."""
    config = TrainConfig(seed=seed, hidden=(64, 32, 16), loss="mae")
    if network == "phi_human":
        config = dataclasses.replace(config, dropout=0.1, validation_fraction=0.3)
    return fit(jax.random.key(seed), rows, config)


def train(data: Data) -> tuple[dict[str, list[Trained]], dict[str, list[GainPredictor]]]:
    """Train all networks with every seed; returns them, and the predictors made of them."""

    def all_seeds(network: str, rows: Rows) -> list[Trained]:
        begun = time.perf_counter()
        runs = [
            training.fit_network(network, rows, TrainConfig(seed=seed)) for seed in range(SEEDS)
        ]
        took = (time.perf_counter() - begun) / SEEDS
        print(f"{network}: {len(rows.target)} rows, {took:.1f} s for each of {SEEDS} seeds")
        return runs

    networks = {network: all_seeds(network, rows) for network, rows in data.train.items()}
    last = {name: all_seeds(name, data.train[name].only(LAST_ONLY)) for name in ckpt.PAIR}
    for name in data.tight:
        networks[f"{name}, tight alone"] = all_seeds(name, data.tight[name])
    published = {
        name: [published_fit(name, data.published[name], seed) for seed in range(SEEDS)]
        for name in ckpt.PAIR
    }

    def pairs(of: dict[str, list[Trained]], suffix: str = "") -> list[GainPredictor]:
        both = zip(*(of[name + suffix] for name in ckpt.PAIR), strict=True)
        return [CostDifference(auto.predictor, human.predictor) for auto, human in both]

    predictors: dict[str, list[GainPredictor]] = {
        "paper": pairs(networks),
        "paper, P = 1": pairs(last),
        "paper, published rows": pairs(published),
        "classifier": [FailureClassifier(done.predictor) for done in networks["failure"]],
        "best": [GainNetwork(done.predictor) for done in networks["gain"]],
        # Those of the time before solutions were checked in a world.
        "first": [predictor_spec("first").load()[0]] * SEEDS,
        "first-best": [predictor_spec("first-best").load()[0]] * SEEDS,
    }
    if data.tight:
        predictors["paper, tight alone"] = pairs(networks, ", tight alone")
    return networks, predictors


def save(data: Data, networks: dict[str, list[Trained]], config: Config) -> list[str]:
    """Write the checkpoints of seed 0; returns a line for each, with its name and digest."""
    written = []
    for network, rows in data.train.items():
        done = networks[network][0]
        about = {
            **training.report_of(done, rows),
            "runs": data.runs[network],
            "data_sha256": data.sha256[network],
        }
        training.save(config.out, network, done, about, TrainConfig())
        path = config.out / ckpt.checkpoint_name(network)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        written.append(f"| `{path.name}` | {path.stat().st_size / 1024:.0f} KiB | {digest} |")
    figure = training.draw_losses({network: networks[network] for network in ckpt.PAIR})
    write_atomically(config.out / training.FIGURE, figure)
    return written


def save_ablations(data: Data, folder: Path) -> None:
    """Write the pairs of networks that do not ship, for sweeps with `--predictor FOLDER`."""
    for network in ckpt.PAIR:
        published = published_fit(network, data.published[network], 0)
        pairs = [("published", "train", published, data.published[network])]
        if data.tight:
            tight = training.fit_network(network, data.tight[network], TrainConfig(seed=0))
            pairs.append(("tight_alone", "train_tight", tight, data.tight[network]))
        for name, part, done, rows in pairs:
            runs = runs_path(folder / part, training.RECIPES[network].mode).read_bytes()
            about = training.report_of(done, rows)
            about |= {"data_sha256": hashlib.sha256(runs).hexdigest()}
            training.save(folder / name, network, done, about, TrainConfig())


def main(config: Config) -> None:
    """Collect, train, judge, write and print."""
    configure()
    console = Console()
    begun = time.perf_counter()
    folder = config.data / f"scale_{config.scale:g}"
    collect(collections(config.tight), folder, config.scale)
    collected_s = time.perf_counter() - begun
    data = load(folder, config.tight)
    networks, predictors = train(data)
    trained_s = time.perf_counter() - begun - collected_s
    files = save(data, networks, config)
    save_ablations(data, folder)
    costs = report.cost_table(data, networks)
    gains = report.gain_table(data.forks, predictors)
    content = {"scale": config.scale, "collected": data.collected, "costs": costs, "gains": gains}
    write_atomically(config.out / "figures.json", (json.dumps(content, indent=1) + "\n").encode())
    text = report.readme(content, files)
    write_atomically(config.out / "README.md", text.encode())
    write_atomically(
        config.out / "calibration.png", report.draw_calibration(data.forks, predictors)
    )
    console.print(text, markup=False, highlight=False, soft_wrap=True)
    print(
        f"collected in {collected_s / 60:.1f} min (data that were there are not counted), "
        f"trained in {trained_s:.0f} s, all in {(time.perf_counter() - begun) / 60:.1f} min"
    )


if __name__ == "__main__":
    main(tyro.cli(Config))
