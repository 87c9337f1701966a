"""From nothing to the checkpoints: collect, train, judge, write.

    python experiments/train_predictors.py [--scale 0.1] [--out DIR]

Data that are there are kept (`--data`), and what was interrupted is continued: the commands that
collect are printed and can be given by hand. Training data have seeds of their own, and so have the
held-out ones: 500 scenes of each class, planned alone, with input, and forked. All figures of
`checkpoints/README.md` come from here.
"""

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("NPROC", "1")  # XLA's threads cost the planar engine a third of its speed

import jax
import numpy as np
import predictor_report as report
import tyro
from rich.console import Console

from pgf_jax.batching.requests import GainPredictor
from pgf_jax.files import write_atomically
from pgf_jax.guidance.predictors import checkpoint as ckpt
from pgf_jax.guidance.predictors.network import CostDifference, FailureClassifier, GainNetwork
from pgf_jax.tables.forks import Forks, forks_of, read_forks
from pgf_jax.tables.runs import Mode, read_runs, runs_path
from pgf_jax.training import train as training
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.fit import Trained, fit
from pgf_jax.training.rows import PUBLISHED, Rows, autonomous_rows, human_rows

SEEDS = 5
LAST_ONLY = ("n_objects", "c_d[t-0]", "c_f[t-0]", "c_b[t-0]")  # P = 1
# folder, mode, scenes at full scale, seed of the first, further options
# Classes in turn; and, for comparison, `tight` alone, the class nearest to the paper's scenes. One
# human run in five lasts until its input comes: 1,500 of the 7,500, as in the paper.
COLLECTIONS = (
    ("train", "autonomous", 4000, 0, ()),
    ("train", "human", 7500, 0, ()),
    ("train", "forks", 12000, 100_000, ("--keys", "4")),
    ("train_tight", "autonomous", 4000, 0, ("--classes", "tight")),
    ("train_tight", "human", 9600, 0, ("--classes", "tight")),
    ("test", "autonomous", 1500, 1_000_000, ()),
    ("test", "human", 1500, 1_000_000, ()),
    ("test", "forks", 1500, 1_000_000, ("--keys", "16")),
)


@dataclasses.dataclass(frozen=True)
class Config:
    """What is done."""

    scale: float = 1.0  # of the numbers of scenes
    data: Path = Path("data/predictors")  # collected data, a folder for each scale
    out: Path = Path("checkpoints")


def collect(config: Config) -> Path:
    """Collect what is missing; the folder of the data."""
    folder = config.data / f"scale_{config.scale:g}"
    for part, mode, scenes, seed, options in COLLECTIONS:
        number = max(30, round(scenes * config.scale))
        command = ["collect", mode, "--scenes", str(number), "--seed", str(seed), *options]
        command += ["--out", str(folder / part), "--resume"]
        print("pgf-jax", *command, flush=True)
        subprocess.run([sys.executable, "-m", "pgf_jax", *command], check=True)
    return folder


@dataclasses.dataclass(frozen=True)
class Data:
    """Rows to train on and to be judged by."""

    train: dict[str, Rows]  # by network
    published: dict[str, Rows]  # phi_auto and phi_human, by the published code's rule
    tight: dict[str, Rows]  # the same two, of tight scenes alone
    test: dict[str, Rows]  # phi_auto and phi_human
    test_class: dict[str, np.ndarray]  # scene class of each row of `test`
    forks: Forks  # held out
    sha256: dict[str, str]  # by network
    runs: dict[str, int]  # scenes with data, by network
    collected: list[dict]  # what each collection holds


def load(folder: Path) -> Data:
    """Read the collected data."""
    train, sha256, runs = {}, {}, {}
    for network, recipe in training.RECIPES.items():
        path = runs_path(folder / "train", recipe.mode)
        frame = recipe.read(path)
        train[network] = recipe.rows(frame)
        sha256[network] = hashlib.sha256(path.read_bytes()).hexdigest()
        runs[network] = frame.select("scene", "seed").n_unique()
    makers = {"phi_auto": (Mode.AUTONOMOUS, autonomous_rows), "phi_human": (Mode.HUMAN, human_rows)}
    published, tight, test, classes = {}, {}, {}, {}
    for network, (mode, make) in makers.items():
        published[network] = make(read_runs(runs_path(folder / "train", mode)), PUBLISHED)
        tight[network] = make(read_runs(runs_path(folder / "train_tight", mode)))
        frame = read_runs(runs_path(folder / "test", mode))
        test[network] = make(frame)
        of_scene = dict(frame.select("scene", "class").unique().iter_rows())
        classes[network] = np.array([of_scene[scene] for scene in test[network].scene])
    forks = forks_of(read_forks(runs_path(folder / "test", Mode.FORKS)))
    collected = [report.describe(folder / part, Mode(mode)) for part, mode, *_ in COLLECTIONS]
    return Data(train, published, tight, test, classes, forks, sha256, runs, collected)


def published_fit(network: str, rows: Rows, seed: int) -> Trained:
    """As the published code trains (D6): 16 units in the third layer, mean absolute error."""
    config = TrainConfig(seed=seed, hidden=(64, 32, 16), loss="mae")
    if network == "phi_human":
        config = dataclasses.replace(config, dropout=0.1, validation_fraction=0.3)
    return fit(jax.random.key(seed), rows, config)


def train(data: Data) -> tuple[dict[str, list[Trained]], dict[str, list[GainPredictor]]]:
    """All networks with every seed; and the bidders that are made of them."""

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
    for name in ckpt.PAIR:
        networks[f"{name}, tight alone"] = all_seeds(name, data.tight[name])
    published = {
        name: [published_fit(name, data.published[name], seed) for seed in range(SEEDS)]
        for name in ckpt.PAIR
    }

    def pairs(of: dict[str, list[Trained]], suffix: str = "") -> list[GainPredictor]:
        both = zip(*(of[name + suffix] for name in ckpt.PAIR), strict=True)
        return [CostDifference(auto.predictor, human.predictor) for auto, human in both]

    bidders = {
        "paper": pairs(networks),
        "paper, tight alone": pairs(networks, ", tight alone"),
        "paper, P = 1": pairs(last),
        "paper, published rows": pairs(published),
        "classifier": [FailureClassifier(done.predictor) for done in networks["failure"]],
        "best": [GainNetwork(done.predictor) for done in networks["gain"]],
    }
    return networks, bidders


def save(data: Data, networks: dict[str, list[Trained]], config: Config) -> list[str]:
    """Write the checkpoints of seed 0; names and digests of the files."""
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
    write_atomically(config.out / train.FIGURE, figure)
    return written


def save_ablations(data: Data, folder: Path) -> None:
    """Write the pairs that do not ship, of seed 0, for sweeps with `--predictor FOLDER`."""
    for network in ckpt.PAIR:
        published = published_fit(network, data.published[network], 0)
        tight = training.fit_network(network, data.tight[network], TrainConfig(seed=0))
        for name, part, done, rows in (
            ("published", "train", published, data.published[network]),
            ("tight_alone", "train_tight", tight, data.tight[network]),
        ):
            runs = runs_path(folder / part, training.RECIPES[network].mode).read_bytes()
            about = training.report_of(done, rows)
            about |= {"data_sha256": hashlib.sha256(runs).hexdigest()}
            training.save(folder / name, network, done, about, TrainConfig())


def main(config: Config) -> None:
    """Do all of it."""
    console = Console()
    begun = time.perf_counter()
    folder = collect(config)
    collected_s = time.perf_counter() - begun
    data = load(folder)
    networks, bidders = train(data)
    trained_s = time.perf_counter() - begun - collected_s
    files = save(data, networks, config)
    save_ablations(data, folder)
    costs = report.cost_table(data, networks)
    gains = report.gain_table(data.forks, bidders)
    content = {"scale": config.scale, "collected": data.collected, "costs": costs, "gains": gains}
    write_atomically(config.out / "figures.json", (json.dumps(content, indent=1) + "\n").encode())
    text = report.readme(content, files)
    write_atomically(config.out / "README.md", text.encode())
    write_atomically(config.out / "calibration.png", report.draw_calibration(data.forks, bidders))
    console.print(text, markup=False, highlight=False, soft_wrap=True)
    print(
        f"collected in {collected_s / 60:.1f} min (what was there is not counted), "
        f"trained in {trained_s:.0f} s, all in {(time.perf_counter() - begun) / 60:.1f} min"
    )


if __name__ == "__main__":
    main(tyro.cli(Config))
