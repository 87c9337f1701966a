"""Worlds and rollouts that the tests of physics share, and MuJoCo stepped by hand."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np

from pgf_jax.physics import hand, model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import World
from pgf_jax.scene import sample_scene

PHYSICS = Physics()
AWAY = (-0.5, 0.0, 0.0)  # a hand that touches nothing


def world(objects, velocities=None, pose=AWAY, gripper=0.0):
    """One world as a batch of one."""
    objects = np.asarray(objects, float)
    velocities = np.zeros_like(objects) if velocities is None else np.asarray(velocities, float)
    return World(objects[None], velocities[None], np.array([pose], float), np.array([gripper]))


def idle(batch=1, knots=8):
    """Controls and gripper of a hand that stays open where it is."""
    return np.zeros((batch, knots, 3)), np.zeros((batch, knots))


def sampled(batch, seed=0):
    """A batch of scenes with a hand that goes in, opening and closing: world, controls, gripper."""
    rng = np.random.default_rng(seed)
    presets = ("tight", "wide")
    scenes = [sample_scene(seed * batch + i, presets[i % 2]) for i in range(batch)]
    positions = np.stack([s.positions for s in scenes])
    start = World(positions, np.zeros_like(positions), np.zeros((batch, 3)), np.zeros(batch))
    goals = np.stack([s.positions[s.goal] for s in scenes]) - hand.EE_POINT
    towards = np.concatenate([goals / PHYSICS.rollout_s, np.zeros((batch, 1))], 1)
    controls = towards[:, None] + rng.normal(0, 0.04, (batch, PHYSICS.knots, 3))
    gripper = rng.choice([0.0, 120.0, 255.0], (batch, PHYSICS.knots))
    return start, controls, gripper


class ByHand:
    """MuJoCo's C engine on the planar model, stepped without the engine's code."""

    def __init__(self, n_objects, physics=PHYSICS):
        self.physics = physics
        self.model = mujoco.MjModel.from_xml_string(model.mjcf(physics, n_objects))
        self.data = mujoco.MjData(self.model)

    def set(self, objects, velocities, pose):
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = np.concatenate([pose, np.zeros(6), np.ravel(objects)])
        self.data.qvel[9:] = np.ravel(velocities)

    def step(self, velocity, gripper):
        """One substep; returns the objects' [N, 2] accelerations."""
        m, d = self.model, self.data
        geoms = m.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
        m.geom_pos[geoms], m.geom_quat[geoms] = hand.capsule_poses(float(gripper))
        d.qpos[3:9] = 0
        d.qvel[:9] = np.append(velocity, self.physics.finger_creep * hand.creep(float(gripper)))
        before = d.qvel[9:].copy()
        mujoco.mj_step(m, d)
        return (d.qvel[9:] - before).reshape(-1, 2) / self.physics.substep_s

    def state(self):
        d = self.data
        return d.qpos[9:].reshape(-1, 2).copy(), d.qvel[9:].reshape(-1, 2).copy(), d.qpos[:3].copy()

    def contact_forces(self):
        """World-frame force of each contact: (geom 1, geom 2, [3] on the second)."""
        out = []
        for i in range(self.data.ncon):
            wrench = np.zeros(6)
            mujoco.mj_contactForce(self.model, self.data, i, wrench)
            contact = self.data.contact[i]
            out.append((*contact.geom, contact.frame.reshape(3, 3).T @ wrench[:3]))
        return out

    def roll(self, start, i, controls, gripper, stop=None):
        """Play rollout `i` of a batch up to substep `stop`; yields (substep, velocity, gripper)."""
        self.set(start.objects[i], start.velocities[i], start.hand[i])
        substeps, before = self.physics.substeps, start.gripper[i]
        for k, (velocity, target) in enumerate(zip(controls[i], gripper[i], strict=True)):
            for s in range(substeps):
                yield k * substeps + s, velocity, before + (target - before) * s / substeps
                if k * substeps + s == stop:
                    return
            before = target
