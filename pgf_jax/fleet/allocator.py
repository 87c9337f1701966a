"""The allocator (Alg. 2): which of the robots that ask is given which operator.

Three disciplines with one interface. None of them knows the time: the simulator says when a robot
asks, when an operator is freed and when a window closes.
"""

import enum
import math
from typing import Protocol

from pgf_jax.fleet.policies import Discipline
from pgf_jax.streams import stream


class AskOutcome(enum.Enum):
    """What becomes of an ask at the instant it is made."""

    IGNORED = enum.auto()  # nobody is free and no window open: it does not count as an ask
    REFUSED = enum.auto()
    WAITS = enum.auto()  # in the open window, or in line
    OPENS = enum.auto()  # waits in the window that it has just opened


class Allocator(Protocol):
    """One discipline. `free` is always the number of operators free at that instant."""

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """A robot that is not waiting asks."""
        ...

    def withdraw(self, robot: int) -> None:
        """A waiting robot has run out of time."""
        ...

    def match(self, *, free: int) -> list[int]:
        """Robots to serve now, best first; after an ask, and when an operator is freed."""
        ...

    def close(self, *, free: int) -> tuple[list[int], list[int]]:
        """The window closes: (winners, best first; losers, by robot)."""
        ...


class FifoQueue:
    """First come, first served; asks at one instant come in the order of D8, by robot."""

    def __init__(self) -> None:
        self.waiting: list[int] = []

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Joins the line; `match` serves it at once when an operator is free."""
        self.waiting.append(robot)
        return AskOutcome.WAITS

    def withdraw(self, robot: int) -> None:
        """Leaves the line."""
        self.waiting.remove(robot)

    def match(self, *, free: int) -> list[int]:
        """The head of the line, as long as operators are free."""
        served, self.waiting = self.waiting[:free], self.waiting[free:]
        return served

    def close(self, *, free: int) -> tuple[list[int], list[int]]:
        """Never called: no window is ever opened."""
        raise AssertionError("a line has no windows")


class LossSystem(FifoQueue):
    """A line in which nobody waits: granted at once or refused."""

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Refused while all operators are busy."""
        return super().ask(robot, bid, free=free) if free else AskOutcome.REFUSED


class Window:
    """Alg. 2: bids are gathered in a fleet-wide window and the highest win when it closes.

    With m operators free at the close the m highest win (several operators: D7; the paper has one).
    Ties fall by a random key of (seed, window number, robot), so that the outcome of a tie depends
    neither on the order of the bids nor on who else is in the window.
    """

    def __init__(self, *, seed: int, robots: int) -> None:
        self.bids: dict[int, float] = {}
        self.is_open = False
        self._seed = seed
        self._robots = robots
        self._number = 0

    def ask(self, robot: int, bid: float, *, free: int) -> AskOutcome:
        """Joins the open window, or opens one if an operator is free."""
        if math.isnan(bid):
            raise ValueError(f"robot {robot} bids nan, which no order of bids can hold")
        opens = not self.is_open
        if opens and not free:
            return AskOutcome.IGNORED
        self.is_open = True
        self.bids[robot] = bid
        return AskOutcome.OPENS if opens else AskOutcome.WAITS

    def withdraw(self, robot: int) -> None:
        """Takes the bid back; the window stays open, even empty."""
        del self.bids[robot]

    def match(self, *, free: int) -> list[int]:
        """Nobody: winners are known only when the window closes."""
        return []

    def close(self, *, free: int) -> tuple[list[int], list[int]]:
        """The `free` highest bids win."""
        keys = stream(self._seed, "window", self._number).random(self._robots)  # [R]
        ranked = sorted(self.bids, key=lambda robot: (-self.bids[robot], keys[robot]))
        self.bids, self.is_open, self._number = {}, False, self._number + 1
        return ranked[:free], sorted(ranked[free:])


def make_allocator(discipline: Discipline, *, seed: int, robots: int) -> Allocator:
    """The allocator of a discipline, with nobody waiting."""
    if discipline is Discipline.WINDOW:
        return Window(seed=seed, robots=robots)
    return FifoQueue() if discipline is Discipline.LINE else LossSystem()
