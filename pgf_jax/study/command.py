"""The command `pgf-jax study`."""

from rich.console import Console
from rich.table import Table

from pgf_jax.study.config import StudyConfig
from pgf_jax.study.design import Design, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.orders import balanced_orders
from pgf_jax.study.progress import steps_of


def study(config: StudyConfig) -> None:
    """Do what the settings say.

    Raises:
      BadInput: the folder cannot be written, or is not that of a study.
    """
    if config.what == "init":
        write_example(config.folder)
        print(f"{config.folder}: written; change it, then pgf-jax study check {config.folder}")
    else:
        _say(load_design(config.folder))


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
