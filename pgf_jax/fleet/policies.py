"""Policies: when a robot asks for an operator, what it bids, and how asks are ordered.

A policy has no state: its answers depend on its arguments alone, so that no result depends on the
order in which fleets or batches are computed. To add a policy, register a factory:

    pgf_jax.register_policy("my-policy", lambda config: MyPolicy())
"""

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.robots import IterationResult
from pgf_jax.plugins.registry import Registry, caller


class Discipline(enum.StrEnum):
    """How asks are served; `allocator.py` has one class for each."""

    WINDOW = "window"  # Alg. 2: bids are collected in a window, the highest win at its end
    REFUSE = "refuse"  # granted at once or refused
    LINE = "line"  # first come, first served; robots wait
    INDEX = "index"  # robots do not ask: a free operator takes the one of highest index


class TaskProgress(NamedTuple):
    """The state of a robot's task that a policy may use."""

    robot: int
    task: int
    reach_iterations: int  # so far, iteration 0s not counted
    grants: int  # so far in this task
    remaining_s: float  # until the task's limit
    since_restart: int = 0  # reach iterations since the segment began or since the last input


class Policy(Protocol):
    """Says when a robot asks, and what it bids. None means: plan on without asking."""

    @property
    def discipline(self) -> Discipline:
        """How the asks are served."""
        ...

    @property
    def plans_on(self) -> bool:
        """Whether a robot plans while it asks and is served, unless the settings say."""
        ...

    def first_bid(self, progress: TaskProgress) -> float | None:
        """The bid before any planning of the task, or None."""
        ...

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """The bid after a reach iteration that is not feasible, or None; never nan.

        Called at the end of every such iteration, iteration 0 included; never while pushing.
        """
        ...


class PolicyBase:
    """Base class of policies: it never asks, neither before planning nor after an iteration."""

    plans_on: bool = False

    def first_bid(self, progress: TaskProgress) -> float | None:
        """None."""
        return None

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """None."""
        return None


# --- the policies -------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class BidGain(PolicyBase):
    """`pgf` (Alg. 2 and 3): bids the predicted gain if it exceeds the threshold; stuck: +inf.

    `oracle-gain` is the same policy with the true gain.
    """

    threshold: float
    discipline: Discipline = Discipline.WINDOW
    plans_on: bool = False

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """The gain; while the history is too short the gain is nan and there is no bid."""
        if result.stuck:
            return math.inf
        return result.gain if result.gain > self.threshold else None


@dataclasses.dataclass(frozen=True)
class AskWhenStuck(PolicyBase):
    """Asks when stuck: `or-hitl`, `or-hitl-window` and `queue`, by the discipline."""

    discipline: Discipline
    plans_on: bool = False

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """+inf while stuck."""
        return math.inf if result.stuck else None


@dataclasses.dataclass(frozen=True)
class AskBeforePlanning(PolicyBase):
    """`always`: asks once, before planning, and waits in line."""

    discipline: Discipline = Discipline.LINE

    def first_bid(self, progress: TaskProgress) -> float | None:
        """+inf."""
        return math.inf


@dataclasses.dataclass(frozen=True)
class NeverAsk(PolicyBase):
    """`autonomous`: never asks."""

    discipline: Discipline = Discipline.REFUSE


@dataclasses.dataclass(frozen=True)
class BidEqually(PolicyBase):
    """`random`: every robot that is still reaching bids the same, so that winners are random.

    A baseline that ignores how much a robot needs help; it is not in the paper.
    """

    discipline: Discipline = Discipline.WINDOW

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """Always 1: the window's random key breaks the ties."""
        return 1.0


@dataclasses.dataclass(frozen=True)
class BidOnPredictedFailure(PolicyBase):
    """`classifier`: bids when failure is predicted; the winner is random.

    `IterationResult.gain` holds the predicted probability of failure. Being stuck counts as a
    predicted failure, and all bids are equal.
    """

    probability: float = 0.5
    discipline: Discipline = Discipline.WINDOW

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """1 when failure is predicted."""
        return 1.0 if result.stuck or result.gain > self.probability else None


@dataclasses.dataclass(frozen=True)
class AskAfter(PolicyBase):
    """`after:N`: asks once N reach iterations have passed since the restart or the last input."""

    iterations: int
    discipline: Discipline = Discipline.REFUSE  # at once: the only robot has the operator to itself

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """+inf from iteration N after the restart or the last input."""
        return math.inf if progress.since_restart >= self.iterations else None


@dataclasses.dataclass(frozen=True)
class AskOnceAfter(PolicyBase):
    """`once-after:N`: asks once in a task, after its reach iteration N."""

    iterations: int
    discipline: Discipline = Discipline.REFUSE

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """+inf from iteration N until it is granted."""
        asks = progress.grants == 0 and progress.reach_iterations >= self.iterations
        return math.inf if asks else None


# --- policies by name ---------------------------------------------------------------------------


class PolicySettings(Protocol):
    """The settings that policies read; `FleetConfig` has them."""

    @property
    def policy(self) -> str:
        """Name of the policy."""
        ...

    @property
    def bid_threshold(self) -> float:
        """A gain must exceed it to be bid."""
        ...

    @property
    def rollout_time_s(self) -> float:
        """Simulated time of one rollout, s."""
        ...

    @property
    def service_mean_s(self) -> float:
        """Mean service time, s."""
        ...

    @property
    def service_sd_s(self) -> float:
        """Its standard deviation, s."""
        ...

    @property
    def while_served(self) -> str | None:
        """What a robot does while it is served; None: as its policy does."""
        ...

    @property
    def reservation(self) -> float | None:
        """Index that a robot must exceed, see `FleetConfig`."""
        ...

    @property
    def failure_cost_s(self) -> float:
        """What a task that is not solved costs, s; see `FleetConfig`."""
        ...


PolicyFactory = Callable[[PolicySettings], Policy]

POLICIES: Registry[PolicyFactory] = Registry(
    "policy",
    {
        "pgf": lambda config: BidGain(config.bid_threshold),
        "pgf+plan": lambda config: BidGain(config.bid_threshold, plans_on=True),
        "or-hitl": lambda config: AskWhenStuck(Discipline.REFUSE),
        "or-hitl+plan": lambda config: AskWhenStuck(Discipline.REFUSE, plans_on=True),
        "or-hitl-window": lambda config: AskWhenStuck(Discipline.WINDOW),
        "always": lambda config: AskBeforePlanning(),
        "autonomous": lambda config: NeverAsk(),
        "random": lambda config: BidEqually(),
        "queue": lambda config: AskWhenStuck(Discipline.LINE),
        "oracle-gain": lambda config: BidGain(config.bid_threshold),
        "classifier": lambda config: BidOnPredictedFailure(),
    },
)


def policy_names() -> list[str]:
    """All registered names, the built-in ones first."""
    return POLICIES.names()


def register_policy(
    name: str, factory: PolicyFactory, *, version: str | None = None, replace: bool = False
) -> None:
    """Register a policy under a name, by which settings ask for it.

    Results are named by the source of the package that registers it, and by the settings of what
    the factory returns (its attributes). So changed code computes its cells again.

    Args:
      name: of the policy.
      factory: called with the fleet's settings; returns a `Policy`.
      version: stands for the source where that cannot be seen; raise it when results change.
      replace: take the place of the policy that has this name.

    Raises:
      BadInput: the name is taken; or neither a source nor a version is there.
    """
    POLICIES.register(name, factory, caller=caller(), version=version, replace=replace)


def check_policy(name: str, field: str = "policy") -> None:
    """BadInput, with the name of a setting, unless a policy of that name is registered."""
    POLICIES.check(name, field)


def make_policy(config: PolicySettings) -> Policy:
    """The policy that `config.policy` names.

    Raises:
      BadInput: there is none, or what was registered is no policy.
    """
    policy = POLICIES.make(config.policy)(config)
    return (
        policy if POLICIES.plugin(config.policy) is None else CheckedPolicy(config.policy, policy)
    )


class CheckedPolicy:
    """A policy of a plugin, whose answers are checked; what it gets wrong is one line.

    Args:
      name: of the policy.
      policy: the plugin's.

    Raises:
      BadInput: it is no policy, or answers with something else than a number or None.
    """

    def __init__(self, name: str, policy: Any) -> None:
        self.policy, self._words = policy, f"policy {name!r}"
        for method in ("first_bid", "bid"):
            if not callable(getattr(policy, method, None)):
                raise BadInput(
                    f"{self._words}: {short_repr(policy)} has no method {method}; derive it from "
                    "PolicyBase"
                )
        given = getattr(policy, "discipline", None)
        if given == Discipline.INDEX and not callable(getattr(policy, "index", None)):
            raise BadInput(f"{self._words}: {short_repr(policy)} has no method index")
        if given not in list(Discipline):
            raise BadInput(
                f"{self._words}: discipline: expected one of {', '.join(Discipline)}, got "
                f"{short_repr(given)}"
            )
        self.discipline = Discipline(given)
        self.plans_on = bool(getattr(policy, "plans_on", False))

    def first_bid(self, progress: TaskProgress) -> float | None:
        """See `Policy.first_bid`."""
        return self._checked("first_bid", self.policy.first_bid(progress))

    def bid(self, result: IterationResult, progress: TaskProgress) -> float | None:
        """See `Policy.bid`."""
        return self._checked("bid", self.policy.bid(result, progress))

    def index(self, robots: Sequence[Any]) -> list[float | None]:
        """See `index.IndexPolicy.index`."""
        found = self.policy.index(robots)
        try:
            values = list(found)
        except TypeError:  # no sequence
            values = None
        if values is None or len(values) != len(robots):
            raise BadInput(
                f"{self._words}: index: expected {len(robots)} numbers, one a robot, got "
                f"{short_repr(found)}"
            )
        return [self._checked("index", value) for value in values]

    def _checked(self, method: str, bid: Any) -> float | None:
        if bid is None:
            return None
        # NumPy's and JAX's numbers are taken; a boolean is a mistake for None.
        if not isinstance(bid, bool) and getattr(bid, "ndim", 0) == 0 and hasattr(bid, "__float__"):
            number = float(bid)
            if not math.isnan(number):
                return number
        raise BadInput(f"{self._words}: {method}: expected a number or None, got {short_repr(bid)}")


def after(iterations: int) -> str:
    """Register `AskAfter(iterations)` where needed; returns its name."""
    return _registered(f"after:{iterations}", AskAfter(iterations))


def once_after(iterations: int) -> str:
    """Register `AskOnceAfter(iterations)` where needed; returns its name."""
    return _registered(f"once-after:{iterations}", AskOnceAfter(iterations))


def check_ask(text: str) -> int:
    """The N of `after:N`, 0 for `stuck`, `gain` and `never`; BadInput for anything else."""
    if text in ("stuck", "gain", "never"):
        return 0
    name, _, number = str(text).partition(":")
    # isdecimal alone accepts digits of other scripts; int() accepts '1_0' and ' 3'. The length is
    # limited because int() fails on thousands of digits.
    if name == "after" and number.isascii() and number.isdecimal() and len(number) < 19:
        return int(number)
    raise BadInput(
        f"ask: expected stuck, gain, never or after:N with N >= 0, got {short_repr(text)}"
    )


def _registered(name: str, policy: Policy) -> str:
    POLICIES.add_built_in(name, lambda config: policy)
    return name
