"""Engine `native`: MuJoCo's C engine in float64 on its own threads; the reference for parity."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import copy

import mujoco
import numpy as np
from mujoco.batch import Batch

from pgf_jax.cores import usable
from pgf_jax.physics import hand, model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, choice, contact_slots
from pgf_jax.physics.shelves import KeptByShelf
from pgf_jax.scene.shelf import Shelf

SOLVERS = {"cg": mujoco.mjtSolver.mjSOL_CG, "newton": mujoco.mjtSolver.mjSOL_NEWTON}
JACOBIANS = {"dense": mujoco.mjtJacobian.mjJAC_DENSE, "sparse": mujoco.mjtJacobian.mjJAC_SPARSE}


class NativeEngine:
    """MuJoCo's C engine. Rollouts do not depend on each other, so `lanes` only sizes the calls."""

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
        self.threads = threads or len(usable())
        solver = choice(self.name, "solver", solver, SOLVERS)
        jacobian = choice(self.name, "jacobian", jacobian, JACOBIANS)

        def simulations(shelf: Shelf | None) -> _Simulations:
            m = copy.copy(model.compile_model(physics, n_objects, shelf))
            m.opt.solver, m.opt.jacobian = solver, jacobian
            m.opt.iterations, m.opt.tolerance = iterations, tolerance
            # A diverged state stays non-finite; MuJoCo would reset it to the initial state.
            m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
            if sleep:
                m.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
            return _Simulations(m, physics, n_objects, self.threads)

        self._standard = simulations(None)
        self._model = self._standard.model
        self._others = KeptByShelf(simulations)

    def rollout(
        self,
        start: World,
        controls,
        gripper,
        substeps: int,
        wanted=None,
        shelf: Shelf | None = None,
    ) -> Rollout:
        """See `Engine.rollout`; float64 arrays, nan where a rollout is not wanted."""
        start = World(*(np.asarray(x, np.float64) for x in start))
        controls, gripper = np.asarray(controls, np.float64), np.asarray(gripper, np.float64)
        wanted = np.ones(len(controls), bool) if wanted is None else np.array(wanted, bool)
        if shelf is None:
            return self._standard.rollout(start, controls, gripper, substeps, wanted)
        out = _nothing(len(controls), controls.shape[1], self.n_objects)
        groups: dict[_Simulations, list[int]] = {}
        for i in np.flatnonzero(wanted):
            groups.setdefault(self._others.of(shelf, int(i)), []).append(int(i))
        for simulations, mine in groups.items():
            begin = World._make([x[mine] for x in start])
            done = simulations.rollout(begin, controls[mine], gripper[mine], substeps, wanted[mine])
            for whole, part in zip(out, done, strict=True):
                whole[mine] = part
        return out


class _Simulations:
    """Simulations of one model, as many as a call has rollouts."""

    def __init__(
        self, compiled: mujoco.MjModel, physics: Physics, n_objects: int, threads: int
    ) -> None:
        self.model, self._physics, self._n_objects = compiled, physics, n_objects
        self._threads = threads
        self._hand_geoms = model.hand_geoms(compiled)
        self._bodies = model.geom_bodies(compiled, n_objects)
        self._batches: dict[int, Batch] = {}
        self._scratch = mujoco.MjData(compiled)

    def rollout(
        self,
        start: World,
        controls: np.ndarray,
        gripper: np.ndarray,
        substeps: int,
        wanted: np.ndarray,
    ) -> Rollout:
        b, t, n = len(controls), controls.shape[1], self._n_objects
        out = _nothing(b, t, n)
        batch = self._batch(b)
        base, dofs = model.HAND_DOFS, model.KINEMATIC_DOFS
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
        qpos[:, :base], qpos[:, dofs:] = start.hand, start.objects.reshape(b, -1)
        qvel[:, dofs:] = start.velocities.reshape(b, -1)
        alive = wanted.copy()
        before = start.gripper.copy()
        for k in range(t):
            target = gripper[:, k]
            for s in range(substeps):
                if s == 0 or (target != before).any():
                    now = before + (target - before) * s / substeps
                    self._pose_fingers(batch, now)
                    speeds = model.kinematic_velocity(controls[:, k].T, now, self._physics).T
                qpos[alive, base:dofs] = 0.0
                qvel[alive, :dofs] = speeds[alive]
                batch.step(np.flatnonzero(alive))
            before = target
            # MuJoCo's own test of a bad state (nan compares false).
            alive &= (np.abs(qpos) <= mujoco.mjMAXVAL).all(1)
            alive &= (np.abs(qvel) <= mujoco.mjMAXVAL).all(1)
            out.objects[alive, k] = qpos[alive, dofs:].reshape(-1, n, 2)
            out.hand[alive, k] = qpos[alive, :base]
            for i in np.flatnonzero(alive):
                self._contacts(batch, int(i), out.force[i, k], out.bodies[i, k])
        out.velocities[alive] = qvel[alive, dofs:].reshape(-1, n, 2)
        return out

    def _batch(self, size: int) -> Batch:
        if size not in self._batches:
            # Sleeping needs each simulation's own data to persist between steps.
            batch = Batch(self.model, size, nthread=self._threads, persistent=True)
            batch.expand("geom_pos")
            batch.expand("geom_quat")
            self._batches[size] = batch
        return self._batches[size]

    def _pose_fingers(self, batch: Batch, gripper: np.ndarray) -> None:
        """Give each simulation's hand the capsule poses of its gripper value."""
        values, which = np.unique(gripper, return_inverse=True)
        poses = [hand.capsule_poses(value) for value in values]
        geoms = self._hand_geoms
        batch.expand("geom_pos")[:, geoms] = np.stack([p for p, _ in poses])[which]
        batch.expand("geom_quat")[:, geoms] = np.stack([q for _, q in poses])[which]

    def _contacts(self, batch: Batch, i: int, force: np.ndarray, bodies: np.ndarray) -> None:
        if not batch.bind("ncon")[i]:
            return
        d = batch.get_data(i, self._scratch)
        wrench = np.zeros(6)
        for c in range(min(d.ncon, len(force))):
            mujoco.mj_contactForce(self.model, d, c, wrench)
            force[c] = np.linalg.norm(wrench[:3])
            bodies[c] = self._bodies[d.contact.geom[c]]


def _nothing(b: int, t: int, n: int) -> Rollout:
    """A rollout of nothing: nan, without contacts."""
    c = contact_slots(n)
    return Rollout(
        objects=np.full((b, t, n, 2), np.nan),
        hand=np.full((b, t, 3), np.nan),
        velocities=np.full((b, n, 2), np.nan),
        force=np.zeros((b, t, c)),
        bodies=np.zeros((b, t, c, 2), np.int32),
    )
