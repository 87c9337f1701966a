"""The types `Search`, one segment's state, and `Rolled`, the rollouts of one of its iterations."""

from typing import NamedTuple

import jax
import numpy as np

from pgf_jax.physics.engine import Array, Rollout, World
from pgf_jax.planning import padding
from pgf_jax.planning.cost import Evaluation, Task
from pgf_jax.scene.shelf import Shelf

HISTORY = 3  # P: cost terms of the best after each of the last P iterations


class Search(NamedTuple):
    """State of one segment's search. Shapes are one robot's; the planner stacks them over lanes."""

    start: World  # where every rollout of the segment starts: [N, 2], [N, 2], [3], []
    task: Task
    gripper: Array  # [T], fixed with the nominal
    controls: Array  # [T, 3] of the best so far (at first the nominal)
    best: Rollout  # of the best so far: [T, N, 2] and so on
    value: Evaluation  # of the best so far
    iteration: Array  # [] int32, done in this segment, the nominal's not counted: -1 before it
    last_cost: Array  # [] c_(i-1); c_0 counts as 0
    stuck_count: Array  # [] int32, n
    history: Array  # [P, 3] (c_d, c_f, c_b) of the best, latest last; nan where none yet
    non_finite: Array  # [] int32, rollouts of this segment whose cost was not finite
    saturated: Array  # [] int32, rollouts with a knot end at which no contact slot was free
    shelf: Shelf | None = None  # [N] each; None: all objects and walls are standard

    @property
    def objects(self) -> int:
        """How many objects there are; a padded shelf has more places."""
        return padding.count(self.shelf, len(self.start.objects))

    @property
    def program(self) -> tuple[int, bool]:
        """What has to be equal in the searches of one call: N, and whether shelves are standard."""
        return len(self.start.objects), self.shelf is None


class Rolled(NamedTuple):
    """All rollouts of one iteration of one search.

    R is K (the noisy trajectories), and 1 at iteration 0 (the nominal); the update `stomp` adds one
    more, the last: their blend.
    """

    controls: Array  # [R, T, 3]
    rollout: Rollout  # [R, T, N, 2] and so on
    value: Evaluation  # [R] and so on


def start_world(positions: np.ndarray) -> World:
    """World at a task's start: robot at (0, 0, 0), hand open, objects ([N, 2], m) at rest."""
    n = len(positions)
    return World(
        np.asarray(positions, np.float32),
        np.zeros((n, 2), np.float32),
        np.zeros(3, np.float32),
        np.float32(0),
    )


def asked(search: Search, rolled: Rolled) -> Rolled:
    """The rollouts of an iteration that are wanted: all, but of the nominal's only the first."""
    return jax.tree.map(lambda x: x[: 1 if search.iteration < 0 else None], rolled)
