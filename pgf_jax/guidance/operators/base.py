"""What an operator is, and how one is asked for its input."""

from typing import TYPE_CHECKING, Protocol

from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.types import Push

if TYPE_CHECKING:  # the planner needs JAX, and the command line lists the operators
    from pgf_jax.batching.requests import Coroutine
    from pgf_jax.planning.planner import BatchPlanner, Search


class Operator(Protocol):
    """Gives input. The same view must give the same input: no state, no randomness of its own.

    One that tries pushes by rollouts before it says anything is a `Deliberate`.
    """

    name: str

    def decide(self, view: View) -> Push | None:
        """Push an object somewhere, or None: go on reaching."""
        ...


class RolloutOperator(Protocol):
    """An operator that uses rollouts (`oracle`), in calls that it shares with the robots."""

    name: str

    def deliberate(
        self, view: View, search: "Search", planner: "BatchPlanner", at: DecisionKey
    ) -> "Coroutine":
        """What it asks of the computer; returns a `Push`, or None: go on reaching.

        Args:
          view: of the robot.
          search: its reach as it stands, where trials begin.
          planner: of the searches.
          at: whose turn it is, for the keys of trials.
        """
        ...


AnyOperator = Operator | RolloutOperator


def ask_operator(
    operator: AnyOperator, view: View, search: "Search", planner: "BatchPlanner", at: DecisionKey
) -> "Coroutine":
    """The operator's input as a deliberation, whether it needs rollouts or not."""
    deliberate = getattr(operator, "deliberate", None)
    if deliberate is not None:
        return (yield from deliberate(view, search, planner, at))
    assert hasattr(operator, "decide"), f"{operator.name}: neither decides nor deliberates"
    return operator.decide(view)  # pyright: ignore[reportAttributeAccessIssue]


class NoOperator:
    """Always says "go on reaching"."""

    name = "none"

    def decide(self, view: View) -> Push | None:
        """See `Operator.decide`."""
        return None
