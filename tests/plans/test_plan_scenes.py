"""Plans: repeatable, independent of the batch, and executable as their files say."""

import dataclasses
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from registered import registered

import pgf_jax.guidance.operators.registry as operators
from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.errors import BadInput
from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import World, make_engine
from pgf_jax.planning.config import Cost
from pgf_jax.planning.cost import reach_distance
from pgf_jax.planning.types import Push, Status
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plans.file import Plan, load_plan, save_plan
from pgf_jax.plans.plan import plan, plan_scenes, seed_of
from pgf_jax.scene import Scene, load_scene, sample_scene

pytestmark = pytest.mark.usefixtures("remembered_rollouts")

NATIVE = PlanConfig(engine="native", world="none", physics="authors")


class Aside:
    """Pushes the object nearest to the hand's start 6 cm outwards."""

    name = "aside"

    def decide(self, view) -> Push:
        distance = np.linalg.norm(view.objects - [0.18, 0.0], axis=-1)
        distance[view.goal] = np.inf
        i = int(np.argmin(distance))
        x, y = view.objects[i]
        return Push(i, float(x), float(y + np.copysign(0.06, y)))


@pytest.fixture
def aside():
    with registered(operators.OPERATORS, aside=Aside):
        yield dataclasses.replace(NATIVE, operator="aside", ask="after:1")


@pytest.fixture(scope="module")
def wide() -> Plan:
    return plan(0, sample_scene(0, "wide"), NATIVE)


def test_a_plan_says_what_it_took(wide):
    assert wide.status is Status.SOLVED and wide.solved
    # The nominal, the iterations and the final check.
    assert wide.planning_time_s == 1.5 + 3.0 * wide.iterations + 1.5
    assert wide.iterations == wide.reach_iterations > 0
    assert wide.history.shape == (wide.iterations + 1, 3)
    assert wide.history_starts == (0,)
    assert wide.execution_s == 3.0
    assert (wide.waiting_s, wide.interaction_s) == (0.0, 0.0)
    assert (wide.pushes, wide.requests, wide.grants) == (0, 0, 0)
    assert [segment.kind for segment in wide.segments] == ["reach"]
    np.testing.assert_array_equal(wide.history[-1], [wide.cost[k] for k in ("c_d", "c_f", "c_b")])
    assert wide.cost["total"] <= 20.0


def test_a_plan_repeats_to_the_last_bit(wide):
    again = plan(jax.random.key(0), sample_scene(0, "wide"), NATIVE)
    assert json.dumps(again.to_json()) == json.dumps(wide.to_json())


def test_another_key_gives_another_plan(wide):
    short = dataclasses.replace(NATIVE, task_limit=10.0)
    one, other = (plan(seed, sample_scene(0, "wide"), short) for seed in (0, 1))
    np.testing.assert_array_equal(one.history, wide.history[: len(one.history)])
    assert not np.array_equal(other.history, one.history)


@pytest.mark.parametrize("lanes", [1, 2])
def test_a_plan_does_not_depend_on_its_batch(computed_rollouts, wide, lanes):
    config = dataclasses.replace(NATIVE, lanes=lanes)
    scenes = [sample_scene(1, "wide"), sample_scene(0, "wide"), sample_scene(2, "wide")]
    batch = plan(0, scenes, config)
    assert [one.scene.name for one in batch] == ["wide_1", "wide_0", "wide_2"]
    alone = {**wide.to_json(), "lanes": lanes}  # C MuJoCo rolls out one by one: L changes nothing
    assert batch[1].to_json() == alone


@pytest.mark.slow
def test_a_plan_by_mjx_does_not_depend_on_its_batch_and_traces_once():
    config = PlanConfig(engine="mjx", lanes=3, task_limit=8.0)
    scenes = [sample_scene(seed, "wide") for seed in (0, 1, 2)]
    batch = plan(0, scenes, config)
    backwards = plan(0, scenes[::-1], config)[::-1]
    alone = [plan(0, scene, config) for scene in scenes]
    for one, two, three in zip(batch, backwards, alone, strict=True):
        assert one.to_json() == two.to_json() == three.to_json()
    engine: Any = planner_service_of(config).engine
    assert traces(engine._batched) == 1


def test_a_second_call_traces_nothing_again(wide):
    planner = planner_service_of(NATIVE).planner
    assert traces(planner._absorb) == 1
    plan(3, sample_scene(1, "wide"), NATIVE)
    assert planner_service_of(NATIVE).planner is planner
    assert traces(planner._absorb) == 1


def traces(jitted: Any) -> int:
    """How often a jitted function has been traced."""
    return jitted._cache_size()


def test_scenes_of_different_sizes_are_planned_together():
    big = sample_scene(1, "wide")
    small = Scene("small", big.objects[:4], big.goal)
    plans = plan(0, [small, big], NATIVE)
    assert [len(one.scene.objects) for one in plans] == [4, 20]
    assert plans[0].to_json() == plan(0, small, NATIVE).to_json()


def test_no_scene_no_plan():
    assert plan(0, [], NATIVE) == []


def test_an_unsolved_plan_is_a_result():
    # 1.5 s for the nominal, 3 s an iteration: the second would end at 7.5 s, after the limit.
    config = dataclasses.replace(NATIVE, task_limit=7.0)
    result = plan(0, sample_scene(0, "wide"), config)
    assert result.status in (Status.TIMED_OUT, Status.STUCK) and not result.solved
    assert result.iterations == 1
    assert len(result.history) == 2
    assert result.planning_time_s == 4.5
    assert result.execution_s == 0.0
    assert [segment.kind for segment in result.segments] == ["reach"]


def test_each_scene_has_its_own_seed():
    pairs = [(sample_scene(seed, "wide"), seed) for seed in (1, 2)]
    both = plan_scenes(pairs, NATIVE)
    assert both[1].seed == 2
    assert both[1].to_json() == plan(2, pairs[1][0], NATIVE).to_json()


def test_scenes_without_their_seeds_are_refused():
    scene = sample_scene(1, "wide")
    with pytest.raises(BadInput, match=r"^scenes: expected \(scene, seed\) pairs, got a Scene$"):
        plan_scenes([scene], NATIVE)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadInput, match=r"^seed: expected a whole number within .*, got 0\.5$"):
        plan_scenes([(scene, 0.5)], NATIVE)  # pyright: ignore[reportArgumentType]


def test_asking_without_an_operator_changes_nothing(wide):
    config = dataclasses.replace(NATIVE, ask="after:1")
    unasked = plan(0, sample_scene(0, "wide"), config)
    assert {**unasked.to_json(), "ask": "stuck"} == wide.to_json()


def test_a_plan_with_a_push_replays_to_its_cost(aside, tmp_path):
    result = plan(7, sample_scene(7, "tight"), aside)
    assert result.pushes >= 1
    assert result.grants >= result.pushes
    assert len(result.history_starts) >= 1 + result.pushes
    assert result.history_starts[1] == 2  # iterations 0 and 1, the push, then a new iteration 0
    assert len(result.segments) == result.pushes + 1
    distance = execute(json.loads(save_plan(tmp_path, result).read_text()))
    c_d = distance if distance < 0.06 else 4000 * distance
    assert c_d == pytest.approx(result.cost["c_d"], abs=1e-4, rel=1e-3)
    assert (distance < 0.06) == result.solved


def execute(content: dict) -> float:
    """Execute a plan's file by the published conventions; d(goal) at the end, m."""
    engine = make_engine("native", n_objects=len(content["objects"]))
    physics = engine.physics
    positions = np.array(content["objects"])[None, :, :2]
    world = World(positions, np.zeros_like(positions), np.zeros((1, 3)), np.zeros(1))

    def advance(world: World, controls: np.ndarray, gripper: np.ndarray, seconds: float) -> World:
        substeps = round(seconds / physics.substep_s / len(controls))
        out = engine.rollout(world, controls[None], gripper[None], substeps)
        return World(out.objects[:, -1], out.velocities, out.hand[:, -1], gripper[-1:])

    for segment in content["segments"]:
        controls, gripper = np.array(segment["controls"]), np.array(segment["gripper"])
        world = advance(world, controls, gripper, segment["duration_s"])
        if segment["kind"] == "push":
            yaw = world.hand[0, 2] + hand.POINTING_YAW
            back = -0.07 * np.array([np.cos(yaw), np.sin(yaw), 0.0])
            world = advance(world, np.tile(back, (8, 1)), np.repeat(world.gripper, 8), 1.0)
    d = reach_distance(
        jnp.asarray(world.hand[0], jnp.float32), jnp.asarray(world.objects[0], jnp.float32), Cost()
    )
    return float(d[content["goal"]])


def test_the_service_counts_towards_the_limit(aside):
    # Asked at 4.5 s, answered at 14.5: the limit of 12 s comes first.
    config = dataclasses.replace(aside, service_mean=10.0, service_sd=0.0, task_limit=12.0)
    result = plan(0, sample_scene(0, "wide"), config)
    assert (result.requests, result.grants, result.pushes) == (1, 1, 0)
    assert result.interaction_s == 7.5
    assert not result.solved


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_a_key_of_a_seed_is_that_seed(seed):
    assert seed_of(seed) == seed_of(np.int64(seed)) == seed
    assert seed_of(jax.random.key(seed)) == seed_of(jax.random.PRNGKey(seed)) == seed


def test_other_keys_are_hashed():
    one, two = (seed_of(key) for key in jax.random.split(jax.random.key(0)))
    assert one != two and 0 <= one < 2**32 and 0 <= two < 2**32


@pytest.mark.parametrize("key", [-1, 2**32, True, 1.5, "7", np.zeros((2, 2), np.uint32)])
def test_what_is_no_key_is_refused(key):
    with pytest.raises(BadInput, match=r"seed|key"):
        plan(key, sample_scene(0, "wide"), NATIVE)


def test_a_corrupt_checkpoint_is_refused_before_planning(tmp_path):
    (tmp_path / "phi_auto.msgpack").write_bytes(b"junk")
    config = dataclasses.replace(NATIVE, predictor=str(tmp_path))
    with pytest.raises(BadInput, match=r"phi_auto\.msgpack: truncated or corrupt"):
        plan(0, sample_scene(0, "wide"), config)


def test_an_engine_is_for_any_number_of_objects_and_some_lanes():
    engine = planner_service_of(dataclasses.replace(NATIVE, lanes=2)).engine
    assert (engine.of(5).n_objects, engine.of(5).lanes, engine.lanes) == (5, 2, 2)
    assert engine.physics == Physics()


def test_a_published_scene_is_planned(authors, tmp_path):
    scene = load_scene(authors / "models" / "warehouse_1.xml")
    result = plan(0, scene, dataclasses.replace(NATIVE, task_limit=20.0))
    assert result.scene.name == "warehouse_1"
    assert load_plan(save_plan(tmp_path, result)).to_json() == result.to_json()
