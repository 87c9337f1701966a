"""The operator protocols, and the coroutine that asks an operator for its input."""

from typing import TYPE_CHECKING, Protocol

from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.types import Push

if TYPE_CHECKING:  # the planner needs JAX, and the command line lists the operators
    from pgf_jax.batching.requests import Coroutine
    from pgf_jax.planning.planner import BatchPlanner, Search


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
        return (yield from deliberate(view, search, planner, decision_key))
    assert hasattr(operator, "decide"), f"{operator.name}: has no method decide or deliberate"
    return operator.decide(view)  # pyright: ignore[reportAttributeAccessIssue]
