"""Allocators: which of the robots that ask is given which operator (Alg. 2).

There are three disciplines with one interface. An allocator does not know the time: the simulator
tells it when a robot asks, when an operator is freed and when a window closes.
"""

import enum
import math
from typing import Protocol

from pgf_jax.fleet.policies import Discipline
from pgf_jax.streams import stream


class AskOutcome(enum.Enum):
    """The outcome of an ask at the instant at which it is made."""

    IGNORED = enum.auto()  # no operator is free and no window open: it does not count as an ask
    REFUSED = enum.auto()
    WAITS = enum.auto()  # in the open window, or in line
    OPENS_WINDOW = enum.auto()  # waits in the window that it has just opened


class Allocator(Protocol):
    """Assigns free operators to robots that ask. `free` is the number of operators free now."""

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Take the ask of a robot that is not waiting."""
        ...

    def withdraw(self, robot: int) -> None:
        """Remove a waiting robot, which has run out of time."""
        ...

    def match(self, *, free: int) -> list[int]:
        """Robots to serve now, best first; called after an ask and when an operator is freed."""
        ...

    def close_window(self, *, free: int) -> tuple[list[int], list[int]]:
        """Close the window; returns (winners, best first; losers, by robot)."""
        ...


class FifoQueue:
    """First come, first served; simultaneous asks come in the order of the robots."""

    def __init__(self) -> None:
        self.waiting: list[int] = []

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Put the robot at the end of the queue; `match` serves it at once if it can."""
        self.waiting.append(robot)
        return AskOutcome.WAITS

    def withdraw(self, robot: int) -> None:
        """Remove the robot from the queue."""
        self.waiting.remove(robot)

    def match(self, *, free: int) -> list[int]:
        """The first `free` robots of the queue."""
        served, self.waiting = self.waiting[:free], self.waiting[free:]
        return served

    def close_window(self, *, free: int) -> tuple[list[int], list[int]]:
        """Never called: no window is ever opened."""
        raise AssertionError("a queue has no windows")


class LossSystem(FifoQueue):
    """A queue in which nobody waits: an ask is granted at once or refused."""

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Refuse the robot while all operators are busy."""
        return super().ask(robot, bid, free=free) if free else AskOutcome.REFUSED


class BidWindow:
    """A fleet-wide window that collects bids; the highest wins when it closes (Alg. 2).

    With m operators free at that time, the m highest win (the paper has one operator). Ties are
    broken by a random key of (seed, window number, robot), so that the outcome of a tie depends
    neither on the order of the bids nor on the other robots in the window.
    """

    def __init__(self, *, seed: int, robots: int) -> None:
        self.bids: dict[int, float] = {}
        self.is_open = False
        self._seed = seed
        self._robots = robots
        self._number = 0

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Put the bid into the open window, or open one if an operator is free."""
        if math.isnan(bid):
            raise ValueError(f"robot {robot} bids nan, expected a number that can be ordered")
        opens = not self.is_open
        if opens and not free:
            return AskOutcome.IGNORED
        self.is_open = True
        self.bids[robot] = bid
        return AskOutcome.OPENS_WINDOW if opens else AskOutcome.WAITS

    def withdraw(self, robot: int) -> None:
        """Remove the robot's bid; the window stays open, even if it is empty."""
        del self.bids[robot]

    def match(self, *, free: int) -> list[int]:
        """Nobody: winners are known only when the window closes."""
        return []

    def close_window(self, *, free: int) -> tuple[list[int], list[int]]:
        """Close the window: the `free` highest bids win."""
        keys = stream(self._seed, "window", self._number).random(self._robots)  # [R]
        ranked = sorted(self.bids, key=lambda robot: (-self.bids[robot], keys[robot]))
        self.bids, self.is_open, self._number = {}, False, self._number + 1
        return ranked[:free], sorted(ranked[free:])


def make_allocator(discipline: Discipline, *, seed: int, robots: int) -> Allocator:
    """A new allocator of the given discipline."""
    match Discipline(discipline):
        case Discipline.WINDOW:
            return BidWindow(seed=seed, robots=robots)
        case Discipline.LINE | Discipline.INDEX:  # whom an index chooses waits no time in line
            return FifoQueue()
        case Discipline.REFUSE:
            return LossSystem()
