"""What commands show: progress, a bar or now and then a line; and tables."""

import sys
import time
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar
from rich.table import Table


class Progress:
    """Shows on stderr how much is done and about how long the rest will take.

    Use as a context manager and call `update`. The bar is gone afterwards, so that an error is the
    only line left on stderr.
    """

    def __init__(self, what: str, *, every_s: float | None = 30.0) -> None:
        """Name what is counted ("scenes").

        Args:
          what: the things that are counted.
          every_s: not on a terminal: s between two lines; None: no lines.
        """
        self._what, self._every_s = what, every_s
        self._began = self._said = time.monotonic()
        self._first: int | None = None  # done before we began
        console = Console(stderr=True)
        self._bar: Bar | None = None
        if console.is_terminal:
            columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            left = (TextColumn("left"), TimeRemainingColumn())
            self._bar = Bar(
                TextColumn("{task.description}"), *columns, *left, console=console, transient=True
            )
            self._task = self._bar.add_task(what, total=None)

    def __enter__(self) -> "Progress":
        if self._bar:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._bar:
            self._bar.stop()

    def update(self, done: int, total: int) -> None:
        """So many of `total` are done."""
        if self._first is None:
            self._first = done
        if self._bar:
            self._bar.update(self._task, completed=done, total=total)
            return
        now = time.monotonic()
        if self._every_s is None or now - self._said < self._every_s or done == self._first:
            return
        self._said = now
        left_s = (now - self._began) / (done - self._first) * (total - done)
        print(f"{done}/{total} {self._what}, about {clock(left_s)} left", file=sys.stderr)


def clock(seconds: float) -> str:
    """A duration as h:mm:ss."""
    minutes, s = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{s:02d}"


def show_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; columns of numbers are flush right."""
    table = Table()
    for i, heading in enumerate(headings):
        numbers = i > 0 and all(row[i][:1].isdigit() for row in rows)
        table.add_column(heading, justify="right" if numbers else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
