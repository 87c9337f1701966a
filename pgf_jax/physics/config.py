"""What the planar world is made of: static, and free of JAX and MuJoCo imports."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Physics:
    """The planar world's constants (D2).

    Softness, friction loss and substep go together: see the README's table of parity for what was
    measured with the default.
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
    hand_friction: float = 1.0  # of palm and fingers: MuJoCo's default, which the authors' keep
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
