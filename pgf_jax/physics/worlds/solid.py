"""The world `solid`: a shelf in three dimensions of our own, and a hand driven as a robot is.

Base and fingers follow their commanded velocities, and contacts feel these velocities. In the
published simulation the fingers' poses are set and their velocities are not, so that they drag
along what they touch; there is nothing of that here.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import copy
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from pgf_jax.physics import hand
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.error import Drawn
from pgf_jax.physics.worlds.solid_model import Solid, compile_model
from pgf_jax.physics.worlds.world import State, World3D
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import HEIGHT, Shelf

_BASE = slice(0, 3)  # x, y, yaw of the base, in qpos and qvel
_SLIP = slice(3, 6)  # x, y, yaw of the hand on the base
_WATCHED = 6  # times in a knot, where somebody watches


class SolidWorld(World3D):
    """The solid world of N objects.

    Args:
      n_objects: N.
      solid: its constants; None: the default ones.
      drawn: in what it differs from them; None: in nothing.
      shelf: its walls and objects; None: standard ones.
    """

    name = "solid"

    def __init__(
        self,
        n_objects: int,
        solid: Solid | None = None,
        drawn: Drawn | None = None,
        shelf: Shelf | None = None,
    ) -> None:
        self.solid = solid or Solid()
        self._drawn = drawn
        model = copy.copy(compile_model(self.solid, n_objects, shelf))
        super().__init__(model, n_objects, None if shelf is None else shelf.radius)
        self._heights = np.full(n_objects, HEIGHT) if shelf is None else shelf.height
        if drawn is not None:
            self._change(drawn)
        links = [self.model.joint(name) for name in hand.LINKS]
        self._link_qpos = np.array([joint.qposadr[0] for joint in links])
        self._link_qvel = np.array([joint.dofadr[0] for joint in links])
        # The table has the turns of the links, a joint's angle is relative to its parent.
        turns = {None: 0.0} | {name: link.angle for name, link in hand.LINKS.items()}
        closed = [turns[name] - turns[link.parent] for name, link in hand.LINKS.items()]
        self._closed = np.array(closed)  # [links] angles of the closed hand, rad

    def start(self, scene: Scene) -> State:
        """See `World3D.start`."""
        positions = scene.positions if self._drawn is None else self._drawn.positions
        still = World(positions, np.zeros((self.n_objects, 2)), np.zeros(3), 0.0)
        return self.state_of(still)

    def _change(self, drawn: Drawn) -> None:
        """Give objects and hand the masses and the friction of a draw."""
        model, factors = self.model, drawn.friction[:, None]
        model.body_mass[self._objects] *= drawn.mass
        model.body_inertia[self._objects] *= drawn.mass[:, None]
        of_object = self._codes[model.geom_bodyid]
        for i in range(self.n_objects):
            model.geom_friction[of_object == i] *= factors[i]
        model.geom_friction[of_object == self.n_objects] *= drawn.hand_friction
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def state_of(self, seen: World) -> State:
        """A state that looks like that from above (unbatched): all objects stand."""
        data = mujoco.MjData(self.model)
        n = self.n_objects  # of the places of a padded world the first
        data.qpos[self._qpos] = [0, 0, 0, 1, 0, 0, 0]
        data.qpos[self._qpos[:, 2]] = self._heights / 2
        data.qpos[self._qpos[:, :2]] = seen.objects[:n]
        data.qvel[self._qvel[:, :2]] = seen.velocities[:n]
        data.qpos[_BASE] = seen.hand
        data.qpos[self._link_qpos] = self._angles(float(seen.gripper))
        mujoco.mj_forward(self.model, data)
        return State(data, float(seen.gripper))

    def _robot(self) -> int:
        return self.model.body("base").id

    def _angles(self, gripper: float) -> np.ndarray:
        return self._closed * gripper / hand.GRIPPER_CLOSED

    def _drive(
        self,
        data: Any,
        velocity: np.ndarray,
        gripper: tuple[float, float],
        seconds: float,
        watch: Callable[[float], None] | None = None,
    ) -> None:
        self._take_up(data)
        # 1 s is no whole number of steps: velocities are such that the way is the commanded one.
        steps = max(1, round(seconds / self.solid.step_s))
        simulated_s = steps * self.solid.step_s
        # The armature keeps these velocities through the knot. The angles are set only so that
        # rounding does not add up.
        before, after = (self._angles(value) for value in gripper)
        data.qpos[self._link_qpos] = before
        data.qvel[_BASE] = velocity * (seconds / simulated_s)
        data.qvel[self._link_qvel] = (after - before) / simulated_s
        parts = 1 if watch is None else min(_WATCHED, steps)
        for part in range(1, parts + 1):
            count = steps * part // parts - steps * (part - 1) // parts
            mujoco.mj_step(self.model, data, count)
            mujoco.mj_kinematics(self.model, data)
            if watch is not None:
                watch(part / parts)

    def _take_up(self, data: Any) -> None:
        """Put the base where the hand is, which may have slipped: commands are about the hand.

        Else a hand that has stalled would from then on turn about a point that is not its own.
        """
        there, (yaw, turning) = self._hand(data), (data.qpos[_BASE][2], data.qvel[_BASE][2])
        # How fast the hand slips stays as it is, along the base's new axes.
        slipping = data.qvel[_SLIP][:2] + turning * np.array([-1, 1]) * data.qpos[_SLIP][1::-1]
        c, s = np.cos(there[2] - yaw), np.sin(there[2] - yaw)
        x, y = slipping
        data.qvel[_SLIP][:2] = c * x + s * y, c * y - s * x
        data.qpos[_BASE], data.qpos[_SLIP] = there, 0.0

    def _hand(self, data: Any) -> np.ndarray:
        slip, base = data.qpos[_SLIP], data.qpos[_BASE]
        c, s = np.cos(base[2]), np.sin(base[2])
        x, y = slip[:2]
        return np.add(base, [c * x - s * y, s * x + c * y, slip[2]])
