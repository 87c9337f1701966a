"""Operators (D5): who gives the human input. One protocol, a registry, `none` and `heuristic`."""

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.planning.types import Push


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


class Operator(Protocol):
    """Gives input. The same view must give the same input: no state, no randomness of its own."""

    name: str

    def decide(self, view: View) -> Push | None:
        """Push an object somewhere, or None: go on reaching."""
        ...


class NoOperator:
    """Always says "go on reaching"."""

    name = "none"

    def decide(self, view: View) -> Push | None:
        """See `Operator.decide`."""
        return None


def _heuristic() -> Operator:
    from pgf_jax.guidance.heuristic import HeuristicOperator  # needs the planner, so JAX

    return HeuristicOperator()


_OPERATORS: dict[str, Callable[[], Operator]] = {"none": NoOperator, "heuristic": _heuristic}


def register_operator(name: str, make: Callable[[], Operator]) -> None:
    """Make `make()` available as `make_operator(name)`."""
    _OPERATORS[name] = make


def operator_names() -> list[str]:
    """Names that `make_operator` takes."""
    return sorted(_OPERATORS)


def make_operator(name: str) -> Operator:
    """Build an operator.

    Raises:
      BadInput: no operator of that name.
    """
    if name not in _OPERATORS:
        expected = ", ".join(operator_names())
        raise BadInput(f"unknown operator {name!r}: expected one of {expected}")
    return _OPERATORS[name]()
