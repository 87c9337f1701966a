"""The figures of the study, from its stored rows alone; they can be read in black and white."""

from collections.abc import Callable, Mapping
from typing import Any

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from study_claims import panels_of
from study_points import EACH, MAIN, NUMBERS, SERVICE_TIMES
from study_rows import over_seeds
from study_tables import TIME, fleets, sizes

from pgf_jax.metrics.summary import Interval
from pgf_jax.sweeping.figure6 import COLORS, MARKERS

LABELS = {
    "or-hitl": "OR-HITL: asks when stuck",
    "pgf": "PGF: bids the predicted gain",
    "gain-rate": "gain-rate: ranks by time saved",
    "autonomous": "never helped",
    "pgf+plan": "PGF that plans on",
    "or-hitl+plan": "OR-HITL that plans on",
    "or-hitl-window": "OR-HITL with a window",
}
STYLES: dict[str, dict[str, Any]] = {
    policy: {"color": COLORS[i % len(COLORS)], "marker": MARKERS[i % len(MARKERS)]}
    for i, policy in enumerate(LABELS)
}


def _line(
    axes: Axes,
    column: str,
    of: Mapping[Any, pl.DataFrame],
    policy: str,
    scale: float = 1.0,
    apart: float = 0.0,
) -> None:
    """Draw a value of a policy over what distinguishes the fleets, with 95 % intervals.

    Policies are drawn `apart` along the axis, so that their intervals do not hide each other.
    """
    points = {x: over_seeds(its, column) for x, its in of.items() if len(its)}
    if not points:
        return
    found = [one if one.n > 1 else Interval(one.mean, one.mean, one.mean, 1)
             for one in points.values()]  # fmt: skip
    below = [scale * (one.mean - one.low) for one in found]
    above = [scale * (one.high - one.mean) for one in found]
    means = [scale * one.mean for one in found]
    style, shift = STYLES[policy], apart * (list(LABELS).index(policy) - 1)
    places = [x + shift for x in points]
    axes.errorbar(
        places, means, [below, above], capsize=2, markersize=5, label=LABELS[policy], **style
    )


def _legend(axes: Axes) -> None:
    if axes.has_data():
        axes.legend(frameon=False, fontsize="small")


def _by_size(rows: pl.DataFrame, name: str, policy: str, setting: str = "") -> dict:
    return {
        robots: fleets(rows, name, robots, policy, setting)
        for robots in sizes(rows, name, setting, policy)
    }


def headline(rows: pl.DataFrame) -> Figure:
    """How long a task takes, and how many are solved, over how many robots one person serves."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.subplots(1, 2)
    columns = ((TIME, "time in the task (s)", 1.0), ("success", "tasks solved (%)", 100.0))
    for ax, (column, label, scale) in zip(axes, columns, strict=True):
        for policy in MAIN:
            _line(ax, column, _by_size(rows, "packed", policy), policy, scale, apart=0.5)
        ends = (("gain-rate", EACH, "always helped at once", "--"), ("autonomous", "", None, ":"))
        for policy, setting, words, style in ends:
            its = _by_size(rows, "packed", policy, setting)
            if its:
                mean = scale * over_seeds(its[max(its)], column).mean
                ax.axhline(mean, color="0.4", linestyle=style, label=words or LABELS[policy])
        ax.set(xlabel="robots that one person helps", ylabel=label, ylim=(0, None))
    _legend(axes[0])
    return figure


def ordering(rows: pl.DataFrame) -> Figure:
    """Figure 6 of the paper on five sets of scenes: planning time and success over fleet size."""
    panels = panels_of(rows)
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    axes = figure.subplots(2, max(1, len(panels)), sharex=True, sharey="row", squeeze=False)
    columns = (("planning_time_s", "planning time (s)", 1.0), ("success", "solved (%)", 100.0))
    for i, name in enumerate(panels):
        for ax, (column, label, scale) in zip(axes[:, i], columns, strict=True):
            for policy in (*MAIN, "autonomous"):
                _line(ax, column, _by_size(rows, name, policy), policy, scale, apart=0.7)
            if not i:
                ax.set_ylabel(label)
        axes[0, i].set_title(name, fontsize="medium")
        axes[1, i].set_xlabel("robots")
    entries = {}
    for ax in axes.flat:
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=5, frameon=False)
    return figure


def difficulty(rows: pl.DataFrame) -> Figure:
    """What help is worth on shelves of which only the number of objects varies."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.subplots(1, 2)
    columns = ((TIME, "time in the task (s)", 1.0), ("success", "tasks solved (%)", 100.0))
    for ax, (column, label, scale) in zip(axes, columns, strict=True):
        for policy in ("autonomous", "or-hitl", "pgf", "pgf+plan", "gain-rate"):
            of = {n: fleets(rows, f"{n} objects", 10, policy) for n in NUMBERS}
            _line(ax, column, of, policy, scale)
        ax.set(xlabel="objects on the shelf", ylabel=label, ylim=(0, None))
    _legend(axes[0])
    return figure


def service_times(rows: pl.DataFrame) -> Figure:
    """Time in the task over the service time, for fleets of 2, 5 and 10 robots."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    means = {8.0: "", **{mean: f"services of {mean:g} s" for mean in SERVICE_TIMES}}
    for ax, robots in zip(axes, (2, 5, 10), strict=True):
        for policy in MAIN:
            of = {m: fleets(rows, "packed", robots, policy, means[m]) for m in sorted(means)}
            _line(ax, TIME, of, policy)
        ax.set_title(f"{robots} robots", fontsize="medium")
        ax.set(xlabel="service time (s)", xscale="log", ylim=(0, None))
        ax.set_xticks(sorted(means), [f"{mean:g}" for mean in sorted(means)])
        ax.minorticks_off()
    axes[0].set_ylabel("time in the task (s)")
    _legend(axes[0])
    return figure


FIGURES: dict[str, Callable[[pl.DataFrame], Figure]] = {
    "headline": headline,
    "ordering": ordering,
    "difficulty": difficulty,
    "service_times": service_times,
}
