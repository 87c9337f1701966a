"""Operators (D5): who gives the human input. A protocol and a registry."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.planning.types import Push

if TYPE_CHECKING:  # the planner needs JAX, and the command line lists the operators
    from pgf_jax.guidance.trials import Deliberation
    from pgf_jax.planning.planner import BatchPlanner, Search

At = tuple[int, int, int, int]  # seed, robot, task, iterations of the task that have ended


@dataclasses.dataclass(frozen=True)
class View:
    """What an operator sees of a robot: the shelf as it is, and the best trajectory so far.

    Attributes:
      objects: [N, 2] centres now, m.
      goal: index of the goal.
      hand: [3] hand pose now: base x, y (m), yaw (rad).
      gripper: 0 open .. 255 closed, now.
      path: [T, N, 2] centres at the knot ends of the best rollout, m; the present ones T times
        while nothing has been rolled out.
      hands: [T, 3] hand poses there.
      force: [T, C] contact forces there, N.
      bodies: [T, C, 2] who touches whom: 0..N-1 an object, N the hand, N+1 a wall.
      terms: [5] the best trajectory's c_d, c_f, c_b, c_e, c_s; inf before the first rollout.
      request: number of this input in its task, 0-based.
      dropped: pushes given since the shelf last changed that the planner could not do.
    """

    objects: np.ndarray
    goal: int
    hand: np.ndarray
    gripper: float
    path: np.ndarray
    hands: np.ndarray
    force: np.ndarray
    bodies: np.ndarray
    terms: np.ndarray
    request: int
    dropped: int

    @classmethod
    def of(cls, search: "Search", request: int = 0, dropped: int = 0) -> "View":
        """What there is to see of a search."""
        return cls(
            objects=np.asarray(search.start.objects),
            goal=int(search.task.goal),
            hand=np.asarray(search.start.hand),
            gripper=float(search.start.gripper),
            path=np.asarray(search.best.objects),
            hands=np.asarray(search.best.hand),
            force=np.asarray(search.best.force),
            bodies=np.asarray(search.best.bodies),
            terms=np.asarray(search.value.terms),
            request=request,
            dropped=dropped,
        )


class Operator(Protocol):
    """Gives input. The same view must give the same input: no state, no randomness of its own.

    One that tries pushes by rollouts before it says anything is a `Deliberate`.
    """

    name: str

    def decide(self, view: View) -> Push | None:
        """Push an object somewhere, or None: go on reaching."""
        ...


class Deliberate(Protocol):
    """An operator that uses rollouts (`oracle`), in calls that it shares with the robots."""

    name: str

    def deliberate(
        self, view: View, search: "Search", planner: "BatchPlanner", at: At
    ) -> "Deliberation":
        """What it asks of the computer; returns a `Push`, or None: go on reaching.

        Args:
          view: of the robot.
          search: its reach as it stands, where trials begin.
          planner: of the searches.
          at: whose turn it is, for the keys of trials.
        """
        ...


AnyOperator = Operator | Deliberate


def consult(
    operator: AnyOperator, view: View, search: "Search", planner: "BatchPlanner", at: At
) -> "Deliberation":
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


def _heuristic() -> AnyOperator:
    from pgf_jax.guidance.heuristic import HeuristicOperator  # needs the planner, so JAX

    return HeuristicOperator()


def _oracle() -> AnyOperator:
    from pgf_jax.guidance.oracle import OracleOperator

    return OracleOperator()


def _clairvoyant() -> AnyOperator:
    from pgf_jax.guidance.oracle import clairvoyant

    return clairvoyant()


def _noisy() -> AnyOperator:
    from pgf_jax.guidance.noisy import NoisyOperator

    return NoisyOperator()


_OPERATORS: dict[str, Callable[[], AnyOperator]] = {
    "none": NoOperator,
    "heuristic": _heuristic,
    "oracle": _oracle,
    "clairvoyant": _clairvoyant,
    "noisy": _noisy,
}


def register_operator(name: str, make: Callable[[], AnyOperator]) -> None:
    """Make `make()` available as `make_operator(name)`."""
    _OPERATORS[name] = make


def operator_names() -> list[str]:
    """Names that `make_operator` takes."""
    return sorted(_OPERATORS)


def make_operator(name: str) -> AnyOperator:
    """Build an operator.

    Raises:
      BadInput: no operator of that name.
    """
    if name not in _OPERATORS:
        expected = ", ".join(operator_names())
        raise BadInput(f"unknown operator {name!r}: expected one of {expected}")
    return _OPERATORS[name]()
