"""The fleet's view of its robots: requests for work, results of work, and nothing of physics."""

import dataclasses
import enum
from typing import Protocol

from pgf_jax.planning.types import Push


class WorkKind(enum.StrEnum):
    """What a robot's computer is asked for."""

    ITERATION = "iteration"  # one planner iteration of the current segment
    RETREAT = "retreat"  # execute the push found, retract, restart reaching from there


@dataclasses.dataclass(frozen=True)
class Work:
    """A piece of pending work; its result depends on (seed, robot, task, iteration) alone."""

    robot: int
    task: int
    kind: WorkKind
    iteration: int  # counted over the whole task, iteration 0s of every segment included


@dataclasses.dataclass(frozen=True)
class IterationResult:
    """What the fleet may know of an iteration that has ended.

    Attributes:
      feasible: the best trajectory reaches the goal (or, pushing, brings the object to its target).
      stuck: the stuck counter says so (D4).
      gain: phi_auto - phi_human, each clipped at 0; nan while the history is too short.
      terms: (c_d, c_f, c_b) of the best trajectory so far; pushing: (c_h, c_f, c_b).
      cost: total cost of the best trajectory so far.
      non_finite: some rollout's cost was not finite.
    """

    feasible: bool
    stuck: bool
    gain: float
    terms: tuple[float, float, float]
    cost: float
    non_finite: bool = False


class Robots(Protocol):
    """The robots of one fleet. Every method but `decide` only changes which segment is planned.

    After `begin`, `start_push`, `drop_push` and a RETREAT, the next ITERATION is the segment's
    iteration 0, the nominal's own rollout.
    """

    def begin(self, robot: int, task: int) -> None:
        """Take task number `task`: a new scene, a reach segment."""
        ...

    def decide(self, robot: int, request: int) -> Push | None:
        """The operator's input for the robot as it stands; None is "go on reaching"."""
        ...

    def start_push(self, robot: int, push: Push) -> None:
        """Plan this push next."""
        ...

    def drop_push(self, robot: int) -> None:
        """Give the push up: back to the state before it, with a new reach nominal and history."""
        ...

    def go_on(self, robot: int) -> None:
        """Go on reaching: keep the trajectory, clear the stuck counter."""
        ...
