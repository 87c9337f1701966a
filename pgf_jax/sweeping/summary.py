"""Tables that summarise a sweep: `summary.csv` and `paired.csv`."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence

import polars as pl

from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.metrics import CellSummary, Interval, paired_difference
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.planning.types import Status


def summary_frame(summaries: Iterable[CellSummary]) -> pl.DataFrame:
    """The table of `summary.csv`: one row for each cell."""
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
    """The difference of two policies on the same tasks: a row of `paired.csv`.

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


def paired_differences(records: Mapping[Cell, Sequence[TaskRecord]]) -> list[Paired]:
    """Paired differences of every two policies at every fleet size, the earlier minus the later."""
    return [
        Paired(
            ours.robots,
            ours.policy,
            theirs.policy,
            name,
            paired_difference(records[ours], records[theirs], value),
        )
        for ours, theirs in itertools.combinations(records, 2)
        if ours.robots == theirs.robots
        for name, value in PAIRED.items()
    ]


def paired_frame(rows: Iterable[Paired]) -> pl.DataFrame:
    """The table of `paired.csv`: one row for each fleet size, pair of policies and value."""
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
