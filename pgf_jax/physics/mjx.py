"""Engine `mjx`: `mjx.step` under `vmap`, float32, one jitted program per batch shape."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import contextlib
import io

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

# The import prints that Warp, an optional backend, is absent.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

from pgf_jax.physics import hand, model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, choice

SOLVERS = {"cg": mujoco.mjtSolver.mjSOL_CG, "newton": mujoco.mjtSolver.mjSOL_NEWTON}


class MjxEngine:
    """MJX with a fixed number of solver iterations (tolerance 0: no early stop by tolerance)."""

    name = "mjx"

    def __init__(
        self,
        physics: Physics,
        n_objects: int,
        *,
        lanes: int = 1,
        solver: str = "newton",
        iterations: int = 2,
        ls_iterations: int = 6,
    ) -> None:
        self.physics, self.n_objects, self.lanes = physics, n_objects, lanes
        compiled = mujoco.MjModel.from_xml_string(model.mjcf(physics, n_objects))
        compiled.opt.solver = choice(self.name, "solver", solver, SOLVERS)
        compiled.opt.iterations = iterations
        compiled.opt.ls_iterations = ls_iterations
        compiled.opt.tolerance = 0.0
        self._model = mjx.put_model(compiled)
        self._data = mjx.make_data(compiled)
        self._hand_geoms = model.hand_geoms(compiled)
        self._bodies = jnp.asarray(model.geom_bodies(compiled, n_objects))
        self._batched = jax.jit(jax.vmap(self._rollout, in_axes=(0, 0, 0, None)))

    def rollout(self, start: World, controls, gripper, substeps: int, wanted=None) -> Rollout:
        """See `Engine.rollout`; computes all rollouts, wanted or not."""
        return self._batched(start, controls, gripper, substeps)

    def _substep(self, data: mjx.Data, velocity: jax.Array, gripper: jax.Array) -> mjx.Data:
        positions, quats = hand.capsule_poses(gripper, jnp)
        posed = self._model.replace(
            geom_pos=self._model.geom_pos.at[self._hand_geoms].set(positions),
            geom_quat=self._model.geom_quat.at[self._hand_geoms].set(quats),
        )
        speeds = model.kinematic_velocity(velocity, gripper, self.physics, jnp)
        fingers = slice(model.HAND_DOFS, model.KINEMATIC_DOFS)
        return mjx.step(
            posed,
            data.replace(
                qpos=data.qpos.at[fingers].set(0.0),
                qvel=data.qvel.at[: model.KINEMATIC_DOFS].set(speeds),
            ),
        )

    def _rollout(self, start: World, controls, gripper, substeps) -> Rollout:
        dofs = model.KINEMATIC_DOFS
        data = self._data.replace(
            qpos=jnp.concatenate([start.hand, jnp.zeros(model.FINGER_DOFS), start.objects.ravel()]),
            qvel=jnp.concatenate([jnp.zeros(dofs), start.velocities.ravel()]),
        )

        def knot(carry, inputs):
            data, before = carry
            velocity, target = inputs

            def body(s, data):
                return self._substep(data, velocity, before + (target - before) * s / substeps)

            data = jax.lax.fori_loop(0, substeps, body, data)
            force, bodies = self._contacts(data)
            objects = data.qpos[dofs:].reshape(-1, 2)
            return (data, target), (objects, data.qpos[: model.HAND_DOFS], force, bodies)

        (data, _), (objects, hands, force, bodies) = jax.lax.scan(
            knot, (data, start.gripper), (controls, gripper)
        )
        velocities = data.qvel[dofs:].reshape(-1, 2)
        return Rollout(objects, hands, velocities, force, bodies)

    def _contacts(self, data: mjx.Data) -> tuple[jax.Array, jax.Array]:
        contact = data._impl.contact
        # Pyramid of a condim-3 contact: edges n + mu t1, n - mu t1, n + mu t2, n - mu t2.
        edges = data._impl.efc_force[contact.efc_address[:, None] + np.arange(4)]
        mu = contact.friction[:, 0]
        normal = edges.sum(-1)
        tangents = mu[:, None] * (edges[:, ::2] - edges[:, 1::2])
        force = jnp.sqrt(normal**2 + (tangents**2).sum(-1))
        return force, self._bodies[contact.geom]
