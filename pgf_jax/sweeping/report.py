"""What a sweep shows: its progress while it runs, its summary when it has ended."""

import json as json_module
import math
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import polars as pl
from rich.console import Console, Group
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from pgf_jax.fleet.metrics import NS_PER_HOUR, CellSummary, Interval
from pgf_jax.sweeping.run_cells import Job

LINE_EVERY_S = 30.0  # where there is no terminal to draw on
DRAW_EVERY_S = 0.1  # with thousands of cells, to add them up after every call would take long
BARS = 16  # more cells than these share one bar


class Report:
    """Progress on a terminal as bars, elsewhere as a line now and then; a `dispatch.Listener`.

    Use it as a context. With `quiet` it says nothing at all; with `json`, a line of JSON for each
    cell that is finished, on standard output, besides what is said on standard error.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        kept: Iterable[Job],
        console: Console,
        *,
        quiet: bool = False,
        json: bool = False,
    ) -> None:
        kept = set(kept)
        self._console, self._quiet, self._json = console, quiet, json and not quiet
        self.sent_again = 0
        self._tasks = {job: job.cell.robots * job.cell.tasks for job in jobs if job not in kept}
        self._done = dict.fromkeys(self._tasks, 0)
        self._time_ns = dict.fromkeys(self._tasks, 0)
        self._finished: set[Job] = set()
        self._start = self._last = time.monotonic()
        self._first: float | None = None  # the first call has ended: nothing compiles any more
        self._live = console.is_terminal and not quiet
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("tasks, {task.fields[hours]:.2f} h simulated"),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._bars: dict[Job, TaskID] = {}
        self._several = len({job.sweep for job in jobs}) > 1
        if len(kept) > BARS:
            self._say(f"kept: {len(kept)} cells")
        elif kept:
            self._say(f"kept: {', '.join(self._name(job) for job in jobs if job in kept)}")

    def __enter__(self) -> "Report":
        if self._live:
            total = sum(self._tasks.values())
            self._all = self._progress.add_task("all", total=total, hours=0.0, rate="")
            if len(self._tasks) <= BARS:
                for job, tasks in self._tasks.items():
                    label = f"{job.cell.policy}, R = {job.cell.robots}"
                    self._bars[job] = self._progress.add_task(
                        label, total=tasks, hours=0.0, rate=""
                    )
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._draw()
            self._progress.stop()

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """See `Listener.progress`."""
        self._done[job], self._time_ns[job] = tasks, time_ns
        self._first = self._first or time.monotonic()
        self._show()

    def finished(self, job: Job, account: Mapping[str, Any]) -> None:
        """See `Listener.finished`."""
        # Tasks that the horizon left unbegun are not waited for.
        self._done[job] = self._tasks[job]
        self._finished.add(job)
        self._show()
        if self._json:
            self._print_json(job, account)
        if not self._live and len(self._tasks) <= BARS:
            self._line(f"finished {self._name(job)}; ")

    def again(self, jobs: int, why: str) -> None:
        """See `Listener.again`."""
        self.sent_again += jobs
        self._say(f"{why}: {jobs} cells are computed again")

    def interrupted(self, *out: object) -> None:
        """Say what is there and how to go on."""
        where = str(out[0]) if len(out) == 1 else f"{out[0]} .. {out[-1]}"
        self._say(
            f"interrupted: {len(self._finished)} of {len(self._tasks)} cells were finished and are "
            f"kept in {where}; the same command with --resume computes the others"
        )

    def _name(self, job: Job) -> str:
        return f"{job.sweep}:{job.cell.name}" if self._several else job.cell.name

    def _show(self) -> None:
        now = time.monotonic()
        if self._live and now - self._last > DRAW_EVERY_S:
            self._last = now
            self._draw()
        elif not self._live and now - self._last > LINE_EVERY_S:
            self._line()

    def _draw(self) -> None:
        hours = {job: ns / NS_PER_HOUR for job, ns in self._time_ns.items()}
        for job, bar in self._bars.items():
            self._progress.update(bar, completed=self._done[job], hours=hours[job])
        done, rate, _ = self._pace()
        self._progress.update(
            self._all, completed=done, hours=sum(hours.values()), rate=f"{rate:.1f}/s"
        )

    def _pace(self) -> tuple[int, float, float]:
        """Tasks done, tasks/s, and the s that are left by it; compilation does not count."""
        done, total = sum(self._done.values()), sum(self._tasks.values())
        elapsed = max(time.monotonic() - (self._first or self._start), 1e-9)
        return done, done / elapsed, elapsed * (total - done) / max(done, 1)

    def _line(self, head: str = "") -> None:
        now = self._last = time.monotonic()
        total = sum(self._tasks.values())
        done, rate, left = self._pace()
        estimate = f", {rate:.1f} tasks/s, about {left:.0f} s left" if 0 < done < total else ""
        hours = sum(self._time_ns.values()) / NS_PER_HOUR
        self._say(
            f"{head}{done}/{total} tasks, {len(self._finished)}/{len(self._tasks)} cells, "
            f"{hours:.2f} h simulated, {now - self._start:.0f} s{estimate}"
        )

    def _print_json(self, job: Job, account: Mapping[str, Any]) -> None:
        done, rate, left = self._pace()
        line = {
            "sweep": job.sweep,
            "cell": job.cell.name,
            "tasks": job.cell.robots * job.cell.tasks,
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
    """The headline numbers of every cell, with 95 % intervals; two tables, to fit 80 columns."""
    outcome = _table("policy", "R", "tasks", "success", "planning (s)", "solved (s)", "tasks/h")
    help_ = _table("policy", "R", "helped", "first grant at", "utilisation", "window size")
    for s in summaries:
        cell = (s.policy, str(s.robots))
        outcome.add_row(
            *cell,
            str(s.tasks),
            _range(s.success),
            _plus_minus(s.planning_time_s),
            _plus_minus(s.planning_time_solved_s),
            _number(s.tasks_per_hour, 1),
        )
        help_.add_row(
            *cell,
            _range(s.helped),
            _plus_minus(s.first_grant),
            _number(s.utilisation, 2),
            _number(s.window_size_mean, 2),
        )
    return Group(outcome, help_)


def numbers(summaries: Sequence[CellSummary], tasks: pl.DataFrame, seed: int) -> str:
    """What is to be known of the physics: where it was not finite, where contacts were dropped."""
    lost, full = (sum(getattr(s, name) for s in summaries) for name in ("non_finite", "saturated"))
    where = ""
    if lost:
        first = tasks.filter(pl.col("non_finite") > 0).row(0, named=True)
        where = (
            f" (first: {first['policy']}, R = {first['robots']}, seed {seed}, robot "
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


def _plus_minus(value: Interval) -> str:
    text = _number(value.mean, 1)
    return text if math.isnan(value.high) else f"{text} ± {value.high - value.mean:.1f}"


def _range(value: Interval) -> str:
    text = _number(value.mean, 2)
    return text if math.isnan(value.low) else f"{text} [{value.low:.2f}, {value.high:.2f}]"
