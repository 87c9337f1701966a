"""Reads what a session is made of: a new session, one that is resumed, or one that is replayed."""

import dataclasses
import logging
from collections.abc import Callable
from typing import Any

from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.live_operator import InputRequest, LiveOperator
from pgf_jax.console.recorder import SessionRecorder
from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet
from pgf_jax.provenance import environment
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.recorded_operator import LIVE, Recording
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.replay import agreed_settings, replay_config, replay_difference, settings_of
from pgf_jax.sweeping.resolve import CellSpec, ResolvedSweep, resolve
from pgf_jax.tables.event_log import JOURNAL, TABLE, EventLog, Journal, read_log

log = logging.getLogger(__name__)
_OF_SERVER = ("host", "port")
_OF_PERSON = ("speed", "patience")  # settings that do not concern a simulated operator


@dataclasses.dataclass(frozen=True, eq=False)
class SessionSpec:
    """The specification of a session, before it runs.

    Attributes:
      config: as given; of a session that is resumed or replayed, as recorded.
      sweep: the session as a sweep of one cell; the two differ in the clock alone.
      earlier: log of the session that is resumed; None: a new session.
    """

    config: ConsoleConfig
    sweep: ResolvedSweep
    earlier: EventLog | None

    @classmethod
    def load(cls, config: ConsoleConfig) -> "SessionSpec":
        """Read the inputs of a session.

        Raises:
          BadInput: a setting or file cannot be used; the folder holds a session and `resume` is not
            set; or the session to resume was recorded by other versions, or has ended.
        """
        earlier = None
        if config.resume:
            earlier = read_log(config.out / JOURNAL)
            if _OF_PERSON[0] not in (earlier.settings or {}):
                raise BadInput(f"{earlier.path}: expected a live session; others are not resumed")
            config = _as_recorded(config, earlier, _OF_SERVER)
        else:
            for name in (JOURNAL, TABLE):
                if (config.out / name).exists():
                    raise BadInput(
                        f"out: {config.out / name} exists; expected a new folder, or --resume"
                    )
        if config.log is None:
            sweep = config.sweep()
        else:
            recorded = read_log(config.log)
            config = _as_recorded(config, recorded, _OF_SERVER + _OF_PERSON)
            sweep = replay_config(config.sweep(), recorded)
        spec = cls(config, resolve(sweep), earlier)
        spec._check_earlier()
        return spec

    @property
    def cell(self) -> CellSpec:
        """The session's fleet."""
        return self.sweep.cells[0]

    @property
    def start_ns(self) -> int:
        """Simulated time at which the session begins, or is resumed, ns."""
        return self.earlier.events[-1].time_ns if self.earlier and self.earlier.events else 0

    def about(self) -> dict[str, Any]:
        """Settings, identity and environment, for the session's log."""
        settings = settings_of(self.sweep.config)
        if self.config.operator == LIVE:
            settings |= {name: getattr(self.config, name) for name in _OF_PERSON}
        return {
            "settings": settings,
            "identity": self.cell.identity,
            "environment": environment(),
        }

    def new_runner(self, on_request: Callable[[InputRequest], None]) -> FleetRunner:
        """Make the fleet, before its first event.

        Args:
          on_request: called when a person is asked for an input.
        """
        if self.config.operator != LIVE:
            return FleetRunner.of(self.cell.fleet)
        recording = None if self.earlier is None else Recording.of(self.earlier)
        operator = LiveOperator(on_request, recording)

        def new_fleet(planned: PlannedRobots) -> Fleet:
            return Fleet(
                self.cell.fleet.config,
                planned,
                service=operator,
                attendance=() if recording is None else recording.attendance,
            )

        return FleetRunner.of(self.cell.fleet, new_fleet=new_fleet, operator=operator)

    def restore(self, runner: FleetRunner) -> None:
        """Run a new fleet up to the time at which the session begins or is resumed.

        Raises:
          BadInput: its events differ from those recorded, or the session had ended.
        """
        runner.run_until(self.start_ns)
        if self.earlier is None:
            return
        difference = replay_difference(runner.fleet.events, self.earlier)
        if difference is not None:
            raise BadInput(difference)
        # A session that was killed before its tables were written is resumed to write them.
        if runner.fleet.done and (self.config.out / TABLE).exists():
            raise BadInput(
                f"{self.earlier.path}: the session has ended; there is nothing to resume"
            )
        log.info("resuming after %d events", len(self.earlier.events))

    def open_recorder(self, runner: FleetRunner) -> SessionRecorder:
        """Open the files that the session is recorded in."""
        path = self.config.out / JOURNAL
        if self.earlier is None:
            journal, written = Journal(path, self.about()), 0
        else:
            # The table has an end that the resumed session will not have.
            (self.config.out / TABLE).unlink(missing_ok=True)
            journal = Journal(path, None, keep=self.earlier.size)
            written = len(self.earlier.events)
        return SessionRecorder(runner, self.cell, self.about(), journal, written)

    def _check_earlier(self) -> None:
        if self.earlier is None:
            return
        theirs, ours = self.earlier.about["identity"], self.cell.identity
        for name, value in ours.items():
            if theirs.get(name) != value:
                raise BadInput(
                    f"{self.earlier.path}: recorded with another {name} than there is now; a "
                    "session is resumed as it was recorded, or not at all"
                )


def _as_recorded(config: ConsoleConfig, earlier: EventLog, own: tuple[str, ...]) -> ConsoleConfig:
    """The settings of the recorded session, except those in `own`, which stay as given."""
    recorded = earlier.settings or {}
    flat = {
        **recorded,
        "robots": _one(recorded, "robots", earlier),
        "policy": _one(recorded, "policies", earlier),
    }
    ours = {n: v for n, v in settings_of(config).items() if n not in own}
    defaults = {n: v for n, v in settings_of(ConsoleConfig()).items() if n not in own}
    values = agreed_settings(ours, defaults, flat, earlier.path)
    try:
        return dataclasses.replace(config, **values)
    except (BadInput, TypeError, ValueError) as error:
        raise BadInput(f"{earlier.path}: settings that cannot be used: {error}") from None


def _one(recorded: dict[str, Any], name: str, earlier: EventLog) -> Any:
    values = recorded.get(name)
    if not isinstance(values, list) or len(values) != 1:
        raise BadInput(f"{earlier.path}: expected settings with one of {name}, got {values!r}")
    return values[0]
