"""Engine `mjx`: `mjx.step` under `vmap`, float32, one jitted program per batch shape."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import contextlib
import copy
import io
from collections.abc import Callable, Mapping

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
from pgf_jax.physics.shelves import KeptByShelf
from pgf_jax.scene.shelf import Shelf

SOLVERS = {"cg": mujoco.mjtSolver.mjSOL_CG, "newton": mujoco.mjtSolver.mjSOL_NEWTON}
# Fields of the model that differ between shelves with the same number of objects.
_OWN = ("geom_size", "geom_friction", "geom_pos", "body_mass", "body_inertia", "body_invweight0")
_OWN += ("dof_frictionloss", "dof_invweight0")


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
        self._solver = choice(self.name, "solver", solver, SOLVERS)
        self._iterations, self._ls_iterations = iterations, ls_iterations
        self._standard = self._program(model.compile_model(physics, n_objects))
        self._other: Callable[..., Rollout] | None = None  # of shelves that are not standard
        self._models = KeptByShelf(lambda shelf: model.compile_model(physics, n_objects, shelf))

    def rollout(
        self,
        start: World,
        controls,
        gripper,
        substeps: int,
        wanted=None,
        shelf: Shelf | None = None,
    ) -> Rollout:
        """See `Engine.rollout`; computes all rollouts, wanted or not."""
        if shelf is None:
            return self._standard(start, controls, gripper, substeps, {})
        which = [self._models.of(shelf, i) for i in range(len(controls))]
        if self._other is None:
            self._other = self._program(which[0])
        own = {name: np.stack([getattr(m, name) for m in which]) for name in _OWN}
        return self._other(start, controls, gripper, substeps, own)

    def _program(self, compiled: mujoco.MjModel) -> Callable[..., Rollout]:
        """The jitted rollout of models that have the same bodies, joints and geoms."""
        compiled = copy.copy(compiled)
        compiled.opt.solver = self._solver
        compiled.opt.iterations, compiled.opt.ls_iterations = self._iterations, self._ls_iterations
        compiled.opt.tolerance = 0.0
        rollouts = _Rollouts(compiled, self.physics, self.n_objects)
        return jax.jit(jax.vmap(rollouts.one, in_axes=(0, 0, 0, None, 0)))


class _Rollouts:
    """Rollouts of a model; some of its fields may be other ones in each."""

    def __init__(self, compiled: mujoco.MjModel, physics: Physics, n_objects: int) -> None:
        self._physics = physics
        self._model = mjx.put_model(compiled)
        self._data = mjx.make_data(compiled)
        self._hand_geoms = model.hand_geoms(compiled)
        self._bodies = jnp.asarray(model.geom_bodies(compiled, n_objects))

    def one(
        self, start: World, controls, gripper, substeps, own: Mapping[str, jax.Array]
    ) -> Rollout:
        """Roll out one trajectory; `own` are fields of the model by name."""
        dofs, of_model = model.KINEMATIC_DOFS, self._model.replace(**own)
        data = self._data.replace(
            qpos=jnp.concatenate([start.hand, jnp.zeros(model.FINGER_DOFS), start.objects.ravel()]),
            qvel=jnp.concatenate([jnp.zeros(dofs), start.velocities.ravel()]),
        )

        def knot(carry, inputs):
            data, before = carry
            velocity, target = inputs

            def body(s, data):
                now = before + (target - before) * s / substeps
                return self._substep(of_model, data, velocity, now)

            data = jax.lax.fori_loop(0, substeps, body, data)
            force, bodies = self._contacts(data)
            objects = data.qpos[dofs:].reshape(-1, 2)
            return (data, target), (objects, data.qpos[: model.HAND_DOFS], force, bodies)

        (data, _), (objects, hands, force, bodies) = jax.lax.scan(
            knot, (data, start.gripper), (controls, gripper)
        )
        velocities = data.qvel[dofs:].reshape(-1, 2)
        return Rollout(objects, hands, velocities, force, bodies)

    def _substep(
        self, of_model: mjx.Model, data: mjx.Data, velocity: jax.Array, gripper: jax.Array
    ) -> mjx.Data:
        positions, quats = hand.capsule_poses(gripper, jnp)
        posed = of_model.replace(
            geom_pos=of_model.geom_pos.at[self._hand_geoms].set(positions),
            geom_quat=of_model.geom_quat.at[self._hand_geoms].set(quats),
        )
        speeds = model.kinematic_velocity(velocity, gripper, self._physics, jnp)
        fingers = slice(model.HAND_DOFS, model.KINEMATIC_DOFS)
        return mjx.step(
            posed,
            data.replace(
                qpos=data.qpos.at[fingers].set(0.0),
                qvel=data.qvel.at[: model.KINEMATIC_DOFS].set(speeds),
            ),
        )

    def _contacts(self, data: mjx.Data) -> tuple[jax.Array, jax.Array]:
        contact = data._impl.contact
        # Pyramid of a condim-3 contact: edges n + mu t1, n - mu t1, n + mu t2, n - mu t2.
        edges = data._impl.efc_force[contact.efc_address[:, None] + np.arange(4)]
        mu = contact.friction[:, 0]
        normal = edges.sum(-1)
        tangents = mu[:, None] * (edges[:, ::2] - edges[:, 1::2])
        force = jnp.sqrt(normal**2 + (tangents**2).sum(-1))
        return force, self._bodies[contact.geom]
