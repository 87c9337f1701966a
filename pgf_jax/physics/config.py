"""Constants of the planar world; no JAX or MuJoCo here, since the command line reads them."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Literal

from pgf_jax.errors import BadInput
from pgf_jax.settings import Bounds, Count, check_fields, named_values

Positive = Annotated[float, Bounds(above=0)]
NotNegative = Annotated[float, Bounds(0)]
PhysicsName = Literal["default", "authors", "paper"]


@dataclasses.dataclass(frozen=True)
class Physics:
    """Constants of the planar world.

    Softness, friction loss and substep were chosen together, so change them together: softer
    contacts allow a larger substep. `experiments/parity.py` measures the error of a choice.
    """

    substeps: Count = 36  # S, per knot; 0.375 s / 36 = 10.4 ms
    rollout_s: float = 3.0
    knots: int = 8  # T
    solref_timeconst: Positive = 0.04  # s
    impedance: Annotated[float, Bounds(above=0, below=1)] = 0.5  # contacts, joint friction alike
    frictionloss: NotNegative = 3.9  # N per axis: mu m g / mean(|cos| + |sin|)
    mass: Positive = 1.0  # kg
    armature: NotNegative = 0.1
    damping: NotNegative = 0.5
    object_friction: NotNegative = 0.3
    hand_friction: NotNegative = 1.0  # of palm and fingers: MuJoCo's default, as the authors' have
    finger_creep: NotNegative = 1.0  # share of the authors' fingers' surface creep (`hand.CREEP`)
    wall_friction: NotNegative = 0.5

    @property
    def knot_s(self) -> float:
        """Duration of a knot in seconds."""
        return self.rollout_s / self.knots

    @property
    def substep_s(self) -> float:
        """Physics substep in seconds."""
        return self.knot_s / self.substeps


PHYSICS = {
    # Fitted to the solid world (`experiments/fit_planar.py`): disks cannot roll along a hand as
    # cylinders do, so it has less friction; and its fingers do not drag what they touch.
    "default": Physics(hand_friction=0.3, finger_creep=0.0),
    # Of the published simulation, with its fingers' surface creep.
    "authors": Physics(),
    # The paper's substep of 0.0015 s and the softness of the authors' geoms.
    "paper": Physics(substeps=250, solref_timeconst=0.02, impedance=0.1),
}
# The planner's nominal trajectories are made for this duration and number of knots.
_FIXED = ("rollout_s", "knots")
_CONSTANTS = {f.name: f.default for f in dataclasses.fields(Physics) if f.name not in _FIXED}


def physics_of(name: str, constants: Sequence[str] = ()) -> Physics:
    """The constants of a name, some of them replaced.

    Args:
      name: default, authors or paper.
      constants: NAME=VALUE of fields of `Physics`.

    Raises:
      BadInput: no such name, no such constant, or a value out of bounds.
    """
    if name not in PHYSICS:
        raise BadInput(f"physics: expected one of {', '.join(PHYSICS)}, got {name!r}")
    values = named_values("physics_constants", constants, _CONSTANTS)
    physics = dataclasses.replace(PHYSICS[name], **values)
    check_fields(physics)
    return physics
