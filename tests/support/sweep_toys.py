"""A world that costs nothing, for tests of what surrounds it; and small checkpoints and scenes."""

import math
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import polars as pl

from pgf_jax.fleet.policies import AskWhenStuck, Discipline, register_policy
from pgf_jax.guidance.operators.registry import register_operator
from pgf_jax.guidance.predictors import checkpoint
from pgf_jax.guidance.predictors.features import AHEAD, FEATURES
from pgf_jax.guidance.predictors.network import combine, init
from pgf_jax.physics.engine import Rollout, contact_slots, register_engine
from pgf_jax.planning.types import Push
from pgf_jax.sweeping.config import SweepConfig

GRIP_SCALE = 9e3  # of the four tasks of two robots, seed 0, one times out and one ends stuck
RESULTS = (
    *("tasks.parquet", "events.parquet", "summary.csv", "fleets.csv", "paired.csv"),
    "fig6.png",
)


class Ghost:
    """The hand passes through objects, but slips: it moves at a speed that the scene decides.

    Some scenes are solved at once, some after many iterations and some never.
    """

    name = "ghost"

    def __init__(self, physics, n_objects, *, lanes=1):
        self.physics, self.n_objects, self.lanes = physics, n_objects, lanes

    def rollout(self, start, controls, gripper, substeps, wanted=None, shelf=None):
        b, t = np.shape(gripper)
        luck = GRIP_SCALE * np.asarray(start.objects, np.float64).sum((1, 2)) % 1
        grip = np.maximum(0.0, 1.2 * luck - 0.2)
        wanted = np.cumsum(np.asarray(controls, np.float64), axis=1) * self.physics.knot_s
        moved = (grip[:, None, None] * wanted).astype(np.float32)
        still = np.repeat(np.asarray(start.objects)[:, None], t, axis=1)
        return Rollout(
            objects=still,
            hand=np.asarray(start.hand)[:, None] + moved,
            velocities=np.zeros_like(np.asarray(start.objects)),
            force=np.zeros((b, t, contact_slots(self.n_objects)), np.float32),
            bodies=np.zeros((b, t, contact_slots(self.n_objects), 2), np.int32),
        )


register_engine("ghost", Ghost)


class Nudge:
    """Pushes an object nowhere, which succeeds at once, or far away, which never does; or goes on.

    What it says depends on the shelf and on how often it was asked, so robots' ways are many.
    """

    name = "nudge"

    def decide(self, view):
        x, y = map(float, view.objects[5])
        kind = (view.request + int(1e5 * view.objects.sum())) % 3
        return (None, Push(5, x, y), Push(6, 0.9 * x, -y))[kind]


register_operator("nudge", Nudge)


class Eager(AskWhenStuck):
    """Waits for input before planning, and again when stuck."""

    def first_bid(self, progress):
        return math.inf


register_policy("eager", lambda config: Eager(Discipline.LINE))


def processes(count: int) -> ProcessPoolExecutor:
    """An executor whose processes know the toys."""
    return ProcessPoolExecutor(
        count, mp_context=multiprocessing.get_context("spawn"), initializer=_know_the_toys
    )


def _know_the_toys() -> None:
    """Whoever is to call this has imported the module."""


def ghost(out: Path, **changes) -> SweepConfig:
    """A sweep of four cells that takes seconds."""
    settings = {
        "robots": (1, 2),
        "policies": ("or-hitl", "autonomous"),
        "tasks": 2,
        "engine": "ghost",
        "operator": "none",
        "lanes": 4,
        "world": "none",  # nothing that a ghost does is true in any
        "physics": "authors",
        "out": out,
    }
    return SweepConfig(**(settings | changes))


OF_STATE = (*FEATURES, "iteration", "distance")  # what the toy `gain` looks at


def write_checkpoints(folder: Path, seed: int = 0) -> Path:
    """Untrained networks about costs in the hundreds, or log-odds; `gain` is an ensemble."""
    rng = np.random.default_rng(seed)
    features, target = rng.uniform(0, 500, (50, len(OF_STATE))), rng.uniform(0, 500, 50)
    for number, network in enumerate(checkpoint.NETWORKS):
        timed = network.startswith("time_")
        names = OF_STATE if network == "gain" else (*FEATURES, AHEAD) if timed else FEATURES
        y = (target - 250) / 50 if network == "failure" or timed else target
        members = [
            init(jax.random.key(10 * member + number), features[:, : len(names)], y, names=names)
            for member in range(2 if network == "gain" else 1)
        ]
        checkpoint.save(
            folder / checkpoint.checkpoint_name(network),
            checkpoint.Checkpoint(
                network,
                combine(members),
                data_sha256=f"digest of {network}",
                scenes=40 + number,
                rows=50,
                config={"seed": str(seed)},
                figures={"loss_val": 1.0},
            ),
        )
    return folder


def write_scene(path: Path, n_objects: int = 4) -> None:
    """A row of cylinders, in the published form."""
    bodies = "".join(
        f'<body name="object_{i + 1}" pos="0.45 {0.1 * i - 0.15:g} 0.05"><freejoint/>'
        '<geom type="cylinder" size="0.03 0.05"/></body>'
        for i in range(n_objects)
    )
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")


class Ways(NamedTuple):
    """Everything that robots did, with all that had happened in its task before; each way once."""

    iterations: set  # of reaches and pushes
    reaches: set  # with the number of inputs before it, like the following
    gains: set  # reach iterations with a known gain
    inputs: set


def ways(*logs: pl.DataFrame) -> Ways:
    """Of fleets with the same tasks, seed and operator; `logs`: the events of one each."""
    found = Ways(set(), set(), set(), set())
    happenings = ("iteration", "service_end", "push_dropped", "retreat_end")
    for log in logs:
        now: dict = {}
        for row in log.filter(pl.col("kind").is_in(happenings)).rows(named=True):
            task, kind = (row["robot"], row["task"]), row["kind"]
            way, given = now.get(task, (task, 0))
            if kind == "iteration":
                way = (*way, kind)
                found.iterations.add(way)
                if row["object"] is None:
                    found.reaches.add((way, given))
                if row["gain"] is not None:
                    found.gains.add((way, given))
            elif kind != "service_end":
                way = (*way, kind)
            elif row["outcome"] in ("push", "go_on"):
                found.inputs.add((way, given))
                given += 1
                if row["outcome"] == "push" or way != task:  # going on before planning is nothing
                    way = (*way, (row["object"], row["x"], row["y"]))
            now[task] = way, given
    return found


def content(out: Path, names=(*RESULTS, "manifest.json")) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in names}


def cell_files(out: Path) -> dict[str, bytes]:
    """A sweep's cells, without what varies from run to run."""
    return {path.name: path.read_bytes() for path in (out / "cells").glob("*.parquet")}


def untouched(*files: Path) -> dict[Path, tuple[int, int]]:
    """Of files, and of those below folders: changes when one is written, be it with the same."""
    found = [p for file in files for p in (file, *file.rglob("*")) if p.is_file()]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in found}


def tree(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
