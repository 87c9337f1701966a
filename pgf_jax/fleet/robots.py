"""The interface between a fleet and its robots: work items, results and the robots' methods."""

import dataclasses
import enum
from typing import NamedTuple, Protocol

from pgf_jax.planning.types import NoInput, Push


class WorkKind(enum.StrEnum):
    """What a robot's computer, or its operator, has to do."""

    ITERATION = "iteration"  # one planner iteration of the current segment -> IterationResult
    # Execute the push found, or leave the reach that missed; retract, restart reaching from there
    # -> None.
    RETREAT = "retreat"
    # The operator's input for the robot's present state -> Push, None: go on, or UNANSWERED.
    INPUT = "input"
    # Roll the next feasible candidate of the last iteration out in the world -> CheckResult.
    CHECK = "check"
    REACH = "reach"  # execute the reach in the world where the robot acts -> ReachResult


@dataclasses.dataclass(frozen=True)
class Work:
    """A work item; its result depends on (seed, robot, task, iteration) alone.

    Attributes:
      robot: 0-based.
      task: 0-based, counted by robot.
      kind: what has to be done.
      iteration: ITERATION: its number over the whole task, iteration 0s of every segment included;
        CHECK: the number of the iteration whose candidates are checked; otherwise the number of
        iterations of the task that have ended.
      request: INPUT: number of the service, 0-based; otherwise None. An input is a work item
        because an operator may try candidate pushes by rollouts, which are computed in the batch
        that all robots share; an operator that needs no rollouts answers at once.
      check: CHECK: number of the check within its iteration, 0-based; otherwise None.
      broken_off: iterations and checks of the task that were broken off before; the result does not
        depend on it. It tells such an item from the one that takes its number.
    """

    robot: int
    task: int
    kind: WorkKind
    iteration: int
    request: int | None = None
    check: int | None = None
    broken_off: int = 0


class TimeLeft(NamedTuple):
    """How long a reach will still take, as probabilities that it is not solved by then.

    Attributes:
      alone: [H] after 1, 2, ..., H more iterations without help.
      helped: [H] the same from the operator's answer on; planning of the push counts.
    """

    alone: tuple[float, ...]
    helped: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class IterationResult:
    """The outcome of an iteration, as far as the fleet needs it.

    Attributes:
      feasible: the best trajectory reaches the goal (or, pushing, brings the object to its target).
      stuck: the planner is stuck, by its stuck counter.
      gain: the number a robot may bid: phi_auto - phi_human, each clipped at 0; the true gain under
        `oracle-gain`, the predicted probability of failure under `classifier`; nan while the
        history is too short.
      terms: (c_d, c_f, c_b) of the best trajectory so far; pushing: (c_h, c_f, c_b).
      cost: total cost of the best trajectory so far.
      non_finite: some rollout's cost was not finite.
      saturated: rollouts with a knot end at which every contact slot was in use, so that contacts
        may have been left out.
      time_left: for policies that rank by time; None for the others, and while the history is too
        short.
    """

    feasible: bool
    stuck: bool
    gain: float
    terms: tuple[float, float, float]
    cost: float
    non_finite: bool = False
    saturated: int = 0
    time_left: TimeLeft | None = None


@dataclasses.dataclass(frozen=True)
class CheckResult:
    """The outcome of a check: a feasible candidate of an iteration, rolled out in the world.

    Attributes:
      passed: the candidate reaches the goal there, too.
      more: another feasible candidate of this iteration may be checked; matters after a miss only.
      result: the iteration's outcome as it stands after this check: `feasible` is `passed`; terms,
        cost and stuck are of the best trajectory that no check has refuted; the gain is nan unless
        the check missed. What its rollouts lost (`non_finite`, `saturated`) is not counted again.
    """

    passed: bool
    more: bool
    result: IterationResult


@dataclasses.dataclass(frozen=True)
class ReachResult:
    """The outcome of a reach that was executed.

    Attributes:
      grasped: the hand holds the goal: the task is solved.
      distance_m: from the hand to the goal at its end, m.
    """

    grasped: bool
    distance_m: float


# Of a work item; see `WorkKind`.
Result = IterationResult | CheckResult | ReachResult | Push | NoInput | None


class Robots(Protocol):
    """The robots of one fleet. Their methods say what a robot plans, and when.

    After `begin`, `start_push`, `drop_push` and a RETREAT, the next ITERATION is the segment's
    iteration 0, the nominal's own rollout. An item is computed from the robot's state at its
    `request`, at any time until its result is needed, and changes the robot at its `end`.

    After the last check of an iteration has missed, its segment goes on: an operator may be asked,
    and the next ITERATION is not an iteration 0. After a missed REACH a RETREAT follows.

    The two properties stay as they are for as long as the robots live. Where both are False, a
    feasible reach is solved: its final check takes time and has no outcome, and no CHECK or REACH
    is asked for.
    """

    @property
    def verified(self) -> bool:
        """Whether checks have outcomes: a CHECK is asked for before a reach is executed."""
        ...

    @property
    def misses(self) -> bool:
        """Whether a reach may miss when it is executed: a REACH is asked for."""
        ...

    def request(self, work: Work) -> None:
        """Take a work item, which is to be computed from the robot's state as it is now."""
        ...

    def end(self, work: Work) -> None:
        """Take the change of the robot that a work item computed: it has ended in simulated time.

        Its result has been delivered. Between `request` and `end` the robot is as it was before.
        """
        ...

    def discard(self, work: Work) -> None:
        """Do without a work item, which may be computed already or not: it never ends."""
        ...

    def begin(self, robot: int, task: int) -> None:
        """Begin task number `task`: a new scene and a reach segment."""
        ...

    def start_push(self, robot: int, push: Push) -> None:
        """Plan this push next."""
        ...

    def drop_push(self, robot: int, *, keep: bool = False) -> None:
        """Give the push up, and reach from the state before it.

        Args:
          robot: whose push it is.
          keep: go on with the search as it was before the push, with a cleared stuck counter; else
            with a new nominal and history.
        """
        ...

    def go_on(self, robot: int) -> None:
        """Go on reaching: keep the trajectory, clear the stuck counter.

        Called when the operator says so or does not answer; not called when the input comes before
        the task's first iteration (`always`). The authors' published code restarts with a new
        nominal instead.
        """
        ...
