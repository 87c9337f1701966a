"""Collection of runs to train the predictors on (Papallas & Dogar 2022, Alg. 3).

A run is one sampled scene planned by one robot to its end, solved or out of time. Autonomous runs
have no help. In a human run the operator gives one input, after a reach iteration that is drawn by
(seed, scene), and none after it, so that the cost ten iterations on is what that input led to; the
input takes no simulated time, which would only cut runs short at random. Runs solved before their
turn comes hold no input, and give no rows.

Forks (`study.forks`) are collected in the same way. Human runs can be taken from recorded sessions
instead (`study.collect_sessions`), in which people give as many inputs as they are asked for.

Runs are written in parts as scenes end, and merged into `runs.parquet` when all are there; what a
run holds depends on its scene and the settings alone, so the file is the same to the last bit
however often collecting was interrupted.
"""

import dataclasses
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.collection.config import CollectConfig
from pgf_jax.collection.scenes import PARTS, run_scenes
from pgf_jax.collection.sessions import replay_sessions
from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, json_bytes, parse_json, read_file, write_atomically
from pgf_jax.provenance import environment
from pgf_jax.tables.forks import read_forks, write_forks
from pgf_jax.tables.parquet import read_provenance
from pgf_jax.tables.runs import RUN, Mode, read_runs, runs_path, write_runs

SETTINGS = "collect.json"
_MOST_SCENES = 10_000_000  # what a file says may not fill the memory
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
    "keys",
)


@dataclasses.dataclass(frozen=True)
class Collected:
    """What a collection holds.

    Attributes:
      path: of the runs, or forks.
      scenes: scenes planned; of sessions: tasks that were begun.
      runs: runs in the file, one a scene; forks: states, one of each scene that was not solved
        too soon.
      by_class: how many of each scene class.
      solved: runs that ended with a feasible reach; forks: states with a future alone that did.
      iterations: of all runs, iteration 0s included; forks: of all futures.
      inputs: runs with human input; forks: states at which it was a push.
      seconds: wall time of this call.
      cut_off: tasks of sessions that were left out: they did not end by themselves.
    """

    path: Path
    scenes: int
    runs: int
    by_class: dict[str, int]
    solved: int
    iterations: int
    inputs: int
    seconds: float
    cut_off: int = 0


def collect(
    config: CollectConfig, *, on_progress: Callable[[int, int], None] | None = None
) -> Collected:
    """Plan the scenes of `config`, or replay its sessions, and write their runs.

    Args:
      config: settings.
      on_progress: called with (runs done, runs wanted) at the start and as runs end; of sessions,
        tasks count.

    Returns:
      What is in the file now, runs of earlier calls included.

    Raises:
      BadInput: there are runs already and `resume` is off, or they were made with other settings,
        or the folder cannot be written. Of sessions: there are runs already, no task has ended by
        itself, or see `replay_sessions`.
    """
    began = time.monotonic()
    path = runs_path(config.out, Mode(config.mode))
    progress = on_progress or (lambda done, wanted: None)
    if config.log:
        return _collect_sessions(config, path, progress, began)
    assert config.scenes is not None
    scenes = config.scenes
    done = _open(config, path, scenes)
    todo = [i for i in range(scenes) if i not in done]
    left = len(todo)
    progress(scenes - left, scenes)

    def ended() -> None:
        nonlocal left
        left -= 1
        progress(scenes - left, scenes)

    about = _provenance(config)
    run_scenes(config, todo, about, ended)
    merged = _merge(config, path, {**about, "scenes": scenes})
    return _summary(config, path, merged, scenes, time.monotonic() - began)


def _collect_sessions(
    config: CollectConfig, path: Path, progress: Callable[[int, int], None], began: float
) -> Collected:
    """`collect` of sessions; `began`: when, by the monotonic clock, s."""
    found = _found(path)
    if found:
        raise BadInput(f"{found[0]}: exists; expected a new folder, nothing is added to it")
    sessions = replay_sessions(config.log, on_progress=progress)
    if all(run.is_empty() for run in sessions.runs):
        raise BadInput(
            f"log: of {sessions.tasks} tasks {sessions.cut_off} were cut off and the others ended "
            "before any iteration, expected one or more with a run"
        )
    about = {
        "settings": {"mode": config.mode, "sessions": sessions.about},
        "versions": environment()["versions"],
        "scenes": sessions.tasks,
    }
    write_runs(path, sessions.runs, about)
    frame = read_runs(path)
    done = _summary(config, path, frame, sessions.tasks, time.monotonic() - began)
    return dataclasses.replace(done, cut_off=sessions.cut_off)


def _found(path: Path) -> list[Path]:
    """What earlier calls have left in the folder of these runs."""
    return [p for p in (path, path.parent / SETTINGS, path.parent / PARTS) if p.exists()]


def _open(config: CollectConfig, path: Path, scenes: int) -> set[int]:
    """Write the settings, or check them against those of earlier calls; scenes done so far."""
    settings = path.parent / SETTINGS
    found = _found(path)
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
        if scenes < before["scenes"]:
            raise BadInput(f"scenes: expected {before['scenes']} or more, got {scenes}")
    kept = {name: wanted[name] for name in (*_KEPT, "scenes")}
    write_atomically(settings, json_bytes({**kept, **environment()}))
    files = _files(path)
    _read_all(config, files)  # a broken one is named before anything is computed
    return set().union(*map(_scenes_in, files))


def _provenance(config: CollectConfig) -> dict[str, Any]:
    """What the data depend on, for the files' metadata."""
    settings = {name: getattr(config, name) for name in _KEPT}
    return {"settings": settings, "versions": environment()["versions"]}


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        settings = parse_json(read_file(path, "settings", MIB))
    except ValueError:  # a BadInput is one, too
        settings = None
    if not isinstance(settings, dict) or type(settings.get("scenes")) is not int:
        raise BadInput(f"{path}: not readable; expected the settings of the runs to resume")
    return settings


def _files(path: Path) -> list[Path]:
    return [p for p in [path, *sorted((path.parent / PARTS).glob("part_*.parquet"))] if p.exists()]


def _scenes_in(file: Path) -> set[int]:
    """Numbers of the scenes that a file holds, those that gave no rows included."""
    about = read_provenance(file)
    indices, scenes = about.get("indices"), about.get("scenes")
    if isinstance(indices, list) and all(type(i) is int for i in indices):
        return set(indices)
    if type(scenes) is not int or not 0 <= scenes <= _MOST_SCENES:
        raise BadInput(f"{file}: does not say which scenes it holds")
    return set(range(scenes))


def _read_all(config: CollectConfig, files: list[Path]) -> pl.DataFrame | None:
    """All rows of the files; a part merged before an interruption counts once."""
    read, row = (read_forks, "key") if config.mode == "forks" else (read_runs, "iteration")
    frames = [read(file) for file in files]
    return pl.concat(frames).unique([*RUN, row], keep="first") if frames else None


def _merge(config: CollectConfig, path: Path, about: dict[str, Any]) -> pl.DataFrame:
    files = _files(path)
    frame = _read_all(config, files)
    if frame is None:
        raise BadInput(f"scenes: all {about['scenes']} were solved too soon for a fork")
    if len(files) > 1 or files[0] != path or _scenes_in(path) != set(range(about["scenes"])):
        (write_forks if config.mode == "forks" else write_runs)(path, [frame], about)
    shutil.rmtree(path.parent / PARTS, ignore_errors=True)
    return frame


def _summary(
    config: CollectConfig, path: Path, frame: pl.DataFrame, scenes: int, seconds: float
) -> Collected:
    forks = config.mode == "forks"
    solved = pl.col("alone_solved") if forks else pl.col("feasible") & (pl.col("kind") == "reach")
    inputs = pl.col("input") == "push" if forks else pl.col("asked_before")
    iterations = pl.sum("alone_iterations", "helped_iterations") if forks else pl.len()
    by_run = frame.group_by(RUN).agg(
        pl.col("class").first(), solved.any().alias("solved"), inputs.any().alias("inputs")
    )
    count = frame.select(pl.sum_horizontal(iterations)).item()
    classes = by_run["class"].value_counts().sort("class").rows()
    return Collected(
        path=path,
        scenes=scenes,
        runs=len(by_run),
        by_class={name: int(count) for name, count in classes},
        solved=int(by_run["solved"].sum()),
        iterations=int(count),
        inputs=int(by_run["inputs"].sum()),
        seconds=seconds,
    )
