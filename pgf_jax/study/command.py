"""The command `pgf-jax study`."""

import asyncio
import contextlib
import ctypes
import signal
from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table

from pgf_jax.errors import BadInput
from pgf_jax.study.config import StudyConfig
from pgf_jax.study.design import Design, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.orders import balanced_orders
from pgf_jax.study.progress import steps_of

LOG = "server.log"
_ARENA_MAX = -8  # the number of a setting of glibc, `M_ARENA_MAX`: heaps at most
_SIMULATED = 8  # participants, unless it is said how many


def study(config: StudyConfig) -> None:
    """Do what the settings say.

    Raises:
      BadInput: the folder cannot be written, or is not that of a study.
    """
    if config.what == "init":
        write_example(config.folder)
        print(f"{config.folder}: written; change it, then pgf-jax study check {config.folder}")
        return
    does = {
        "check": _check,
        "size": _size,
        "serve": serve,
        "export": _export,
        "analyse": _analyse,
        "what-if": _what_if,
    }
    does[config.what](config, load_design(config.folder))


def serve(config: StudyConfig, design: Design) -> None:
    """Serve a study until it is interrupted; needs the extra `console`.

    Raises:
      BadInput: the port is not free.
    """
    from pgf_jax.console.log_file import log_to
    from pgf_jax.study.server import StudyServer

    server = StudyServer(design, config.at_once)
    log_to(config.folder / LOG, "pgf_jax")

    def ready(port: int) -> None:
        """Print the addresses; the tokens are shown here, and kept nowhere."""
        place = f"http://{config.host}:{port}"
        print(f"experimenter: {place}/x/{server.key}")
        for _ in range(config.participants):
            link = server.add()
            print(f"participant {len(server.visits)}: {place}{link}")
        print("Ctrl-C ends it; the same command goes on where it was", flush=True)

    _share_heap()

    async def run() -> None:
        running = asyncio.current_task()
        assert running is not None
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, running.cancel)
        with contextlib.suppress(asyncio.CancelledError):
            await server.run(config.host, config.port, ready)

    asyncio.run(run())


def _share_heap() -> None:
    """Keep the C library from giving each thread a heap of its own, where it is glibc.

    Each session runs in a new thread, and what it frees in its own heap no other thread would use.
    """
    with contextlib.suppress(OSError, AttributeError):  # no such library, or no such function
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def _check(config: StudyConfig, design: Design) -> None:
    """Print the orders, and how many participants balance them."""
    conditions, console = list(design.conditions), Console()
    orders = len(balanced_orders(len(conditions)))
    table = Table("participants", *(f"block {n + 1}" for n in range(len(conditions))))
    for number in range(orders * len(conditions)):
        blocks = design.blocks_of(number)
        cells = [f"{conditions[b.condition]}, scenes {b.scenes + 1}" for b in blocks]
        table.add_row(str(number + 1), *cells)
    console.print(table)
    steps = [step.name for step in steps_of(design, design.blocks_of(0))]
    print(f"steps of the first: {', '.join(steps)}")
    print(
        f"{orders} participants balance the orders, {orders * len(conditions)} the scenes too; "
        f"{design.title!r} is in order"
    )


def _size(config: StudyConfig, design: Design) -> None:
    from pgf_jax import jax_setup
    from pgf_jax.study import sample_size

    jax_setup.configure()
    participants = config.participants or _SIMULATED
    if participants < 2 or len(design.conditions) < 2:
        raise BadInput("participants: expected two or more, in a study of two or more conditions")
    blocks = participants * len(design.conditions)
    with _progress() as say:
        found = sample_size.sample_size(
            design, participants, lambda done: say(f"{done} of {blocks} blocks have ended")
        )
    sample_size.show(found, participants)


def _export(config: StudyConfig, design: Design) -> None:
    from pgf_jax.study.export import export

    out = config.out or config.folder / "export"
    tables = export(design, out)
    rows = ", ".join(f"{len(frame)} {name}" for name, frame in tables.items())
    print(f"{out}: {rows}")


def _analyse(config: StudyConfig, design: Design) -> None:
    from pgf_jax.study import analysis_report
    from pgf_jax.study.analysis import analyse
    from pgf_jax.study.records import read_people

    found = analyse(design, read_people(design))
    if not found.participants:
        raise BadInput(f"{config.folder}: no participant has done all blocks yet")
    out = config.out or config.folder / "analysis"
    analysis_report.show(design, found)
    analysis_report.write(design, found, out)
    print(f"{out}: written")


def _what_if(config: StudyConfig, design: Design) -> None:
    from pgf_jax import jax_setup
    from pgf_jax.study import what_if
    from pgf_jax.study.records import read_people

    jax_setup.configure()
    with _progress() as say:
        found = what_if.what_if(design, read_people(design), config.policies, say)
    what_if.show(found)


@contextlib.contextmanager
def _progress() -> Iterator[Any]:
    """A function that shows what has been done so far, on standard error."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=None)
        yield lambda text: shown.update(task, description=text)
