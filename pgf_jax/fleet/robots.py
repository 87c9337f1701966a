"""The fleet's view of its robots: requests for work, results of work, and nothing of physics."""

import dataclasses
import enum
from typing import Protocol

from pgf_jax.planning.types import NoInput, Push


class WorkKind(enum.StrEnum):
    """What a robot's computer, or its operator, is asked for."""

    ITERATION = "iteration"  # one planner iteration of the current segment -> IterationResult
    RETREAT = "retreat"  # execute the push found, retract, restart reaching from there -> None
    # What the operator says of the robot as it stands -> Push, None: go on, or UNANSWERED.
    INPUT = "input"


@dataclasses.dataclass(frozen=True)
class Work:
    """A piece of pending work; its result depends on (seed, robot, task, iteration) alone.

    Attributes:
      robot: 0-based.
      task: 0-based, counted by robot.
      kind: what to do.
      iteration: ITERATION: its number over the whole task, iteration 0s of every segment included;
        otherwise how many iterations of the task have ended.
      request: INPUT: number of the service, 0-based; otherwise None. An input is work because an
        operator may try candidate pushes by rollouts, which belong in the shared batch (D8); one
        that needs no rollouts answers at once.
    """

    robot: int
    task: int
    kind: WorkKind
    iteration: int
    request: int | None = None


@dataclasses.dataclass(frozen=True)
class IterationResult:
    """What the fleet may know of an iteration that has ended.

    Attributes:
      feasible: the best trajectory reaches the goal (or, pushing, brings the object to its target).
      stuck: the stuck counter says so (D4).
      gain: the number a robot may bid: phi_auto - phi_human, each clipped at 0; the true gain under
        `oracle-gain`, the predicted probability of failure under `classifier`; nan while the
        history is too short.
      terms: (c_d, c_f, c_b) of the best trajectory so far; pushing: (c_h, c_f, c_b).
      cost: total cost of the best trajectory so far.
      non_finite: some rollout's cost was not finite.
      saturated: rollouts with a knot end at which every contact slot was in use, so that contacts
        may have been left out.
    """

    feasible: bool
    stuck: bool
    gain: float
    terms: tuple[float, float, float]
    cost: float
    non_finite: bool = False
    saturated: int = 0


Result = IterationResult | Push | NoInput | None  # of a piece of work, by its kind


class Robots(Protocol):
    """The robots of one fleet. Every method only changes which segment is planned.

    After `begin`, `start_push`, `drop_push` and a RETREAT, the next ITERATION is the segment's
    iteration 0, the nominal's own rollout. A robot has at most one piece of work outstanding, and
    none of these methods is called for it while it has one; so work may be computed from the
    robot's state as it is when the work is handed out, or at any time until it is delivered.
    """

    def begin(self, robot: int, task: int) -> None:
        """Take task number `task`: a new scene, a reach segment."""
        ...

    def start_push(self, robot: int, push: Push) -> None:
        """Plan this push next."""
        ...

    def drop_push(self, robot: int) -> None:
        """Give the push up: back to the state before it, with a new reach nominal and history."""
        ...

    def go_on(self, robot: int) -> None:
        """Go on reaching: keep the trajectory, clear the stuck counter.

        Told to, or left alone by an operator who did not answer.
        Not called when the input comes before the task's first iteration (`always`): there is
        nothing to keep or to clear then.
        """
        ...
