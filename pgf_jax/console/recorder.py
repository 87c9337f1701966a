"""What a session leaves behind: its log as it goes, its tables at the end."""

from collections.abc import Mapping
from typing import Any

from pgf_jax.files import json_bytes, write_atomically
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.metrics import CellSummary, summarise
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.resolve import Setup
from pgf_jax.sweeping.summary import csv, summary_frame
from pgf_jax.tables.event_log import TABLE, Journal, write_log
from pgf_jax.tables.results import parquet, tasks_frame


class SessionRecorder:
    """Writes a session down.

    Args:
      play: its fleet.
      setup, cell: what it is of.
      about: settings and identity.
      journal: for its events as they happen.
      written: events that are in it already.
    """

    def __init__(
        self,
        play: FleetRunner,
        setup: Setup,
        cell: Cell,
        about: Mapping[str, Any],
        journal: Journal,
        written: int,
    ) -> None:
        self.folder = journal.path.parent
        self._play, self._setup, self._cell, self._about = play, setup, cell, about
        self._journal, self._written = journal, written

    def write(self) -> None:
        """Write what has happened since the last call; it is on the disk when this returns."""
        events = self._play.fleet.events
        self._journal.append(events[self._written :])
        self._written = len(events)

    def close(self) -> CellSummary:
        """Write the tables.

        A fleet that is not done is cut off in them, at its clock, but not in the journal: the
        session can be gone on with.
        """
        fleet = self._play.fleet
        if not fleet.done:
            fleet.stop()
            self._play.run_until()
        else:
            self.write()
        self._journal.close()
        self._play.planned.finish()
        summary = summarise(self._setup.config.fleet(self._cell), fleet.records, fleet.events)
        tasks = tasks_frame(fleet.records, self._setup.scene_name)
        for name, data in {
            "tasks.parquet": parquet(tasks),
            "summary.csv": csv(summary_frame([summary])),
            "session.json": json_bytes(self._about),
        }.items():
            write_atomically(self.folder / name, data)
        write_log(self.folder / TABLE, fleet.events, self._about)
        return summary
