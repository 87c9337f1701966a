"""Costs, nominals and the planner on shelves that are not standard, and on padded ones."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, contact_slots, register_engine
from pgf_jax.physics.hand import EE_POINT
from pgf_jax.physics.sized import SizedEngine
from pgf_jax.planning import padding
from pgf_jax.planning.config import Cost, Planner
from pgf_jax.planning.cost import Task, evaluate
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import start_world
from pgf_jax.planning.types import Push
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plans.file import load_plan, save_plan
from pgf_jax.plans.plan import plan
from pgf_jax.scene import Scene, sample_scene
from pgf_jax.scene.shelf import standard_shelf

SCENE = sample_scene(3, "mixed")
N = len(SCENE.objects)
PLACES = 28


@functools.cache
def planner() -> BatchPlanner:
    return BatchPlanner(SizedEngine.of_name("native", Physics(), 1), Planner(rollouts=2))


def rollout(objects, hand, n: int) -> Rollout:
    """One that stands still."""
    return Rollout(
        np.tile(np.asarray(objects, np.float32), (8, 1, 1)),
        np.tile(np.asarray(hand, np.float32), (8, 1)),
        np.zeros((n, 2), np.float32),
        np.zeros((8, contact_slots(n)), np.float32),
        np.zeros((8, contact_slots(n), 2), np.int32),
    )


def value(objects, hand, shelf, goal=0, cost=None):
    n = len(objects)
    task = Task(np.int32(goal), np.array(False), np.int32(goal), np.zeros(2, np.float32))
    gripper = jnp.zeros(8, jnp.float32)
    return evaluate(rollout(objects, hand, n), gripper, task, cost or Cost(), shelf)


@pytest.mark.parametrize("radius", [0.02, 0.03, 0.045])
def test_lengths_of_the_cost_grow_with_the_object(radius):
    """An object counts as blocking within 75 mm of the end effector if it is standard."""
    more = radius - 0.03
    for distance, counts in ((0.074 + more, True), (0.076 + more, False)):
        # Straight ahead, so that the bearing is 0.
        ahead = np.array([np.cos(-0.0485), np.sin(-0.0485)])
        objects = np.array([[0.9, 0.9], EE_POINT + distance * ahead])
        shelf = standard_shelf(2)._replace(radius=np.array([0.03, radius]))
        assert (float(value(objects, [0, 0, 0], shelf).terms[2]) > 0) == counts


def test_a_larger_goal_is_reached_from_further_away():
    ahead = np.array([np.cos(-0.0485), np.sin(-0.0485)])
    objects = np.array([EE_POINT + 0.063 * ahead])
    for radius, feasible in ((0.03, False), (0.035, True)):
        shelf = standard_shelf(1)._replace(radius=np.array([radius]))
        assert bool(value(objects, [0, 0, 0], shelf).feasible) == feasible


def test_edges_are_where_the_walls_are():
    shelf = standard_shelf(1)._replace(back_x=np.array(0.8), side_y=np.array(0.6))
    for place, radius, beyond in (
        ((0.78, 0.0), 0.03, 0),
        ((0.795, 0.0), 0.03, 8),
        ((0.785, 0.0), 0.04, 8),
        ((0.5, 0.57), 0.03, 0),
        ((0.5, -0.585), 0.03, 8),
        ((0.19, 0.0), 0.02, 8),
    ):
        own = shelf._replace(radius=np.array([radius]))
        assert float(value(np.array([place]), [-1, 0, 0], own).terms[3]) == 300.0 * beyond


def test_what_is_standard_as_data_costs_the_same():
    scene = sample_scene(1, "tight")
    hand = [0.1, 0.0, 0.1]
    plain = value(scene.positions, hand, None, scene.goal)
    given = value(scene.positions, hand, standard_shelf(20), scene.goal)
    jax.tree.map(np.testing.assert_array_equal, plain, given)


def test_empty_places_cost_nothing():
    world, shelf = padding.pad(start_world(SCENE.positions), SCENE.shelf, PLACES)
    assert N < PLACES and padding.count(shelf, PLACES) == N
    hand = [0.15, 0.0, 0.0]
    plain = value(SCENE.positions, hand, SCENE.shelf, SCENE.goal)
    padded = value(world.objects, hand, shelf, SCENE.goal)
    np.testing.assert_allclose(padded.terms, plain.terms, rtol=1e-6)
    back = padding.without_empty(shelf)
    assert back is not None and SCENE.shelf is not None
    for one, other in zip(back, SCENE.shelf, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_a_rollout_of_a_world_gets_the_places_of_the_program():
    seen = rollout(SCENE.positions, [0, 0, 0], N)
    seen.force[0, 0], seen.bodies[0, 0] = 1.0, (3, N)  # the hand on object 3
    padded = padding.pad_rollout(seen, PLACES)
    assert padded.objects.shape == (8, PLACES, 2) and padded.bodies[0, 0].tolist() == [3, PLACES]
    assert padded.force.shape == (8, contact_slots(PLACES))


def test_nominals_keep_the_distance_of_the_object():
    search = planner().begin_reach(start_world(SCENE.positions), SCENE.goal, SCENE.shelf)
    end = np.asarray(search.controls).sum(0) * Physics().knot_s
    yaw = end[2]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    away = np.linalg.norm(end[:2] + turn @ EE_POINT - SCENE.positions[SCENE.goal])
    assert away == pytest.approx(0.04 + SCENE.radii[SCENE.goal] - 0.03, abs=1e-5)
    pushed = next(i for i in range(N) if i != SCENE.goal)
    x, y = SCENE.positions[pushed] + [0.05, 0.0]
    push = planner().begin_push(
        start_world(SCENE.positions), SCENE.goal, Push(pushed, x, y), SCENE.shelf
    )
    end = np.asarray(push.controls).sum(0)[:2] * Physics().knot_s + EE_POINT
    assert np.linalg.norm(end - [x, y]) == pytest.approx(
        0.05 + SCENE.radii[pushed] - 0.03, abs=1e-5
    )


def test_an_engine_of_before_refuses_other_objects():
    class Old:
        name, physics, n_objects, lanes = "old", Physics(), N, 1

        def rollout(self, start: World, controls, gripper, substeps, wanted=None):
            raise AssertionError

    register_engine("old", lambda physics, n, lanes: Old(), replace=True)
    old = BatchPlanner(SizedEngine.of_name("old", Physics(), 1))
    old.begin_reach(start_world(SCENE.positions), SCENE.goal)  # standard objects at these places
    with pytest.raises(BadInput, match=r"engine old: simulates cylinders of 0\.03 m and 1 kg"):
        old.begin_reach(start_world(SCENE.positions), SCENE.goal, SCENE.shelf)


def test_plans_of_scenes_of_different_sizes(tmp_path):
    config = PlanConfig(engine="native", task_limit=12.0, world="none")
    deep = Scene("deep", np.array([[0.5, 0.1, 0.03], [0.7, 0.0, 0.03]]), 1, depth=0.6)
    together = plan(0, [SCENE, deep], config)
    for each, scene in zip(together, (SCENE, deep), strict=True):
        assert plan(0, scene, config).to_json() == each.to_json()
        read = load_plan(save_plan(tmp_path, each))
        assert read.to_json() == each.to_json()
        assert read.scene.shelf is not None
        motion = read.motion()
        assert motion.objects.shape[1:] == (len(scene.objects), 2)
        assert motion.at(0.0).radii.tolist() == scene.radii.tolist()
    with pytest.raises(BadInput, match="scene_file: expected the plan's scene"):
        content = together[0].to_json()
        other = int(np.argmin(SCENE.radii + (np.arange(N) == SCENE.goal)))
        content["scene_file"]["goal"] = other
        from pgf_jax.plans.file import _from_json

        _from_json(content)
