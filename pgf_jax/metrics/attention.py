"""Metrics of the operators' attention: asks, waiting, the effect of help, and fairness.

They are computed from one fleet's records and events, as in `metrics.py`.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence

from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.events import ENDS_OF_WAITING, Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.metrics.summary import (
    NS_PER_HOUR,
    Interval,
    flat_row,
    mean_interval,
    rate_interval,
    ratio,
    summarise,
)
from pgf_jax.planning.types import Status

# An answer that lowers the cost by no more than this is wasted, in units of cost. It is the default
# of `bid_threshold`, the gain that a robot must expect before it asks.
MIN_COST_DROP = 1.0


@dataclasses.dataclass(frozen=True)
class Attention:
    """How one cell used its operators. Intervals are 95 %: t for means, Wilson for rates.

    Tasks that the horizon cut off count as in `CellSummary`: in totals of asks, answers, grants and
    times and in what is computed from events, but not in metrics of the outcome of a task or of an
    answer (`waiting_per_task_s`, `wasted`, `cost_drop`, `fairness_throughput`). The wait of an ask
    that the horizon cut off ends at the horizon, so that `waiting_per_ask_s` times the number of
    asks is all waiting.

    Attributes:
      policy, robots, operators, seed: the cell.
      utilisation: busy share of the operators' time.
      waiting_per_ask_s: over all asks; an ask refused at once waits 0 s. Under a policy with
        windows, a robot that finds all operators busy does not ask.
      waiting_per_task_s: over all tasks that ended.
      refused, expired: shares of the asks.
      go_on: share of the answers that were "go on reaching".
      dropped: share of the answers that were a push that was dropped.
      wasted: share of the answers after which the cost (`TaskRecord.helped_cost`) was not lower by
        more than `MIN_COST_DROP`, among those with both costs known. The cost might have become
        lower without help, too.
      cost_drop: cost at the answer minus cost after it, over the same answers without those that
        have a cost that is not finite.
      services_per_robot_hour: grants per hour that robots spent on tasks.
      fairness_grants, fairness_throughput, fairness_waiting: Jain's index over robots, of grants,
        of solved tasks per simulated hour until the robot's last task ended, and of waiting time;
        nan where all are 0.
      largest_share: share of the grants that went to the robot with the most; nan without grants.
    """

    policy: str
    robots: int
    operators: int
    seed: int
    utilisation: float
    waiting_per_ask_s: Interval
    waiting_per_task_s: Interval
    refused: Interval
    expired: Interval
    go_on: Interval
    dropped: Interval
    wasted: Interval
    cost_drop: Interval
    services_per_robot_hour: float
    fairness_grants: float
    fairness_throughput: float
    fairness_waiting: float
    largest_share: float

    def row(self) -> dict[str, str | int | float]:
        """The metrics as a flat row; see `metrics.flat_row`."""
        return flat_row(self)


def attention(
    config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]
) -> Attention:
    """Compute how the operators' attention was spent in one fleet that is done.

    Args:
      config: the fleet's settings.
      records: its task records, in any order.
      events: its event log, in order.
    """
    summary = summarise(config, records, events)
    costs = [
        (before, after)
        for record in records
        if record.status is not Status.CENSORED
        for before, after in zip(record.asked_cost, record.helped_cost, strict=True)
        if not (math.isnan(before) or math.isnan(after))
    ]
    # If both costs are infinite, their difference is nan, and the answer counts as wasted.
    wasted = sum(not before - after > MIN_COST_DROP for before, after in costs)
    drops = [before - after for before, after in costs if math.isfinite(before - after)]
    go_on = sum(e.kind is EventKind.SERVICE_END and e.outcome == "go_on" for e in events)
    dropped = sum(event.kind is EventKind.PUSH_DROPPED for event in events)

    def by_robot(value: Callable[[TaskRecord], int]) -> list[int]:
        totals = [0] * config.robots
        for record in records:
            totals[record.robot] += value(record)
        return totals

    grants = by_robot(lambda record: record.grants)
    solved = by_robot(lambda record: record.status is Status.SOLVED)
    at_tasks_ns = by_robot(lambda record: record.end_ns - record.start_ns)
    return Attention(
        policy=config.policy,
        robots=config.robots,
        operators=config.operators,
        seed=config.seed,
        utilisation=summary.utilisation,
        waiting_per_ask_s=mean_interval(waits_s(events)),
        waiting_per_task_s=summary.waiting_s,
        refused=rate_interval(summary.refusals, summary.requests),
        expired=rate_interval(summary.expired, summary.requests),
        go_on=rate_interval(go_on, summary.answered),
        dropped=rate_interval(dropped, summary.answered),
        wasted=rate_interval(wasted, len(costs)),
        cost_drop=mean_interval(drops),
        services_per_robot_hour=ratio(summary.grants * NS_PER_HOUR, sum(at_tasks_ns)),
        fairness_grants=jain_index(grants),
        # A robot begins a task when the one before ends, so its tasks take all its time until the
        # last one ends. A robot whose tasks took no time solved none, so its rate is 0.
        fairness_throughput=jain_index(
            [n / max(ns, 1) for n, ns in zip(solved, at_tasks_ns, strict=True)]
        ),
        fairness_waiting=jain_index(by_robot(lambda record: nanoseconds(record.waiting_s))),
        largest_share=ratio(max(grants), sum(grants)),
    )


def waits_s(events: Iterable[Event]) -> list[float]:
    """Time that each ask waited until it was granted, refused, expired or cut off, s."""
    since, waits = {}, []
    for event in events:
        if event.kind is EventKind.BID:
            since[event.robot] = event.time_ns
        elif event.kind in ENDS_OF_WAITING:
            waits.append((event.time_ns - since.pop(event.robot)) / 1e9)
    return waits


def jain_index(values: Sequence[float]) -> float:
    """Jain's index of fairness, (sum x)^2 / (n sum x^2); nan where all are 0.

    It is 1 where all values are equal, 1/n where one value is the whole sum (Jain, Chiu & Hawe,
    1984).
    """
    return ratio(sum(values) ** 2, len(values) * sum(value * value for value in values))
