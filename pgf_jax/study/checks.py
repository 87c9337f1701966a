"""Checks of settings, each with its one line of BadInput."""

import sys
from typing import Literal, Protocol

from pgf_jax.errors import BadInput, shown
from pgf_jax.guidance.operators import operator_names
from pgf_jax.physics.engine import engine_names

MAX_SEED = 2**32 - 1  # a seed is one word of a noise key


class Planning(Protocol):
    """Settings of planning that several commands share."""

    @property
    def engine(self) -> str:
        """Physics engine."""
        ...

    @property
    def physics(self) -> str:
        """Name of the physics constants."""
        ...

    @property
    def cost(self) -> Literal["source", "paper"]:
        """Cost variant."""
        ...

    @property
    def update(self) -> Literal["greedy", "stomp"]:
        """How an iteration changes the best trajectory."""
        ...

    @property
    def lanes(self) -> int | None:
        """L."""
        ...


def check_planning(config: Planning) -> None:
    """BadInput unless the engine, physics, cost, update and lanes of `config` exist."""
    one_of("engine", config.engine, engine_names())
    one_of("physics", config.physics, ["default", "paper"])
    one_of("cost", config.cost, ["source", "paper"])
    one_of("update", config.update, ["greedy", "stomp"])
    whole("lanes", config.lanes, 1)


def check_operator(name: str) -> None:
    """BadInput unless an operator of that name is registered."""
    one_of("operator", name, operator_names())


def one_of(name: str, value: object, choices: list[str]) -> None:
    """BadInput unless `value` is one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        raise BadInput(f"{name}: expected one of {', '.join(choices)}, got {shown(value)}")


def whole(name: str, value: object, least: int, most: int | None = None) -> None:
    """BadInput unless `value` is a whole number within least..most."""
    if (
        not isinstance(value, int)
        or isinstance(value, bool)
        or value < least
        or (most is not None and value > most)
    ):
        bounds = f"{least} or more" if most is None else f"within {least}..{most}"
        raise BadInput(f"{name}: expected a whole number {bounds}, got {shown(value)}")


def at_least(name: str, value: float, least: float) -> None:
    """BadInput unless `value` is a finite number of seconds, `least` or more."""
    # A whole number may be too large for what it is used as.
    if not isinstance(value, int | float) or not least <= value <= sys.float_info.max:
        raise BadInput(
            f"{name}: expected a number of seconds, {least:g} or more, got {shown(value)}"
        )
