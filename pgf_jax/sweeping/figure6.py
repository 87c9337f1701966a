"""The figure of a sweep, like figure 6 of Papallas & Dogar (2022)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pgf_jax.fleet.metrics import CellSummary, Interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "osD^vP*X"


def figure6(summaries: Sequence[CellSummary]) -> "Figure":
    """Draw planning time and success rate over the fleet size, a line for each policy.

    Planning time is the mean over all tasks that ended, failures included; bars are 95 % intervals
    (t for times, Wilson for rates).

    Args:
      summaries: one a cell, in any order.

    Source: figure 6 of Papallas & Dogar (2022).
    """
    # The object interface: no global state, and no display.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    times, rates = figure.subplots(1, 2)
    policies = list(dict.fromkeys(summary.policy for summary in summaries))
    sizes = sorted({summary.robots for summary in summaries})
    for i, policy in enumerate(policies):
        cells = sorted((s for s in summaries if s.policy == policy), key=lambda s: s.robots)
        # Side by side by a hair, so that equal means and their bars do not hide each other.
        shift = (i - (len(policies) - 1) / 2) * 0.012 * (sizes[-1] - sizes[0])
        x = [cell.robots + shift for cell in cells]
        marker = MARKERS[i % len(MARKERS)]
        _line(times, x, [cell.planning_time_s for cell in cells], policy, marker)
        _line(rates, x, [cell.success for cell in cells], policy, marker)
    times.set_ylabel("planning time (s), mean and 95 % CI")
    times.set_ylim(bottom=0)
    rates.set_ylabel("success rate, 95 % CI")
    rates.set_ylim(-0.02, 1.02)
    for axes in (times, rates):
        axes.set_xlabel("robots")
        axes.set_xticks(sizes)
        axes.grid(alpha=0.3)
    times.legend(title="policy")
    figure.suptitle(_title(summaries, policies, sizes), fontsize="medium")
    return figure


def _line(axes: "Axes", x: Sequence[float], y: Sequence[Interval], label: str, marker: str) -> None:
    mean = np.array([interval.mean for interval in y])
    below = mean - [interval.low for interval in y]
    above = [interval.high for interval in y] - mean
    # No interval, no bar; and rounding may leave one that is negative by the last bit.
    bars = np.maximum(np.nan_to_num(np.stack([below, above])), 0.0)
    axes.errorbar(x, mean, yerr=bars, label=label, marker=marker, markersize=5, linewidth=1.5)


def _title(summaries: Sequence[CellSummary], policies: list[str], sizes: list[int]) -> str:
    total = sum(summary.tasks for summary in summaries)
    counts = []
    for size in sizes:
        tasks = sorted({summary.tasks for summary in summaries if summary.robots == size})
        # The horizon may let policies end different numbers of tasks.
        counts.append("-".join(map(str, tasks[:1] + tasks[1:][-1:])))
    each = ", ".join(f"{count} (R = {size})" for count, size in zip(counts, sizes, strict=True))
    return f"{total} tasks; for each policy: {each}"
