"""Columns of merged tables that say which fleet a row is of: every setting that decides on it.

So the tables of several sweeps, and of sessions at the console, can be stacked.
"""

import dataclasses
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import polars as pl

from pgf_jax.fleet.config import Cell
from pgf_jax.guidance.predictors.registry import NETWORKS
from pgf_jax.settings import stored_settings
from pgf_jax.sweeping.cell_file import Content
from pgf_jax.sweeping.config import HOW, INPUTS, SweepConfig
from pgf_jax.tables import results

# Settings with the name of a column of tasks or events have another one here.
_OTHER_NAMES = {"cost": "cost_variant", "operator": "operator_name"}
_TYPES: dict[Any, pl.DataType] = {int: pl.Int64(), float: pl.Float64(), str: pl.String()}


def _dtype(hint: Any) -> pl.DataType:
    """The type of a setting's column."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return _dtype(inner[0])
    if origin in (typing.Union, types.UnionType):
        return _dtype(next(one for one in inner if one is not types.NoneType))
    return _TYPES.get(hint, pl.String())


def _settings() -> dict[str, str]:
    """Setting -> column, of the settings that a cell has beside policy and fleet size."""
    left_out = {*HOW, *INPUTS, "robots", "policies", "seeds"}
    names = [f.name for f in dataclasses.fields(SweepConfig) if f.name not in left_out]
    first = ["seed", "scene_class"]
    return {n: _OTHER_NAMES.get(n, n) for n in [*first, *(n for n in names if n not in first)]}


_COLUMNS = _settings()
_OF_INPUTS = ("scenes_sha256", "log_sha256", "predictor", "predictor_sha256", "plugins_sha256")
_HINTS = typing.get_type_hints(SweepConfig, include_extras=True)
SETTING_SCHEMA: dict[str, pl.DataType] = {
    **{column: _dtype(_HINTS[name]) for name, column in _COLUMNS.items()},
    **dict.fromkeys(_OF_INPUTS, pl.String()),
}
TASK_SCHEMA = results.MERGED_TASK_SCHEMA | {"task_time_s": pl.Float64()} | SETTING_SCHEMA
EVENT_SCHEMA = results.MERGED_EVENT_SCHEMA | SETTING_SCHEMA


def setting_texts(texts: Mapping[str, str]) -> dict[str, str]:
    """Meanings of the columns, from those of the settings."""
    inputs = {
        "scenes_sha256": "digest of the scenes that were given; null where they were sampled",
        "log_sha256": "digest of the events of the session that was replayed",
        "predictor": "networks that predicted what robots may bid: paper, best or classifier",
        "predictor_sha256": "digests of their checkpoints",
        "plugins_sha256": "digests of what policy, operator and engine of plugins are made of",
    }
    return {column: f"setting: {texts[name]}" for name, column in _COLUMNS.items()} | inputs


def labelled(frame: pl.DataFrame, about: Mapping[str, Any]) -> pl.DataFrame:
    """A fleet's table with the columns that say which fleet it is, and with the time in the task.

    Args:
      frame: its tasks or events.
      about: where they come from, see `CellSpec.about`.
    """
    identity, config = about["identity"], stored_settings(about["config"])
    fleet = identity["fleet"]
    cell = Cell(fleet["policy"], fleet["robots"], fleet["tasks"], fleet["seed"])
    # A setting that a stored cell lacks has the value that was built in then.
    defaults = {field.name: field.default for field in dataclasses.fields(SweepConfig)}
    settings = {
        column: config.get(name, defaults[name]) for name, column in _COLUMNS.items()
    } | _of_inputs(identity)
    if "execution_s" in frame.columns:
        whole_ns = pl.col("end_ns") - pl.col("start_ns")
        frame = frame.with_columns(task_time_s=whole_ns / 1e9 - pl.col("execution_s"))
    rest = [_constant(settings[name], dtype, name) for name, dtype in SETTING_SCHEMA.items()]
    return results.merge([(cell, frame)]).with_columns(rest)


def _constant(value: Any, dtype: pl.DataType, name: str) -> pl.Expr:
    if isinstance(value, list | tuple):  # as text, so that rows can be grouped by it
        value = " ".join(map(str, value))
    try:
        return pl.lit(pl.Series([value], dtype=dtype)).first().alias(name)
    except OverflowError:  # a whole number of hundreds of digits
        raise TypeError(f"{name}: too large for {dtype}") from None


def _of_inputs(identity: Mapping[str, Any]) -> dict[str, str | None]:
    """Columns of scenes, log, predictor and plugins."""
    networks = identity.get("predictors") or {}
    kinds = [name for name, needs in NETWORKS.items() if set(needs) == set(networks)]
    return {
        "scenes_sha256": identity.get("scenes"),
        "log_sha256": identity.get("log"),
        "predictor": kinds[0] if kinds else None,
        "predictor_sha256": _digests(networks, sorted(networks)),
        "plugins_sha256": _digests(identity.get("plugins") or {}, ("policy", "operator", "engine")),
    }


def _digests(found: Mapping[str, str], names: Iterable[str]) -> str | None:
    return " ".join(f"{name}:{found[name]}" for name in names if name in found) or None


def merged(tables: Iterable[Content], name: str) -> pl.DataFrame:
    """The tables of all cells as one; a count that only other cells have is null.

    Args:
      tables: of the cells.
      name: tasks or events.
    """
    contents = list(tables)
    frames = [getattr(content, name) for content in contents]
    if name == "tasks":
        # Null where a cell lacks them; all cells' columns are in the same order.
        present = [column for frame in frames for column in frame.columns]
        schema = results.with_extra(results.TASK_SCHEMA, present)
        frames = [
            frame.select(
                pl.col(n) if n in frame.columns else pl.lit(None, dtype).alias(n)
                for n, dtype in schema.items()
            )
            for frame in frames
        ]
    return pl.concat(labelled(f, c.about) for f, c in zip(frames, contents, strict=True))
