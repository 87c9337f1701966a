"""Registry that finds operators by name: those that ship, and those that users register."""

from collections.abc import Callable

from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.base import AnyOperator, NoOperator
from pgf_jax.settings import check_choice

# These import late: the operators need the planner and so JAX, and the command line lists them.


def _heuristic() -> AnyOperator:
    from pgf_jax.guidance.operators.heuristic import HeuristicOperator

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
    """Register `make()` for `make_operator(name)`."""
    _OPERATORS[name] = make


def operator_names() -> list[str]:
    """Names of all registered operators, sorted."""
    return sorted(_OPERATORS)


def make_operator(name: str) -> AnyOperator:
    """Build the operator of a name.

    Raises:
      BadInput: no operator of that name.
    """
    if name not in _OPERATORS:
        expected = ", ".join(operator_names())
        raise BadInput(f"unknown operator {name!r}: expected one of {expected}")
    return _OPERATORS[name]()


def check_operator(name: str) -> None:
    """Raise BadInput unless an operator of that name is registered."""
    check_choice("operator", name, operator_names())
