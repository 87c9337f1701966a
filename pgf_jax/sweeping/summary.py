"""Summaries of a sweep: `summary.csv` and `paired.csv`."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import polars as pl

from pgf_jax.fleet.metrics import CellSummary, Interval
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.planning.types import Status

# -- tables ------------------------------------------------------------------------------------


def summary_frame(summaries: Iterable[CellSummary]) -> pl.DataFrame:
    """`summary.csv`: one row a cell, `CellSummary.row()`."""
    return pl.DataFrame([summary.row() for summary in summaries], infer_schema_length=None)


PAIRED: Mapping[str, Callable[[TaskRecord], float]] = {
    "planning_time_s": lambda record: record.planning_time_s,
    "solved": lambda record: float(record.status is Status.SOLVED),
    "reach_iterations": lambda record: record.reach_iterations,
    "grants": lambda record: record.grants,
    "waiting_s": lambda record: record.waiting_s,
    "interaction_s": lambda record: record.interaction_s,
}


@dataclasses.dataclass(frozen=True)
class Paired:
    """A row of `paired.csv`: how two policies differ on the same tasks.

    Attributes:
      robots: R.
      policy, baseline: `difference` is the mean of the first's value minus the second's over pairs
        of one (robot, task), which share scene, planning noise and service times.
      value: of `PAIRED`.
      difference: with its 95 % t interval.
    """

    robots: int
    policy: str
    baseline: str
    value: str
    difference: Interval


def paired_frame(rows: Iterable[Paired]) -> pl.DataFrame:
    """`paired.csv`: one row a fleet size, two policies and a value."""
    schema = {"robots": pl.Int64(), "policy": pl.String(), "baseline": pl.String()}
    schema |= {"value": pl.String(), "mean": pl.Float64()}
    schema |= {"low": pl.Float64(), "high": pl.Float64(), "n": pl.Int64()}
    return pl.DataFrame(
        [
            (r.robots, r.policy, r.baseline, r.value, *dataclasses.astuple(r.difference))
            for r in rows
        ],
        schema=schema,
        orient="row",
    )


def csv(frame: pl.DataFrame) -> bytes:
    """A CSV file with numbers to the last digit; nan where there is none."""
    return frame.write_csv().encode()
