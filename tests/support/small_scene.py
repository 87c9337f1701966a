"""A small scene file of our own, with the names that the world `scene` drives."""

import itertools
import struct
from pathlib import Path

import numpy as np

from pgf_jax.physics.hand import EE_POINT, EE_POINT_AHEAD
from pgf_jax.scene.scene import Scene

PLACES = ((0.5, 0.2), (0.33, -0.15), (0.4, -0.0088))  # the goal stands straight ahead
FINGERS = [f"joint{n}_{side}" for side in (1, 2) for n in (7, 8, 9, 10)]


def objects(places=PLACES) -> str:
    return "".join(
        f'<body name="object_{i + 1}" pos="{x} {y} 0.05"><freejoint/>'
        '<geom type="cylinder" size=".03 .05" mass="1" contype="3" conaffinity="3"/></body>'
        for i, (x, y) in enumerate(places)
    )


def robot() -> str:
    """A box on a base, with eight small links; half of them close."""
    links = "".join(
        f'<body pos="0.05 {0.01 * i} 0.05"><joint name="{name}" type="hinge" axis="0 0 1"/>'
        '<geom type="sphere" size="0.004" contype="0" conaffinity="0"/></body>'
        for i, name in enumerate(FINGERS)
    )
    sites = "".join(
        f'<site name="ee_point_{i}" pos="{x} {y} 0.05"/>'
        for i, (x, y) in enumerate((EE_POINT, EE_POINT_AHEAD), 1)
    )
    return f"""<body name="robot">
      <joint name="robot_lin_x" type="slide" axis="1 0 0"/>
      <joint name="robot_lin_y" type="slide" axis="0 1 0"/>
      <joint name="robot_ang_z" type="hinge" axis="0 0 1"/>
      <geom type="mesh" mesh="block" pos="0.1 0 0.05" mass="100" contype="1" material="paint"/>
      {sites}{links}</body>"""


SHELF = """<body name="shelf"><geom type="box" size="0.2 0.41 0.1" pos="0.4 0 -0.1" contype="4"
      conaffinity="3"/><geom type="box" size="0.1 0.4 0.2" pos="0.69 0 0" contype="4"
      conaffinity="3"/></body>"""


def block() -> bytes:
    """A box as binary STL: x of 0.1 m, y of 0.08 m, z of 0.04 m."""
    corners = np.array(list(itertools.product((-0.05, 0.05), (-0.04, 0.04), (-0.02, 0.02))))
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    triangles = b"".join(
        struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces
    )
    return bytes(80) + struct.pack("<I", len(faces)) + triangles


def document(*, head="", body="", places=PLACES) -> str:
    return f"""<mujoco><compiler angle="radian" meshdir="robot/meshes"/>{head}
      <include file="robot/assets.xml"/>
      <worldbody><light pos="0 0 2"/>{objects(places)}<include file="robot/robot.xml"/>
      {SHELF}{body}</worldbody></mujoco>"""


def write(folder: Path, text: str | None = None) -> Path:
    """Write the scene file and its folder; returns its path."""
    (folder / "robot" / "meshes").mkdir(parents=True)
    (folder / "robot" / "meshes" / "block.stl").write_bytes(block())
    assets = '<mesh file="block.stl"/><material name="paint"/>'
    included = {"robot.xml": robot(), "assets.xml": f"<asset>{assets}</asset>"}
    for name, held in included.items():
        (folder / "robot" / name).write_text(f"<mujocoinclude>{held}</mujocoinclude>")
    path = folder / "small.xml"
    path.write_text(document() if text is None else text)
    return path


def scene() -> Scene:
    return Scene("small", np.array([[*place, 0.03] for place in PLACES]), 2)
