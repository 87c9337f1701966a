"""Constants of the planar world; no JAX or MuJoCo here, since the command line reads them."""

import dataclasses
from typing import Literal

PhysicsName = Literal["default", "paper"]


@dataclasses.dataclass(frozen=True)
class Physics:
    """Constants of the planar world.

    Softness, friction loss and substep were chosen together, so change them together: softer
    contacts allow a larger substep. `experiments/parity.py` measures the error of a choice.
    """

    substeps: int = 36  # S, per knot; 0.375 s / 36 = 10.4 ms
    rollout_s: float = 3.0
    knots: int = 8  # T
    solref_timeconst: float = 0.04  # s
    impedance: float = 0.5  # contacts and joint friction alike
    frictionloss: float = 3.9  # N per axis: mu m g / mean(|cos| + |sin|)
    mass: float = 1.0  # kg
    armature: float = 0.1
    damping: float = 0.5
    object_friction: float = 0.3
    hand_friction: float = 1.0  # of palm and fingers: MuJoCo's default, as in the authors' world
    finger_creep: float = 1.0  # share of the authors' fingers' surface creep (`hand.CREEP`)
    wall_friction: float = 0.5

    @property
    def knot_s(self) -> float:
        """Duration of a knot in seconds."""
        return self.rollout_s / self.knots

    @property
    def substep_s(self) -> float:
        """Physics substep in seconds."""
        return self.knot_s / self.substeps


PHYSICS = {
    "default": Physics(),
    # The paper's substep of 0.0015 s and the softness of the authors' geoms.
    "paper": Physics(substeps=250, solref_timeconst=0.02, impedance=0.1),
}
