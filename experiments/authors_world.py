"""Compares the planar model with the authors' 3-D world: final positions, reach, creep of fingers.

    python experiments/authors_world.py SCENES_DIR [--count 60] [--rollouts 3]
    python experiments/authors_world.py SCENES_DIR --creep

SCENES_DIR holds the published MJCF with its includes. By default the reach nominal of each scene is
rolled out with noise in both worlds. The script prints the distances between final positions, of
objects that the 3-D world moved by more than 5 mm, and how often each world ends within reach of
the goal. `--creep` measures the table `hand.CREEP`: the acceleration of the finger links while
their poses are held, divided by the damping of the contacts.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import dataclasses
from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import mujoco
import numpy as np
import tyro

from pgf_jax import configure, load_scene, make_engine
from pgf_jax.physics.engine import World
from pgf_jax.physics.hand import GRIPPER_CLOSED
from pgf_jax.planning.config import Cost
from pgf_jax.planning.cost import reach_distance
from pgf_jax.profiling.measure import noisy_nominals

SUBSTEP, KNOT_S = 0.0015, 0.375
BASE = ("robot_lin_x", "robot_lin_y", "robot_ang_z")
# Finger joint angles of the closed gripper, rad.
CLOSED = {
    "joint7_1": 0.822592,
    "joint8_1": -0.186819,
    "joint9_1": -0.642,
    "joint10_1": 0.721295,
    "joint7_2": 0.822595,
    "joint8_2": -0.18689,
    "joint9_2": -0.642,
    "joint10_2": 0.721342,
}
DAMPING = 1000.0  # 1/s, of the authors' contacts: 2 / (dmax timeconst) = 2 / (0.1 * 0.02)
GRIPPERS = (0, 2, 20, 40, 85, 128, 170, 212, 255)


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: Annotated[Path, tyro.conf.Positional]
    count: int = 60
    rollouts: int = 3  # of each scene
    creep: bool = False


class AuthorsWorld:
    """One published scene in 3-D, in which the robot is driven as the authors do it."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.timestep = SUBSTEP
        self.data = mujoco.MjData(self.model)
        joint = self.model.joint
        self.base = [joint(j).dofadr[0] for j in BASE]
        self.base_qpos = [joint(j).qposadr[0] for j in BASE]
        self.fingers = [joint(j).dofadr[0] for j in CLOSED]
        self.fingers_qpos = [joint(j).qposadr[0] for j in CLOSED]

    def step(self, velocity: np.ndarray, gripper: float) -> None:
        """Simulate one substep, with the hand's velocity and the fingers' pose set."""
        self.data.qvel[self.base] = velocity
        self.data.qvel[self.fingers] = 0
        closed = np.array(list(CLOSED.values()))
        self.data.qpos[self.fingers_qpos] = closed * gripper / GRIPPER_CLOSED
        mujoco.mj_step(self.model, self.data)

    def rollout(self, controls: np.ndarray, gripper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulate a rollout; returns object centres [N, 2] and hand pose [3] at its end."""
        mujoco.mj_resetData(self.model, self.data)
        before, substeps = 0.0, round(KNOT_S / SUBSTEP)
        for velocity, target in zip(controls, gripper, strict=True):
            for s in range(substeps):
                self.step(velocity, before + (target - before) * s / substeps)
            before = target
        mujoco.mj_forward(self.model, self.data)
        names = [f"object_{i + 1}" for i in range(20)]
        centres = np.array([self.data.body(n).xpos[:2] for n in names])
        return centres, self.data.qpos[self.base_qpos].copy()

    def creep(self, gripper: float) -> list[float]:
        """Measure the twist (vx, vy, wz) at the hand's origin of right and left follower link."""
        mujoco.mj_resetData(self.model, self.data)
        for i in range(20):  # out of the way
            self.data.joint(f"object_{i + 1}_free").qpos[:2] = (-5 - i, 0)
        for _ in range(100):
            self.step(np.zeros(3), gripper)
        twist = []
        for side in ("right", "left"):
            body = self.model.body(f"{side}_follower_link").id
            linear, angular = np.zeros((2, 3, self.model.nv))
            origin = np.array([0.0, 0.0, self.data.xpos[body, 2]])
            mujoco.mj_jac(self.model, self.data, linear, angular, origin, body)
            acceleration = [*(linear @ self.data.qacc)[:2], (angular @ self.data.qacc)[2]]
            twist += [a / DAMPING for a in acceleration]
        return twist


def main(config: Config) -> None:
    """Measure, and print the results."""
    configure("native")
    paths = sorted(config.scenes.glob("*.xml"))[: config.count]
    if config.creep:
        for gripper in GRIPPERS:
            print(gripper, np.round(AuthorsWorld(paths[0]).creep(gripper), 4).tolist())
        return
    scenes = [load_scene(p) for p in paths]
    engine = make_engine("native")
    start, controls, gripper, _ = noisy_nominals(engine, scenes, 0)
    k = len(controls) // len(scenes)
    chosen = [i * k + j for i in range(len(scenes)) for j in range(config.rollouts)]
    start, controls, gripper = World(*(f[chosen] for f in start)), controls[chosen], gripper[chosen]
    planar = engine.rollout(start, controls, gripper, engine.physics.substeps)
    worlds = [AuthorsWorld(p) for p in paths]
    solid = [
        worlds[c // k].rollout(u, g) for c, u, g in zip(chosen, controls, gripper, strict=True)
    ]
    objects, hands = (np.array(x) for x in zip(*solid, strict=True))
    moved = np.linalg.norm(objects - start.objects, axis=-1) > 0.005
    apart = 1e3 * np.linalg.norm(planar.objects[:, -1] - objects, axis=-1)[moved]
    goals = np.array([s.goal for s in scenes for _ in range(config.rollouts)])

    def reached(hand, centres) -> np.ndarray:
        d = reach_distance(
            jnp.asarray(hand, jnp.float32), jnp.asarray(centres, jnp.float32), Cost()
        )
        return np.asarray(d)[np.arange(len(goals)), goals] < Cost().goal_radius

    flat, real = reached(planar.hand[:, -1], planar.objects[:, -1]), reached(hands, objects)
    print(
        f"{len(chosen)} rollouts, {moved.sum()} objects moved: median {np.median(apart):.1f} mm, "
        f"mean {apart.mean():.1f} mm\nwithin reach of the goal: planar {flat.sum()}, "
        f"3-D {real.sum()}, both {(flat & real).sum()}"
    )


if __name__ == "__main__":
    main(tyro.cli(Config))
