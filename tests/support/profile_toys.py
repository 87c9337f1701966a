"""An engine that costs little and tells what it has done, for tests of the profiler."""

import os

import numpy as np
from sweep_toys import Ghost

from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import register_engine

FLOPS = 1000.0  # of each physics step


class Counted(Ghost):
    """Says that it has used three of four lanes of its work; `tick` makes it slow."""

    name = "counted"

    def __init__(self, physics: Physics, n_objects: int, *, lanes: int = 1, tick: int = 1) -> None:
        super().__init__(physics, n_objects, lanes=lanes)
        self._tick, self._flops, self._lanes = tick, 0.0, 0

    def rollout(self, start, controls, gripper, substeps, wanted=None):
        for _ in range(self._tick):
            out = super().rollout(start, controls, gripper, substeps, wanted)
        self._flops += FLOPS * np.size(gripper) * substeps
        self._lanes += len(gripper)
        return out

    def occupancy(self):
        lanes, self._lanes = self._lanes, 0
        return 3 * lanes, 4 * lanes

    def flops(self):
        flops, self._flops = self._flops, 0.0
        return flops


register_engine("counted", Counted)  # pyright: ignore[reportArgumentType]


def dies(job):
    """Takes the place of a measurement, in a process that ends."""
    os._exit(1)
