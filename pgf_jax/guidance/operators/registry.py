"""Operators by name: those that ship, and those that users register."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.base import AnyOperator, NoOperator
from pgf_jax.settings import check_choice

if TYPE_CHECKING:  # the planner needs JAX, and the command line lists the operators
    pass


def _heuristic() -> AnyOperator:
    from pgf_jax.guidance.operators.heuristic import HeuristicOperator  # needs the planner, so JAX

    return HeuristicOperator()


def _oracle() -> AnyOperator:
    from pgf_jax.guidance.operators.oracle import OracleOperator

    return OracleOperator()


def _clairvoyant() -> AnyOperator:
    from pgf_jax.guidance.operators.oracle import clairvoyant

    return clairvoyant()


def _noisy() -> AnyOperator:
    from pgf_jax.guidance.operators.noisy import NoisyOperator

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


def check_operator(name: str) -> None:
    """BadInput unless an operator of that name is registered."""
    check_choice("operator", name, operator_names())
