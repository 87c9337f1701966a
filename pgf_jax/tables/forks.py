"""Forks: the same robot state carried on with help and without, under several keys.

What a robot would gain from help is never seen in a run, which has one future. `forks.parquet`
holds, for each state and each key, the future without help and the one with the operator's input,
both `rows.LOOK_AHEAD` reach iterations on, under the same keys (common random numbers):

| column | type | meaning |
|---|---|---|
| scene, seed, class | String, Int64, String | as in `runs.parquet` |
| iteration | Int64 | reach iterations before the fork |
| input | String | what the operator said: `push` or `go_on` |
| key | Int64 | 0, 1, ...: number of the noise |
| alone, helped | Float64 | c_d + c_f + c_b of the best trajectory at the end of each future |
| alone_solved, helped_solved | Boolean | whether it is feasible |
| alone_iterations, helped_iterations | Int64 | taken, those of the push and iteration 0s included |
| pushed | Boolean | the push was found (not dropped) |
| one for each of `state.STATE` | Float64 | the state that was forked; the same under all its keys |

The true gain of a state is the mean of `alone` - `helped` over its keys.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.tables.parquet import check_columns, read_table, write_table

FORK_SCHEMA: dict[str, pl.DataType] = {
    "scene": pl.String(),
    "seed": pl.Int64(),
    "class": pl.String(),
    "iteration": pl.Int64(),
    "input": pl.String(),
    "key": pl.Int64(),
    "alone": pl.Float64(),
    "helped": pl.Float64(),
    "alone_solved": pl.Boolean(),
    "helped_solved": pl.Boolean(),
    "alone_iterations": pl.Int64(),
    "helped_iterations": pl.Int64(),
    "pushed": pl.Boolean(),
    **{f"state:{name}": pl.Float64() for name in STATE},
}


FORK = ("scene", "seed")  # names a state: there is one of each scene


@dataclasses.dataclass(frozen=True, eq=False)
class Forks:
    """States with their futures; F states under K keys.

    Attributes:
      scene: [F] str.
      scene_class: [F] str.
      iteration: [F] int64.
      push: [F] bool, the operator gave a push.
      state: [F, S] float64, in the order of `state.STATE`.
      alone: [F, K] cost without help.
      helped: [F, K] cost with it.
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
        """[F] true gains: means over the keys."""
        with np.errstate(over="ignore", invalid="ignore"):  # costs near the largest float
            return (self.alone - self.helped).mean(axis=1)

    def take(self, index: np.ndarray) -> "Forks":
        """Some of the states."""
        fields = {f.name: getattr(self, f.name)[index] for f in dataclasses.fields(self)}
        return Forks(**fields)


def write_forks(
    path: Path | str, frames: Iterable[pl.DataFrame], about: Mapping[str, Any] | None = None
) -> None:
    """Write forks as one file, ordered by scene, seed and key; BadInput where they are not ones."""
    write_table(path, check_forks(pl.concat(frames), str(path)), about)


def read_forks(path: Path | str) -> pl.DataFrame:
    """Read and check a `forks.parquet`.

    Raises:
      BadInput: the file is missing, not a whole Parquet file, lacks a column, or holds something
        that is not a fork.
    """
    return check_forks(read_table(path, FORK_SCHEMA, "forks"), str(path))


def check_forks(frame: pl.DataFrame, name: str) -> pl.DataFrame:
    """The forks in canonical order and columns, or BadInput with `name` in the message."""
    frame = check_columns(frame, FORK_SCHEMA, name).sort([*FORK, "key"], maintain_order=True)
    same = [
        pl.col(c).n_unique().over(*FORK) > 1
        for c in FORK_SCHEMA
        if c.startswith("state:") or c in ("class", "iteration", "input")
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
    """Arrays of a table as `read_forks` returns it.

    A state is left out where a future of it blew up, or its description is not finite.

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
