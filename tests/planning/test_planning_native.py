"""The planner on real physics: MuJoCo's C engine."""

import jax
import numpy as np
import planning_oracle as oracle
import pytest

from pgf_jax.physics import hand
from pgf_jax.physics.engine import World, make_engine
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import start_world
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene

SCENES = [sample_scene(seed, "tight") for seed in range(3)]


def key(seed, number):
    return np.array(jax.random.key_data(jax.random.fold_in(jax.random.key(seed), number)))


def assert_same(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.fixture(scope="module")
def planner():
    return BatchPlanner(make_engine("native", lanes=3, threads=2))


@pytest.fixture(scope="module")
def planned(planner):
    """Three robots after iterations 0 to 2: reaching, reaching, pushing; and the keys' seeds."""
    searches = [
        planner.begin_reach(start_world(SCENES[0].positions), SCENES[0].goal),
        planner.begin_reach(start_world(SCENES[1].positions), SCENES[1].goal),
        planner.begin_push(start_world(SCENES[2].positions), SCENES[2].goal, Push(*front_push())),
    ]
    for i in range(3):
        searches = planner.step(searches, [key(robot, i) for robot in range(3)])
    return searches


def front_push():
    """The foremost object of the last scene, 0.06 m to the right."""
    first = int(SCENES[2].positions[:, 0].argmin())
    x, y = SCENES[2].positions[first]
    return first, x + 0.02, y - 0.06


def test_same_key_same_result_alone_or_in_company(planner, planned):
    """Bit for bit; other lanes hold other robots, in another order, or padding."""
    for robot, lanes in ((0, [0]), (1, [2, 1]), (2, [2, 0, 2])):
        searches = [
            planner.begin_reach(start_world(SCENES[r].positions), SCENES[r].goal)
            if r < 2
            else planner.begin_push(
                start_world(SCENES[2].positions), SCENES[2].goal, Push(*front_push())
            )
            for r in lanes
        ]
        for i in range(3):
            searches = planner.step(searches, [key(r, i) for r in lanes])
        assert_same(searches[lanes.index(robot)], planned[robot])


def test_the_best_rollout_is_the_trajectory_s_own(planner, planned):
    for search in planned:
        again = planner.engine.rollout(
            World(*(np.asarray(x)[None] for x in search.start)),
            search.controls[None],
            search.gripper[None],
            planner.engine.physics.substeps,
        )
        np.testing.assert_allclose(again.objects[0], search.best.objects, atol=1e-7)
        np.testing.assert_allclose(again.force[0], search.best.force, rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(again.bodies[0], search.best.bodies)
        terms, total, feasible = oracle.cost(
            search.best, search.gripper, search.task, planner.config.cost
        )
        np.testing.assert_allclose(search.value.terms, terms, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(search.value.total, total, rtol=1e-4)
        assert planner.terminate(search) == feasible


def test_another_key_is_another_result(planner, planned):
    (other,) = planner.step([planned[0]], [key(99, 3)])
    (same,) = planner.step([planned[0]], [key(0, 3)])
    assert other.last_cost != same.last_cost


def test_iterations_make_the_three_robots_better(planner, planned):
    nominals = [
        planner.begin_reach(start_world(SCENES[r].positions), SCENES[r].goal) for r in range(2)
    ]
    nominals = planner.step(nominals, [key(r, 0) for r in range(2)])
    for before, after in zip(nominals, planned, strict=False):
        assert after.value.total < before.value.total or planner.terminate(before)


def test_retreat_pulls_the_hand_back_along_its_direction(planner, planned):
    push = planned[2]
    (world,) = planner.retreat([push])
    end = np.asarray(push.best.hand[-1], float)
    angle = oracle.pointing(end)
    np.testing.assert_allclose(world.hand[:2] - end[:2], back(0.07, angle), atol=1e-4)
    assert world.hand[2] == pytest.approx(end[2], abs=1e-4)
    assert world.gripper == hand.GRIPPER_CLOSED
    away = np.linalg.norm(push.best.objects[-1] - oracle.ee_of(end), axis=-1) > 0.25
    resting = np.linalg.norm(push.best.velocities, axis=-1) < 1e-6
    assert (away & resting).sum() > 3
    np.testing.assert_allclose(
        world.objects[away & resting], push.best.objects[-1][away & resting], atol=1e-6
    )
    # A second is enough for what the push set in motion to come to rest.
    clear = np.linalg.norm(world.objects - oracle.ee_of(world.hand), axis=-1) > 0.1
    assert np.abs(world.velocities[clear]).max() < 1e-3
    (alone, twice) = planner.retreat([push, push])
    assert_same(alone, world)
    assert_same(twice, world)


def back(distance, angle):
    return [-distance * np.cos(angle), -distance * np.sin(angle)]


def test_reaching_goes_on_from_the_pushed_world(planner, planned):
    (world,) = planner.retreat([planned[2]])
    search = planner.begin_reach(world, SCENES[2].goal)
    (search,) = planner.step([search], [key(5, 0)])
    # The fingers leave the closed hand only in the knots that open it.
    ee = [oracle.ee_of(pose) for pose in search.best.hand]
    steps = np.diff([oracle.ee_of(world.hand), *ee], axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:1], steps.shape), atol=1e-5)
    goal = world.objects[SCENES[2].goal]
    assert np.linalg.norm(goal - ee[-1]) == pytest.approx(0.04, abs=1e-4)
