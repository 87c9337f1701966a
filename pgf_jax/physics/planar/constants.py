"""Constants of engine `planar`, read from the compiled model so that no number is given twice."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

from typing import NamedTuple

import mujoco
import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.physics import model
from pgf_jax.physics.config import Physics

N_WALLS = 2  # the back wall, and either side wall: they are alike


class Constants(NamedTuple):
    """Numbers of one compiled model; C capsules."""

    substep_s: float
    mass: float  # with armature, kg
    damping: float  # N s/m
    radius: float  # of an object, m
    back_x: float  # faces of the walls, m
    side_y: float
    reference: float  # b of every row: its reference acceleration is -b velocity - k imp gap, 1/s
    stiffness: float  # k imp, 1/s^2
    friction_reference: float  # b of joint friction
    friction_weight: float  # D of joint friction, kg
    friction_loss: float  # N
    capsule_radii: np.ndarray  # [C] m
    capsule_lengths: np.ndarray  # [C] of their axes, m
    hand_friction: float  # mu of the hand against an object
    hand_weight: float  # D of a pyramid edge, kg
    wall_friction: tuple[float, float]  # of the back wall and of the side walls
    wall_weight: tuple[float, float]
    pair_friction: float
    pair_weight: float


def read(physics: Physics, n_objects: int) -> Constants:
    """Read the constants from the compiled model.

    Raises:
      BadInput: objects differ, are no disks on slides, or contacts differ in softness.
    """
    m = model.compile_model(physics, n_objects)
    capsules = model.hand_geoms(m)
    objects = [m.geom(f"object_{i + 1}").id for i in range(n_objects)]
    walls = [m.geom(name).id for name in ("back", "left", "right")]
    geoms = np.array([*capsules, *objects, *walls])
    dofs = np.arange(model.KINEMATIC_DOFS, m.nv)

    def one(name: str, values: np.ndarray) -> float:
        if np.ptp(values, axis=0).any():
            raise BadInput(f"engine planar: {name} must be the same everywhere in the model")
        return float(np.asarray(values)[0])

    timeconst = one("solref timeconst", m.geom_solref[geoms, 0])
    ratio = one("solref dampratio", m.geom_solref[geoms, 1])
    impedance = _impedance(m.geom_solimp[geoms])
    b, k = _reference(m, timeconst, ratio, impedance)
    friction_impedance = _impedance(m.dof_solimp[dofs])
    friction_b, _ = _reference(
        m,
        one("solreffriction timeconst", m.dof_solref[dofs, 0]),
        one("solreffriction dampratio", m.dof_solref[dofs, 1]),
        friction_impedance,
    )
    weight0 = one("inverse weight", m.body_invweight0[m.geom_bodyid[objects], 0])
    mu = one("object friction", m.geom_friction[objects, 0])

    def edge_weight(inverse_weight: float, friction: float) -> float:
        regular = (1 - impedance) / impedance * inverse_weight * (1 + friction**2)
        return 1 / (2 * friction**2 * regular)

    ground = [*capsules, walls[0], walls[1]]
    if not np.array_equal(m.geom_friction[walls[1]], m.geom_friction[walls[2]]):
        raise BadInput("engine planar: the side walls must have the same friction")
    frictions = np.array([max(mu, m.geom_friction[g, 0]) for g in ground])
    weights = np.array(
        [
            edge_weight(weight0 + m.body_invweight0[m.geom_bodyid[g], 0], friction)
            for g, friction in zip(ground, frictions, strict=True)
        ]
    )
    # The bodies of the kinematic hand differ in the seventh digit.
    if np.ptp(weights[:-N_WALLS]) > 1e-5 * weights[0]:
        raise BadInput("engine planar: the hand's bodies must have the same inverse weight")
    dof_weight = one("dof inverse weight", m.dof_invweight0[dofs])
    return Constants(
        substep_s=m.opt.timestep,
        mass=one("mass", m.body_mass[m.geom_bodyid[objects]])
        + one("armature", m.dof_armature[dofs]),
        damping=one("damping", np.ravel(m.dof_damping[dofs])),
        radius=one("radius", m.geom_size[objects, 0]),
        back_x=float(m.geom_pos[walls[0], 0]),
        side_y=float(m.geom_pos[walls[1], 1]),
        reference=b,
        stiffness=k * impedance,
        friction_reference=friction_b,
        friction_weight=friction_impedance / (1 - friction_impedance) / dof_weight,
        friction_loss=one("frictionloss", m.dof_frictionloss[dofs]),
        capsule_radii=m.geom_size[capsules, 0].copy(),
        capsule_lengths=2 * m.geom_size[capsules, 1],
        hand_friction=one("hand friction", frictions[:-N_WALLS]),
        hand_weight=float(weights[0]),
        wall_friction=(float(frictions[-2]), float(frictions[-1])),
        wall_weight=(float(weights[-2]), float(weights[-1])),
        pair_friction=mu,
        pair_weight=edge_weight(2 * weight0, mu),
    )


def _impedance(solimp: np.ndarray) -> float:
    """The impedance of all rows: one constant, which does not depend on the gap."""
    if np.ptp(solimp, axis=0).any() or solimp[0, 0] != solimp[0, 1]:
        raise BadInput("engine planar: solimp must be one constant impedance in the whole model")
    return float(np.clip(solimp[0, 0], mujoco.mjMINIMP, mujoco.mjMAXIMP))


def _reference(
    m: mujoco.MjModel, timeconst: float, ratio: float, impedance: float
) -> tuple[float, float]:
    """(b, k) of MuJoCo's solref, with the time constant raised to at least two substeps."""
    timeconst = max(timeconst, 2 * m.opt.timestep)
    return 2 / (impedance * timeconst), 1 / (impedance * timeconst * ratio) ** 2
