"""Makes the figures and tables of `open_questions.py`, from its stored rows alone."""

import math
from pathlib import Path

import polars as pl
from figure6_report import legend_below
from matplotlib.figure import Figure
from study_rows import POLICIES, difference, fleets, over_seeds, read, table_row, text
from study_served import cycle

from pgf_jax.files import png, write_atomically
from pgf_jax.metrics.summary import Interval
from pgf_jax.sweeping.figure6 import COLORS as PALETTE
from pgf_jax.sweeping.figure6 import MARKERS

COLORS = dict(zip(POLICIES, PALETTE, strict=False))
LOSS = 0.05  # accepted loss of success or throughput, against a robot that is always served
DEFAULT = {"service time": "8 s", "window": "2 s", "operators": "1", "computers": "of their own",
           "scenes": "all three"}  # fmt: skip


class Rows:
    """The stored rows of the study."""

    def __init__(self, name: str, out: Path) -> None:
        # Solved tasks per time that robots spend on tasks. The time until the last task is done
        # would include the time in which most robots are idle.
        rate = (pl.col("solved") / pl.col("robot_hours")).alias("rate")
        self.frame = read(name, out).with_columns(pl.col("value").fill_null(""), rate)
        self.sizes = sorted(self.frame.filter(question="default")["robots"].unique().to_list())

    def cell(self, question: str, value: str, policy: str, robots: int) -> pl.DataFrame:
        """The fleets of one cell, one per seed; a default value means the default point."""
        if DEFAULT.get(question) == value:
            question, value = "default", ""
        return fleets(self.frame, policy, robots, question=question, value=value)

    def values(self, question: str) -> list[str]:
        """The values of a question in order, including the default."""
        found = self.frame.filter(question=question)["value"].unique(maintain_order=True).to_list()
        found = [value for value in found if "an operator each" not in value]  # references
        if question not in DEFAULT:
            return found
        return sorted([*found, DEFAULT[question]], key=_number)


def write(name: str, out: Path) -> None:
    """Write `NAME.png`, `NAME_fleets.png` and `NAME.md`."""
    rows = Rows(name, out)
    write_atomically(out / f"{name}.png", png(_leads(rows)))
    write_atomically(out / f"{name}_fleets.png", png(_fleets(rows)))
    parts = [_surface(rows), _fan_out(rows), _policies(rows), _operators(rows), _attention(rows)]
    write_atomically(out / f"{name}.md", ("\n\n".join(parts) + "\n").encode())


def _number(value: str) -> float:
    head = value.split()[0]
    try:
        return float(head)
    except ValueError:
        return math.inf


# -- figures -----------------------------------------------------------------------------------

SURFACE = ("service time", "window", "operators", "computers")


def _leads(rows: Rows) -> Figure:
    """Planning time saved by prediction over the fleet size, for each value of four questions."""
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    axes = figure.subplots(2, len(SURFACE), sharex=True, sharey="row")
    for column, question in enumerate(SURFACE):
        for row, policy in enumerate(("PGF", "PGF, best")):
            ax = axes[row, column]
            for i, value in enumerate(rows.values(question)):
                points = [(r, _lead(rows, question, value, policy, r)) for r in rows.sizes]
                points = [(r, p) for r, p in points if p.n > 1]
                if not points:
                    continue
                color = PALETTE[i % len(PALETTE)]
                x = [r for r, _ in points]
                ax.plot(x, [p.mean for _, p in points], marker=MARKERS[i % len(MARKERS)],
                        markersize=4, color=color, label=value)  # fmt: skip
                low, high = [p.low for _, p in points], [p.high for _, p in points]
                ax.fill_between(x, low, high, color=color, alpha=0.12, linewidth=0)
            ax.axhline(0, color="black", linewidth=0.8)
            ax.grid(alpha=0.3)
            ax.set_xticks(rows.sizes)
            if row == 0:
                ax.set_title(question)
            else:
                ax.set_xlabel("fleet size R (robots)")
                legend_below(ax)
        axes[0, 0].set_ylabel("PGF less its rival (s)")
        axes[1, 0].set_ylabel("PGF with best, less its rival (s)")
    figure.suptitle(
        "Planning time saved by prediction (below 0); rival: OR-HITL, for the window "
        "OR-HITL with the same window. Bands: 95 % over seeds"
    )
    return figure


def _rival(question: str) -> str:
    return "OR-HITL, window" if question == "window" else "OR-HITL"


def _lead(
    rows: Rows, question: str, value: str, policy: str, robots: int, of: str = "planning_time_s"
) -> Interval:
    ours = rows.cell(question, value, policy, robots)
    return difference(ours, rows.cell(question, value, _rival(question), robots), of)


def _fleets(rows: Rows) -> Figure:
    """Throughput, success and planning time of every policy over the fleet size."""
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    values = (
        ("rate", "solved tasks per robot and hour", 1.0),
        ("success", "success rate (%)", 100.0),
        ("planning_time_s", "planning time (s)", 1.0),
    )
    for ax, (value, label, scale) in zip(axes, values, strict=True):
        for i, policy in enumerate(POLICIES):
            points = []
            for robots in rows.sizes:
                cell = rows.cell("default", "", policy, robots)
                if cell.is_empty():
                    cell = rows.cell("policy", "", policy, robots)
                if len(cell):
                    points.append((robots, over_seeds(cell, value), scale))
            if not points:
                continue
            x = [r for r, *_ in points]
            ax.plot(x, [s * p.mean for _, p, s in points], label=policy, color=COLORS[policy],
                    marker=MARKERS[i % len(MARKERS)], markersize=4)  # fmt: skip
        ax.set(xlabel="fleet size R (robots)", ylabel=label, xticks=rows.sizes)
        ax.grid(alpha=0.3)
    axes[2].set_ylim(bottom=0)
    handles, labels = axes[2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize="small")
    figure.suptitle(
        "One operator, all three scene classes: means. Intervals of differences: see the tables"
    )
    return figure


# -- tables ------------------------------------------------------------------------------------


def _table(headings: list[str], lines: list[list[str]]) -> str:
    rule = "|" + "---|" * len(headings)
    return "\n".join([table_row(headings), rule, *map(table_row, lines)])


def _surface(rows: Rows) -> str:
    """Table of the planning time saved, for each value of each question."""
    lines = []
    for question in (*SURFACE, "scenes"):
        for value in rows.values(question):
            for policy in ("PGF", "PGF, best"):
                found = [_lead(rows, question, value, policy, r) for r in rows.sizes]
                if any(p.n > 1 for p in found):
                    success = _lead(rows, question, value, policy, rows.sizes[-1], "success")
                    cells = [*map(text, found), text(success, 1, 100)]
                    lines.append([question, value, policy, *cells])
    headings = ["question", "value", "policy", *(f"R = {r} (s)" for r in rows.sizes)]
    headings.append("success at the largest (points)")
    return (
        "## Planning time saved\n\nPolicy less OR-HITL (for the window: less OR-HITL with the same "
        "window); below 0 it is faster.\n\n" + _table(headings, lines)
    )


def _fan_out(rows: Rows) -> str:
    """Table of the largest fleets for one operator, and the knee of the machine-repair model."""
    lines = []
    settings = [  # (question, value) of one operator, and of an operator each
        (("default", ""), ("operators", "one each")),
        (("computers", "slow: rollouts of 6 s"), ("computers", "slow, an operator each")),
        *(
            (("scenes", name), ("scenes", f"{name}, an operator each"))
            for name in ("tight", "medium", "wide")
        ),
    ]
    for one, each in settings:
        for policy in ("PGF", "PGF, best", "OR-HITL", "queue"):
            cells = {r: rows.cell(*one, policy, r) for r in rows.sizes}
            cells = {r: cell for r, cell in cells.items() if len(cell)}
            full = {r: rows.cell(*each, policy, r) for r in cells}
            reference = full[max(full)]
            largest = {name: _largest(cells, full, name) for name in ("success", "rate")}
            think, service = cycle(reference)
            knee = (think + service) / service if service else math.inf
            lines.append(
                [
                    one[1] or "default",
                    policy,
                    text(over_seeds(reference, "success"), 1, 100),
                    largest["success"],
                    largest["rate"],
                    f"{think:.0f}",
                    f"{knee:.1f}",
                ]
            )
    headings = ["setting", "policy", "success, served at once (%)", "largest fleet by success",
                "by throughput", "time between services Z (s)", "knee (Z + S) / S"]  # fmt: skip
    return (
        f"## How many robots one operator serves\n\nThe largest fleet tried whose mean is within "
        f"{100 * LOSS:.0f} % of that of a robot that is served at once (an operator each), beside "
        "the knee of the machine-repair model, with Z and S measured on fully served fleets. "
        f"`N+`: the largest tried.\n\n" + _table(headings, lines)
    )


def _largest(cells: dict, full: dict, value: str) -> str:
    """The largest fleet that is within the loss, as all smaller ones are too."""
    best = None
    for robots, cell in cells.items():
        ratio = over_seeds(cell, value).mean / over_seeds(full[robots], value).mean
        if ratio < 1 - LOSS:
            return f"under {robots}" if best is None else str(best)
        best = robots
    return f"{best}+"


def _policies(rows: Rows) -> str:
    """Table of all policies, at the sizes at which all were run."""
    few = sorted(rows.frame.filter(question="policy")["robots"].unique().to_list())
    lines = []
    for robots in few:
        for policy in POLICIES:
            cell = rows.cell("default", "", policy, robots)
            if cell.is_empty():
                cell = rows.cell("policy", "", policy, robots)
            base = rows.cell("default", "", "OR-HITL", robots)
            lines.append(
                [
                    str(robots),
                    policy,
                    text(over_seeds(cell, "planning_time_s")),
                    text(difference(cell, base, "planning_time_s")),
                    text(over_seeds(cell, "success"), 1, 100),
                    text(over_seeds(cell, "rate")),
                    text(over_seeds(cell, "first_grant")),
                    text(over_seeds(cell, "utilisation"), 2),
                ]
            )
    headings = ["R", "policy", "planning time (s)", "less OR-HITL (s)", "success (%)",
                "tasks per robot and hour", "first grant at", "utilisation"]  # fmt: skip
    return "## Policies\n\n" + _table(headings, lines)


def _operators(rows: Rows) -> str:
    """Table of operators of different quality."""
    lines = []
    robots = rows.frame.filter(question="operator")["robots"].unique().item()
    for value in rows.values("operator"):
        for policy in ("PGF", "PGF, best", "OR-HITL"):
            cell = rows.cell("operator", value, policy, robots)
            lines.append(
                [
                    value,
                    policy,
                    text(over_seeds(cell, "planning_time_s")),
                    text(_lead(rows, "operator", value, policy, robots)),
                    text(over_seeds(cell, "success"), 1, 100),
                    text(over_seeds(cell, "wasted"), 0, 100),
                ]
            )
    headings = ["operator", "policy", "planning time (s)", "less OR-HITL (s)", "success (%)",
                "answers that did not lower the cost (%)"]  # fmt: skip
    return f"## How good the operator is ({robots} robots)\n\n" + _table(headings, lines)


def _attention(rows: Rows) -> str:
    """Table of how the operator's attention is spent."""
    lines = []
    for robots in rows.sizes:
        for policy in ("PGF", "PGF, best", "OR-HITL", "OR-HITL, window", "queue"):
            cell = rows.cell("default", "", policy, robots)
            lines.append(
                [
                    str(robots),
                    policy,
                    text(over_seeds(cell, "utilisation"), 2),
                    text(over_seeds(cell, "waiting_per_ask_s"), 2),
                    text(over_seeds(cell, "refused_share"), 0, 100),
                    text(over_seeds(cell, "wasted"), 0, 100),
                    text(over_seeds(cell, "go_on"), 0, 100),
                    text(over_seeds(cell, "fairness_grants"), 2),
                    text(over_seeds(cell, "fairness_throughput"), 2),
                    text(over_seeds(cell, "largest_share"), 2),
                ]
            )
    headings = ["R", "policy", "utilisation", "wait per ask (s)", "asks refused (%)",
                "answers that did not lower the cost (%)", 'answers "go on" (%)',
                "Jain, grants", "Jain, tasks per hour", "largest share of grants"]  # fmt: skip
    return "## Attention\n\n" + _table(headings, lines)
