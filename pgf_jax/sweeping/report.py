"""Shows a sweep: its progress while it runs, its summary when it has ended."""

import json as json_module
import math
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import polars as pl
from rich.console import Console, Group
from rich.progress import TaskID, TextColumn
from rich.table import Table
from rich.text import Text

from pgf_jax.metrics.summary import NS_PER_HOUR, CellSummary, Interval
from pgf_jax.sweeping.resolve import CellSpec
from pgf_jax.sweeping.summary import over_fleets
from pgf_jax.terminal import Progress

BARS = 16  # more cells than these share one bar


class Report:
    """Shows the progress of a sweep; a `dispatch.SweepListener`.

    Use it as a context. With `quiet` it says nothing at all; with `json`, a line of JSON for each
    cell that is finished, on standard output, besides what is said on standard error.
    """

    def __init__(
        self,
        cells: Sequence[CellSpec],
        kept: Iterable[CellSpec],
        console: Console,
        *,
        quiet: bool = False,
        json: bool = False,
    ) -> None:
        kept = set(kept)
        self._console, self._quiet, self._json = console, quiet, json and not quiet
        self.retried_cells = 0
        self._tasks = {cell: cell.tasks for cell in cells if cell not in kept}
        self._done = dict.fromkeys(self._tasks, 0)
        self._time_ns = dict.fromkeys(self._tasks, 0)
        self._finished: set[CellSpec] = set()
        self._start = time.monotonic()
        self._first: float | None = None  # the first call has ended: nothing compiles any more
        hours = TextColumn("tasks, {task.fields[hours]:.2f} h simulated")
        columns = (hours, TextColumn("{task.fields[rate]}"))
        self._display = Progress("all", columns=columns, console=console, keep=True, quiet=quiet)
        self._bars: dict[CellSpec, TaskID] = {}
        self._several = len({cell.sweep for cell in cells}) > 1
        if len(kept) > BARS:
            self._say(f"kept: {len(kept)} cells")
        elif kept:
            self._say(f"kept: {', '.join(self._name(cell) for cell in cells if cell in kept)}")

    def __enter__(self) -> "Report":
        if self._display.live:
            no = {"hours": 0.0, "rate": ""}
            self._all = self._display.add_bar("all", sum(self._tasks.values()), **no)
            if len(self._tasks) <= BARS:
                for cell, tasks in self._tasks.items():
                    label = f"{cell.cell.policy}, R = {cell.cell.robots}"
                    self._bars[cell] = self._display.add_bar(label, tasks, **no)
        self._display.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        if self._display.live:
            self._draw()
        self._display.__exit__()

    def progress(self, cell: CellSpec, tasks: int, time_ns: int) -> None:
        """See `SweepListener.progress`."""
        self._done[cell], self._time_ns[cell] = tasks, time_ns
        self._first = self._first or time.monotonic()
        self._show()

    def finished(self, cell: CellSpec, account: Mapping[str, Any]) -> None:
        """See `SweepListener.finished`."""
        # Tasks that the horizon left unbegun are not waited for.
        self._done[cell] = self._tasks[cell]
        self._finished.add(cell)
        self._show()
        if self._json:
            self._print_json(cell, account)
        if not self._display.live and len(self._tasks) <= BARS:
            self._line(f"finished {self._name(cell)}; ")

    def retried(self, cells: int, why: str) -> None:
        """See `SweepListener.retried`."""
        self.retried_cells += cells
        self._say(f"{why}: {cells} cells are computed again")

    def plugin_changed(self, cells: Sequence[CellSpec]) -> None:
        """Say which cells are computed again because a plugin is another one now."""
        if cells:
            names = ", ".join(self._name(cell) for cell in cells)
            self._say(f"computed again, as a plugin has changed since: {names}")

    def interrupted(self, *out: object) -> None:
        """Say what is kept, and how to go on."""
        where = str(out[0]) if len(out) == 1 else f"{out[0]} .. {out[-1]}"
        self._say(
            f"interrupted: {len(self._finished)} of {len(self._tasks)} cells were finished and are "
            f"kept in {where}; the same command with --resume computes the others"
        )

    def _name(self, cell: CellSpec) -> str:
        return f"{cell.sweep}:{cell.name}" if self._several else cell.name

    def _show(self) -> None:
        if self._display.is_due():
            self._draw() if self._display.live else self._line()

    def _draw(self) -> None:
        hours = {cell: ns / NS_PER_HOUR for cell, ns in self._time_ns.items()}
        for cell, bar in self._bars.items():
            self._display.update_bar(bar, self._done[cell], hours=hours[cell])
        done, rate, _ = self._pace()
        total_hours = sum(hours.values())
        self._display.update_bar(self._all, done, hours=total_hours, rate=f"{rate:.1f}/s")

    def _pace(self) -> tuple[int, float, float]:
        """Tasks done, tasks/s, and s left at that rate; compilation does not count."""
        done, total = sum(self._done.values()), sum(self._tasks.values())
        elapsed = max(time.monotonic() - (self._first or self._start), 1e-9)
        return done, done / elapsed, elapsed * (total - done) / max(done, 1)

    def _line(self, head: str = "") -> None:
        total = sum(self._tasks.values())
        done, rate, left = self._pace()
        estimate = f", {rate:.1f} tasks/s, about {left:.0f} s left" if 0 < done < total else ""
        hours = sum(self._time_ns.values()) / NS_PER_HOUR
        self._say(
            f"{head}{done}/{total} tasks, {len(self._finished)}/{len(self._tasks)} cells, "
            f"{hours:.2f} h simulated, {time.monotonic() - self._start:.0f} s{estimate}"
        )

    def _print_json(self, cell: CellSpec, account: Mapping[str, Any]) -> None:
        done, rate, left = self._pace()
        line = {
            "sweep": cell.sweep,
            "cell": cell.name,
            "tasks": cell.tasks,
            **{name: account.get(name) for name in ("sha256", "wall_s", "attempt")},
            "host": (account.get("host") or {}).get("name"),
            "cells_done": len(self._finished),
            "cells": len(self._tasks),
            "tasks_done": done,
            "tasks_in_all": sum(self._tasks.values()),
            "tasks_per_s": round(rate, 3),
            "left_s": round(left, 1),
        }
        print(json_module.dumps(line), file=sys.stdout, flush=True)

    def _say(self, text: str) -> None:
        if not self._quiet:
            self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def summary_tables(summaries: Sequence[CellSummary]) -> Group:
    """The headline numbers of every policy and fleet size, in tables that fit 80 columns.

    Where checks are real or reaches may miss, a third table says what came of them. Means are over
    fleets of several seeds, with half the width of their 95 % intervals.
    """
    rows = over_fleets(summaries)
    all_solved = all(row.solved == row.tasks for row in rows)
    success = () if all_solved else ("success",)
    of_task = ("planning (s)", "in the task (s)")
    outcome = _table("policy", "R", "fleets", "tasks", *success, *of_task, "tasks/h")
    help_ = _table("policy", "R", "helped", "waiting (s)", "1st grant", "utilisation", "window")
    for row in rows:
        fleet = (row.policy, str(row.robots))
        outcome.add_row(
            *fleet,
            str(row.fleets),
            str(row.tasks),
            *(() if all_solved else (_plus_minus(row.success, 2),)),
            _plus_minus(row.planning_time_s),
            _plus_minus(row.task_time_s),
            _plus_minus(row.tasks_per_hour, 0),
        )
        help_.add_row(
            *fleet,
            _plus_minus(row.helped, 2),
            _plus_minus(row.waiting_s),
            _plus_minus(row.first_grant),
            _plus_minus(row.utilisation, 2),
            _plus_minus(row.window_size_mean),
        )
    tries = _table("policy", "R", "1st attempt", "missed grasps", "checks", "missed checks")
    for row in rows:
        found = (row.grasp_misses, row.checks, row.check_misses)
        if row.first_attempt is not None:
            words = ["" if value is None else _plus_minus(value, 2) for value in found]
            tries.add_row(row.policy, str(row.robots), _plus_minus(row.first_attempt, 2), *words)
    fleets = max((row.fleets for row in rows), default=0)
    notes = [
        *(["all tasks solved"] if all_solved else []),
        f"mean ± 95 % interval over {fleets} fleets (seeds)"
        if fleets > 1
        else "one fleet: no interval (--seeds 0 1 2 makes several)",
        "in the task: planning, waiting and service; 1st grant: at which reach iteration;",
        "window: bids in it at its close",
        *(["1st attempt: success rate of it; the others: of a task"] if tries.row_count else []),
    ]
    tables = [outcome, help_, *([tries] if tries.row_count else [])]
    return Group(*tables, *(Text(note) for note in notes))


def physics_line(summaries: Sequence[CellSummary], tasks: pl.DataFrame) -> str:
    """A line about the physics: what was not finite, and where contact slots were full."""
    lost, full = (sum(getattr(s, name) for s in summaries) for name in ("non_finite", "saturated"))
    where = ""
    if lost:
        first = tasks.filter(pl.col("non_finite") > 0).row(0, named=True)
        where = (
            f" (first: {first['policy']}, R = {first['robots']}, seed {first['seed']}, robot "
            f"{first['robot']}, task {first['task']}, iteration {first['non_finite_at'][0]}; all "
            "in tasks.parquet, non_finite_at)"
        )
    return (
        f"physics: {lost} iterations with a rollout that is not finite{where}; every contact slot "
        f"in use in {full} rollouts, of {tasks.filter(pl.col('saturated') > 0).height} tasks"
    )


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False, title=" ")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "policy" else "right", no_wrap=True)
    return table


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _plus_minus(value: Interval, digits: int = 1) -> str:
    """A mean and half the width of its interval, which may be cut on one side."""
    text = _number(value.mean, digits)
    if math.isnan(value.high):
        return text
    half = max(value.high - value.mean, value.mean - value.low)
    return f"{text} ± {half:.{digits}f}"
