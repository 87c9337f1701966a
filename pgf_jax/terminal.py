"""Shows progress, as bars or as a line from time to time, and tables."""

import sys
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars
from rich.table import Table

DRAW_EVERY_S = 0.1  # s between two drawings of the bars


class Progress:
    """Shows progress on stderr: as bars on a terminal, elsewhere as a line from time to time.

    Use it as a context. Bars that are not kept are gone afterwards, so that an error is the only
    line left on stderr.

    Attributes:
      live: there is a terminal, and bars on it.
    """

    def __init__(
        self,
        what: str,
        *,
        every_s: float | None = 30.0,
        columns: Sequence[ProgressColumn] = (),
        console: Console | None = None,
        keep: bool = False,
        quiet: bool = False,
    ) -> None:
        """Name what is counted ("scenes").

        Args:
          what: the things that are counted; the label of the first bar.
          every_s: without a terminal: s between two lines; None: no lines.
          columns: of the bars, besides label, bar, count, time elapsed and time left.
          console: to draw on; None: standard error.
          keep: leave the bars on the terminal at the end.
          quiet: show nothing.
        """
        self._what, self._every_s = what, None if quiet else every_s
        self._began = self._shown = time.monotonic()
        self._first: int | None = None  # done before we began
        console = console or Console(stderr=True)
        self.live = console.is_terminal and not quiet
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            *columns,
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            transient=not keep,
        )
        self._first_bar: TaskID | None = None

    def __enter__(self) -> "Progress":
        if self.live:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.live:
            self._bars.stop()

    def add_bar(self, label: str, total: int | None, **fields: Any) -> TaskID:
        """Add a bar; `fields` are for its own columns."""
        return self._bars.add_task(label, total=total, **fields)

    def update_bar(self, bar: TaskID, completed: int, **fields: Any) -> None:
        """Say how much of a bar is done."""
        self._bars.update(bar, completed=completed, **fields)

    def is_due(self) -> bool:
        """Whether it is time to draw the bars, or to print a line; then it is not, for a while."""
        every_s = DRAW_EVERY_S if self.live else self._every_s
        now = time.monotonic()
        if every_s is None or now - self._shown < every_s:
            return False
        self._shown = now
        return True

    def update(self, done: int, total: int) -> None:
        """Say that `done` of `total` things are done."""
        if self._first is None:
            self._first = done
        if self.live:
            if self._first_bar is None:
                self._first_bar = self.add_bar(self._what, total)
            self._bars.update(self._first_bar, completed=done, total=total)
        elif done > self._first and self.is_due():
            left_s = (self._shown - self._began) / (done - self._first) * (total - done)
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
