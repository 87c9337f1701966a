"""Small types that planner, operators and fleet exchange; no JAX here, so that imports are fast."""

import dataclasses
import enum

LOOK_AHEAD = 10  # l, in reach iterations: how far on a gain is predicted, and help is judged


class Status(enum.StrEnum):
    """How a task ended. A failure is a result like any other, and raises nothing."""

    SOLVED = "solved"
    TIMED_OUT = "timed_out"
    STUCK = "stuck"  # out of time while stuck
    NON_FINITE = "non_finite"
    CENSORED = "censored"  # cut off by the horizon


@dataclasses.dataclass(frozen=True)
class Push:
    """Human input: push object number `object` (0-based) until its centre is at (x, y), metres.

    The other possible input, "go on reaching", is `None`; an operator who gave no input is
    `UNANSWERED`.
    """

    object: int
    x: float
    y: float


class NoInput(enum.Enum):
    """Result of a service in which the operator gave no input."""

    UNANSWERED = "unanswered"


UNANSWERED = NoInput.UNANSWERED
