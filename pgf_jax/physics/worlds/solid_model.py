"""The MJCF of the solid world: table and walls, upright cylinders, and the hand in its links.

The plane of the table is z = 0. An object is a cylinder, which meets the others as spheres, because
contacts of spheres are exact and cheap, and those of two cylinders that touch along a line are
neither. It stands on small feet around its edge. Two spheres of its radius meet hand, walls and
other objects: at their heights they are its cross-section as long as it stands. If it topples, it
lies on the feet and the upper sphere.

The hand is the capsule table of `hand.py`, each capsule extruded to the gripper's height: a box
with rounded ends. Links turn about their joints. The base follows its commanded velocity whatever
the contacts do, and carries the hand by a drive that slips at a force that stalls a robot arm: a
hand that squeezes objects against a wall stops, where a kinematic one would go through them.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import dataclasses
import functools

import mujoco
import numpy as np

from pgf_jax.physics import hand
from pgf_jax.scene.shelf import (
    FRICTION,
    FRONT_X,
    HEIGHT,
    MASS,
    RADIUS,
    TABLE_FRICTION,
    Shelf,
    standard_shelf,
)

ARMATURE = 1e6  # of driven joints, kg or kg m^2: 100 N change a velocity by 4e-5 m/s within a knot
# The solver measures its progress against the mean inertia, of which the armature is most.
TOLERANCE = 1e-8 / ARMATURE
# Of contacts, where objects have frictions of their own: between objects, and with the walls.
_OBJECT_BIT, _WALL_BIT = 8, 16


@dataclasses.dataclass(frozen=True)
class Solid:
    """Constants of the solid world.

    Attributes:
      step_s: of the simulation, s; a hundred in a knot.
      timeconst_s: of contacts, s: how fast an overlap is undone. At least two steps.
      mass_kg: of an object.
      table_friction, object_friction, hand_friction, wall_friction: coefficients of an object
        against the table, other objects, the hand, the walls.
      reach_m: half the height of the hand's links, whose middle is that of the objects; the
        spheres of an object are at its upper and lower end.
      stall_n, stall_nm: force and torque at which the drive slips, N, N m.
      hand_kg: of the hand, which moves when the drive slips.
      feet: of an object.
      foot_m: radius of a foot, m.
      foot_impedance: of its contact: how much of an acceleration it takes up at once.
    """

    step_s: float = 0.00375
    timeconst_s: float = 0.01
    mass_kg: float = 1.0
    table_friction: float = 0.5
    object_friction: float = 0.3
    hand_friction: float = 0.5
    wall_friction: float = 0.5
    reach_m: float = 0.02
    stall_n: float = 150.0
    stall_nm: float = 20.0
    hand_kg: float = 10.0
    # MuJoCo has a cylinder stand on three points of its edge, which jump about as it rocks: the
    # nearest side of their triangle is 15 mm from the middle, where sliding at a friction of 0.5
    # shifts the load by 25 mm. So it slides up to 30 % too short, by the direction, or falls. The
    # nearest side of eight feet is 26.8 mm from the middle. Softer feet rock, too: at an impedance
    # of 0.95 ways are 5 % short.
    feet: int = 8
    foot_m: float = 0.001
    foot_impedance: float = 0.99


def mjcf(solid: Solid, n_objects: int, shelf: Shelf | None = None) -> str:
    """Write the model as MJCF text; a world sets the objects' positions.

    Args:
      solid: the constants, which are those of standard objects.
      n_objects: N.
      shelf: its walls and objects ([N]); None: standard ones.
    """
    own = shelf or standard_shelf(n_objects)
    back_x, side_y = float(own.back_x), float(own.side_y)
    # Half sizes of the side walls, which begin at the shelf's front: a hand may pass before it.
    depth, thick = (back_x - FRONT_X) / 2, 0.05
    drive = 'solreffriction="0.0075 1" solimpfriction="0.999 0.999"'
    standard, wall_bits = _standard_object(solid), 6 if shelf is None else 4 | _WALL_BIT
    objects = "\n    ".join(
        f'<body name="object_{i + 1}" pos="0 0 {own.height[i] / 2}">'
        f"{standard if shelf is None else _object(solid, shelf, i)}</body>"
        for i in range(n_objects)
    )
    links = "".join(_link(name, solid) for name, one in hand.LINKS.items() if one.parent is None)
    return f"""
<mujoco model="solid">
  <compiler angle="radian"/>
  <option timestep="{solid.step_s!r}" cone="elliptic" jacobian="sparse" tolerance="{TOLERANCE}">
    <flag sleep="enable"/>
  </option>
  <default>
    <geom condim="3" solref="{solid.timeconst_s} 1" mass="0"/>
    <default class="cylinder">
      <geom type="cylinder" size="{RADIUS} {HEIGHT / 2}" mass="{solid.mass_kg}" contype="0"
            conaffinity="0"/>
    </default>
    <default class="foot">
      <geom type="sphere" size="{solid.foot_m}" contype="1" conaffinity="0" priority="2"
            friction="{solid.table_friction}"
            solimp="{solid.foot_impedance} {solid.foot_impedance}"/>
    </default>
    <default class="side">
      <geom type="sphere" size="{RADIUS}" contype="2" conaffinity="2"
            friction="{solid.object_friction}"/>
    </default>
    <default class="hand">
      <geom contype="2" conaffinity="4" priority="1" friction="{solid.hand_friction}"/>
      <joint armature="{ARMATURE}"/>
    </default>
    <default class="wall">
      <geom contype="{wall_bits}" conaffinity="0" priority="1" friction="{solid.wall_friction}"/>
    </default>
  </default>
  <worldbody>
    <geom name="table" type="plane" size="2 2 .1" contype="0" conaffinity="1"/>
    <geom class="wall" name="back" type="plane" size="1 1 .1" pos="{back_x} 0 0"
          zaxis="-1 0 0"/>
    <geom class="wall" name="left" type="box" size="{depth} {thick} 0.2"
          pos="{FRONT_X + depth} {side_y + thick} 0.2"/>
    <geom class="wall" name="right" type="box" size="{depth} {thick} 0.2"
          pos="{FRONT_X + depth} {-side_y - thick} 0.2"/>
    <body name="base" sleep="never">
      <inertial pos="0 0 0" mass="124" diaginertia="1 1 1"/>
      <joint class="hand" name="x" type="slide" axis="1 0 0"/>
      <joint class="hand" name="y" type="slide" axis="0 1 0"/>
      <joint class="hand" name="yaw" type="hinge" axis="0 0 1"/>
      <body name="palm">
        <inertial pos="0 0 0" mass="{solid.hand_kg}" diaginertia="1 1 {solid.hand_kg / 100}"/>
        <joint type="slide" axis="1 0 0" frictionloss="{solid.stall_n}" {drive}/>
        <joint type="slide" axis="0 1 0" frictionloss="{solid.stall_n}" {drive}/>
        <joint type="hinge" axis="0 0 1" frictionloss="{solid.stall_nm}" {drive}/>
        {_geoms("palm", np.zeros(2), solid)}
        {links}
      </body>
    </body>
    {objects}
  </worldbody>
</mujoco>"""


def _standard_object(solid: Solid) -> str:
    return (
        f'<freejoint/><geom class="cylinder"/>{_feet(solid, RADIUS, HEIGHT)}'
        f'<geom class="side" contype="3" pos="0 0 {solid.reach_m}"/>'
        f'<geom class="side" pos="0 0 {-solid.reach_m}"/>'
    )


def _object(solid: Solid, shelf: Shelf, i: int) -> str:
    """An object with properties of its own.

    MuJoCo takes one geom's friction where it has priority, else the larger one of two. So that an
    object's counts against hand and walls too, they meet spheres of their own, with priority.
    """
    radius, height = float(shelf.radius[i]), float(shelf.height[i])
    rough = float(shelf.friction[i]) / FRICTION
    mass = solid.mass_kg * float(shelf.mass[i]) / MASS
    foot = solid.table_friction * float(shelf.table_friction[i]) / TABLE_FRICTION
    # The middle of the hand's links, from the object's own; a high object ends above them.
    middle = (HEIGHT - height) / 2
    levels = {middle - solid.reach_m, min(middle + solid.reach_m, height / 2)}
    top = max(*levels, height / 2 - solid.reach_m - 0.01)
    bits: dict[float, int] = {}  # of what has which friction
    for friction, bit in ((solid.hand_friction, 2), (solid.wall_friction, _WALL_BIT)):
        bits[friction] = bits.get(friction, 0) | bit
    spheres = []
    for z in sorted(levels | {top}):
        side = f'<geom class="side" size="{radius}" pos="0 0 {z}"'
        meets = _OBJECT_BIT | (1 if z == top else 0)
        spheres.append(
            f'{side} contype="{meets}" conaffinity="{_OBJECT_BIT}"'
            f' friction="{solid.object_friction * rough}"/>'
        )
        spheres += [
            f'{side} contype="0" conaffinity="{bit}" priority="2" friction="{friction * rough}"/>'
            for friction, bit in bits.items()
        ]
    return (
        f'<freejoint/><geom class="cylinder" size="{radius} {height / 2}" mass="{mass}"/>'
        f"{_feet(solid, radius, height, foot)}{''.join(spheres)}"
    )


def _feet(solid: Solid, radius: float, height: float, friction: float | None = None) -> str:
    """The feet of an object, inside of its cylinder."""
    turns = 2 * np.pi * np.arange(solid.feet) / solid.feet
    out, down = radius - solid.foot_m, solid.foot_m - height / 2
    own = "" if friction is None else f' friction="{friction}"'
    return "".join(
        f'<geom class="foot" pos="{out * np.cos(turn)} {out * np.sin(turn)} {down}"{own}/>'
        for turn in turns
    )


def _link(name: str, solid: Solid) -> str:
    """A link of the open hand on its joint, with the links that it carries."""
    link = hand.LINKS[name]
    origin = hand.LINKS[link.parent].joint if link.parent else (0.0, 0.0)
    x, y = np.subtract(link.joint, origin)
    carried = "".join(_link(other, solid) for other, o in hand.LINKS.items() if o.parent == name)
    return f"""<body name="{name}" pos="{x} {y} 0">
      <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      <joint class="hand" name="{name}" type="hinge" axis="0 0 1"/>
      {_geoms(name, np.array(link.joint), solid)}{carried}</body>"""


def _geoms(owner: str, origin: np.ndarray, solid: Solid) -> str:
    """The capsules of a link, each as a box with rounded ends, relative to the link's joint."""
    texts = []
    segments = hand.capsule_segments(0.0)
    for number, y in hand.MEASURED_FRONTS.items():
        segments[number, 0, 1] = y  # the planar hand's reach further inwards, see `hand.py`
    for capsule, ends, radius in zip(hand.CAPSULES, segments, hand.RADII, strict=True):
        if capsule[0] != owner:
            continue
        a, b = ends - origin
        x, y = (a + b) / 2
        length, yaw = np.linalg.norm(b - a), np.arctan2(*(b - a)[::-1])
        z, h = HEIGHT / 2, solid.reach_m
        texts.append(
            f'<geom class="hand" type="box" size="{length / 2} {radius} {h}" pos="{x} {y} {z}"'
            f' euler="0 0 {yaw}"/>'
        )
        texts += [
            f'<geom class="hand" type="capsule" size="{radius} {h}" pos="{x} {y} {z}"/>'
            for x, y in (a, b)
        ]
    return "\n        ".join(texts)


def compile_model(solid: Solid, n_objects: int, shelf: Shelf | None = None) -> mujoco.MjModel:
    """Compile the model, once per settings; copy the result before you change it."""
    if shelf is None:
        return _standard_model(solid, n_objects)
    return mujoco.MjModel.from_xml_string(mjcf(solid, n_objects, shelf))


@functools.lru_cache(maxsize=8)
def _standard_model(solid: Solid, n_objects: int) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(mjcf(solid, n_objects))
