"""The command `pgf-jax console`: runs a session with its page until the tasks are done."""

import signal
import statistics
import threading
import time
from pathlib import Path

from rich.console import Console

from pgf_jax.console.access_control import AccessControl
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.log_file import log_to
from pgf_jax.console.page import Page
from pgf_jax.console.session import Session
from pgf_jax.console.session_spec import SessionSpec
from pgf_jax.metrics.summary import CellSummary
from pgf_jax.operator_fit.command import service_times
from pgf_jax.operator_fit.lognormal import ANSWERS
from pgf_jax.sweeping.report import summary_tables

LOG = "console.log"
FAREWELL_S = 1.0  # time in which the pages receive the end of the session


def console(config: ConsoleConfig) -> CellSummary:
    """Run a session, until its tasks are done or it is interrupted.

    Returns:
      The summary of the fleet. The files of the session are in the folder `out`.

    Raises:
      BadInput: a setting, a file, the folder or the port cannot be used.
    """
    spec = SessionSpec.load(config)
    config = spec.config
    access = AccessControl(needs_token=config.needs_token)
    page = Page(
        config.host,
        config.port,
        access,
        robots=spec.cell.cell.robots,
        n_objects=spec.sweep.scenes.n_objects,
        live=config.operator == "live",
    )
    try:
        session = Session(spec, page.show)
        log_to(config.out / LOG, "pgf_jax.console", terminal=True)
        _say(page, access, config)
        page.open(session)
        _stop_on_signals(session)
        session.run()
        summary = session.recorder.close()
        time.sleep(FAREWELL_S)
    finally:
        page.close()
    _conclude(session, config.out, summary)
    return summary


def _say(page: Page, access: AccessControl, config: ConsoleConfig) -> None:
    """Print the address of the page; the token is shown here and nowhere else."""
    token = "" if access.token is None else f"?token={access.token}"
    start = "; the clock starts when an operator has come" if config.operator == "live" else ""
    print(f"{page.url}{token}{start}; Ctrl-C ends the session", flush=True)


def _conclude(session: Session, out: Path, summary: CellSummary) -> None:
    Console().print(summary_tables([summary]))
    services = service_times(session.runner.fleet.events).services
    seconds = [service.seconds for service in services if service.outcome in ANSWERS]
    took = f" after {statistics.median(seconds):.1f} s (median)" if seconds else ""
    print(
        f"{len(seconds)} answers{took}; the clock waited {session.clock.held_s:.1f} s for the "
        f"computer; results in {out}"
    )


def _stop_on_signals(session: Session) -> None:
    """Let Ctrl-C and SIGTERM end the session in order; a second one kills the process."""

    def stop(number: int, frame: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        session.stop()

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
