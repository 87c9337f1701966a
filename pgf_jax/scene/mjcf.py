"""Import of the authors' published scene files (MJCF).

A scene file holds its objects as bodies `object_1`, `object_2`, ... of the worldbody, each one
upright cylinder on a free joint, and takes shelf and robot from includes. Only the objects are
read: the planar model has its own shelf and robot, so includes are not opened and may be missing.
Values that a file leaves out (mass, friction, the joint's damping) are those of the published
objects. A file with another damping or armature is refused, because the planar model would not
simulate it. The friction is that with other bodies; on the table it is the standard one.
"""

import dataclasses
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, read_file
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import FRICTION, HEIGHT, MASS, RADIUS

GOAL_BODY = "object_3"

# Other ways of MJCF to turn a body. Only `quat` is read: the published files use no other.
_OTHER_ORIENTATIONS = ("axisangle", "euler", "xyaxes", "zaxis")
_WHAT = "a scene file (MJCF)"
_LARGEST = 4 * MIB  # of a file; the published ones take 10 kB
_MAX_TILT = math.radians(1.0)
_MAX_LEVEL_SPREAD = HEIGHT / 4  # m; the published objects' z agree to 0.1 mm
_WORLD_CHILDREN = ("body", "include", "light", "camera", "site")
_BODY_CHILDREN = ("geom", "joint", "freejoint", "site", "light", "camera")
# Attributes that the planar model fixes: element, attribute, the first number of its value.
_FIXED = (
    ("joint", "damping", 0.5),
    ("joint", "armature", 0.1),
)


def read_mjcf(path: Path) -> Scene:
    """Read one MJCF file, see `load_scene`; its stem is the scene's name and `object_3` the goal.

    Raises:
      BadInput: the file is missing, malformed, or holds what is not simulated.
    """
    content = read_file(path, _WHAT, _LARGEST)
    try:
        return dataclasses.replace(_read(content, path.stem), source=path.absolute())
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _read(content: bytes, name: str) -> Scene:
    bodies = _object_bodies(_parse(content))
    numbers = sorted(bodies)
    for expected, number in enumerate(numbers, start=1):
        if number != expected:
            raise BadInput(
                f"object_{expected} is missing; expected objects numbered 1..N, "
                f"got {len(numbers)} up to object_{numbers[-1]}"
            )
    goal = int(GOAL_BODY.removeprefix("object_"))
    if goal not in bodies:
        raise BadInput(
            f"the goal {GOAL_BODY} is missing; expected it among the objects, got {len(numbers)}"
        )
    positions = np.array([_position(bodies[n], f"object_{n}") for n in numbers])  # [N, 3]
    cylinders = [_read_object(bodies[n], f"object_{n}") for n in numbers]
    heights = np.array([2 * cylinder.half_height for cylinder in cylinders])
    bottoms = positions[:, 2] - heights / 2
    off = np.abs(bottoms - np.median(bottoms))
    if off.max() > _MAX_LEVEL_SPREAD:
        i = int(off.argmax())
        raise BadInput(
            f"object_{i + 1} is at z {positions[i, 2]:g} m; expected all objects to stand on one "
            f"level (median z {np.median(positions[:, 2]):g} m)"
        )
    positions[:, 2] = [cylinder.radius for cylinder in cylinders]
    return Scene(
        name,
        positions,
        goal - 1,
        heights=_unless(HEIGHT, heights),
        masses=_unless(MASS, [cylinder.mass for cylinder in cylinders]),
        frictions=_unless(FRICTION, [cylinder.friction for cylinder in cylinders]),
    )


class _Cylinder(NamedTuple):
    """What an object's body says of it: m, kg."""

    radius: float
    half_height: float
    mass: float
    friction: float


def _unless(standard: float, values: Any) -> np.ndarray | None:
    """The values; None where all of them are standard to within rounding."""
    values = np.array(values)
    return None if np.allclose(values, standard, rtol=0, atol=1e-6) else values


def _parse(content: bytes) -> ET.Element:
    try:
        root = ET.fromstring(content)
    # The parser also lets errors of the text decoding through.
    except (ET.ParseError, ValueError, LookupError) as error:
        raise BadInput(f"not well-formed XML ({error}); expected {_WHAT}") from None
    if root.tag != "mujoco":
        raise BadInput(f"root element is <{root.tag}>; expected <mujoco>")
    return root


def _object_bodies(root: ET.Element) -> dict[int, ET.Element]:
    """The object bodies by number."""
    bodies: dict[int, ET.Element] = {}
    for element in root.iterfind("worldbody/*"):
        if element.tag not in _WORLD_CHILDREN:
            raise BadInput(f"worldbody holds <{element.tag}>; expected object bodies and includes")
        if element.tag != "body":
            continue
        name = element.get("name", "")
        match = re.fullmatch(r"object_([1-9][0-9]{0,5})", name)
        if match is None:
            raise BadInput(f"body {name!r} is not supported; expected bodies named object_N")
        number = int(match[1])
        if number in bodies:
            raise BadInput(f"{name} appears twice; expected every object once")
        bodies[number] = element
    if not bodies:
        raise BadInput("no objects; expected bodies object_1, object_2, ... in the worldbody")
    return bodies


def _read_object(body: ET.Element, name: str) -> _Cylinder:
    """Read a body; refuse one that is not one upright cylinder on a free joint."""
    for child in body:
        if child.tag not in _BODY_CHILDREN:
            raise BadInput(f"{name} holds <{child.tag}>; expected one geom and one free joint")
    _check_upright(body, name)
    geom = _only_geom(body, name)
    kind = geom.get("type")
    if kind != "cylinder":
        raise BadInput(f"{name} has a geom of type {kind!r}; only upright cylinders are supported")
    size = _numbers(geom, "size", name)
    if len(size) != 2:
        raise BadInput(f"{name} has size {geom.get('size')!r}; expected radius and half height, m")
    if _all_close(size, (RADIUS, HEIGHT / 2)):
        size = [RADIUS, HEIGHT / 2]
    for attribute in ("pos", "quat", "fromto", *_OTHER_ORIENTATIONS):
        if geom.get(attribute) is not None:
            raise BadInput(
                f"{name} has a geom with {attribute}={geom.get(attribute)!r}; "
                f"expected the cylinder at its body's own pose"
            )
    joints = [*body.iterfind("joint"), *body.iterfind("freejoint")]
    free = len(joints) == 1 and (joints[0].tag == "freejoint" or joints[0].get("type") == "free")
    if not free:
        raise BadInput(f"{name} has {_describe(joints)}; expected one free joint")
    for tag, attribute, expected in _FIXED:
        for element in body.iterfind(tag):
            if element.get(attribute) is None:
                continue
            if not _all_close(_numbers(element, attribute, name)[:1], (expected,)):
                raise BadInput(
                    f"{name} has {attribute} {element.get(attribute)!r}; expected {expected:g}"
                )
    mass, friction = _first(geom, "mass", MASS, name), _first(geom, "friction", FRICTION, name)
    return _Cylinder(size[0], size[1], mass, friction)


def _first(geom: ET.Element, attribute: str, standard: float, name: str) -> float:
    """The first number of an attribute, which may be left out."""
    if geom.get(attribute) is None:
        return standard
    values = _numbers(geom, attribute, name)
    if not values:
        raise BadInput(f"{name} has {attribute} {geom.get(attribute)!r}; expected a number")
    return values[0]


def _check_upright(body: ET.Element, name: str) -> None:
    for attribute in _OTHER_ORIENTATIONS:
        if body.get(attribute) is not None:
            raise BadInput(
                f"{name} has {attribute}={body.get(attribute)!r}; expected its orientation as quat"
            )
    if body.get("quat") is None:
        return
    quat = _numbers(body, "quat", name)
    norm = math.hypot(*quat)  # inf where the squares are too large; nothing is raised
    if len(quat) != 4 or not 1e-6 <= norm < math.inf:
        raise BadInput(f"{name} has quat {body.get('quat')!r}; expected four numbers, not all 0")
    # The z axis of the body, seen from the world: its z component is the cosine of the tilt.
    cosine = 1 - 2 * ((quat[1] / norm) ** 2 + (quat[2] / norm) ** 2)
    if cosine < math.cos(_MAX_TILT):
        tilt = math.degrees(math.acos(max(-1.0, cosine)))
        raise BadInput(f"{name} is tilted by {tilt:.1f} deg; expected it upright (quat about z)")


def _position(body: ET.Element, name: str) -> list[float]:
    position = _numbers(body, "pos", name)
    if len(position) != 3:
        raise BadInput(f"{name} has pos {body.get('pos')!r}; expected three numbers 'x y z' (m)")
    return position


def _only_geom(body: ET.Element, name: str) -> ET.Element:
    geoms = body.findall("geom")
    if len(geoms) != 1:
        raise BadInput(f"{name} has {len(geoms)} geoms; expected one cylinder")
    return geoms[0]


def _describe(joints: list[ET.Element]) -> str:
    if len(joints) != 1:
        return f"{len(joints)} joints"
    return f"a joint of type {joints[0].get('type', 'hinge')!r}"


def _numbers(element: ET.Element, attribute: str, name: str) -> list[float]:
    """The finite numbers of an attribute."""
    text = element.get(attribute)
    if text is None:
        raise BadInput(f"{name} has no {attribute}; expected it on its <{element.tag}>")
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise BadInput(f"{name} has {attribute} {text!r}; expected finite numbers")
    return values


def _all_close(values: list[float], expected: tuple[float, ...]) -> bool:
    return len(values) == len(expected) and all(
        abs(value - want) <= 1e-6 for value, want in zip(values, expected, strict=True)
    )
