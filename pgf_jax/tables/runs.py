"""Collected runs: the training data of the predictors.

A *run* is one scene planned once. `runs.parquet` holds one row for each iteration of each run: of
runs without help in `DIR/autonomous/runs.parquet`, of runs with help in `DIR/human/runs.parquet`.
`RUN_COLUMNS` has the columns, none of which may be null.

The first row of a segment is its iteration 0, the nominal's rollout. The rows after `asked_before`
show the human input: a push segment that ends feasible, a push segment that does not (the push was
dropped), or the same reach segment (go on reaching). Input that no iteration followed, because the
time was up, is not in the table. Terms that are not finite are allowed, because a rollout may
diverge; training rows that would need them are skipped and counted.
"""

import enum
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.tables.parquet import check_columns, read_table, write_table

# Column -> its type, and what it means.
RUN_COLUMNS: dict[str, tuple[pl.DataType, str]] = {
    "scene": (pl.String(), "the scene's name; the 80/20 split keeps its rows together"),
    "seed": (pl.Int64(), "the planner's seed; (scene, seed) identifies a run"),
    "class": (
        pl.String(),
        "the scene's class, one of `sample_scene`, or as the collector calls it",
    ),
    "n_objects": (pl.Int64(), "N, the same in all of a run"),
    "segment": (pl.Int64(), "0, 1, ... over the run: first reach, a push, the reach after it, ..."),
    "kind": (pl.String(), "`reach` or `push`, the same in all of a segment"),
    "iteration": (pl.Int64(), "0, 1, ... over the run, iteration 0 of every segment included"),
    "c_d": (pl.Float64(), "reach term of the best trajectory so far; in a push, c_h"),
    "c_f": (pl.Float64(), "force term of the best trajectory so far"),
    "c_b": (pl.Float64(), "blocking term of the best trajectory so far"),
    "feasible": (pl.Boolean(), "that trajectory is feasible; in a reach: the run is solved"),
    "asked_before": (pl.Boolean(), "human input was given right before this iteration"),
}
RUN_SCHEMA = {name: dtype for name, (dtype, _) in RUN_COLUMNS.items()}
RUN = ("scene", "seed")  # identifies a run


class Mode(enum.StrEnum):
    """The kind of collected data."""

    AUTONOMOUS = "autonomous"
    HUMAN = "human"
    FORKS = "forks"
    FUTURES = "futures"


def runs_path(data_dir: Path | str, mode: Mode) -> Path:
    """Path of the runs of this mode, or of the forks or futures, in a folder of collected data."""
    name = f"{mode}.parquet" if mode in (Mode.FORKS, Mode.FUTURES) else "runs.parquet"
    return Path(data_dir) / mode / name


def write_runs(
    path: Path | str, frames: Iterable[pl.DataFrame], about: Mapping[str, Any] | None = None
) -> None:
    """Write runs (each a `RunLog.frame()`) as one file, ordered by scene, seed and iteration.

    Args:
      path: the file.
      frames: the runs.
      about: their provenance, for the file's metadata.

    Raises:
      BadInput: the frames are not valid runs, or the file cannot be written.
    """
    frames = list(frames)
    if not frames:
        raise BadInput(f"{path}: there are no runs to write")
    frame = check_runs(pl.concat(frames), str(path))
    write_table(path, frame, about)


def read_runs(path: Path | str, *, mode: Mode | None = None) -> pl.DataFrame:
    """Read and check a `runs.parquet`.

    Args:
      path: the file.
      mode: the expected kind; `autonomous` refuses runs with human input.

    Returns:
      The runs, ordered by scene, seed and iteration; unknown columns are left out.

    Raises:
      BadInput: the file is missing, not a whole Parquet file, empty, lacks a column, or holds
        rows that are not a valid run.
    """
    frame = read_table(path, RUN_SCHEMA, "collected runs")
    frame = check_runs(frame, str(path))
    if mode == Mode.AUTONOMOUS:
        check_unhelped(frame, str(path))
    return frame


def check_runs(frame: pl.DataFrame, name: str) -> pl.DataFrame:
    """The runs in canonical order and columns; BadInput with `name` if they are not valid."""
    frame = check_columns(frame, RUN_SCHEMA, name)
    frame = frame.sort([*RUN, "iteration"], maintain_order=True)

    first = pl.int_range(pl.len()).over(*RUN) == 0
    step = pl.col("segment").diff().over(*RUN)
    continued = ~first & (step == 0)
    before = pl.col("kind").shift(1).over(*RUN)
    rules = {
        "kind must be reach or push": ~pl.col("kind").is_in(["reach", "push"]),
        "n_objects must be at least 1": pl.col("n_objects") < 1,
        "n_objects must be the same in all of a run": pl.col("n_objects").n_unique().over(*RUN) > 1,
        "the iterations of a run must be 0, 1, 2, ...": pl.col("iteration")
        != pl.int_range(pl.len()).over(*RUN),
        "the segments of a run must be 0, 1, 2, ...": pl.when(first)
        .then(pl.col("segment") != 0)
        .otherwise(~step.is_in([0, 1])),
        "a segment must be all reach or all push": continued & (pl.col("kind") != before),
        "a push must begin with human input": (pl.col("kind") == "push")
        & ~continued
        & ~pl.col("asked_before"),
        "cost terms must not be negative": pl.min_horizontal("c_d", "c_f", "c_b") < 0,
        "human input is not given while pushing": pl.col("asked_before") & (before == "push"),
    }
    for rule, broken in rules.items():
        offending = frame.filter(broken)
        if len(offending):
            row = offending.row(0, named=True)
            raise BadInput(
                f"{name}: {rule}; broken by scene {row['scene']}, seed {row['seed']}, "
                f"iteration {row['iteration']} (segment {row['segment']}, {row['kind']})"
            )
    return frame


def check_unhelped(frame: pl.DataFrame, name: str) -> None:
    """Raise BadInput, with `name` in the message, if a run has human input."""
    helped = frame.filter(pl.col("asked_before") | (pl.col("kind") == "push"))
    if len(helped):
        raise BadInput(
            f"{name}: scene {helped['scene'][0]} has human input at iteration "
            f"{helped['iteration'][0]}, expected runs without help"
        )
