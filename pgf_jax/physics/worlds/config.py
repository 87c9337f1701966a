"""Names of the worlds, and how wrong a robot is about its own; imports no MuJoCo."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Literal

from pgf_jax.errors import BadInput
from pgf_jax.settings import Bounds, check_fields, named_values

WorldName = Literal["solid", "scene", "none"]
Share = Annotated[float, Bounds(0, below=1)]


@dataclasses.dataclass(frozen=True)
class WorldError:
    """How far the world in which a robot acts is from the one in which it checks.

    Attributes:
      friction: of each object with the table and with other objects, and of the hand: drawn evenly
        from the value times 1 - friction .. 1 + friction.
      mass: of each object, likewise.
      position: standard deviation of each object's place from where the robot sees it at first, in
        x and y, m.
    """

    friction: Share = 0.3
    mass: Share = 0.3
    position: Annotated[float, Bounds(0, 0.02)] = 0.005


def world_error_of(texts: Sequence[str], world: str) -> WorldError | None:
    """The error that a setting asks for; None: there is none.

    Args:
      texts: none; `default`; or NAME=VALUE of fields of `WorldError`, the others then 0.
      world: in which the robot checks.

    Raises:
      BadInput: no such name, a value out of bounds, or a world in which nothing can be wrong.
    """
    if not texts:
        return None
    if world != "solid":
        raise BadInput(f"world_error: expected with world solid only, got world {world}")
    if tuple(texts) == ("default",):
        return WorldError()
    names = {field.name: field.default for field in dataclasses.fields(WorldError)}
    nothing = dict.fromkeys(names, 0.0)
    error = WorldError(**{**nothing, **named_values("world_error", texts, names)})
    check_fields(error)
    return error
