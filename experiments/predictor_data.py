"""The collected data that predictors are trained on and judged by: collects and reads them.

Part of `train_predictors.py`.
"""

import dataclasses
import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from pgf_jax.scene import PRESETS
from pgf_jax.tables.forks import Forks, forks_of, read_forks
from pgf_jax.tables.parquet import read_provenance
from pgf_jax.tables.runs import Mode, read_runs, runs_path
from pgf_jax.training import train as training
from pgf_jax.training.rows import PUBLISHED, Rows, autonomous_rows, human_rows

# Every class in turn, to the task's limit, and input after any iteration: the last that leaves the
# predictors' look-ahead within the limit is reach iteration 39.
EVERY = ("--classes", *PRESETS, "--task-limit", "180", "--ask-to", "39")
# (folder, mode, scenes at full scale, seed of the first scene, further options)
COLLECTIONS = (
    ("train", "autonomous", 4000, 0, EVERY),
    ("train", "human", 7500, 0, EVERY),
    ("train", "forks", 4000, 100_000, (*EVERY, "--keys", "4")),
    ("test", "autonomous", 1500, 1_000_000, EVERY),
    ("test", "human", 1500, 1_000_000, EVERY),
    ("test", "forks", 750, 1_000_000, (*EVERY, "--keys", "16")),
)
# For comparison: of `tight` alone, the class nearest to the paper's scenes.
TIGHT = (
    ("train_tight", "autonomous", 4000, 0, ("--classes", "tight")),
    ("train_tight", "human", 9600, 0, ("--classes", "tight")),
)


@dataclasses.dataclass(frozen=True)
class Data:
    """Rows to train on, and rows and forks to judge by."""

    train: dict[str, Rows]  # by network
    published: dict[str, Rows]  # phi_auto and phi_human, by the published code's rule
    tight: dict[str, Rows]  # the same two, of tight scenes alone; empty if not asked for
    test: dict[str, Rows]  # phi_auto and phi_human
    test_class: dict[str, np.ndarray]  # scene class of each row of `test`
    forks: Forks  # held out
    sha256: dict[str, str]  # of the training data, by network
    runs: dict[str, int]  # scenes with data, by network
    collected: list[dict[str, Any]]  # content of each collection


def collections(tight: bool) -> tuple:
    """What is collected; with `tight`, also of that class alone."""
    return COLLECTIONS + TIGHT if tight else COLLECTIONS


def collect(wanted: tuple, folder: Path, scale: float) -> None:
    """Collect what is missing of collections; `scale` multiplies the numbers of scenes."""
    for part, mode, scenes, seed, options in wanted:
        number = max(30, round(scenes * scale))
        command = ["collect", mode, "--scenes", str(number), "--seed", str(seed), *options]
        command += ["--out", str(folder / part), "--resume"]
        print("pgf-jax", *command, flush=True)
        subprocess.run([sys.executable, "-m", "pgf_jax", *command], check=True)


def load(folder: Path, with_tight: bool) -> Data:
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
        if with_tight:
            tight[network] = make(read_runs(runs_path(folder / "train_tight", mode)))
        frame = read_runs(runs_path(folder / "test", mode))
        test[network] = make(frame)
        of_scene = dict(frame.select("scene", "class").unique().iter_rows())
        classes[network] = np.array([of_scene[scene] for scene in test[network].scene])
    forks = forks_of(read_forks(runs_path(folder / "test", Mode.FORKS)))
    collected = [_content(folder / part, Mode(mode)) for part, mode, *_ in collections(with_tight)]
    return Data(train, published, tight, test, classes, forks, sha256, runs, collected)


def _content(folder: Path, mode: Mode) -> dict[str, Any]:
    """Counts of a collection, fit for JSON."""
    path = runs_path(folder, mode)
    settings = read_provenance(path)
    frame = read_forks(path) if mode == Mode.FORKS else read_runs(path)
    first = frame.group_by("scene").first()
    kinds = frame["input"].eq("push") if mode == Mode.FORKS else frame["asked_before"]
    if mode == Mode.FORKS:
        solved = [frame["alone_solved"].mean(), frame["helped_solved"].mean()]
    else:
        reached = frame.filter(frame["feasible"] & (frame["kind"] == "reach"))
        solved = [reached["scene"].n_unique() / len(first)]
    return {
        "data": f"{folder.name}/{mode}",
        "scenes": settings["scenes"],
        "with_data": len(first),
        "by_class": {name: int((first["class"] == name).sum()) for name in PRESETS},
        "solved": solved,
        "with_input": int(frame.filter(kinds)["scene"].n_unique()),
        "seed": settings["settings"]["seed"],
        "operator": settings["settings"]["operator"] if mode != Mode.AUTONOMOUS else "",
    }
