"""Registry that finds operators by name: those that ship, and those that users register."""

from collections.abc import Callable

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.guidance.operators.base import AnyOperator, NoOperator
from pgf_jax.physics.engine import ENGINES
from pgf_jax.plugins.registry import Plugin, Registry, caller

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


OPERATORS: Registry[Callable[[], AnyOperator]] = Registry(
    "operator",
    {
        "none": NoOperator,
        "heuristic": _heuristic,
        "oracle": _oracle,
        "clairvoyant": _clairvoyant,
        "noisy": _noisy,
    },
    # They imagine a second push.
    revisions={"heuristic": 2, "noisy": 2},
)


def register_operator(
    name: str,
    make: Callable[[], AnyOperator],
    *,
    version: str | None = None,
    replace: bool = False,
) -> None:
    """Register an operator under a name, by which settings ask for it.

    Results are named by the source of the package that registers it, and by the settings of what
    `make()` returns (its attributes). So changed code computes its cells again.

    Args:
      name: of the operator.
      make: returns an `Operator` or a `RolloutOperator`.
      version: stands for the source where that cannot be seen; raise it when results change.
      replace: take the place of the operator that has this name.

    Raises:
      BadInput: the name is taken; or neither a source nor a version is there.
    """
    OPERATORS.register(name, make, caller=caller(), version=version, replace=replace)


def operator_names() -> list[str]:
    """Names of all registered operators, the built-in ones first."""
    return OPERATORS.names()


def make_operator(name: str) -> AnyOperator:
    """Build the operator of a name.

    Raises:
      BadInput: no operator of that name, or what was registered is none.
    """
    operator = OPERATORS.make(name)()
    if not callable(getattr(operator, "decide", getattr(operator, "deliberate", None))):
        raise BadInput(
            f"operator {name!r}: {short_repr(operator)} has no method decide(view), see Operator"
        )
    return operator


def world_plugins(engine: str, operator: str | None) -> list[tuple[Plugin, str]]:
    """What an engine and an operator (None: nobody) are made of, where they are of plugins."""
    used = [ENGINES.made_of(engine, built=False)]  # an engine itself may hold anything
    if operator is not None:
        used.append(OPERATORS.made_of(operator))
    return [one for one in used if one is not None]


def check_operator(name: str) -> None:
    """Raise BadInput unless an operator of that name is registered."""
    OPERATORS.check(name)
