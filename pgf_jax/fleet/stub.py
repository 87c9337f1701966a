"""Fleets without physics: robots whose iterations come from a function.

Use them to try a policy in seconds, for queueing studies and for tests.

    robots = StubRobots(lambda work: outcome(gain=work.iteration))
    fleet = Fleet(FleetConfig(robots=4), robots)
    drive([(fleet, robots)])
"""

import math
from collections.abc import Callable, Iterable

from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.planning.types import Push


def outcome(
    *,
    feasible: bool = False,
    stuck: bool = False,
    gain: float = math.nan,
    cost: float = 100.0,
    non_finite: bool = False,
    saturated: int = 0,
) -> IterationResult:
    """Make an iteration's result; its whole cost is the term c_d."""
    terms = (cost, 0.0, 0.0)
    return IterationResult(feasible, stuck, gain, terms, cost, non_finite, saturated)


class StubRobots:
    """Robots whose results are functions of the work item; they implement `Robots`.

    Attributes:
      calls: every call of a `Robots` method: (name, robot, argument or None).
    """

    def __init__(
        self,
        iterate: Callable[[Work], IterationResult],
        decide: Callable[[Work], Push | None] = lambda work: None,
    ) -> None:
        """Set the functions for ITERATION and INPUT; both must depend on the item alone."""
        self._iterate = iterate
        self._decide = decide
        self.calls: list[tuple[str, int, int | Push | None]] = []

    def begin(self, robot: int, task: int) -> None:
        """Record the call."""
        self.calls.append(("begin", robot, task))

    def start_push(self, robot: int, push: Push) -> None:
        """Record the call."""
        self.calls.append(("start_push", robot, push))

    def drop_push(self, robot: int) -> None:
        """Record the call."""
        self.calls.append(("drop_push", robot, None))

    def go_on(self, robot: int) -> None:
        """Record the call."""
        self.calls.append(("go_on", robot, None))

    def compute(self, work: Work) -> IterationResult | Push | None:
        """The result of a work item."""
        if work.kind is WorkKind.ITERATION:
            return self._iterate(work)
        return self._decide(work) if work.kind is WorkKind.INPUT else None


def drive(fleets: Iterable[tuple[Fleet, StubRobots]]) -> None:
    """Run fleets to their ends; in each round, the work of all fleets is one batch."""
    fleets = list(fleets)
    while any(not fleet.done for fleet, _ in fleets):
        batch = [(fleet, robots, work) for fleet, robots in fleets for work in fleet.advance()]
        for fleet, robots, work in batch:
            fleet.deliver(work, robots.compute(work))
