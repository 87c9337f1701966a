"""The command `pgf-jax study`."""

import asyncio
import contextlib
import signal

from rich.console import Console
from rich.table import Table

from pgf_jax.console.log_file import log_to
from pgf_jax.study.config import StudyConfig
from pgf_jax.study.design import Design, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.orders import balanced_orders
from pgf_jax.study.progress import steps_of
from pgf_jax.study.server import StudyServer

LOG = "server.log"


def study(config: StudyConfig) -> None:
    """Do what the settings say.

    Raises:
      BadInput: the folder cannot be written, or is not that of a study.
    """
    if config.what == "init":
        write_example(config.folder)
        print(f"{config.folder}: written; change it, then pgf-jax study check {config.folder}")
    elif config.what == "check":
        _say(load_design(config.folder))
    else:
        serve(config)


def serve(config: StudyConfig) -> None:
    """Serve a study until it is interrupted.

    Raises:
      BadInput: the folder is not that of a study, or the port is not free.
    """
    server = StudyServer(load_design(config.folder), config.at_once)
    log_to(config.folder / LOG, "pgf_jax")

    def ready(port: int) -> None:
        """Print the addresses; the tokens are shown here, and kept nowhere."""
        place = f"http://{config.host}:{port}"
        print(f"experimenter: {place}/x/{server.key}")
        for _ in range(config.participants):
            link = server.add()
            print(f"participant {len(server.visits)}: {place}{link}")
        print("Ctrl-C ends it; the same command goes on where it was", flush=True)

    async def run() -> None:
        running = asyncio.current_task()
        assert running is not None
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, running.cancel)
        with contextlib.suppress(asyncio.CancelledError):
            await server.run(config.host, config.port, ready)

    asyncio.run(run())


def _say(design: Design) -> None:
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
