"""The MuJoCo model of the planar world, which all engines share.

The world is the plane z = 0 seen from above. The hand is a kinematic body on two slides and a
hinge: its armature is so large that contacts cannot slow it, and engines write its velocity. The
fingers are bodies of the same kind; their joints stay at zero and only give their surfaces a
velocity (`hand.CREEP`), and their geoms are posed by the gripper value. Objects are spheres on two
slides, walls are planes. Table friction is the frictionloss of the objects' joints.

Standard objects are alike. Others have sizes, masses and frictions of their own, in proportion to
the constants of the physics, which are those of a standard object.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import functools
from types import ModuleType
from typing import Any

import mujoco
import numpy as np

from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import contact_slots
from pgf_jax.scene import shelf as standard
from pgf_jax.scene.shelf import BACK_WALL_X, RADIUS, SIDE_WALL_Y, Shelf

HAND_DOFS = 3  # x, y, yaw
# (x, y, yaw) of the right and the left finger: held at zero, only their speed counts
FINGER_DOFS = 6
KINEMATIC_DOFS = HAND_DOFS + FINGER_DOFS
KINEMATIC_ARMATURE = 1e6  # 100 N change the hand's velocity by 4e-5 m/s within a knot

# MuJoCo measures the solver's progress against the inertias of an island, and the hand's armature
# is one of them: with the default tolerance, 1e-8, the solver stops while objects' accelerations
# are off by up to a quarter, which is up to 11 mm after 3 s. This tolerance leaves 0.1 um, at the
# same speed.
SOLVER_TOLERANCE = 1e-8 / KINEMATIC_ARMATURE


def mjcf(physics: Physics, n_objects: int, shelf: Shelf | None = None) -> str:
    """Write the model as MJCF text; engines set the objects' positions through qpos.

    Args:
      physics: the constants.
      n_objects: N.
      shelf: its walls and objects ([N], unbatched); None: standard ones.
    """
    soft = f'solref="{physics.solref_timeconst} 1" solimp="{physics.impedance} {physics.impedance}"'
    positions, quats = hand.capsule_poses(np.float64(0.0))
    lengths = np.linalg.norm(np.diff(hand.capsule_segments(np.float64(0.0)), axis=1)[:, 0], axis=-1)
    capsules = [
        f'<geom class="hand" size="{r} {h / 2}" pos="{" ".join(map(str, p))}"'
        f' quat="{" ".join(map(str, q))}"/>'
        for r, h, p, q in zip(hand.RADII, lengths, positions, quats, strict=True)
    ]

    def kinematic_body(name: str, inner: str = "") -> str:
        number = hand.BODIES.index(name)
        own = [c for c, n in zip(capsules, hand.CAPSULE_BODY, strict=True) if n == number]
        geoms = "\n".join(own)
        return f"""<body name="{name}" {'sleep="never"' if name == "palm" else ""}>
      <inertial pos="0 0 0" mass="124" diaginertia="1 1 1"/>
      <joint class="hand" type="slide" axis="1 0 0"/>
      <joint class="hand" type="slide" axis="0 1 0"/>
      <joint class="hand" type="hinge" axis="0 0 1"/>
      {geoms}{inner}</body>"""

    fingers = kinematic_body("right") + kinematic_body("left")
    objects = "\n".join(
        _standard_object(i) if shelf is None else _object(i, physics, shelf)
        for i in range(n_objects)
    )
    back_x = BACK_WALL_X if shelf is None else float(shelf.back_x)
    side_y = SIDE_WALL_Y if shelf is None else float(shelf.side_y)
    wall_bit = 2 if shelf is None else 4  # see `_object`
    # Walls carry the hand's bit, so that hand and walls never meet: touching the shelf is a cost
    # (c_s) that is computed from positions; a contact of two kinematic bodies would have no use.
    return f"""
<mujoco model="planar">
  <option timestep="{physics.substep_s!r}" gravity="0 0 0" cone="pyramidal" jacobian="dense"
          integrator="Euler" tolerance="{SOLVER_TOLERANCE}">
    <flag eulerdamp="disable" midphase="disable"/>
  </option>
  <custom><numeric name="max_contact_points" data="{contact_slots(n_objects)}"/></custom>
  <default>
    <geom condim="3" {soft}/>
    <default class="object">
      <geom type="sphere" size="{RADIUS}" mass="{physics.mass}" contype="1" conaffinity="3"
            friction="{physics.object_friction}"/>
      <joint type="slide" armature="{physics.armature}" damping="{physics.damping}"
             frictionloss="{physics.frictionloss}" solreffriction="{physics.solref_timeconst} 1"
             solimpfriction="{physics.impedance} {physics.impedance}"/>
    </default>
    <default class="hand">
      <geom type="capsule" contype="2" conaffinity="0" friction="{physics.hand_friction}" mass="0"/>
      <joint armature="{KINEMATIC_ARMATURE}"/>
    </default>
    <default class="wall">
      <geom type="plane" size="1 1 .1" contype="{wall_bit}" conaffinity="0"
            friction="{physics.wall_friction}"/>
    </default>
  </default>
  <worldbody>
    <geom class="wall" name="back" pos="{back_x} 0 0" zaxis="-1 0 0"/>
    <geom class="wall" name="left" pos="0 {side_y} 0" zaxis="0 -1 0"/>
    <geom class="wall" name="right" pos="0 {-side_y} 0" zaxis="0 1 0"/>
    {kinematic_body("palm", fingers)}
    {objects}
  </worldbody>
</mujoco>"""


def _standard_object(i: int) -> str:
    return (
        f'<body name="object_{i + 1}" pos="0 0 0"><geom class="object" name="object_{i + 1}"/>'
        '<joint class="object" axis="1 0 0"/><joint class="object" axis="0 1 0"/></body>'
    )


def _object(i: int, physics: Physics, shelf: Shelf) -> str:
    """An object with properties of its own.

    MuJoCo takes the larger friction of two geoms, unless one has priority. So that an object's
    counts against the hand and the walls too, it has a sphere for each of them, with priority.
    """
    rough = shelf.friction[i] / standard.FRICTION
    loss = physics.frictionloss * shelf.mass[i] / standard.MASS
    loss *= shelf.table_friction[i] / standard.TABLE_FRICTION
    size = f'type="sphere" size="{shelf.radius[i]}"'
    spheres = "".join(
        f'<geom {size} mass="0" contype="0" conaffinity="{bit}" priority="1"'
        f' friction="{friction * rough}"/>'
        for bit, friction in ((2, physics.hand_friction), (4, physics.wall_friction))
    )
    joint = f'<joint class="object" frictionloss="{loss}"'
    return (
        f'<body name="object_{i + 1}" pos="0 0 0">'
        f'<geom name="object_{i + 1}" {size} mass="{physics.mass * shelf.mass[i] / standard.MASS}"'
        f' contype="1" conaffinity="1" friction="{physics.object_friction * rough}"/>{spheres}'
        f'{joint} axis="1 0 0"/>{joint} axis="0 1 0"/></body>'
    )


def compile_model(physics: Physics, n_objects: int, shelf: Shelf | None = None) -> mujoco.MjModel:
    """Compile the model, once per settings; copy the result before you change its options."""
    if shelf is None:
        return _standard_model(physics, n_objects)
    return _compiled(mjcf(physics, n_objects, shelf))


@functools.lru_cache(maxsize=8)
def _standard_model(physics: Physics, n_objects: int) -> mujoco.MjModel:
    return _compiled(mjcf(physics, n_objects))


def _compiled(text: str) -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_string(text)
    # The broad phase boxes each body once; the fingers move, so the box must hold every pose.
    for name in hand.BODIES:
        root = model.body_bvhadr[model.body(name).id]
        model.bvh_aabb[root] = np.array([0.1, 0.0, 0.0, 0.25, 0.2, 0.1])
    return model


def hand_geoms(model: mujoco.MjModel) -> np.ndarray:
    """[C] geom ids of the hand's capsules, in the order of `hand.CAPSULES`."""
    return np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)


def geom_bodies(model: mujoco.MjModel, n_objects: int) -> np.ndarray:
    """[geoms] body number of each geom: 0..N-1 an object, N the hand, N+1 a wall."""
    codes = np.full(model.ngeom, n_objects + 1, np.int32)
    codes[hand_geoms(model)] = n_objects
    for i in range(n_objects):
        codes[model.geom_bodyid == model.body(f"object_{i + 1}").id] = i
    return codes


def kinematic_velocity(velocity: Any, gripper: Any, physics: Physics, xp: ModuleType = np) -> Any:
    """[9] speeds of the kinematic joints: the hand's [3], then the fingers' surface creep [6]."""
    return xp.concatenate([xp.asarray(velocity), physics.finger_creep * hand.creep(gripper, xp)])
