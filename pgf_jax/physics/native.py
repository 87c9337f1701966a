"""Engine `native`: MuJoCo's C engine in float64 on a pool of threads; the parity oracle."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import concurrent.futures
import copy
import os
import queue

import mujoco
import numpy as np

from pgf_jax.physics import hand, model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import MAX_CONTACTS, Rollout, World

SOLVERS = {"cg": mujoco.mjtSolver.mjSOL_CG, "newton": mujoco.mjtSolver.mjSOL_NEWTON}
JACOBIANS = {"dense": mujoco.mjtJacobian.mjJAC_DENSE, "sparse": mujoco.mjtJacobian.mjJAC_SPARSE}


class NativeEngine:
    """MuJoCo C; each rollout is independent of the others, so `lanes` is only a size of calls."""

    name = "native"

    def __init__(
        self,
        physics: Physics,
        n_objects: int,
        *,
        lanes: int = 1,
        threads: int | None = None,
        solver: str = "newton",
        jacobian: str = "dense",
        iterations: int = 100,
        tolerance: float = model.SOLVER_TOLERANCE,
        sleep: bool = True,
    ) -> None:
        self.physics, self.n_objects, self.lanes = physics, n_objects, lanes
        compiled = model.compile_model(physics, n_objects)
        self.threads = threads or len(os.sched_getaffinity(0))
        self._hand_geoms = model.hand_geoms(compiled)
        self._bodies = model.geom_bodies(compiled, n_objects)
        self._pool = concurrent.futures.ThreadPoolExecutor(self.threads)
        # A thread works on a model of its own: the fingers move by changing geom poses.
        self._workspaces: queue.SimpleQueue = queue.SimpleQueue()
        for _ in range(self.threads):
            m = copy.copy(compiled)
            m.opt.solver, m.opt.jacobian = SOLVERS[solver], JACOBIANS[jacobian]
            m.opt.iterations, m.opt.tolerance = iterations, tolerance
            if sleep:
                m.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
            self._workspaces.put((m, mujoco.MjData(m)))

    def rollout(self, start: World, controls, gripper, substeps: int) -> Rollout:
        """See `Engine.rollout`; float64 arrays."""
        start = World(*(np.asarray(x, np.float64) for x in start))
        controls, gripper = np.asarray(controls, np.float64), np.asarray(gripper, np.float64)
        b, t, n = len(controls), controls.shape[1], self.n_objects
        out = Rollout(
            objects=np.empty((b, t, n, 2)),
            hand=np.empty((b, t, 3)),
            velocities=np.empty((b, n, 2)),
            force=np.zeros((b, t, MAX_CONTACTS)),
            bodies=np.zeros((b, t, MAX_CONTACTS, 2), np.int32),
        )

        def one(i: int) -> None:
            m, d = self._workspaces.get()
            try:
                self._one(m, d, start, controls, gripper, substeps, out, i)
            finally:
                self._workspaces.put((m, d))

        list(self._pool.map(one, range(b)))
        return out

    def _one(self, m, d, start, controls, gripper, substeps, out: Rollout, i: int) -> None:
        base, dofs = model.HAND_DOFS, model.KINEMATIC_DOFS
        mujoco.mj_resetData(m, d)
        d.qpos[:base], d.qpos[dofs:] = start.hand[i], start.objects[i].ravel()
        d.qvel[dofs:] = start.velocities[i].ravel()
        before = start.gripper[i]
        for k, (velocity, target) in enumerate(zip(controls[i], gripper[i], strict=True)):
            for s in range(substeps):
                if s == 0 or target != before:
                    now = before + (target - before) * s / substeps
                    self._pose_fingers(m, now)
                    speeds = model.kinematic_velocity(velocity, now, self.physics)
                d.qpos[base:dofs] = 0.0
                d.qvel[:dofs] = speeds
                mujoco.mj_step(m, d)
            before = target
            if _diverged(d):
                for array in (out.objects[i, k:], out.hand[i, k:], out.velocities[i]):
                    array[:] = np.nan
                return
            out.objects[i, k] = d.qpos[dofs:].reshape(-1, 2)
            out.hand[i, k] = d.qpos[:base]
            self._contacts(m, d, out.force[i, k], out.bodies[i, k])
        out.velocities[i] = d.qvel[dofs:].reshape(-1, 2)

    def _pose_fingers(self, m: mujoco.MjModel, gripper: float) -> None:
        positions, quats = hand.capsule_poses(np.float64(gripper))
        m.geom_pos[self._hand_geoms], m.geom_quat[self._hand_geoms] = positions, quats

    def _contacts(self, m, d, force: np.ndarray, bodies: np.ndarray) -> None:
        n = min(d.ncon, len(force))
        wrench = np.zeros(6)
        for c in range(n):
            mujoco.mj_contactForce(m, d, c, wrench)
            force[c] = np.linalg.norm(wrench[:3])
            bodies[c] = self._bodies[d.contact.geom[c]]


def _diverged(d: mujoco.MjData) -> bool:
    """Whether MuJoCo met a state that is not finite, which it then replaced by the model's own."""
    bad = (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
    return any(d.warning[w].number for w in bad)
