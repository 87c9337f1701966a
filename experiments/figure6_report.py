"""Makes the figures and tables of `figure6.py`, from its stored rows alone."""

import math
from collections.abc import Callable
from pathlib import Path

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from study_claims import Measured
from study_rows import difference, fleets, over_seeds, read, table_row, text

from pgf_jax.files import png, write_atomically
from pgf_jax.metrics.summary import Interval
from pgf_jax.sweeping.figure6 import COLORS as PALETTE
from pgf_jax.sweeping.figure6 import MARKERS

# What a reader of the figures alone should know of each policy.
NAMES = {
    "PGF": "PGF: bids its predicted gain",
    "PGF, best": "PGF, best: the same, with our best predictor",
    "OR-HITL": "OR-HITL: asks when stuck, refused while the operator is busy",
    "OR-HITL, window": "OR-HITL, window: asks when stuck, served after a window",
    "always": "always: asks before planning, waits in line",
    "autonomous": "autonomous: never asks",
}
POLICIES = tuple(NAMES)
COLORS: dict[str, str] = dict(zip(POLICIES, PALETTE, strict=False))
# Bounds of the claims "like" (5 % of OR-HITL's planning time), "similar" and "at least as high".
LIKE_S, SIMILAR, AS_HIGH = 0.75, 0.10, 0.01
MEASURES = {
    "first bid": "first_bid",
    "first grant": "first_grant",
    "every grant": "every_grant",
    "every grant whose push succeeded": "every_successful_grant",
}


class Rows:
    """The stored rows of the study."""

    def __init__(self, name: str, out: Path) -> None:
        # Planning time includes the waits in windows, which only policies with windows have; it
        # does not include those in line, which only `always` has.
        iterating = (pl.col("planning_time_s") - pl.col("waiting_s")).alias("iterating_s")
        in_line = pl.when(pl.col("policy") == "always").then(pl.col("waiting_s")).otherwise(0.0)
        in_task = pl.col("planning_time_s") + in_line + pl.col("interaction_s")
        self.frame = read(name, out).with_columns(iterating)
        if "task_time_s" not in self.frame.columns:  # rows of earlier versions lack it
            self.frame = self.frame.with_columns(in_task.alias("task_time_s"))
        self.sizes = sorted(self.frame["robots"].unique().to_list())

    def cell(self, scenes: str, scenario: str, policy: str, robots: int) -> pl.DataFrame:
        """The fleets of one cell: one per seed."""
        return fleets(self.frame, policy, robots, scenes=scenes, scenario=scenario)

    def scenarios(self, scenes: str) -> list[str]:
        """Scenarios with these scenes, in the order in which they were run."""
        return self.frame.filter(scenes=scenes)["scenario"].unique(maintain_order=True).to_list()


def write(name: str, out: Path) -> None:
    """Write `NAME.png`, `NAME_differences.png` and `NAME.md`."""
    rows = Rows(name, out)
    write_atomically(out / f"{name}.png", png(_main_figure(rows)))
    write_atomically(out / f"{name}_differences.png", png(_differences_figure(rows)))
    parts = [_claims(rows), _shares(rows), _differences(rows), _cells(rows)]
    write_atomically(out / f"{name}.md", ("\n\n".join(parts) + "\n").encode())


# -- figures -----------------------------------------------------------------------------------


def _main_figure(rows: Rows) -> Figure:
    figure = Figure(figsize=(14, 8.4), layout="constrained")
    axes = figure.subplots(2, 3)
    for row, scenes in enumerate(("tight", "all")):
        for column, (value, label, scale) in enumerate(
            (
                ("planning_time_s", "planning time of a task (s)", 1.0),
                ("task_time_s", "time in the task (s):\nplanning, waiting, service", 1.0),
                ("success", "tasks solved (%)", 100.0),
            )
        ):
            ax = axes[row, column]
            for policy in POLICIES:
                _band(ax, rows, scenes, policy, value, scale)
            where = "tight scenes" if scenes == "tight" else "all three classes"
            ax.set(title=where, xlabel="fleet size R (robots)", ylabel=label, xticks=rows.sizes)
            ax.grid(alpha=0.3)
            if column == 0:  # cut off the band of `always`, which has few tasks at R = 1
                usual = [rows.cell(scenes, "main", "autonomous", r) for r in rows.sizes]
                highest = max(over_seeds(cell, value).high for cell in usual)
                ax.set_ylim(0, 1.25 * highest)
            else:
                ax.set_ylim(0, 103.0 if value == "success" else None)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    words = [NAMES[label] for label in labels]
    figure.legend(handles, words, loc="outside lower center", ncols=2)
    figure.suptitle("Mean of a fleet's tasks, failures included; bands: 95 % over seeds")
    return figure


def _band(ax, rows: Rows, scenes: str, policy: str, value: str, scale: float) -> None:
    cells = [(r, rows.cell(scenes, "main", policy, r)) for r in rows.sizes]
    points = [(r, over_seeds(cell, value)) for r, cell in cells if len(cell)]
    if not points:
        return
    x = [r for r, _ in points]
    marker = MARKERS[POLICIES.index(policy)]
    color = COLORS[policy]
    mean = [scale * p.mean for _, p in points]
    ax.plot(x, mean, color=color, marker=marker, markersize=5, label=policy)
    low, high = ([scale * getattr(p, end) for _, p in points] for end in ("low", "high"))
    ax.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)


def _differences_figure(rows: Rows) -> Figure:
    figure = Figure(figsize=(13, 4.4), layout="constrained")
    axes = figure.subplots(1, 3)
    tight = rows.scenarios("tight")
    random = [scenario for scenario in tight if "random" in scenario]
    panels = (
        ("tight scenes", "tight", [scenario for scenario in tight if scenario not in random]),
        ("all three classes", "all", rows.scenarios("all")),
        ("tight scenes, random winner", "tight", random),
    )
    for ax, (title, scenes, scenarios) in zip(axes, panels, strict=True):
        for i, scenario in enumerate(scenarios):
            found = [(r, _paired(rows, scenes, scenario, r, "planning_time_s")) for r in rows.sizes]
            points = [(r, p) for r, p in found if p.n]
            shift = (i - len(scenarios) / 2) * 0.35
            ax.errorbar(
                [r + shift for r, _ in points],
                [p.mean for _, p in points],
                yerr=[
                    [p.mean - p.low for _, p in points],
                    [p.high - p.mean for _, p in points],
                ],
                marker=MARKERS[i % len(MARKERS)],
                markersize=5,
                linewidth=1,
                label=scenario,
            )
        ax.axhline(0, color="black", linewidth=0.8)
        ax.set(title=title, xlabel="fleet size R (robots)", xticks=rows.sizes)
        ax.grid(alpha=0.3)
        legend_below(ax)
    axes[0].set_ylabel("planning time, PGF less OR-HITL (s)")
    axes[2].set_ylim(-45, 10)  # an interval of two seeds may be larger
    figure.suptitle("Same scenes, noise and service times; below 0: PGF is faster. Bars: 95 %")
    return figure


def legend_below(ax: Axes) -> None:
    """A legend under the axes' label, where no data are."""
    ax.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.19), ncols=2, frameon=False)


# -- tables ------------------------------------------------------------------------------------


def _paired(
    rows: Rows, scenes: str, scenario: str, robots: int, value: str, ours: str = "PGF"
) -> Interval:
    """Policy `ours` less OR-HITL, which is the main scenario's if only a predictor changed."""
    mine = rows.cell(scenes, scenario, ours, robots)
    theirs = rows.cell(scenes, scenario, "OR-HITL", robots)
    if theirs.is_empty():
        theirs = rows.cell(scenes, "main", "OR-HITL", robots)
    return difference(mine, theirs, value)


Verdict = Callable[[Interval], str]
FASTER = (-math.inf, 0.0)  # bounds of a difference, as claimed
MORE = (0.0, math.inf)


def _within(low: float, high: float) -> Verdict:
    """Judge intervals: yes if the whole interval is within the bounds, no if none of it is."""

    def verdict(found: Interval) -> str:
        return "-" if found.n < 2 else Measured(found, (low, high)).holds

    return verdict


def _claims(rows: Rows) -> str:
    """Table of the claims of section VI, beside what was measured on both sets of scenes."""
    lines = [
        "## The paper's claims",
        "",
        "Main scenario: computers of their own, rollouts of 1.5 s. Differences are PGF less",
        "OR-HITL on the same scenes, noise and service times. A claim holds (yes) where the whole",
        "interval is where the claim puts it, and does not (no) where none of it is. `like`: by",
        f"less than {LIKE_S} s; `similar`: by less than {100 * SIMILAR:.0f} points; `at least as",
        f"high`: not lower by more than {100 * AS_HIGH:.0f} point.",
        "",
        "| claim | paper | tight scenes | holds | all classes | holds |",
        "|---|---|---|---|---|---|",
    ]

    def line(claim: str, paper: str, value: str, bounds: tuple, unit: str, robots: int) -> None:
        measure_line(claim, paper, lambda s: _paired(rows, s, "main", robots, value), bounds, unit)

    def measure_line(
        claim: str, paper: str, measure: Callable[[str], Interval], bounds: tuple, unit: str
    ) -> None:
        cells = []
        scale, digits = (100.0, 2) if unit == "points" else (1.0, 1)
        for scenes in ("tight", "all"):
            found = measure(scenes)
            cells += [f"{text(found, digits, scale)} {unit}", _within(*bounds)(found)]
        lines.append(table_row([claim, paper, *cells]))

    few, many = rows.sizes[0], rows.sizes[-1]
    for robots in rows.sizes:
        paper, bounds = ("like", (-LIKE_S, LIKE_S)) if robots == 30 else ("PGF faster", FASTER)
        claim = f"planning time at R = {robots}"
        line(claim, paper, "planning_time_s", bounds, "s", robots)
    measure_line(
        f"PGF's planning time rises from R = {few} to {many}",
        "rises",
        lambda scenes: difference(
            rows.cell(scenes, "main", "PGF", many),
            rows.cell(scenes, "main", "PGF", few),
            "planning_time_s",
        ),
        MORE,
        "s",
    )
    measure_line(
        f"the lead over OR-HITL shrinks from R = {few} to {many}",
        "shrinks",
        lambda scenes: _change_of_lead(rows, scenes, few, many),
        MORE,
        "s",
    )
    at = 20 if 20 in rows.sizes else many
    for name, value in MEASURES.items():
        claim = f"iteration of asking at R = {at}: {name}"
        line(claim, "6 against 25", value, FASTER, "iterations", at)
    claim = f"tasks with a grant at R = {at}"
    line(claim, "31 % against 18 %", "helped", MORE, "points", at)
    claim = f"use of the human at R = {at} (utilisation)"
    line(claim, "similar", "utilisation", (-SIMILAR, SIMILAR), "points", at)
    for robots in rows.sizes:
        claim = f"success at R = {robots}"
        line(claim, "at least as high", "success", (-AS_HIGH, math.inf), "points", robots)
    return "\n".join(lines)


def _change_of_lead(rows: Rows, scenes: str, few: int, many: int) -> Interval:
    """Change of the difference PGF less OR-HITL from few to many robots, paired by seed."""

    def lead(robots: int) -> pl.DataFrame:
        ours, theirs = (rows.cell(scenes, "main", p, robots) for p in ("PGF", "OR-HITL"))
        both = ours.join(theirs, on="seed", suffix="_theirs")
        gap = pl.col("planning_time_s") - pl.col("planning_time_s_theirs")
        return both.select("seed", gap.alias("lead"))

    return difference(lead(many), lead(few), "lead")


def _shares(rows: Rows) -> str:
    """Table of the parts of the difference in planning time."""
    lines = [
        "## What asking costs",
        "",
        "PGF less OR-HITL in the main scenario, s a task. Planning time is iterations and waits in",
        "windows; interaction is not in it, but counts for the task's limit of 180 s.",
        "",
        "| scenes | R | planning time | of it iterations | waits in windows | interaction | "
        "success (points) |",
        "|---|---:|---|---|---|---|---|",
    ]
    for scenes in ("tight", "all"):
        for robots in rows.sizes:
            values = ("planning_time_s", "iterating_s", "waiting_s", "interaction_s")
            found = [text(_paired(rows, scenes, "main", robots, v), 2) for v in values]
            success = text(_paired(rows, scenes, "main", robots, "success"), 2, 100)
            lines.append(table_row([scenes, str(robots), *found, success]))
    return "\n".join(lines)


def _cells(rows: Rows) -> str:
    """Table of the means of every policy in every scenario."""
    lines = [
        "## Levels",
        "",
        "| scenes | scenario | policy | R | planning time (s) | success (%) | with a grant (%) | "
        "first bid at | first grant at | every grant | whose push succeeded | utilisation |",
        "|---|---|---|---:|---|---|---|---|---|---|---|---|",
    ]
    for scenes in ("tight", "all"):
        for scenario in rows.scenarios(scenes):
            for policy in POLICIES:
                for robots in rows.sizes:
                    cell = rows.cell(scenes, scenario, policy, robots)
                    if cell.is_empty():
                        continue
                    values = [
                        text(over_seeds(cell, "planning_time_s")),
                        text(over_seeds(cell, "success"), 2, 100),
                        text(over_seeds(cell, "helped"), 1, 100),
                        *(text(over_seeds(cell, v)) for v in MEASURES.values()),
                        text(over_seeds(cell, "utilisation"), 2),
                    ]
                    lines.append(table_row([scenes, scenario, policy, str(robots), *values]))
    return "\n".join(lines)


def _differences(rows: Rows) -> str:
    """Table of the differences PGF less OR-HITL in every scenario."""
    lines = [
        "## PGF less OR-HITL",
        "",
        "| scenes | scenario | PGF's predictor | "
        + " | ".join(f"R = {r}: planning time (s)" for r in rows.sizes)
        + " | success at the largest (points) |",
        "|---|---|---|" + "---|" * (len(rows.sizes) + 1),
    ]
    for scenes in ("tight", "all"):
        for scenario in rows.scenarios(scenes):
            for ours, predictor in (("PGF", "paper"), ("PGF, best", "best")):
                found = [
                    _paired(rows, scenes, scenario, r, "planning_time_s", ours) for r in rows.sizes
                ]
                if not any(f.n for f in found):
                    continue
                success = _paired(rows, scenes, scenario, rows.sizes[-1], "success", ours)
                cells = [*map(text, found), text(success, 2, 100)]
                lines.append(table_row([scenes, scenario, predictor, *cells]))
    return "\n".join(lines)
