"""Fleets without physics: robots whose iterations come from a function.

Use them to try a policy in seconds, for queueing studies and for tests.

    robots = StubRobots(lambda work: outcome(gain=work.iteration))
    fleet = Fleet(FleetConfig(robots=4), robots)
    drive([(fleet, robots)])
"""

import dataclasses
import math
from collections.abc import Callable, Iterable

from pgf_jax.fleet.robots import CheckResult, IterationResult, ReachResult, Result, Work, WorkKind
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.planning.types import Push
from pgf_jax.streams import stream


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
      discarded: number of items that were discarded.
      verified, misses: see `Robots`.
    """

    def __init__(
        self,
        iterate: Callable[[Work], IterationResult],
        decide: Callable[[Work], Push | None] = lambda work: None,
        *,
        check: Callable[[Work], CheckResult] | None = None,
        reach: Callable[[Work], ReachResult] | None = None,
    ) -> None:
        """Set the functions for the kinds of work; each must depend on the item alone.

        Args:
          iterate: for ITERATION.
          decide: for INPUT.
          check: for CHECK; None: checks have no outcome. See `missed_checks`.
          reach: for REACH; None: a reach cannot miss. See `missed_grasps`.
        """
        self.verified, self.misses = check is not None, reach is not None
        self.discarded = 0
        self._iterate = iterate
        self._decide = decide
        self._check = check
        self._reach = reach
        self.calls: list[tuple[str, int, int | Push | None]] = []

    def request(self, work: Work) -> None:
        """Nothing: a result depends on the item alone."""

    def end(self, work: Work) -> None:
        """Nothing: these robots have no state."""

    def discard(self, work: Work) -> None:
        """Count the item."""
        self.discarded += 1

    def begin(self, robot: int, task: int) -> None:
        """Record the call."""
        self.calls.append(("begin", robot, task))

    def start_push(self, robot: int, push: Push) -> None:
        """Record the call."""
        self.calls.append(("start_push", robot, push))

    def drop_push(self, robot: int, *, keep: bool = False) -> None:
        """Record the call."""
        self.calls.append(("drop_push", robot, None))

    def go_on(self, robot: int) -> None:
        """Record the call."""
        self.calls.append(("go_on", robot, None))

    def compute(self, work: Work) -> Result:
        """The result of a work item."""
        match work.kind:
            case WorkKind.ITERATION:
                return self._iterate(work)
            case WorkKind.INPUT:
                return self._decide(work)
            case WorkKind.CHECK:
                assert self._check is not None
                return self._check(work)
            case WorkKind.REACH:
                assert self._reach is not None
                return self._reach(work)
            case WorkKind.RETREAT:
                return None


def missed_checks(
    iterate: Callable[[Work], IterationResult],
    probability: float,
    *,
    candidates: int = 3,
    seed: int = 0,
) -> Callable[[Work], CheckResult]:
    """Make checks that miss with a probability, each by a stream of its own.

    Args:
      iterate: the robots' own; its result for the iteration is the outcome of the iteration's
        checks, too, but for `feasible` and for the gain after a check that passed.
      probability: that a check misses.
      candidates: most checks of an iteration; how many it has is drawn from 1 to this number.
      seed: of the draws.
    """

    def check(work: Work) -> CheckResult:
        assert work.check is not None
        key = (work.robot, work.task, work.iteration)
        number = int(stream(seed, "feasible", *key).integers(1, candidates + 1))
        passed = bool(stream(seed, "check", *key, work.check).random() >= probability)
        result = iterate(dataclasses.replace(work, kind=WorkKind.ITERATION, check=None))
        return CheckResult(
            passed=passed,
            more=not passed and work.check + 1 < number,
            result=dataclasses.replace(
                result, feasible=passed, gain=math.nan if passed else result.gain
            ),
        )

    return check


def missed_grasps(probability: float, *, seed: int = 0) -> Callable[[Work], ReachResult]:
    """Make reaches that miss with a probability, each by a stream of its own."""

    def reach(work: Work) -> ReachResult:
        draws = stream(seed, "grasp", work.robot, work.task, work.iteration).random(2)
        grasped = bool(draws[0] >= probability)
        return ReachResult(grasped, 0.0 if grasped else 0.1 * float(draws[1]))

    return reach


def drive(fleets: Iterable[tuple[Fleet, StubRobots]]) -> None:
    """Run fleets to their ends; in each round, the work of all fleets is one batch."""
    fleets = list(fleets)
    while any(not fleet.done for fleet, _ in fleets):
        batch = [(fleet, robots, work) for fleet, robots in fleets for work in fleet.advance()]
        for fleet, robots, work in batch:
            fleet.deliver(work, robots.compute(work))
