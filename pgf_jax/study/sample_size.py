"""How many participants a study needs: estimated from simulated ones before the first real one.

Simulated participants differ in how long their services take: each has a pace of their own. They
give the inputs of the operator `heuristic`. What people differ in besides (which push, attention,
fatigue) is not simulated, so that real differences spread more: take it as the least.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import NormalDist

from rich.console import Console
from rich.table import Table

from pgf_jax.fleet.service import LogNormal
from pgf_jax.streams import stream
from pgf_jax.study.analysis import MEASURES, Difference, Measured, difference_of
from pgf_jax.study.design import Design
from pgf_jax.study.orders import balanced_orders
from pgf_jax.study.simulated import Simulated, run_blocks

PACE_SD = 0.25  # of the logarithm of a person's pace
POWER, LEVEL = 0.8, 0.05
_SHOWN = ("task_time_s", "success", "solved_per_hour")


@dataclasses.dataclass(frozen=True)
class Needed:
    """How many participants show the difference of two conditions.

    Attributes:
      difference: as simulated.
      participants: that find it with a probability of 80 %, at the level of 5 % (two-sided), as
        many as balance the orders; None: there is no difference, or there are too few to say.
    """

    difference: Difference
    participants: int | None


def sample_size(
    design: Design, participants: int, said: Callable[[int], None] = lambda count: None
) -> list[Needed]:
    """Simulate participants, and estimate how many real ones are needed.

    Args:
      design: of the study.
      participants: that are simulated, two or more.
      said: told how many blocks have ended.
    """
    blocks = []
    for number in range(participants):
        pace = math.exp(PACE_SD * stream(0, "pace", number).standard_normal())
        for place, block in enumerate(design.blocks_of(number), 1):
            config = design.session(block, Path())
            person = LogNormal(number, pace * config.service_mean, pace * config.service_sd)
            label = number + 1, place, list(design.conditions)[block.condition]
            blocks.append(Simulated(config, person, label=label))
    measured = [
        Measured(who, place, condition, name, value)
        for done in run_blocks(blocks, said)
        for who, place, condition in [done.block.label]
        for name, value in done.measures.items()
    ]
    return [
        Needed(found, needed(found.effect, len(balanced_orders(len(names)))))
        for names in [list(design.conditions)]
        for measure in _SHOWN
        for i, baseline in enumerate(names)
        for found in [difference_of(measured, measure, c, baseline) for c in names[i + 1 :]]
    ]


def needed(effect: float, orders: int) -> int | None:
    """Participants that show an effect (d_z) in a paired t-test, as a multiple of the orders.

    By Guenther's correction of the normal approximation (Guenther 1981, The American Statistician
    35, 243): n = ((z_a + z_b) / d)^2 + z_a^2 / 2.
    """
    if not math.isfinite(effect) or effect == 0:
        return None
    normal = NormalDist()
    z_a, z_b = normal.inv_cdf(1 - LEVEL / 2), normal.inv_cdf(POWER)
    n = ((z_a + z_b) / abs(effect)) ** 2 + z_a**2 / 2
    return orders * math.ceil(max(n, 2) / orders)


def show(found: Sequence[Needed], participants: int) -> None:
    """Print how many participants each difference needs."""
    table = Table("measure", "difference", "mean (95 %)", "d_z", "participants", box=None)
    for one in found:
        d = one.difference
        interval = f"{d.difference.mean:.2f} ({d.difference.low:.2f}..{d.difference.high:.2f})"
        number = "-" if one.participants is None else str(one.participants)
        words = f"{d.condition} - {d.baseline}"
        table.add_row(MEASURES[d.measure], words, interval, f"{d.effect:.2f}", number)
    Console().print(table)
    print(f"from {participants} simulated participants; for a power of {POWER:.0%} at {LEVEL:.0%}.")
    print("People differ in more than their pace: take these numbers as the least.")
