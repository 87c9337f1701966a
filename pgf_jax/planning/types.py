"""What planner, operators and fleet say to each other; no JAX here, so that imports stay light."""

import dataclasses
import enum

LOOK_AHEAD = 10  # l, in reach iterations: how far on a gain is predicted, and help is judged


class Status(enum.StrEnum):
    """How a task ended. Failure is data: nothing raises."""

    SOLVED = "solved"
    TIMED_OUT = "timed_out"
    STUCK = "stuck"  # out of time while stuck
    NON_FINITE = "non_finite"
    CENSORED = "censored"  # cut off by the horizon


@dataclasses.dataclass(frozen=True)
class Push:
    """Human input: push object number `object` (0-based) until its centre is at (x, y), metres.

    "Go on reaching", the other possible input, is `None`; that none came, `UNANSWERED`.
    """

    object: int
    x: float
    y: float


class NoInput(enum.Enum):
    """What comes of a service in which the operator says nothing."""

    UNANSWERED = "unanswered"


UNANSWERED = NoInput.UNANSWERED
