"""Collection of runs to train the predictors on (Papallas & Dogar 2022, Alg. 3).

A run is one sampled scene planned by one robot to its end, solved or out of time. Autonomous runs
have no help. In a human run the operator gives one input, after a reach iteration that is drawn by
(seed, scene), and none after it, so that the cost ten iterations on is what that input led to; the
input takes no simulated time, which would only cut runs short at random. Runs solved before their
turn comes hold no input, and give no rows.

Runs are written in parts as scenes end, and merged into `runs.parquet` when all are there; what a
run holds depends on its scene and the settings alone, so the file is the same to the last bit
however often collecting was interrupted.
"""

import dataclasses
import json
import shutil
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet
from pgf_jax.fleet.service import stream
from pgf_jax.guidance.runs import RUN, Mode, read_runs, runs_path, write_atomically, write_runs
from pgf_jax.scene.sampling import OBJECTS, sample_scene
from pgf_jax.scene.scene import Scene
from pgf_jax.study.asks import once_after
from pgf_jax.study.collect_config import CollectConfig
from pgf_jax.study.crew import Crew, Robot, drive
from pgf_jax.study.plan import planning_computer, single_robot

SETTINGS = "collect.json"
PARTS = "parts"
# Settings that must be as they were for runs to be continued; more scenes may always be added.
_KEPT = (
    "mode",
    "classes",
    "seed",
    "engine",
    "physics",
    "cost",
    "update",
    "operator",
    "lanes",
    "task_limit",
    "ask_from",
    "ask_to",
)


@dataclasses.dataclass(frozen=True)
class Collected:
    """What a collection holds.

    Attributes:
      path: of the runs.
      runs: scenes planned.
      by_class: how many of each scene class.
      solved: runs that ended with a feasible reach.
      iterations: of all runs, iteration 0s included.
      inputs: human inputs given.
      seconds: wall time of this call.
    """

    path: Path
    runs: int
    by_class: dict[str, int]
    solved: int
    iterations: int
    inputs: int
    seconds: float


def collect(
    config: CollectConfig, *, on_progress: Callable[[int, int], None] | None = None
) -> Collected:
    """Plan the scenes of `config` and write their runs.

    Args:
      config: settings.
      on_progress: called with (runs done, runs wanted) at the start and as runs end.

    Returns:
      What is in the file now, runs of earlier calls included.

    Raises:
      BadInput: there are runs already and `resume` is off, or they were made with other settings,
        or the folder cannot be written.
    """
    began = time.monotonic()
    path = runs_path(config.out, Mode(config.mode))
    done = _open(config, path)
    todo = [i for i in range(config.scenes) if _name(config, i) not in done]
    store = _Store(path, config.chunk)
    progress = on_progress or (lambda done, wanted: None)
    progress(config.scenes - len(todo), config.scenes)

    def ended(robot: Robot) -> None:
        store.add(robot.log.frame())
        progress(config.scenes - len(todo) + store.added, config.scenes)

    if todo:
        computer = planning_computer(config, OBJECTS)

        def fleets() -> Iterator[tuple[Fleet, Crew]]:
            for i in todo:
                scene = scene_of(config, i)
                human = config.mode == "human"
                yield single_robot(
                    computer,
                    scene,
                    config.seed + i,
                    operator=config.operator if human else "none",
                    policy=once_after(ask_at(config, scene)) if human else "autonomous",
                    task_limit_s=config.task_limit,
                    service_s=(0.0, 0.0),
                    on_end=ended,
                )

        try:
            # No more under way than fit in a call, so that its lanes stay full to the end.
            drive(fleets(), computer, at_once=config.lanes)
        finally:
            store.flush()
    return _summary(path, _merge(path), time.monotonic() - began)


def scene_of(config: CollectConfig, index: int) -> Scene:
    """Scene number `index`: classes in turn, and a seed of its own."""
    return sample_scene(config.seed + index, config.classes[index % len(config.classes)])


def ask_at(config: CollectConfig, scene: Scene) -> int:
    """The reach iteration after which the input of a scene comes, drawn by (seed, scene)."""
    draw = stream(config.seed, "ask-at", zlib.crc32(scene.name.encode()))
    return int(draw.integers(config.ask_from, config.ask_to, endpoint=True))


def _name(config: CollectConfig, index: int) -> str:
    return f"{config.classes[index % len(config.classes)]}_{config.seed + index}"


class _Store:
    """Finished runs on their way to disk."""

    def __init__(self, path: Path, chunk: int) -> None:
        self.added = 0
        self._folder, self._chunk = path.parent / PARTS, chunk
        self._frames: list[pl.DataFrame] = []

    def add(self, frame: pl.DataFrame) -> None:
        """Keep a run, and write when there are enough."""
        self.added += 1
        self._frames.append(frame)
        if len(self._frames) >= self._chunk:
            self.flush()

    def flush(self) -> None:
        """Write what is kept as a new part."""
        if self._frames:
            number = len(_parts(self._folder.parent))
            write_runs(self._folder / f"part_{number:05d}.parquet", self._frames)
            self._frames = []


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / PARTS).glob("part_*.parquet"))


def _open(config: CollectConfig, path: Path) -> set[str]:
    """Write the settings, or check them against those of earlier calls; scenes done so far."""
    settings = path.parent / SETTINGS
    found = [p for p in (path, settings, path.parent / PARTS) if p.exists()]
    if found and not config.resume:
        raise BadInput(f"{found[0]}: exists; expected a new folder, or --resume to continue it")
    wanted = json.loads(json.dumps(dataclasses.asdict(config), default=str))
    if found:
        before = _read_settings(settings)
        for name in _KEPT:
            if before.get(name) != wanted[name]:
                raise BadInput(
                    f"{settings}: runs were collected with {name} {before.get(name)!r}, "
                    f"expected the same to resume, got {wanted[name]!r}"
                )
        if config.scenes < before["scenes"]:
            raise BadInput(f"scenes: expected {before['scenes']} or more, got {config.scenes}")
    kept = {name: wanted[name] for name in (*_KEPT, "scenes")}
    write_atomically(settings, (json.dumps(kept, indent=2) + "\n").encode())
    runs = _read_all(path)
    return set() if runs is None else set(runs["scene"].unique())


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        settings = json.loads(path.read_bytes())
    except (OSError, ValueError):
        settings = None
    if not isinstance(settings, dict) or type(settings.get("scenes")) is not int:
        raise BadInput(f"{path}: not readable; expected the settings of the runs to resume")
    return settings


def _read_all(path: Path) -> pl.DataFrame | None:
    """All runs so far; a part merged before an interruption counts once."""
    files = [p for p in [path, *_parts(path.parent)] if p.exists()]
    frames = [read_runs(file) for file in files]
    if not frames:
        return None
    return pl.concat(frames).unique([*RUN, "iteration"], keep="first")


def _merge(path: Path) -> pl.DataFrame:
    runs = _read_all(path)
    assert runs is not None, "a run has one iteration or more"
    if _parts(path.parent):
        write_runs(path, [runs])
    shutil.rmtree(path.parent / PARTS, ignore_errors=True)
    return read_runs(path)


def _summary(path: Path, runs: pl.DataFrame, seconds: float) -> Collected:
    by_run = runs.group_by(RUN, maintain_order=True).agg(
        pl.col("class").first(),
        ((pl.col("kind") == "reach") & pl.col("feasible")).any().alias("solved"),
    )
    classes = by_run["class"].value_counts().sort("class").rows()
    return Collected(
        path=path,
        runs=len(by_run),
        by_class={name: int(count) for name, count in classes},
        solved=int(by_run["solved"].sum()),
        iterations=len(runs),
        inputs=int(runs["asked_before"].sum()),
        seconds=seconds,
    )
