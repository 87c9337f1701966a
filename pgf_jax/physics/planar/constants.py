"""Constants of engine `planar`, read from the compiled model so that no number is given twice.

Objects that are all standard have numbers in common. Of others, each has its own (`of_shelf`), as
data of the program: [N, C], objects by lanes; `taken` picks those that take part in a knot.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.physics import model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.planar.fusion import rows
from pgf_jax.scene import shelf as standard
from pgf_jax.scene.shelf import Shelf

N_WALLS = 2  # the back wall, and either side wall: they are alike
DECELERATION = 3.0  # m/s^2 at least, of a sliding standard object: with a margin
Each = Any  # of an object: a float where all are standard, or [N, C]


class Constants(NamedTuple):
    """Numbers of one compiled model; G capsules."""

    substep_s: float
    armature: float  # kg
    damping: float  # N s/m
    reference: float  # b of every row: its reference acceleration is -b velocity - k imp gap, 1/s
    stiffness: float  # k imp, 1/s^2
    softness: float  # (1 - imp) / imp of every row
    friction_reference: float  # b of joint friction
    capsule_radii: np.ndarray  # [G] m
    capsule_lengths: np.ndarray  # [G] of their axes, m
    back_x: Any  # faces of the walls, m: a float or [C]
    side_y: Any
    radius: Each  # m
    mass: Each  # with armature, kg
    inverse_weight: Each  # 1/kg
    friction: Each  # mu of the object against another of its kind
    friction_weight: Each  # D of joint friction, kg
    friction_loss: Each  # N
    deceleration: Each  # m/s^2 at least, of a sliding object
    hand_friction: Each  # mu of the hand against an object
    hand_weight: Each  # D of a pyramid edge, kg
    wall_friction: tuple[Each, Each]  # of the back wall and of the side walls
    wall_weight: tuple[Each, Each]
    # Of two objects: a float, or [T, C] of those that are taken.
    pair_reach: Any  # distance at which they touch, m
    pair_friction: Any
    pair_weight: Any


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

    softness = (1 - impedance) / impedance
    ground = [*capsules, walls[0], walls[1]]
    if not np.array_equal(m.geom_friction[walls[1]], m.geom_friction[walls[2]]):
        raise BadInput("engine planar: the side walls must have the same friction")
    frictions = np.array([max(mu, m.geom_friction[g, 0]) for g in ground])
    weights = np.array(
        [
            _edge_weight(softness, weight0 + m.body_invweight0[m.geom_bodyid[g], 0], friction)
            for g, friction in zip(ground, frictions, strict=True)
        ]
    )
    # The bodies of the kinematic hand differ in the seventh digit.
    if np.ptp(weights[:-N_WALLS]) > 1e-5 * weights[0]:
        raise BadInput("engine planar: the hand's bodies must have the same inverse weight")
    dof_weight = one("dof inverse weight", m.dof_invweight0[dofs])
    radius, armature = one("radius", m.geom_size[objects, 0]), one("armature", m.dof_armature[dofs])
    return Constants(
        substep_s=m.opt.timestep,
        armature=armature,
        damping=one("damping", np.ravel(m.dof_damping[dofs])),
        reference=b,
        stiffness=k * impedance,
        softness=softness,
        friction_reference=friction_b,
        capsule_radii=m.geom_size[capsules, 0].copy(),
        capsule_lengths=2 * m.geom_size[capsules, 1],
        back_x=float(m.geom_pos[walls[0], 0]),
        side_y=float(m.geom_pos[walls[1], 1]),
        radius=radius,
        mass=one("mass", m.body_mass[m.geom_bodyid[objects]]) + armature,
        inverse_weight=weight0,
        friction=mu,
        friction_weight=friction_impedance / (1 - friction_impedance) / dof_weight,
        friction_loss=one("frictionloss", m.dof_frictionloss[dofs]),
        deceleration=DECELERATION,
        hand_friction=one("hand friction", frictions[:-N_WALLS]),
        hand_weight=float(weights[0]),
        wall_friction=(float(frictions[-2]), float(frictions[-1])),
        wall_weight=(float(weights[-2]), float(weights[-1])),
        pair_reach=2 * radius,
        pair_friction=mu,
        pair_weight=_edge_weight(softness, 2 * weight0, mu),
    )


def of_shelf(c: Constants, shelf: Shelf) -> Constants:
    """The constants where each object has its own; those of pairs are filled in by `taken`.

    Args:
      c: of standard objects.
      shelf: [N, C] of the objects, [C] of the walls.
    """
    share = shelf.mass / standard.MASS
    mass = (c.mass - c.armature) * share + c.armature
    inverse_weight = c.inverse_weight / share  # MuJoCo leaves the armature out of it
    loss = share * shelf.table_friction / standard.TABLE_FRICTION
    rough = shelf.friction / standard.FRICTION

    def against(friction: float) -> tuple[Each, Each]:
        """Friction and weight of the contacts with a body that cannot be moved."""
        mu = friction * rough
        return mu, _edge_weight(c.softness, inverse_weight, mu)

    hand, back, side = (against(mu) for mu in (c.hand_friction, *c.wall_friction))
    return c._replace(
        back_x=shelf.back_x,
        side_y=shelf.side_y,
        radius=shelf.radius,
        mass=mass,
        inverse_weight=inverse_weight,
        friction=c.friction * rough,
        friction_weight=c.friction_weight * share,
        friction_loss=c.friction_loss * loss,
        deceleration=c.deceleration * loss * (c.mass / mass),
        hand_friction=hand[0],
        hand_weight=hand[1],
        wall_friction=(back[0], side[0]),
        wall_weight=(back[1], side[1]),
        pair_reach=None,
        pair_friction=None,
        pair_weight=None,
    )


def taken(c: Constants, which: jax.Array, first: np.ndarray, second: np.ndarray) -> Constants:
    """The constants of some of the objects.

    Args:
      c: of standard objects, which stay as they are; or of all [N, C].
      which: [A, C] numbers of the objects.
      first, second: [T] places in A of each pair.
    """
    if not _own(c):
        return c

    def pick(values: Any) -> Any:
        return jax.tree.map(lambda v: jnp.take_along_axis(v, which, 0), values)

    radius, weight, mu = pick((c.radius, c.inverse_weight, c.friction))
    pair_mu = jnp.maximum(rows(mu, first), rows(mu, second))
    both = rows(weight, first) + rows(weight, second)
    return c._replace(
        radius=radius,
        inverse_weight=weight,
        friction=mu,
        **{name: pick(getattr(c, name)) for name in _OF_OBJECTS},
        pair_reach=rows(radius, first) + rows(radius, second),
        pair_friction=pair_mu,
        pair_weight=_edge_weight(c.softness, both, pair_mu),
    )


# Beside radius, inverse weight and friction.
_OF_OBJECTS = ("mass", "friction_weight", "friction_loss", "deceleration", "hand_friction")
_OF_OBJECTS += ("hand_weight", "wall_friction", "wall_weight")


def head(values: Each, count: int) -> Each:
    """Of the first objects."""
    return values if isinstance(values, float) else values[:count]


def reach_of(one: Each, other: Each) -> Any:
    """Distance at which any of some objects [A, C] and any of others [B, C] touch: [A, B, C]."""
    return one + other if isinstance(one, float) else one[:, None] + other[None]


def _own(c: Constants) -> bool:
    """Whether each object has its own."""
    return not isinstance(c.radius, float)


def _edge_weight(softness: float, inverse_weight: Any, friction: Any) -> Any:
    """D of a pyramid's edge."""
    return 1 / (2 * friction**2 * (softness * inverse_weight * (1 + friction**2)))


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
