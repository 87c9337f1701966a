"""The figure of a sweep, after figure 6 of Papallas & Dogar (2022)."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pgf_jax.metrics.summary import CellSummary, Interval
from pgf_jax.sweeping.summary import FleetsSummary, over_fleets

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "osD^vP*X<>"
# Okabe and Ito's: told apart by people with any colour vision.
COLORS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9"),
    *("#E69F00", "#000000", "#999999", "#882255", "#44AA99"),
)
# What a reader of the figure alone should know of a policy.
NAMES = {
    "pgf": "pgf: bids its predicted gain",
    "or-hitl": "or-hitl (OR-HITL): asks when stuck, refused while the operator is busy",
    "or-hitl-window": "or-hitl-window: asks when stuck, served after a window",
    "queue": "queue: asks when stuck, waits in line",
    "always": "always: asks before planning, waits in line",
    "autonomous": "autonomous: never asks",
    "random": "random: a random robot is served",
    "classifier": "classifier: bids when failure is predicted",
    "oracle-gain": "oracle-gain: bids its true gain",
}
_PANELS: tuple[tuple[str, Callable[[FleetsSummary], Interval]], ...] = (
    ("planning time of a task (s), mean", lambda row: row.planning_time_s),
    ("time in the task (s), mean:\nplanning, waiting, service", lambda row: row.task_time_s),
    ("success rate of tasks", lambda row: row.success),
)
_HEIGHT, _LINE = 4.2, 0.24  # inches: of the panels, and of a line below them


def figure6(summaries: Sequence[CellSummary]) -> "Figure":
    """Draw planning time, time in the task and success rate over the fleet size.

    There is a line for each policy. Success has a panel where not every task was solved. Times are
    means over all tasks that ended, failures included. Bars are 95 % intervals over fleets of
    several seeds (Student's t); one fleet has none.

    Args:
      summaries: one a cell, in any order.

    Source: figure 6 of Papallas & Dogar (2022), which has planning time and success.
    """
    # The object interface: no global state, and no display.
    from matplotlib.figure import Figure

    rows = over_fleets(summaries)
    policies = list(dict.fromkeys(row.policy for row in rows))
    sizes = sorted({row.robots for row in rows})
    all_solved = all(row.solved == row.tasks for row in rows)
    panels = _PANELS[:2] if all_solved else _PANELS
    height = _HEIGHT + _LINE * (len(policies) + 1)
    figure = Figure(figsize=(4.6 * len(panels), height), layout="constrained")
    for axes, (label, value) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        for i, policy in enumerate(policies):
            own = sorted((row for row in rows if row.policy == policy), key=lambda r: r.robots)
            # Side by side by a hair, so that equal means and their bars do not hide each other.
            shift = (i - (len(policies) - 1) / 2) * 0.012 * (sizes[-1] - sizes[0])
            _line(axes, [row.robots + shift for row in own], [value(row) for row in own], policy, i)
        axes.set_xlabel("fleet size R (robots)")
        axes.set_ylabel(label)
        axes.set_xticks(sizes)
        axes.set_ylim(0, 1.02 if value is _PANELS[2][1] else 1.05 * axes.get_ylim()[1])
        axes.grid(alpha=0.3)
    handles, _ = axes.get_legend_handles_labels()
    words = [NAMES.get(policy, policy) for policy in policies]
    figure.legend(
        handles, words, loc="outside lower center", title="policy", fontsize="small", frameon=False
    )
    figure.suptitle(_title(rows, all_solved=all_solved), fontsize="medium")
    return figure


def _line(axes: "Axes", x: Sequence[float], y: Sequence[Interval], label: str, i: int) -> None:
    mean = np.array([interval.mean for interval in y])
    below = mean - [interval.low for interval in y]
    above = [interval.high for interval in y] - mean
    # No interval, no bar; and rounding may leave one that is negative by the last bit.
    bars = np.maximum(np.nan_to_num(np.stack([below, above])), 0.0)
    axes.errorbar(
        x,
        mean,
        yerr=bars if bars.any() else None,
        label=label,
        marker=MARKERS[i % len(MARKERS)],
        color=COLORS[i % len(COLORS)],
        markersize=5,
        linewidth=1.5,
        capsize=2,
    )


def _title(rows: Sequence[FleetsSummary], *, all_solved: bool) -> str:
    """How many tasks and fleets there are, and what the bars mean."""
    total = sum(row.tasks for row in rows)
    fleets = sorted({row.fleets for row in rows})
    solved = f"{total} tasks, all of them solved" if all_solved else f"{total} tasks"
    if fleets == [1]:
        return f"{solved}; one fleet for each point, so no intervals"
    count = "-".join(map(str, fleets[:1] + fleets[1:][-1:]))
    return f"{solved}; bars: 95 % intervals over {count} fleets"
