"""The operator protocols, and the coroutine that asks an operator for its input."""

import numbers
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.config import EDGE_X, EDGE_Y
from pgf_jax.planning.types import UNANSWERED, NoInput, Push

if TYPE_CHECKING:  # the planner needs JAX, and the command line lists the operators
    from pgf_jax.batching.requests import Coroutine
    from pgf_jax.planning.planner import BatchPlanner
    from pgf_jax.planning.search import Search


class Operator(Protocol):
    """Operator that decides from the view alone.

    The same view must give the same input: the operator has no state and no randomness of its own.
    An operator that needs rollouts is a `RolloutOperator`.
    """

    name: str

    def decide(self, view: View) -> Push | None:
        """Return a push, or None: go on reaching."""
        ...


class RolloutOperator(Protocol):
    """Operator that does rollouts first (`oracle`), in the same engine calls as the robots."""

    name: str

    def deliberate(
        self, view: View, search: "Search", planner: "BatchPlanner", decision_key: DecisionKey
    ) -> "Coroutine":
        """Coroutine that requests rollouts and returns a `Push`, or None: go on reaching.

        Args:
          view: of the robot.
          search: the robot's reach as it stands, where trials begin.
          planner: of the searches.
          decision_key: identifies the decision; the keys of trials are made of it.
        """
        ...


AnyOperator = Operator | RolloutOperator


class NoOperator:
    """Operator `none`: always says "go on reaching"."""

    name = "none"

    def decide(self, view: View) -> Push | None:
        """See `Operator.decide`."""
        return None


def ask_operator(
    operator: AnyOperator,
    view: View,
    search: "Search",
    planner: "BatchPlanner",
    decision_key: DecisionKey,
) -> "Coroutine":
    """Coroutine that returns an operator's input, whether the operator needs rollouts or not."""
    deliberate = getattr(operator, "deliberate", None)
    if deliberate is not None:
        given = yield from deliberate(view, search, planner, decision_key)
    else:
        given = operator.decide(view)  # pyright: ignore[reportAttributeAccessIssue]
    if getattr(operator, "checked", False):
        return given
    return check_input(getattr(operator, "name", type(operator).__name__), given, view)


def check_input(name: str, given: object, view: View) -> Push | NoInput | None:
    """Check what an operator gives, and return it, with Python's numbers in it.

    Raises:
      BadInput: one line that names the operator: it is no input, or its object or target is not on
        the shelf. A target is the object's centre, on the shelf where x is 0.20..0.58 m and y
        -0.38..0.38 m, as the cost's edge term has it.
    """
    if given is None or given is UNANSWERED:
        return given  # pyright: ignore[reportReturnType]
    if not isinstance(given, Push):
        raise BadInput(
            f"operator {name!r}: expected a Push(object, x, y), or None to go on reaching, got "
            f"{short_repr(given)}"
        )
    count = len(view.objects)
    if not isinstance(given.object, numbers.Integral) or not 0 <= given.object < count:
        raise BadInput(
            f"operator {name!r}: push of object {short_repr(given.object)}, expected one of "
            f"0..{count - 1}"
        )
    low, high = np.transpose([EDGE_X, EDGE_Y])
    try:
        target = np.array([given.x, given.y], float)
    except (TypeError, ValueError):
        target = np.full(2, np.nan)
    if not ((target >= low) & (target <= high)).all():
        raise BadInput(
            f"operator {name!r}: push to ({short_repr(given.x)}, {short_repr(given.y)}) m, which "
            f"is off the shelf; expected x within {EDGE_X[0]}..{EDGE_X[1]}, y within "
            f"{EDGE_Y[0]}..{EDGE_Y[1]}"
        )
    return Push(int(given.object), float(given.x), float(given.y))
