"""What a sweep shows: its progress while it runs, its summary when it has ended."""

import math
import time
from collections.abc import Iterable, Sequence

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
from pgf_jax.study.sweep_run import Job

LINE_EVERY_S = 30.0  # where there is no terminal to draw on
BARS = 16  # more cells than these share one bar


class Report:
    """Progress on a terminal as bars, elsewhere as a line now and then; a `Listener`.

    Use it as a context. With `quiet` it says nothing at all.
    """

    def __init__(
        self, jobs: Sequence[Job], kept: Iterable[Job], console: Console, *, quiet: bool = False
    ) -> None:
        kept = set(kept)
        self._console, self._quiet = console, quiet
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
            self._all = self._progress.add_task("all", total=total, hours=0.0)
            if len(self._tasks) <= BARS:
                for job, tasks in self._tasks.items():
                    label = f"{job.cell.policy}, R = {job.cell.robots}"
                    self._bars[job] = self._progress.add_task(label, total=tasks, hours=0.0)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._progress.stop()

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """See `Listener.progress`."""
        self._done[job], self._time_ns[job] = tasks, time_ns
        self._first = self._first or time.monotonic()
        self._show(job)

    def finished(self, job: Job) -> None:
        """See `Listener.finished`."""
        # Tasks that the horizon left unbegun are not waited for.
        self._done[job] = self._tasks[job]
        self._finished.add(job)
        self._show(job)
        if not self._live and len(self._tasks) <= BARS:
            self._line(f"finished {self._name(job)}; ")

    def interrupted(self, *out: object) -> None:
        """Say what is there and how to go on."""
        where = str(out[0]) if len(out) == 1 else f"{out[0]} .. {out[-1]}"
        self._say(
            f"interrupted: {len(self._finished)} of {len(self._tasks)} cells were finished and are "
            f"kept in {where}; the same command with --resume computes the others"
        )

    def _name(self, job: Job) -> str:
        return f"{job.sweep}:{job.cell.name}" if self._several else job.cell.name

    def _show(self, job: Job) -> None:
        if self._live:
            hours = {j: ns / NS_PER_HOUR for j, ns in self._time_ns.items()}
            if job in self._bars:
                self._progress.update(self._bars[job], completed=self._done[job], hours=hours[job])
            total = sum(self._done.values())
            self._progress.update(self._all, completed=total, hours=sum(hours.values()))
        elif time.monotonic() - self._last > LINE_EVERY_S:
            self._line()

    def _line(self, head: str = "") -> None:
        now = self._last = time.monotonic()
        done, total = sum(self._done.values()), sum(self._tasks.values())
        left = (now - (self._first or self._start)) * (total - done) / max(done, 1)
        estimate = f", about {left:.0f} s left" if 0 < done < total else ""
        hours = sum(self._time_ns.values()) / NS_PER_HOUR
        self._say(
            f"{head}{done}/{total} tasks, {len(self._finished)}/{len(self._tasks)} cells, "
            f"{hours:.2f} h simulated, {now - self._start:.0f} s{estimate}"
        )

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
