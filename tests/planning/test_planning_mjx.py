"""Independence of the batch on mjx, whose vectorised arithmetic could break it."""

import jax
import numpy as np
import pytest

from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import start_world
from pgf_jax.scene import sample_scene


@pytest.fixture(autouse=True)
def strict_arrays():
    """Takes the room's fixture away: mjx promotes dtypes and ranks."""


def key(seed, number):
    return np.array(jax.random.key_data(jax.random.fold_in(jax.random.key(seed), number)))


def test_lanes_do_not_see_each_other(mjx_engine):
    planner = BatchPlanner(mjx_engine)
    scenes = [sample_scene(seed, "tight") for seed in range(3)]
    first, second, third = (planner.begin_reach(start_world(s.positions), s.goal) for s in scenes)
    for i in range(2):
        here = planner.step([first, second], [key(1, i), key(2, i)])
        swapped = planner.step([second, first], [key(2, i), key(1, i)])
        other = planner.step([first, third], [key(1, i), key(3, i)])
        padded = planner.step([first], [key(1, i)])
        for again in (swapped[1], other[0], padded[0]):
            for a, b in zip(jax.tree.leaves(here[0]), jax.tree.leaves(again), strict=True):
                np.testing.assert_array_equal(a, b)
        first, second = here
        third = other[1]
    assert len({float(s.value.total) for s in (first, second, third)}) == 3
