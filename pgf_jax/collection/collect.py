"""`pgf_jax.collect`: runs and forks to train the predictors on (Papallas & Dogar 2022, Alg. 3).

A run is one sampled scene planned by one robot to its end, solved or out of time. Autonomous runs
have no help. In a human run the operator gives one input, after a reach iteration that is drawn by
(seed, scene), and none after it, so that the cost ten iterations later is the result of that input.
The input takes no simulated time, which would only cut runs short at random. A run that is solved
before its input comes holds no input, and gives no rows.

Forks (`fork.py`) are collected in the same way. Human runs can be taken from recorded sessions
instead (`sessions.py`), in which people give as many inputs as they are asked for.
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import polars as pl

from pgf_jax.collection.config import CollectConfig
from pgf_jax.collection.dataset import Dataset, data_path, existing
from pgf_jax.collection.scenes import run_scenes
from pgf_jax.collection.sessions import replay_sessions
from pgf_jax.errors import BadInput
from pgf_jax.jax_setup import configure_early
from pgf_jax.provenance import environment
from pgf_jax.settings import check_type
from pgf_jax.tables.runs import RUN, read_runs, write_runs


@dataclasses.dataclass(frozen=True)
class Collected:
    """The result of a collection: a file of runs or forks, and counts of what it holds.

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
      WorkersLost: a worker process died; the runs that had been written are kept.
    """
    check_type("config", config, CollectConfig)
    configure_early(config.engine)
    began = time.monotonic()
    progress = on_progress or (lambda done, wanted: None)
    if config.log:
        return _collect_sessions(config, progress, began)
    dataset = Dataset.open(config)
    assert config.scenes is not None
    scenes, left = config.scenes, len(dataset.missing)
    progress(scenes - left, scenes)

    def ended() -> None:
        nonlocal left
        left -= 1
        progress(scenes - left, scenes)

    run_scenes(dataset, ended)
    frame = dataset.merge()
    return _summary(config, frame, scenes, time.monotonic() - began)


def _collect_sessions(
    config: CollectConfig, progress: Callable[[int, int], None], began: float
) -> Collected:
    """`collect` of sessions; `began`: when, by the monotonic clock, s."""
    found = existing(config)
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
    path = data_path(config)
    write_runs(path, sessions.runs, about)
    done = _summary(config, read_runs(path), sessions.tasks, time.monotonic() - began)
    return dataclasses.replace(done, cut_off=sessions.cut_off)


def _summary(config: CollectConfig, frame: pl.DataFrame, scenes: int, seconds: float) -> Collected:
    forks = config.forks
    solved = pl.col("alone_solved") if forks else pl.col("feasible") & (pl.col("kind") == "reach")
    inputs = pl.col("input") == "push" if forks else pl.col("asked_before")
    iterations = pl.sum("alone_iterations", "helped_iterations") if forks else pl.len()
    by_run = frame.group_by(RUN).agg(
        pl.col("class").first(), solved.any().alias("solved"), inputs.any().alias("inputs")
    )
    count = frame.select(pl.sum_horizontal(iterations)).item()
    classes = by_run["class"].value_counts().sort("class").rows()
    return Collected(
        path=data_path(config),
        scenes=scenes,
        runs=len(by_run),
        by_class={name: int(count) for name, count in classes},
        solved=int(by_run["solved"].sum()),
        iterations=int(count),
        inputs=int(by_run["inputs"].sum()),
        seconds=seconds,
    )
