"""Draws a shelf in three dimensions with MuJoCo's renderer; nothing is simulated here.

The model holds the shelf alone. Objects and hand are added to the drawn scene for each picture, so
one model and one GL context serve every robot, every number of objects and every size.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import atexit
import itertools
import math
from typing import Any

import numpy as np
from PIL import ImageColor

from pgf_jax.errors import BadInput
from pgf_jax.physics import hand
from pgf_jax.render.paint import SHELF_ASPECT
from pgf_jax.render.top import PUSH_COLOR
from pgf_jax.scene.draw import CORRIDOR_OBJECT_COLOR, GOAL_COLOR, ROBOT_COLOR
from pgf_jax.scene.shelf import BACK_WALL_X, FRONT_X, SIDE_WALL_Y
from pgf_jax.simulation.snapshot import RobotSnapshot

_SIDE, _WALL, _BOARD = 0.17, 0.012, 0.02  # height of the walls, thickness of walls and board, m
_HAND_Z = 0.060  # height of the hand's middle plane, m
# Half heights of the palm's capsules, m; all different, because faces in one plane would flicker.
_PALM_HALF_Z = (0.036, 0.028, 0.032, 0.024)
_OBJECT, _PATH, _FINGER, _ARM = "#b9bec6", "#f2b705", "#2a2f38", "#c5ccd6"
_LOOK_AT, _DISTANCE, _ELEVATION = (0.29, 0.0, 0.02), 1.10, -54.0  # m, m, degrees
_MAX_GEOMS = 1000
_SHADOWS_FROM_PX = 200  # smallest width of a picture with shadows
_SPARE = 256  # sides of the drawing buffer are multiples of it, pixels

_MODEL = """
<mujoco>
  <statistic center="0.3 0 0" extent="1"/>
  <visual>
    <quality shadowsize="4096" offsamples="4"/>
    <headlight ambient="0.38 0.38 0.38" diffuse="0.28 0.28 0.28" specular="0 0 0"/>
    <global offwidth="{width}" offheight="{height}" fovy="40"/>
    <map shadowclip="0.9" znear="0.05"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" width="64" height="64"
      rgb1="0.93 0.94 0.96" rgb2="0.80 0.83 0.87"/>
    <texture name="wood" type="2d" builtin="flat" mark="random" random="0.12" width="512"
      height="64" rgb1="0.85 0.70 0.50" markrgb="0.81 0.66 0.46"/>
    <material name="wood" texture="wood" texuniform="true" texrepeat="1 1" specular="0.1"/>
    <material name="wall" rgba="0.52 0.38 0.25 1" specular="0.1"/>
  </asset>
  <worldbody>
    <light directional="true" pos="0 0.3 1.5" dir="0.35 -0.3 -1" diffuse="0.45 0.45 0.44"
      specular="0.3 0.3 0.3" castshadow="true"/>
    {boxes}
  </worldbody>
</mujoco>
"""


class View3d:
    """Draws shelves in three dimensions, seen from the front and above; a `ShelfView`.

    Raises:
      BadInput: the computer has no EGL.
    """

    def __init__(self) -> None:
        try:
            import mujoco
            from mujoco.egl import GLContext

            self._gl: Any = GLContext(0, 0)
        # A missing driver has many forms: no library, no display, no configuration.
        except (ImportError, AttributeError, RuntimeError, OSError, ValueError) as error:
            raise _no_egl() from error
        except Exception as error:  # PyOpenGL's own errors share no base class with these
            if not type(error).__module__.startswith("OpenGL"):
                raise
            raise _no_egl() from error
        self._mujoco = mujoco
        self._walls = (BACK_WALL_X, SIDE_WALL_Y)  # of the shelf in the model
        self._context: Any = None
        self._buffer = (0, 0)  # width and height of the drawing buffer, pixels
        atexit.register(self.close)  # the context must be freed before the display is

    def shelf(self, robot: RobotSnapshot, width: int, height: int) -> np.ndarray:
        """See `ShelfView.shelf`."""
        mujoco = self._mujoco
        if self._gl is None:
            raise RuntimeError("the view has been closed")
        self._gl.make_current()
        self._prepare(width, height, (robot.back_x, robot.side_y))
        camera = mujoco.MjvCamera()
        camera.lookat[:] = _LOOK_AT
        # In a narrow picture the whole width of the shelf is seen from farther away.
        wider = max(1.0, robot.side_y / SIDE_WALL_Y, robot.back_x / BACK_WALL_X)
        camera.distance = _DISTANCE * wider * max(1.0, SHELF_ASPECT * height / width)
        camera.azimuth, camera.elevation = 0.0, _ELEVATION
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, camera, everything, self._scene
        )
        moving = _MovingGeoms(mujoco, self._scene)
        moving.objects(robot)
        moving.hand(robot)
        moving.path(robot)
        if robot.push is not None:
            moving.push(robot)
        # Shadows take two thirds of the time in software, and are hardly seen in a small picture.
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW.value] = width >= _SHADOWS_FROM_PX
        picture = np.empty((height, width, 3), np.uint8)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._context)
        mujoco.mjr_readPixels(picture, None, rect, self._context)
        return np.ascontiguousarray(picture[::-1])

    def close(self) -> None:
        """See `ShelfView.close`."""
        if self._gl is None:
            return
        atexit.unregister(self.close)
        self._gl.make_current()
        if self._context is not None:
            self._context.free()
        self._gl.free()
        self._gl = None

    def _prepare(self, width: int, height: int, walls: tuple[float, float]) -> None:
        """Have a drawing buffer of `width` x `height` pixels at least, and these walls."""
        fits = width <= self._buffer[0] and height <= self._buffer[1]
        if fits and walls == self._walls:
            return
        self._walls = walls
        mujoco = self._mujoco
        if self._context is not None:
            self._context.free()
        least = (max(width, self._buffer[0]), max(height, self._buffer[1]))
        self._buffer = (-(-least[0] // _SPARE) * _SPARE, -(-least[1] // _SPARE) * _SPARE)
        self._model = mujoco.MjModel.from_xml_string(
            _MODEL.format(width=self._buffer[0], height=self._buffer[1], boxes=_boxes(*walls))
        )
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._option = mujoco.MjvOption()
        self._scene = mujoco.MjvScene(self._model, _MAX_GEOMS)
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)


def _no_egl() -> BadInput:
    return BadInput(
        "view 3d: needs EGL (install libegl1, or a graphics driver, and leave PYOPENGL_PLATFORM "
        "unset), found none; --view top does without"
    )


def _boxes(back_x: float, side_y: float) -> str:
    """XML of the shelf: a board and three walls."""
    depth, middle = (back_x - FRONT_X) / 2, (back_x + FRONT_X) / 2
    z, tall, thin = (_SIDE - _BOARD) / 2, (_SIDE + _BOARD) / 2, _WALL / 2
    boxes = [
        ("wood", (middle, 0, -_BOARD / 2), (depth, side_y, _BOARD / 2)),
        ("wall", (back_x + thin, 0, z), (thin, side_y + _WALL, tall)),
        ("wall", (middle, side_y + thin, z), (depth, thin, tall)),
        ("wall", (middle, -side_y - thin, z), (depth, thin, tall)),
    ]
    return "".join(
        f'<geom type="box" material="{material}" pos="{_numbers(pos)}" size="{_numbers(size)}"/>'
        for material, pos, size in boxes
    )


def _numbers(values) -> str:
    return " ".join(f"{v:g}" for v in values)


class _MovingGeoms:
    """Adds the objects, the hand, the path and the push to a scene before it is drawn."""

    def __init__(self, mujoco: Any, scene: Any) -> None:
        self._mujoco, self._scene, self._type = mujoco, scene, mujoco.mjtGeom

    def _geom(self, shape: Any, size, pos, color: str, turn=None, alpha: float = 1.0) -> Any:
        """Add a geom; returns None if the scene is full."""
        scene = self._scene
        if scene.ngeom >= scene.maxgeom:
            return None
        geom = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        turn = np.eye(3) if turn is None else turn
        rgba = np.array([*(v / 255 for v in ImageColor.getrgb(color)[:3]), alpha], np.float32)
        self._mujoco.mjv_initGeom(
            geom, shape.value, np.array(size, float), np.array(pos, float), turn.ravel(), rgba
        )
        # A geom of the category "decoration" would throw no shadow.
        geom.category = self._mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        geom.transparent = int(alpha < 1)
        geom.specular, geom.shininess = 0.25, 0.4
        return geom

    def _connect(self, shape: Any, width: float, a, b, color: str) -> None:
        geom = self._geom(shape, (0.01, 0.01, 0.01), (0, 0, 0), color)
        if geom is not None:
            ends = (np.array(a, float), np.array(b, float))
            self._mujoco.mjv_connector(geom, shape.value, width, *ends)

    def _cylinder(
        self, x, y, z, radius, half: float, color: str, alpha: float = 1.0, turn=None
    ) -> None:
        # As in a model: `mjv_initGeom` makes the three sizes that are drawn of these two.
        size = (radius, half, 0.0)
        self._geom(self._type.mjGEOM_CYLINDER, size, (x, y, z), color, turn, alpha)

    def objects(self, robot: RobotSnapshot) -> None:
        """Add the objects as cylinders, upright where nothing says how they lean."""
        pushed = None if robot.push is None else robot.push.object
        standing = np.tile([0.0, 0.0, 0.0, 1.0], (len(robot.objects), 1))
        standing[:, 0] = robot.heights / 2
        leaning = robot.leaning if len(robot.leaning) else standing
        for i, ((x, y), (z, *axis)) in enumerate(zip(robot.objects, leaning, strict=True)):
            color = CORRIDOR_OBJECT_COLOR if i == pushed else _OBJECT
            color = GOAL_COLOR if i == robot.goal else color
            size = (robot.radii[i], robot.heights[i] / 2)
            self._cylinder(x, y, z, *size, color, turn=_along(np.array(axis)))

    def hand(self, robot: RobotSnapshot) -> None:
        """Add the hand's capsules, extruded, and a wrist and a forearm behind them."""
        x, y, yaw = (float(v) for v in robot.hand)
        axes, palms = robot.hand_axes(), iter(_PALM_HALF_Z)
        for (a, b), radius, body in zip(axes, hand.RADII, hand.CAPSULE_BODY, strict=True):
            palm = hand.BODIES[body] == "palm"
            color, half = (ROBOT_COLOR, next(palms)) if palm else (_FINGER, 0.016)
            (dx, dy), (mx, my) = b - a, (a + b) / 2
            length = math.hypot(dx, dy)
            if length < radius / 2:
                self._cylinder(mx, my, _HAND_Z, radius + length / 2, half, color)
                continue
            along = _about_z(math.atan2(dy, dx))
            size = (length / 2, radius, half)
            self._geom(self._type.mjGEOM_BOX, size, (mx, my, _HAND_Z), color, along)
            for end_x, end_y in (a, b):
                self._cylinder(end_x, end_y, _HAND_Z, radius, half - 0.002, color)
        ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        base = np.array([x, y, _HAND_Z])
        self._connect(
            self._type.mjGEOM_CYLINDER, 0.046, base - 0.075 * ahead, base - 0.02 * ahead, _FINGER
        )
        self._connect(self._type.mjGEOM_CAPSULE, 0.042, base - 0.70 * ahead, base, _ARM)

    def path(self, robot: RobotSnapshot) -> None:
        """Add the path of the end-effector point, above the objects."""
        above = robot.heights.max(initial=0.0) + 0.012
        points = [(x, y, above) for x, y in robot.end_effector_path()]
        for a, b in itertools.pairwise(points):
            self._connect(self._type.mjGEOM_CAPSULE, 0.003, a, b, _PATH)
        for point in points:
            self._geom(self._type.mjGEOM_SPHERE, (0.006,) * 3, point, _PATH)

    def push(self, robot: RobotSnapshot) -> None:
        """Add the pushed object once more, transparent, at its target, and an arrow to it."""
        push = robot.push
        assert push is not None
        start, half = robot.objects[push.object], robot.heights[push.object] / 2
        size = (robot.radii[push.object], half)
        self._cylinder(push.x, push.y, half, *size, CORRIDOR_OBJECT_COLOR, 0.4)
        z = robot.heights.max() + 0.02
        a, b = (float(start[0]), float(start[1]), z), (push.x, push.y, z)
        if math.dist(a, b) > 1e-3:
            self._connect(self._type.mjGEOM_ARROW, 0.006, a, b, PUSH_COLOR)


def _along(axis: np.ndarray) -> np.ndarray:
    """A rotation that turns the vertical into an axis (any length)."""
    ahead = axis / np.linalg.norm(axis)
    aside = np.cross(ahead, np.eye(3)[np.argmin(abs(ahead))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(ahead, aside), ahead], axis=1)


def _about_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
