"""What a session is made of: a new one, one that is gone on with, or one that is replayed."""

import dataclasses
import logging
from collections.abc import Callable
from typing import Any

from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.live_operator import InputRequest, LiveOperator
from pgf_jax.console.recorder import SessionRecorder
from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet
from pgf_jax.fleet.config import Cell
from pgf_jax.provenance import environment
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.recorded_operator import LIVE, Recording
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.replay import agreed, compare, replaying, settings_of
from pgf_jax.sweeping.resolve import Setup, identity, prepare
from pgf_jax.tables.event_log import JOURNAL, TABLE, EventLog, Journal, read_log

log = logging.getLogger(__name__)
_OF_A_SERVER = ("host", "port")
_OF_PEOPLE = ("speed", "patience")  # settings that a simulated operator knows nothing of


@dataclasses.dataclass(frozen=True, eq=False)
class SessionSpec:
    """A session before it runs.

    Attributes:
      config: as given; of a session that is gone on with, or replayed, as recorded.
      setup: the sweep of one cell that it is, but for its clock.
      earlier: what was recorded of it before, where it is gone on with.
    """

    config: ConsoleConfig
    setup: Setup
    earlier: EventLog | None

    @classmethod
    def of(cls, config: ConsoleConfig) -> "SessionSpec":
        """Prepare a session.

        Raises:
          BadInput: a setting or file cannot be used; the folder holds a session and `resume` was
            not said; or what is to be gone on with was recorded by other versions or has ended.
        """
        earlier = None
        if config.resume:
            earlier = read_log(config.out / JOURNAL)
            if _OF_PEOPLE[0] not in (earlier.settings or {}):
                raise BadInput(f"{earlier.path}: was no live session, and only those go on")
            config = _as_recorded(config, earlier, _OF_A_SERVER)
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
            config = _as_recorded(config, recorded, _OF_A_SERVER + _OF_PEOPLE)
            sweep = replaying(config.sweep(), recorded)
        spec = cls(config, prepare(sweep), earlier)
        spec._check_earlier()
        return spec

    @property
    def cell(self) -> Cell:
        """The fleet's policy and sizes."""
        return self.setup.config.cells()[0]

    @property
    def start_ns(self) -> int:
        """Simulated time at which it begins, or goes on."""
        return self.earlier.events[-1].time_ns if self.earlier and self.earlier.events else 0

    def about(self) -> dict[str, Any]:
        """What its log says of it."""
        settings = settings_of(self.setup.config)
        if self.config.operator == LIVE:
            settings |= {name: getattr(self.config, name) for name in _OF_PEOPLE}
        return {
            "settings": settings,
            "identity": identity(self.setup, self.cell),
            "environment": environment(),
        }

    def play(self, on_asked: Callable[[InputRequest], None]) -> FleetRunner:
        """The fleet, before anything has happened.

        Args:
          on_asked: called when a person is asked for an input.
        """
        if self.config.operator != LIVE:
            return FleetRunner.of(self.setup, self.cell)
        recording = None if self.earlier is None else Recording.of(self.earlier)
        operator = LiveOperator(on_asked, recording)

        def new_fleet(planned: PlannedRobots) -> Fleet:
            return Fleet(
                self.setup.config.fleet(self.cell),
                planned,
                service=operator,
                attendance=() if recording is None else recording.attendance,
            )

        return FleetRunner.of(self.setup, self.cell, new_fleet=new_fleet, operator=operator)

    def catch_up(self, play: FleetRunner) -> None:
        """Bring a new fleet to where it begins or goes on.

        Raises:
          BadInput: it went another way now than it was recorded, or had ended there.
        """
        play.run_until(self.start_ns)
        if self.earlier is None:
            return
        difference = compare(play.fleet.events, self.earlier)
        if difference is not None:
            raise BadInput(difference)
        # One that was killed before its tables were written has only these to come.
        if play.fleet.done and (self.config.out / TABLE).exists():
            raise BadInput(
                f"{self.earlier.path}: the session has ended; there is nothing to resume"
            )
        log.info("going on after %d events", len(self.earlier.events))

    def record(self, play: FleetRunner) -> SessionRecorder:
        """Where it is written."""
        path = self.config.out / JOURNAL
        if self.earlier is None:
            journal, written = Journal(path, self.about()), 0
        else:
            (self.config.out / TABLE).unlink(missing_ok=True)  # it will end otherwise now
            journal = Journal(path, None, keep=self.earlier.size)
            written = len(self.earlier.events)
        return SessionRecorder(play, self.setup, self.cell, self.about(), journal, written)

    def _check_earlier(self) -> None:
        if self.earlier is None:
            return
        theirs, ours = self.earlier.about["identity"], identity(self.setup, self.cell)
        for name, value in ours.items():
            if theirs.get(name) != value:
                raise BadInput(
                    f"{self.earlier.path}: recorded with another {name} than there is now; a "
                    "session can only be gone on with as it was"
                )


def _as_recorded(config: ConsoleConfig, earlier: EventLog, own: tuple[str, ...]) -> ConsoleConfig:
    """The settings of the session that is gone on with, or replayed; but for its `own`."""
    recorded = earlier.settings or {}
    flat = {
        **recorded,
        "robots": _one(recorded, "robots", earlier),
        "policy": _one(recorded, "policies", earlier),
    }
    ours = {n: v for n, v in settings_of(config).items() if n not in own}
    defaults = {n: v for n, v in settings_of(ConsoleConfig()).items() if n not in own}
    values = agreed(ours, defaults, flat, earlier.path)
    try:
        return dataclasses.replace(config, **values)
    except (BadInput, TypeError, ValueError) as error:
        raise BadInput(f"{earlier.path}: settings that cannot be used: {error}") from None


def _one(recorded: dict[str, Any], name: str, earlier: EventLog) -> Any:
    values = recorded.get(name)
    if not isinstance(values, list) or len(values) != 1:
        raise BadInput(f"{earlier.path}: expected settings with one of {name}, got {values!r}")
    return values[0]
