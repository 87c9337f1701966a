"""The world `scene`: what a published scene file describes, driven as its authors drive it.

The robot's base velocity and the fingers' poses are set before every substep. So contacts feel a
creep of the fingers that a robot would not have (`hand.CREEP`), and nothing stalls the hand: this
world is here because it is the published one.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.physics.hand import GRIPPER_CLOSED
from pgf_jax.physics.worlds.scene_model import (
    BASE,
    FINGERS,
    SITES,
    SceneModel,
    read_scene_model,
)
from pgf_jax.physics.worlds.world import State, World3D
from pgf_jax.scene.scene import Scene

__all__ = ["SceneModel", "SceneWorld", "read_scene_model"]

STEP_S = 0.0015
_SAME_M = 1e-9  # positions that are read of the same file


class SceneWorld(World3D):
    """The world of one scene file.

    Args:
      model: what was read of the file.
    """

    name = "scene"

    def __init__(self, model: SceneModel) -> None:
        self.digest = model.digest
        super().__init__(model.compile(), model.n_objects)
        compiled = self.model
        compiled.opt.timestep = STEP_S
        base, fingers = ([compiled.joint(name) for name in names] for names in (BASE, FINGERS))
        self._base_qpos = np.array([joint.qposadr[0] for joint in base])
        self._base_qvel = np.array([joint.dofadr[0] for joint in base])
        self._finger_qpos = np.array([joint.qposadr[0] for joint in fingers])
        self._finger_qvel = np.array([joint.dofadr[0] for joint in fingers])
        self._turn = np.array(list(FINGERS.values())) / GRIPPER_CLOSED  # [fingers] rad a unit
        self._sites = np.array([compiled.site(name).id for name in SITES])

    def start(self, scene: Scene) -> State:
        """See `World3D.start`; the state is the file's.

        Raises:
          BadInput: the scene's objects stand elsewhere.
        """
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        there = data.qpos[self._qpos[:, :2]]
        if len(scene.objects) != self.n_objects:
            raise BadInput(
                f"scene {scene.name}: has {len(scene.objects)} objects; expected "
                f"{self.n_objects} as in the file of its world"
            )
        apart = np.abs(scene.positions - there).max(1)
        if not (apart <= _SAME_M).all():
            i = int(apart.argmax())
            (x, y), (a, b) = scene.positions[i], there[i]
            raise BadInput(
                f"scene {scene.name}: object_{i + 1} is at ({x:g}, {y:g}); expected ({a:g}, {b:g})"
                f" as in the file of its world"
            )
        return State(data, 0.0)

    def _robot(self) -> int:
        return self.model.body("robot").id

    def _drive(
        self,
        data: Any,
        velocity: np.ndarray,
        gripper: tuple[float, float],
        seconds: float,
        watch: Callable[[float], None] | None = None,
    ) -> None:
        before, after = gripper
        steps = round(seconds / STEP_S)  # 1 s is 667 steps here
        qpos, qvel = data.qpos, data.qvel
        for step in range(steps):
            qvel[self._base_qvel] = velocity
            qpos[self._finger_qpos] = self._turn * (before + (after - before) * step / steps)
            qvel[self._finger_qvel] = 0
            mujoco.mj_step(self.model, data)
        mujoco.mj_forward(self.model, data)
        if watch is not None:
            watch(1.0)

    def _hand(self, data: Any) -> np.ndarray:
        return data.qpos[self._base_qpos]

    def _pointing(self, data: Any) -> tuple[np.ndarray, np.ndarray]:
        # The sites, and not the planner's rounded numbers: a retreat is to the bit the authors'.
        point, ahead = data.site_xpos[self._sites, :2]
        return point, (ahead - point) / np.linalg.norm(ahead - point)
