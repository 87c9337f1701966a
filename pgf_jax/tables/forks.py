"""Forks: robot states continued with help and without help, under several noise keys.

A run has only one future, so it does not show what a robot would gain from help. `forks.parquet`
holds, for each state and each key, the future without help and the future with the operator's
input, both `LOOK_AHEAD` reach iterations long, under the same keys (common random numbers).
`FORK_COLUMNS` has the columns.

The true gain of a state is the mean of `alone` - `helped` over its keys.

`futures.parquet` holds forks whose futures go on until the reach is solved or the task's time is
up, with the simulated time that they take (`FUTURE_COLUMNS`).
"""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.features import STATE, STATE_MEANINGS
from pgf_jax.tables.parquet import check_columns, read_table, write_table
from pgf_jax.tables.runs import RUN_COLUMNS

# Column -> its type, and what it means.
FORK_COLUMNS: dict[str, tuple[pl.DataType, str]] = {
    **{name: RUN_COLUMNS[name] for name in ("scene", "seed", "class")},
    "iteration": (pl.Int64(), "reach iterations before the fork"),
    "input": (pl.String(), "what the operator said: `push` or `go_on`"),
    "key": (pl.Int64(), "0, 1, ...: number of the noise"),
    "alone": (pl.Float64(), "c_d + c_f + c_b of the best trajectory at the end, without help"),
    "helped": (pl.Float64(), "c_d + c_f + c_b of the best trajectory at the end, with help"),
    "alone_solved": (pl.Boolean(), "the future without help ends feasible"),
    "helped_solved": (pl.Boolean(), "the future with help ends feasible"),
    "alone_iterations": (
        pl.Int64(),
        "iterations of the future without help, iteration 0s included",
    ),
    "helped_iterations": (
        pl.Int64(),
        "iterations of the future with help, those of the push and iteration 0s included",
    ),
    "pushed": (pl.Boolean(), "the push was found, not dropped"),
    **{f"state:{name}": (pl.Float64(), text) for name, text in STATE_MEANINGS.items()},
}
FORK_SCHEMA = {name: dtype for name, (dtype, _) in FORK_COLUMNS.items()}
FUTURE_COLUMNS: dict[str, tuple[pl.DataType, str]] = {
    **FORK_COLUMNS,
    "alone_s": (
        pl.Float64(),
        "planning time of the future without help, s: until it is solved, or else time is up",
    ),
    "helped_s": (
        pl.Float64(),
        "planning time of the future with help, from the answer on, that of the push included, s",
    ),
}
FUTURE_SCHEMA = {name: dtype for name, (dtype, _) in FUTURE_COLUMNS.items()}
FORK = ("scene", "seed", "iteration")  # identifies a state


@dataclasses.dataclass(frozen=True, eq=False)
class Forks:
    """The futures of F states under K keys, as arrays.

    Attributes:
      scene: [F] str, name of the scene.
      scene_class: [F] str, class of the scene.
      iteration: [F] int64, reach iterations before the fork.
      push: [F] bool, the operator gave a push.
      state: [F, S] float64, in the order of `features.STATE`.
      alone: [F, K] cost without help.
      helped: [F, K] cost with help.
    """

    scene: np.ndarray
    scene_class: np.ndarray
    iteration: np.ndarray
    push: np.ndarray
    state: np.ndarray
    alone: np.ndarray
    helped: np.ndarray

    @property
    def gain(self) -> np.ndarray:
        """[F] true gains: the means over the keys."""
        with np.errstate(over="ignore", invalid="ignore"):  # costs near the largest float
            return (self.alone - self.helped).mean(axis=1)

    def take(self, index: np.ndarray) -> "Forks":
        """The states at the given indices."""
        fields = {f.name: getattr(self, f.name)[index] for f in dataclasses.fields(self)}
        return Forks(**fields)


def write_forks(
    path: Path | str, frames: Iterable[pl.DataFrame], about: Mapping[str, Any] | None = None
) -> None:
    """Write forks as one file, ordered by scene, seed and key; BadInput if they are not valid."""
    write_table(path, check_forks(pl.concat(frames), str(path)), about)


def read_forks(path: Path | str) -> pl.DataFrame:
    """Read and check a `forks.parquet`.

    Raises:
      BadInput: the file is missing, not a whole Parquet file, lacks a column, or holds something
        that is not a valid fork.
    """
    return check_forks(read_table(path, FORK_SCHEMA, "forks"), str(path))


def write_futures(
    path: Path | str, frames: Iterable[pl.DataFrame], about: Mapping[str, Any] | None = None
) -> None:
    """Write futures as one file, as `write_forks`."""
    write_table(path, check_futures(pl.concat(frames), str(path)), about)


def read_futures(path: Path | str) -> pl.DataFrame:
    """Read and check a `futures.parquet`; BadInput as `read_forks`."""
    return check_futures(read_table(path, FUTURE_SCHEMA, "futures"), str(path))


def check_futures(frame: pl.DataFrame, name: str) -> pl.DataFrame:
    """The futures, as `check_forks`."""
    frame = _check(frame, FUTURE_SCHEMA, name)
    if not (frame.select((pl.col("alone_s", "helped_s") >= 0).all()).row(0) == (True, True)):
        raise BadInput(f"{name}: times must not be negative")
    return frame


def check_forks(frame: pl.DataFrame, name: str) -> pl.DataFrame:
    """The forks in canonical order and columns; BadInput with `name` if they are not valid."""
    return _check(frame, FORK_SCHEMA, name)


def _check(frame: pl.DataFrame, schema: Mapping[str, Any], name: str) -> pl.DataFrame:
    frame = check_columns(frame, schema, name).sort([*FORK, "key"], maintain_order=True)
    same = [
        pl.col(c).n_unique().over(*FORK) > 1
        for c in FORK_SCHEMA
        if c.startswith("state:") or c in ("class", "input")
    ]
    rules = {
        "input must be push or go_on": ~pl.col("input").is_in(["push", "go_on"]),
        "the keys of a state must be 0, 1, 2, ...": pl.col("key")
        != pl.int_range(pl.len()).over(*FORK),
        "a state must be the same under all its keys": pl.any_horizontal(same),
    }
    for rule, broken in rules.items():
        offending = frame.filter(broken)
        if len(offending):
            row = offending.row(0, named=True)
            raise BadInput(f"{name}: {rule}; broken by scene {row['scene']}, seed {row['seed']}")
    return frame


def forks_of(frame: pl.DataFrame, name: str = "forks") -> Forks:
    """The arrays of a table that `read_forks` returned.

    A state is left out where a cost of its futures or a feature of the state is not finite.

    Raises:
      BadInput: states have different numbers of keys, or none is finite.
    """
    keys = frame.group_by(FORK).len()["len"].unique().to_list()
    if len(keys) != 1:
        raise BadInput(f"{name}: states have {sorted(keys)} keys, expected the same number each")
    first = frame.filter(pl.col("key") == 0)
    state = first.select(f"state:{s}" for s in STATE).to_numpy()
    alone, helped = (frame[c].to_numpy().reshape(len(first), -1) for c in ("alone", "helped"))
    forks = Forks(
        scene=first["scene"].to_numpy(),
        scene_class=first["class"].to_numpy(),
        iteration=first["iteration"].to_numpy(),
        push=(first["input"] == "push").to_numpy(),
        state=state,
        alone=alone,
        helped=helped,
    )
    finite = np.isfinite(np.concatenate([state, alone, helped], axis=1)).all(axis=1)
    finite &= np.isfinite(forks.gain)  # costs may be finite, and their difference not
    if not finite.any():
        raise BadInput(f"{name}: no state whose futures are all finite")
    return forks.take(np.flatnonzero(finite))
