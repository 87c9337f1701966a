"""Policies (D7): when a robot asks for the operator, what it bids, and how askers are ordered.

A policy is stateless: what it says depends on its arguments alone, so that no result depends on
the order in which fleets or batches are computed. To add one, register a factory:

    register_policy("after-5", lambda config: MyPolicy())
"""

import dataclasses
import enum
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.robots import IterationResult

if TYPE_CHECKING:  # config checks policy names, so it imports this module
    from pgf_jax.fleet.config import FleetConfig


class Discipline(enum.StrEnum):
    """How asks meet operators; `allocator.py` has one class for each."""

    WINDOW = "window"  # Alg. 2: bids inside a window, the highest win at its end
    REFUSE = "refuse"  # granted at once or refused
    LINE = "line"  # first come, first served; askers wait


class Progress(NamedTuple):
    """How far a robot is in its task when its policy is consulted."""

    robot: int
    task: int
    reach_iterations: int  # so far, iteration 0s not counted
    grants: int  # so far in this task
    remaining_s: float  # until the task's limit
    since_restart: int = 0  # reach iterations since the segment began or since the last input


class Policy(Protocol):
    """When to ask. None means: plan on without asking."""

    @property
    def discipline(self) -> Discipline:
        """How its asks meet the operators."""
        ...

    def first_bid(self, progress: Progress) -> float | None:
        """The bid before any planning of the task, or None."""
        ...

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """The bid after a reach iteration that is not feasible, or None; never nan.

        Consulted at the end of every such iteration, iteration 0 included; never while pushing.
        """
        ...


class Silent:
    """What most policies share: nothing is asked before planning, and, unless said, nor later."""

    def first_bid(self, progress: Progress) -> float | None:
        """None."""
        return None

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """None."""
        return None


@dataclasses.dataclass(frozen=True)
class Gain(Silent):
    """`pgf` (Alg. 2 and 3): bids the predicted gain when it exceeds the threshold; stuck: +inf.

    `oracle-gain` is the same policy on the true gain.
    """

    threshold: float
    discipline: Discipline = Discipline.WINDOW

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """The gain; nan, a history still too short, exceeds no threshold."""
        if result.stuck:
            return math.inf
        return result.gain if result.gain > self.threshold else None


@dataclasses.dataclass(frozen=True)
class WhenStuck(Silent):
    """Asks when stuck, all alike: `or-hitl`, `or-hitl-window` and `queue`, by the discipline."""

    discipline: Discipline

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """+inf while stuck."""
        return math.inf if result.stuck else None


@dataclasses.dataclass(frozen=True)
class Always(Silent):
    """`always`: asks once, before planning, and waits in line."""

    discipline: Discipline = Discipline.LINE

    def first_bid(self, progress: Progress) -> float | None:
        """+inf."""
        return math.inf


@dataclasses.dataclass(frozen=True)
class Autonomous(Silent):
    """`autonomous`: never asks."""

    discipline: Discipline = Discipline.REFUSE


@dataclasses.dataclass(frozen=True)
class Random(Silent):
    """`random`: every robot still reaching bids the same, so chance alone says who is helped.

    The design only names this policy: it is the comparison without any notion of need.
    """

    discipline: Discipline = Discipline.WINDOW

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """1, always: ties fall by the window's random key."""
        return 1.0


@dataclasses.dataclass(frozen=True)
class Classifier(Silent):
    """`classifier`: bids on predicted failure, winner at random.

    `IterationResult.gain` holds the predicted probability of failure. Being stuck counts as a
    predicted failure, and all bid the same.
    """

    probability: float = 0.5
    discipline: Discipline = Discipline.WINDOW

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """1 when failure is predicted."""
        return 1.0 if result.stuck or result.gain > self.probability else None


PolicyFactory = Callable[["FleetConfig"], Policy]


_POLICIES: dict[str, PolicyFactory] = {
    "pgf": lambda config: Gain(config.bid_threshold),
    "or-hitl": lambda config: WhenStuck(Discipline.REFUSE),
    "or-hitl-window": lambda config: WhenStuck(Discipline.WINDOW),
    "always": lambda config: Always(),
    "autonomous": lambda config: Autonomous(),
    "random": lambda config: Random(),
    "queue": lambda config: WhenStuck(Discipline.LINE),
    "oracle-gain": lambda config: Gain(config.bid_threshold),
    "classifier": lambda config: Classifier(),
}


def policy_names() -> tuple[str, ...]:
    """All registered names, the built-in ones first."""
    return tuple(_POLICIES)


def register_policy(name: str, factory: PolicyFactory) -> None:
    """Add a policy under a new name; ValueError if the name is taken."""
    if name in _POLICIES:
        raise ValueError(f"policy {name!r} is registered already")
    _POLICIES[name] = factory


def check_policy(name: str) -> None:
    """Raise BadInput unless `name` is registered."""
    if name not in _POLICIES:
        raise BadInput(f"policy must be one of {', '.join(_POLICIES)}, got {name!r}")


def make_policy(config: "FleetConfig") -> Policy:
    """The policy that `config.policy` names; BadInput if there is none."""
    check_policy(config.policy)
    return _POLICIES[config.policy](config)


@dataclasses.dataclass(frozen=True)
class AskAfter(Silent):
    """`after:N`: asks once N reach iterations have passed since the restart or the last input."""

    iterations: int
    discipline: Discipline = Discipline.REFUSE  # at once: the operator is all this robot's

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """+inf from iteration N of each stretch on."""
        return math.inf if progress.since_restart >= self.iterations else None


@dataclasses.dataclass(frozen=True)
class AskOnceAfter(Silent):
    """`once-after:N`: asks once in a task, after its reach iteration N."""

    iterations: int
    discipline: Discipline = Discipline.REFUSE

    def bid(self, result: IterationResult, progress: Progress) -> float | None:
        """+inf from iteration N on, until it is granted."""
        asks = progress.grants == 0 and progress.reach_iterations >= self.iterations
        return math.inf if asks else None


def after(iterations: int) -> str:
    """The name under which `After(iterations)` is registered."""
    return _named(f"after:{iterations}", AskAfter(iterations))


def once_after(iterations: int) -> str:
    """The name under which `Once(iterations)` is registered."""
    return _named(f"once-after:{iterations}", AskOnceAfter(iterations))


def _named(name: str, policy: Policy) -> str:
    if name not in policy_names():
        register_policy(name, lambda config: policy)
    return name


def check_ask(text: str) -> int:
    """The N of `after:N`, 0 for `stuck`, `gain` and `never`; BadInput for anything else."""
    if text in ("stuck", "gain", "never"):
        return 0
    name, _, number = str(text).partition(":")
    # isdecimal alone lets other scripts' digits through; int() would take '1_0' and ' 3'.
    # More digits would not be read as a number, nor be reached.
    if name == "after" and number.isascii() and number.isdecimal() and len(number) < 19:
        return int(number)
    raise BadInput(
        f"ask: expected stuck, gain, never or after:N with N >= 0, got {short_repr(text)}"
    )
