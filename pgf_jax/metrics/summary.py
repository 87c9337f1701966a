"""Metrics of a cell: a row of `summary.csv` from one fleet's records and events.

Records and events are all that the metrics need, so that they can be computed again from the files
of a sweep.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from statistics import NormalDist
from typing import Any, Protocol

import numpy as np

from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.planning.types import Status

NS_PER_HOUR = 3600 * 10**9


@dataclasses.dataclass(frozen=True)
class Interval:
    """A mean, or a rate, with its confidence interval; nan where the sample is too small."""

    mean: float
    low: float
    high: float
    n: int  # sample size


@dataclasses.dataclass(frozen=True)
class CellSummary:
    """The metrics of one cell. Intervals are 95 %: t for means, Wilson for rates.

    Tasks that the horizon cut off have no outcome: they count in `censored`, in `requests` to
    `expired` and in what is computed from events, and nowhere else. Intervals treat tasks as
    independent, although a fleet's tasks share its operators; only `paired_difference` removes
    differences between scenes.

    Attributes:
      policy: name of the policy.
      robots: R, number of robots.
      operators: number of operators.
      seed: the fleet's seed.
      tasks: number of tasks that ended by themselves.
      solved: number of these tasks that were solved; in fleets whose reaches may miss: grasped.
      timed_out: number of these tasks that ran out of time and were not stuck.
      stuck: number of these tasks that ran out of time while stuck.
      failed_non_finite: number of these tasks that ran out of time with a cost that is not finite.
      censored: number of tasks that the horizon cut off.
      hours: simulated time, to the horizon or to the last task's end.
      tasks_per_hour: solved tasks per simulated hour, the throughput.
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
      every_grant: reach iteration, over all grants.
      every_successful_grant: reach iteration, over the grants whose push succeeded.
      requests: total of the asks.
      answered: total of the inputs that operators gave.
      grants: total of the services that began.
      refusals: total of the asks refused.
      expired: total of the asks that ended with the task, and of services without an answer.
      pushes_planned: total of the pushes whose planning began.
      pushes_succeeded: total of the pushes found feasible.
      non_finite: total of iterations in which some rollout's cost was not finite.
      saturated: total of rollouts with every contact slot in use at a knot's end.
      utilisation: busy share of the operators' time.
      windows: number of windows that were closed.
      window_size_mean: mean number of bids in a window at its close.
      window_size_max: largest number of bids in a window at its close.
      first_attempt: rate of tasks solved by the first reach that was executed, among those that
        ended; only in fleets whose checks are real or whose reaches may miss.
      grasp_misses: executed reaches that missed, of all tasks that ended; as `first_attempt`.
      checks: final checks of all tasks that ended; only in fleets whose checks are real.
      check_misses: those of them that missed; as `checks`.
    """

    policy: str
    robots: int
    operators: int
    seed: int
    tasks: int
    solved: int
    timed_out: int
    stuck: int
    failed_non_finite: int
    censored: int
    hours: float
    tasks_per_hour: float
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
    every_grant: Interval
    every_successful_grant: Interval
    requests: int
    answered: int
    grants: int
    refusals: int
    expired: int
    pushes_planned: int
    pushes_succeeded: int
    non_finite: int
    saturated: int
    utilisation: float
    windows: int
    window_size_mean: float
    window_size_max: int
    first_attempt: Interval | None = None
    grasp_misses: Interval | None = None
    checks: Interval | None = None
    check_misses: Interval | None = None

    def row(self) -> dict[str, str | int | float]:
        """The summary as a flat row; see `flat_row`."""
        return flat_row(self)


def flat_row(summary: Any) -> dict[str, str | int | float]:
    """Make a dataclass a flat row; an interval becomes NAME, NAME_low, NAME_high and NAME_n.

    A field that is None is left out.
    """
    row: dict[str, str | int | float] = {}
    for field in dataclasses.fields(summary):
        value = getattr(summary, field.name)
        if isinstance(value, Interval):
            row[field.name] = value.mean
            row |= {f"{field.name}_{k}": getattr(value, k) for k in ("low", "high", "n")}
        elif value is not None:
            row[field.name] = value
    return row


class FleetSettings(Protocol):
    """The settings of a fleet that its summary needs; `FleetConfig` has them."""

    @property
    def policy(self) -> str:
        """Name of the policy."""
        ...

    @property
    def robots(self) -> int:
        """R."""
        ...

    @property
    def operators(self) -> int:
        """Number of operators."""
        ...

    @property
    def seed(self) -> int:
        """The fleet's seed."""
        ...


def summarise(
    config: FleetSettings, records: Sequence[TaskRecord], events: Sequence[Event]
) -> CellSummary:
    """Summarise one fleet that is done.

    Args:
      config: the fleet's settings.
      records: its task records, in any order.
      events: its event log, in order.
    """
    ended = [record for record in records if record.status is not Status.CENSORED]
    solved = [record for record in ended if record.status is Status.SOLVED]
    elapsed_ns = max((record.end_ns for record in records), default=0)
    sizes = window_sizes(events)

    def count(status: Status) -> int:
        return sum(record.status is status for record in records)

    def total(name: str) -> int:
        return sum(getattr(record, name) for record in records)

    def mean(name: str, among: list[TaskRecord] = ended) -> Interval:
        values = [getattr(record, name) for record in among]
        return mean_interval([value for value in values if value is not None])

    def pooled(name: str) -> Interval:
        return mean_interval([value for record in ended for value in getattr(record, name)])

    checks = any(record.checks is not None for record in records)
    attempts = any(record.attempts is not None for record in records)
    first = rate_interval(sum(record.first_attempt for record in ended), len(ended))
    return CellSummary(
        policy=config.policy,
        robots=config.robots,
        operators=config.operators,
        seed=config.seed,
        tasks=len(ended),
        solved=len(solved),
        timed_out=count(Status.TIMED_OUT),
        stuck=count(Status.STUCK),
        failed_non_finite=count(Status.NON_FINITE),
        censored=count(Status.CENSORED),
        hours=elapsed_ns / NS_PER_HOUR,
        tasks_per_hour=ratio(len(solved) * NS_PER_HOUR, elapsed_ns),
        success=rate_interval(len(solved), len(ended)),
        helped=rate_interval(sum(record.grants > 0 for record in ended), len(ended)),
        planning_time_s=mean("planning_time_s"),
        planning_time_solved_s=mean("planning_time_s", solved),
        task_time_s=mean("task_time_s"),
        waiting_s=mean("waiting_s"),
        interaction_s=mean("interaction_s"),
        reach_iterations=mean("reach_iterations"),
        first_bid=mean("first_bid"),
        first_grant=mean("first_grant"),
        every_grant=pooled("grants_at"),
        every_successful_grant=pooled("successful_grants_at"),
        requests=total("requests"),
        answered=total("answered"),
        grants=total("grants"),
        refusals=total("refusals"),
        expired=total("expired"),
        pushes_planned=total("pushes_planned"),
        pushes_succeeded=total("pushes_succeeded"),
        non_finite=total("non_finite"),
        saturated=total("saturated"),
        utilisation=ratio(busy_ns(events), config.operators * elapsed_ns),
        windows=len(sizes),
        window_size_mean=float(np.mean(sizes)) if sizes else math.nan,
        window_size_max=max(sizes, default=0),
        **({"first_attempt": first, "grasp_misses": mean("grasp_misses")} if attempts else {}),
        **({name: mean(name) for name in ("checks", "check_misses")} if checks else {}),
    )


def busy_ns(events: Iterable[Event]) -> int:
    """Time that all operators together spend serving, ns."""
    total, since = 0, {}
    for event in events:
        if event.kind is EventKind.GRANT:
            since[event.operator] = event.time_ns
        elif event.kind is EventKind.SERVICE_END:
            total += event.time_ns - since.pop(event.operator)
    return total


def window_sizes(events: Iterable[Event]) -> list[int]:
    """Number of bids in each window at its close, in order; expired bids are not in it."""
    sizes, size = [], 0
    for event in events:
        if event.kind is EventKind.WINDOW_OPEN:
            size = 0
        elif event.kind is EventKind.WINDOW_CLOSE:
            sizes.append(size)
        elif event.kind is EventKind.BID:
            size += 1
        elif event.kind is EventKind.EXPIRED:
            size -= 1
    return sizes


def paired_difference(
    records: Iterable[TaskRecord],
    baseline: Iterable[TaskRecord],
    value: Callable[[TaskRecord], float],
    *,
    confidence: float = 0.95,
) -> Interval:
    """Mean of value(record) - value(baseline record) over pairs of one (robot, task).

    Under one seed such a pair has the same scene, the same planner noise and the same service times
    (common random numbers), so most of the spread between scenes cancels. A pair is left out where
    the horizon cut off one of its tasks.
    """

    def by_task(side: Iterable[TaskRecord]) -> dict[tuple[int, int], TaskRecord]:
        return {(r.robot, r.task): r for r in side if r.status is not Status.CENSORED}

    ours, theirs = by_task(records), by_task(baseline)
    shared = sorted(ours.keys() & theirs.keys())
    differences = [value(ours[key]) - value(theirs[key]) for key in shared]
    return mean_interval(differences, confidence=confidence)


def ratio(numerator: float, denominator: float) -> float:
    """The quotient; nan where the denominator is 0."""
    return numerator / denominator if denominator else math.nan


def mean_interval(values: Sequence[float], *, confidence: float = 0.95) -> Interval:
    """The mean with Student's t interval."""
    n = len(values)
    if n == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    mean = float(np.mean(values))
    if n == 1:
        return Interval(mean, math.nan, math.nan, 1)
    half = t_quantile((1 + confidence) / 2, n - 1) * float(np.std(values, ddof=1)) / math.sqrt(n)
    return Interval(mean, mean - half, mean + half, n)


def rate_interval(successes: int, n: int, *, confidence: float = 0.95) -> Interval:
    """The rate with Wilson's score interval, which stays within 0..1, also for rates 0 and 1."""
    if n == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    rate = successes / n
    centre = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    # With 0 or n successes the interval ends exactly at 0 or 1; rounding must not change that.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == n else centre + half
    return Interval(rate, low, high, n)


@functools.cache
def t_quantile(probability: float, dof: int) -> float:
    """Quantile of Student's t for a probability in [0.5, 1) and a whole number of dof >= 1.

    Bisection on the closed form of P(|T| < t) for whole dof (Abramowitz and Stegun 26.7.3 and
    26.7.4), so that no statistics library is needed.
    """
    target = 2 * probability - 1
    low, high = 0.0, math.pi / 2  # of theta = atan(t / sqrt(dof))
    for _ in range(60):
        theta = (low + high) / 2
        if _t_central(theta, dof) < target:
            low = theta
        else:
            high = theta
    return math.sqrt(dof) * math.tan((low + high) / 2)


def _t_central(theta: float, dof: int) -> float:
    """P(|T| < sqrt(dof) tan(theta))."""
    odd = dof % 2
    k = np.arange(1, (dof - odd) // 2)  # terms after the first
    ratios = 2 * k / (2 * k + 1) if odd else (2 * k - 1) / (2 * k)
    series = 1 + float(np.sum(np.cumprod(ratios * math.cos(theta) ** 2)))
    if not odd:
        return math.sin(theta) * series
    tail = math.sin(theta) * math.cos(theta) * series if dof > 1 else 0.0
    return (theta + tail) * 2 / math.pi
