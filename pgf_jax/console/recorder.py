"""Records a session: its event log while it runs, its tables at the end."""

from collections.abc import Mapping
from typing import Any

from pgf_jax.files import json_bytes, write_atomically
from pgf_jax.metrics.summary import CellSummary, summarise
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.columns import labelled
from pgf_jax.sweeping.resolve import CellSpec
from pgf_jax.sweeping.summary import csv, summary_frame
from pgf_jax.tables.event_log import TABLE, Journal
from pgf_jax.tables.parquet import encode_table, write_table
from pgf_jax.tables.results import events_frame, tasks_frame


class SessionRecorder:
    """Writes the files of a session.

    Args:
      runner: of the fleet.
      cell: specification of the fleet.
      about: settings, identity and environment.
      journal: takes the events as they happen.
      written: number of events that are in the journal already.
    """

    def __init__(
        self,
        runner: FleetRunner,
        cell: CellSpec,
        about: Mapping[str, Any],
        journal: Journal,
        written: int,
    ) -> None:
        self.folder = journal.path.parent
        self._runner, self._cell, self._about = runner, cell, about
        self._journal, self._written = journal, written

    def write(self) -> None:
        """Write the events since the last call; they are on the disk when this returns."""
        events = self._runner.fleet.events
        self._journal.append(events[self._written :])
        self._written = len(events)

    def leave(self) -> None:
        """Write the events, and leave the session as it is, to be resumed."""
        self.write()
        self._journal.close()

    def close(self) -> CellSummary:
        """Write the tables, and return the summary.

        In the tables a fleet that is not done is cut off at its present time; in the journal it is
        not, so that the session can be resumed.
        """
        fleet = self._runner.fleet
        if not fleet.done:
            fleet.stop()
            self._runner.run_until()
        else:
            self.write()
        self._journal.close()
        self._runner.robots.finish()
        summary = summarise(self._cell.fleet.config, fleet.records, fleet.events)
        tasks = tasks_frame(fleet.records, self._cell.fleet.scenes.name)
        of_fleet = self._cell.about()
        for name, data in {
            "tasks.parquet": encode_table(labelled(tasks, of_fleet), self._about),
            "summary.csv": csv(summary_frame([summary])),
            "session.json": json_bytes(self._about),
        }.items():
            write_atomically(self.folder / name, data)
        # Last: where there is such a table, the session has ended.
        events = labelled(events_frame(fleet.events), of_fleet)
        write_table(self.folder / TABLE, events, self._about)
        return summary
