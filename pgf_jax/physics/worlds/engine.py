"""Engine `solid`: the solid world behind the protocol of engines, to plan in it, slowly.

An engine starts from what the planner sees: all objects stand, the solver is cold. So a check of
the same trajectory in the world, whose state has a history, may differ after a push.
"""

import numpy as np

from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, contact_slots
from pgf_jax.physics.shelves import KeptByShelf
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.physics.worlds.world import Command, execute_all
from pgf_jax.scene.shelf import Shelf


class SolidEngine:
    """The solid world as an engine, on all cores of the process.

    Of the constants in `physics` it takes the durations; the world has its own (`Solid`).
    """

    name = "solid"

    def __init__(self, physics: Physics, n_objects: int, *, lanes: int = 1) -> None:
        self.physics, self.n_objects, self.lanes = physics, n_objects, lanes
        self._world = SolidWorld(n_objects)
        self._others = KeptByShelf(lambda shelf: SolidWorld(n_objects, shelf=shelf))

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
        controls, gripper = np.asarray(controls, np.float64), np.asarray(gripper, np.float64)
        b, t, n = len(controls), controls.shape[1], self.n_objects
        chosen = np.arange(b) if wanted is None else np.flatnonzero(np.asarray(wanted))
        seconds = t * substeps * self.physics.substep_s
        commands = []
        for i in chosen:
            seen = World(*(np.asarray(x, np.float64)[i] for x in start))
            world = self._world if shelf is None else self._others.of(shelf, int(i))
            command = Command(world.state_of(seen), controls[i], gripper[i], seconds)
            commands.append((world, command))
        c = contact_slots(n)
        out = Rollout(
            objects=np.full((b, t, n, 2), np.nan),
            hand=np.full((b, t, 3), np.nan),
            velocities=np.full((b, n, 2), np.nan),
            force=np.zeros((b, t, c)),
            bodies=np.zeros((b, t, c, 2), np.int32),
        )
        executed = execute_all(commands)
        for i, result in zip(chosen, executed, strict=True):
            for whole, part in zip(out, result.rollout, strict=True):
                whole[i] = part
        return out
