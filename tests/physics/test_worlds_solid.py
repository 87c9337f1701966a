"""The solid world against closed forms and invariants: what slides, rests, stalls and topples."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest

from pgf_jax import cores
from pgf_jax.physics import hand
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.physics.worlds.solid_model import Solid
from pgf_jax.physics.worlds.world import Command, Executed, State, execute_all
from pgf_jax.scene import sample_scene
from pgf_jax.scene.shelf import BACK_WALL_X, HEIGHT, RADIUS

KNOTS, KNOT_S = 8, 0.375
STILL = np.zeros(2)
AWAY = (-0.5, 0.0, 0.0)
GRAVITY = 9.81  # MuJoCo's


@pytest.fixture(scope="module")
def twenty():
    return SolidWorld(20)


@pytest.fixture(scope="module")
def two():
    return SolidWorld(2)


def placed(world, positions, *, at: Sequence[float] = AWAY, velocity=STILL, gripper=0.0):
    """A state with objects at some places, the first with a velocity."""
    objects = np.array(positions, float)
    velocities = np.zeros_like(objects)
    velocities[0] = velocity
    return world.state_of(World(objects, velocities, np.array(at, float), np.array(gripper)))


def still(state, knots=KNOTS, **options):
    gripper = np.full(knots, state.gripper)
    return Command(state, np.zeros((knots, 3)), gripper, knots * KNOT_S, **options)


def reach(world, seed=0, speed=0.12, **options):
    """A command that plows through a sampled scene, with the gripper of a reach nominal."""
    scene = sample_scene(seed, "tight")
    rng = np.random.default_rng(seed)
    controls = np.c_[np.full(KNOTS, speed), rng.normal(0, [0.03, 0.1], (KNOTS, 2))]
    gripper = np.where(np.arange(KNOTS) < KNOTS / 2, hand.GRIPPER_CLOSED, 0.0)
    return Command(world.start(scene), controls, gripper, 3.0, goal=scene.goal, **options)


def kept(executed: Executed) -> State:
    assert executed.state is not None
    return executed.state


def same(a: Executed, b: Executed) -> bool:
    """Whether two results are equal, bit for bit."""
    values = [(one.distance, one.upright, one.touched) for one in (a, b)]
    return values[0] == values[1] and all(
        x.tobytes() == y.tobytes() for x, y in zip(a.rollout, b.rollout, strict=True)
    )


# -- objects --------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.8, 2.3, 3.7, 5.5])
@pytest.mark.parametrize("speed", [0.2, 0.4, 0.8])
def test_an_object_slides_as_far_as_friction_lets_it(speed, angle):
    """v^2 / (2 mu g), less v step / 2, because a step first brakes and then moves."""
    solid = Solid()
    world = SolidWorld(1, solid)
    velocity = speed * np.array([np.cos(angle), np.sin(angle)])
    start = np.array([0.4, 0.0])
    executed = world.execute(still(placed(world, [start], velocity=velocity)))
    moved = executed.rollout.objects[-1, 0] - start
    way = speed**2 / (2 * solid.table_friction * GRAVITY) - speed * solid.step_s / 2
    assert np.linalg.norm(moved) == pytest.approx(way, rel=0.03)
    assert np.linalg.norm(moved - way * velocity / speed) < 0.04 * way
    assert executed.upright > np.cos(np.radians(0.5))
    assert np.linalg.norm(executed.rollout.velocities) < 1e-6


@pytest.mark.parametrize("friction", [0.2, 0.3])
def test_less_friction_is_a_longer_way(friction):
    solid = Solid(table_friction=friction)
    world = SolidWorld(1, solid)
    executed = world.execute(still(placed(world, [[0.3, 0.1]], velocity=np.array([0.4, 0.0]))))
    way = 0.4**2 / (2 * friction * GRAVITY) - 0.4 * solid.step_s / 2
    moved = executed.rollout.objects[-1, 0] - [0.3, 0.1]
    np.testing.assert_allclose(moved, [way, 0], atol=0.03 * way)


@pytest.mark.parametrize("preset", ["tight", "medium", "wide"])
def test_objects_at_rest_stay_at_rest(twenty, preset):
    scene = sample_scene(3, preset)
    state = twenty.start(scene)
    awake = SolidWorld(20)
    awake.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    for world in (twenty, awake):
        data = world._copy(state.data)
        for _ in range(KNOTS):
            world._drive(data, np.zeros(3), (0.0, 0.0), KNOT_S)
            mujoco.mj_energyVel(world.model, data)
            assert data.energy[1] < 1e-8  # J
            apart = data.xpos[world._objects, :2] - scene.positions
            assert np.abs(apart).max() < 1e-4


def test_a_toppled_object_is_a_disk_at_its_centre(two):
    state = placed(two, [[0.4, 0.0], [0.4, 0.2]])
    data = two._copy(state.data)
    quarter = np.sqrt(0.5)
    data.qpos[two._qpos[0, 2:]] = [RADIUS, quarter, 0.0, quarter, 0.0]
    mujoco.mj_forward(two.model, data)
    lying = State(data, 0.0)
    executed = two.execute(still(lying, keep=True))
    end = kept(executed)
    assert executed.upright < 0.2
    np.testing.assert_allclose(executed.rollout.objects[-1], [[0.4, 0.0], [0.4, 0.2]], atol=5e-3)
    seen = two.seen(end)
    np.testing.assert_array_equal(seen.objects, end.data.xpos[two._objects, :2].astype("f"))
    assert end.data.xpos[two._objects[0], 2] < 0.04 < HEIGHT / 2  # it lies
    assert two.execute(still(state)).upright > 0.999999


@pytest.mark.parametrize(("degrees", "falls"), [(25.0, False), (37.0, True)])
def test_an_object_falls_beyond_its_edge(two, degrees, falls):
    """Its centre is above the edge at atan(0.03 / 0.05) = 31 degrees; `upright` is of all."""
    data = two._copy(placed(two, [[0.4, 0.0], [0.4, 0.2]]).data)
    tilt = np.radians(degrees)
    height = RADIUS * np.sin(tilt) + HEIGHT / 2 * np.cos(tilt)
    data.qpos[two._qpos[1, 2:]] = [height, np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]
    mujoco.mj_forward(two.model, data)
    executed = two.execute(still(State(data, 0.0), keep=True))
    axes = kept(executed).data.xmat[two._objects, 8]
    assert axes[0] > 0.999 and (abs(axes[1]) < 0.2 if falls else axes[1] > 0.999)
    assert (executed.upright < 0.2) == falls


# -- the hand -------------------------------------------------------------------------------------


def ends_of_links(world, data):
    """[capsules, 2] centres of the hand's capsules from above, m."""
    model = world.model
    capsules = [
        g
        for g in range(model.ngeom)
        if world._codes[model.geom_bodyid[g]] == world.n_objects
        and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CAPSULE
    ]
    return data.geom_xpos[capsules, :2]


def away_from_table(world, data, gripper, pose):
    """How far the hand's capsules are from those of the table at most, m."""
    x, y, yaw = pose
    c, s = np.cos(yaw), np.sin(yaw)
    table = hand.capsule_segments(float(gripper))
    as_measured = ~np.isin(np.arange(hand.N_CAPSULES), list(hand.MEASURED_FRONTS))
    wanted = np.array([x, y]) + table.reshape(-1, 2) @ np.array([[c, -s], [s, c]]).T
    there = ends_of_links(world, data)
    assert len(there) == len(wanted) == 2 * hand.N_CAPSULES
    apart = np.linalg.norm(wanted[:, None] - there, axis=-1).min(1)
    # On the plane the fronts of the tips reach 6 mm further inwards, see `hand.py`.
    assert apart.max() < 6.1e-3 and (~as_measured).sum() == 2
    return apart.reshape(-1, 2)[as_measured].max()


@pytest.mark.parametrize("gripper", [0, 128, 255])
def test_the_fingers_are_those_of_the_capsule_table(two, gripper):
    pose = [-0.3, 0.1, 0.4]
    positions = [[0.4, 0.1], [0.4, -0.1]]
    set_so = placed(two, positions, at=pose, gripper=float(gripper))
    assert away_from_table(two, set_so.data, gripper, pose) < 1e-9
    # And where they were moved there, while the hand moved too.
    start = placed(two, positions, at=pose, gripper=60.0)
    move = np.tile([0.05, -0.02, 0.1], (2, 1))
    moved = two.execute(Command(start, move, np.array([200.0, gripper]), 0.75, keep=True))
    end = np.array(pose) + 0.75 * move[0]
    np.testing.assert_allclose(moved.rollout.hand[-1], end, atol=1e-6)
    assert away_from_table(two, kept(moved).data, gripper, end) < 1e-6


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_the_hand_retreats_straight_back(two, yaw):
    state = placed(two, [[0.4, 0.1], [0.4, -0.1]], at=[-0.4, 0.1, yaw], gripper=40.0)
    back = two.execute(two.retreat(state))
    ahead = yaw + hand.POINTING_YAW
    moved = back.rollout.hand[-1] - [-0.4, 0.1, yaw]
    wanted = [-0.07 * np.cos(ahead), -0.07 * np.sin(ahead), 0.0]
    np.testing.assert_allclose(moved, wanted, atol=1e-6)
    assert kept(back).gripper == 40.0


def squeezed(world, positions, gripper=0.0):
    """The hand goes on for 3 s against objects that stand at the wall; the largest overlap, m."""
    data = placed(world, positions, at=[0.2, 0.0, 0.0], gripper=gripper).data
    worst, ahead = 0.0, np.array([0.1, 0.0, 0.0])
    for _ in range(800):
        world._drive(data, ahead, (gripper, gripper), 0.00375)
        worst = max(worst, -float(data.contact.dist.min(initial=0.0)))
    return State(data, gripper), worst


@pytest.mark.parametrize("gripper", [0.0, 128.0])
def test_a_hand_that_squeezes_objects_against_the_wall_stalls(two, gripper):
    end, overlap = squeezed(two, [[0.56, -0.005], [0.5, -0.006]], gripper)
    assert 1e-4 < overlap < 2e-3
    x, *_ = two._hand(end.data)
    assert 0.2 < x < 0.35  # 0.5 if nothing stopped it
    deepest = two.seen(end).objects[:, 0].max()
    assert BACK_WALL_X - RADIUS - 1e-3 < deepest < BACK_WALL_X - RADIUS + 2e-3


def test_a_hand_that_has_stalled_turns_about_itself(two):
    end, _ = squeezed(two, [[0.56, -0.005], [0.5, -0.006]])
    free = kept(two.execute(two.retreat(end)))
    for state in (free, two.state_of(two.seen(free))):
        pose = two._hand(state.data)
        turned = two.execute(Command(state, np.array([[0.0, 0.0, 0.5]]), np.zeros(1), 1.0))
        np.testing.assert_allclose(turned.rollout.hand[-1] - pose, [0, 0, 0.5], atol=1e-5)


@pytest.mark.parametrize("seed", [5, 6])
def test_no_overlap_of_a_reach_is_large(twenty, seed):
    command = reach(twenty, seed)
    data, before, worst = twenty._copy(command.state.data), 0.0, 0.0
    for u, g in zip(command.controls, command.gripper, strict=True):
        for part in np.linspace(before, g, 101)[1:]:
            twenty._drive(data, u, (before, part), KNOT_S / 100)
            before = part
            worst = max(worst, -float(data.contact.dist.min(initial=0.0)))
    assert (
        np.abs(data.xpos[twenty._objects, :2] - sample_scene(seed, "tight").positions).max() > 0.05
    )
    assert worst < 2e-3


# -- the same, however it is executed -------------------------------------------------------------


def test_executing_side_by_side_in_any_order_changes_nothing(twenty, monkeypatch):
    commands = [(twenty, reach(twenty, seed)) for seed in range(6)]
    alone = [twenty.execute(command) for _, command in commands]
    monkeypatch.setattr(cores, "usable", lambda: {0, 1})  # on one core nothing is side by side
    for order in ([0, 1, 2, 3, 4, 5], [5, 3, 1, 0, 2, 4], [2]):
        together = execute_all([commands[i] for i in order])
        assert all(same(alone[i], one) for i, one in zip(order, together, strict=True))
    assert not same(alone[0], alone[1])


@pytest.mark.parametrize("seed", [0, 1])
def test_two_halves_of_a_segment_are_the_whole(twenty, seed):
    command = reach(twenty, seed, keep=True)
    whole = twenty.execute(command)
    half = dataclasses.replace(
        command, controls=command.controls[:4], gripper=command.gripper[:4], seconds=1.5
    )
    first = twenty.execute(half)
    rest = dataclasses.replace(
        half, state=kept(first), controls=command.controls[4:], gripper=command.gripper[4:]
    )
    second = twenty.execute(rest)
    for a, b, both in zip(first.rollout, second.rollout, whole.rollout, strict=True):
        if len(both) == KNOTS:  # velocities are those at the end
            assert np.array_equal(np.concatenate([a, b]), both)
    assert np.array_equal(second.rollout.velocities, whole.rollout.velocities)
    for name in ("qpos", "qvel", "qacc_warmstart"):
        assert np.array_equal(getattr(kept(second).data, name), getattr(kept(whole).data, name))
    assert second.distance == whole.distance
    assert min(first.upright, second.upright) == whole.upright
    assert (first.touched or second.touched) == whole.touched


def test_a_state_stays_as_it_is(twenty):
    command = reach(twenty, 2)
    before = command.state.data.qpos.copy()
    first, again = twenty.execute(command), twenty.execute(command)
    assert same(first, again) and first.state is None
    assert np.array_equal(command.state.data.qpos, before)


def test_a_state_is_made_of_what_is_seen(twenty):
    end = kept(twenty.execute(reach(twenty, 4, keep=True)))
    seen = twenty.seen(end)
    again = twenty.seen(twenty.state_of(seen))
    for a, b in zip(seen, again, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
