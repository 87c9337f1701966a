"""Tables that summarise a sweep: `summary.csv`, `fleets.csv` and `paired.csv`.

The tasks of one fleet share its operators, so they are not independent. Intervals that hold for
other fleets are over fleets of several seeds: those of `fleets.csv`.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import polars as pl

from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.metrics.summary import (
    CellSummary,
    Interval,
    flat_row,
    mean_interval,
    paired_difference,
    summarise,
)
from pgf_jax.planning.types import Status
from pgf_jax.sweeping.cell_file import Content
from pgf_jax.tables import results


class _Fleet(NamedTuple):
    """Settings of a stored fleet; its policy need not be registered here."""

    policy: str
    robots: int
    operators: int
    seed: int


def summary_of(content: Content) -> CellSummary:
    """The summary of a stored cell."""
    fleet = content.about["identity"]["fleet"]
    return summarise(
        _Fleet(*(fleet[name] for name in _Fleet._fields)),
        content.records,
        results.event_log(content.events),
    )


def summary_frame(summaries: Iterable[CellSummary]) -> pl.DataFrame:
    """The table of `summary.csv`: one row for each cell."""
    return _frame([summary.row() for summary in summaries])


def _frame(rows: Sequence[dict[str, str | int | float]]) -> pl.DataFrame:
    """A table of rows; a column that only some rows have is null in the others."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    whole = [{name: row.get(name) for name in columns} for row in rows]
    return pl.DataFrame(whole, infer_schema_length=None)


# -- over fleets ---------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class FleetsSummary:
    """The metrics of one policy at one fleet size, over fleets of several seeds.

    A mean is that of the fleets' means, and its interval Student's t at 95 % over fleets, cut to
    what is possible (no time below 0, no rate beyond 0..1). One fleet has no interval. A fleet
    without a value (in which nobody was helped, say) does not count in it.

    Attributes:
      policy: name of the policy.
      robots: R, number of robots.
      operators: number of operators.
      fleets: number of fleets, one for each seed.
      tasks: number of tasks that ended by themselves, of all fleets.
      solved: number of these tasks that were solved.
      success: rate of solved tasks among those that ended.
      helped: rate of tasks with at least one grant among those that ended.
      planning_time_s: planning time of all tasks that ended, failures included, s.
      planning_time_solved_s: planning time of solved tasks, s.
      task_time_s: time in the task of all tasks that ended, execution apart: planning, waiting and
        being served, s.
      waiting_s: waiting time of all tasks that ended, s.
      interaction_s: time being served of all tasks that ended, s.
      reach_iterations: reach iterations of all tasks that ended.
      first_bid: reach iteration of the first ask, over the tasks that have one.
      first_grant: reach iteration of the first grant, over the tasks that have one.
      tasks_per_hour: solved tasks per simulated hour, the throughput.
      utilisation: busy share of the operators' time.
      window_size_mean: mean number of bids in a window at its close.
      first_attempt: rate of tasks solved by the first reach that was executed, among those that
        ended; only in fleets whose checks are real or whose reaches may miss.
      grasp_misses: executed reaches that missed, of all tasks that ended; as `first_attempt`.
      checks: final checks of all tasks that ended; only in fleets whose checks are real.
      check_misses: those of them that missed; as `checks`.
    """

    policy: str
    robots: int
    operators: int
    fleets: int
    tasks: int
    solved: int
    success: Interval
    helped: Interval
    planning_time_s: Interval
    planning_time_solved_s: Interval
    task_time_s: Interval
    waiting_s: Interval
    interaction_s: Interval
    reach_iterations: Interval
    first_bid: Interval
    first_grant: Interval
    tasks_per_hour: Interval
    utilisation: Interval
    window_size_mean: Interval
    first_attempt: Interval | None = None
    grasp_misses: Interval | None = None
    checks: Interval | None = None
    check_misses: Interval | None = None


_RATES = ("success", "helped", "utilisation", "first_attempt")
_OVER_FLEETS = [f.name for f in dataclasses.fields(FleetsSummary)][6:]


def over_fleets(summaries: Iterable[CellSummary]) -> list[FleetsSummary]:
    """Summarise the fleets of each policy and fleet size, in the order of their first ones."""
    groups: dict[tuple[str, int], list[CellSummary]] = {}
    for summary in summaries:
        groups.setdefault((summary.policy, summary.robots), []).append(summary)

    def interval(fleets: list[CellSummary], name: str) -> Interval:
        values = [value for fleet in fleets if (value := getattr(fleet, name)) is not None]
        means = [value.mean if isinstance(value, Interval) else value for value in values]
        found = mean_interval([mean for mean in means if not math.isnan(mean)])
        if math.isnan(found.low):
            return found
        high = min(found.high, 1.0) if name in _RATES else found.high
        return dataclasses.replace(found, low=max(found.low, 0.0), high=high)

    return [
        FleetsSummary(
            policy=policy,
            robots=robots,
            operators=fleets[0].operators,
            fleets=len(fleets),
            tasks=sum(fleet.tasks for fleet in fleets),
            solved=sum(fleet.solved for fleet in fleets),
            **{
                name: interval(fleets, name)
                for name in _OVER_FLEETS
                if any(getattr(fleet, name) is not None for fleet in fleets)
            },
        )
        for (policy, robots), fleets in groups.items()
    ]


def fleets_frame(rows: Iterable[FleetsSummary]) -> pl.DataFrame:
    """The table of `fleets.csv`: one row for each policy and fleet size."""
    return _frame([flat_row(row) for row in rows])


# -- differences ---------------------------------------------------------------------------------


PAIRED: Mapping[str, Callable[[TaskRecord], float]] = {
    "planning_time_s": lambda record: record.planning_time_s,
    "solved": lambda record: float(record.status is Status.SOLVED),
    "reach_iterations": lambda record: record.reach_iterations,
    "grants": lambda record: record.grants,
    "waiting_s": lambda record: record.waiting_s,
    "interaction_s": lambda record: record.interaction_s,
    "task_time_s": lambda record: record.task_time_s,
}


@dataclasses.dataclass(frozen=True)
class Paired:
    """The difference of two policies on the same tasks: a row of `paired.csv`.

    Attributes:
      robots: R.
      policy, baseline: `difference` is the mean of the first's value minus the second's over pairs
        of one (robot, task), which share scene, planning noise and service times.
      value: of `PAIRED`.
      difference: with its 95 % t interval: over pairs where there is one seed; over the mean
        differences of the fleets where there are several.
    """

    robots: int
    policy: str
    baseline: str
    value: str
    difference: Interval


def paired_differences(records: Mapping[Cell, Sequence[TaskRecord]]) -> list[Paired]:
    """Paired differences of every two policies at every fleet size, the earlier minus the later."""
    groups: dict[tuple[str, int], dict[int, Sequence[TaskRecord]]] = {}
    for cell, of_cell in records.items():
        groups.setdefault((cell.policy, cell.robots), {})[cell.seed] = of_cell

    def difference(ours, theirs, value: Callable[[TaskRecord], float]) -> Interval:
        fleets = [paired_difference(ours[s], theirs[s], value) for s in ours if s in theirs]
        if len(fleets) == 1:
            return fleets[0]
        return mean_interval([fleet.mean for fleet in fleets if fleet.n])

    return [
        Paired(robots, policy, baseline, name, difference(ours, theirs, value))
        for ((policy, robots), ours), ((baseline, size), theirs) in itertools.combinations(
            groups.items(), 2
        )
        if robots == size
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
