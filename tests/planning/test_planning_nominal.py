import math

import jax
import jax.numpy as jnp
import numpy as np
import planning_oracle as oracle
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pgf_jax.physics.config import Physics
from pgf_jax.planning import nominal
from pgf_jax.planning.config import Cost

PHYSICS = Physics()
START = (0.0, 0.0, 0.0)
MOVED = (0.06, -0.08, 0.4)  # after pushes and retreats
_reach = jax.jit(nominal.reach, static_argnums=(3, 4))
_push = jax.jit(nominal.push, static_argnums=4)


def reach(pose, objects, goal=0, physics=PHYSICS):
    controls, gripper = _reach(_f32(pose), _f32(objects), jnp.int32(goal), physics, Cost())
    return _follow(pose, controls, gripper, physics)


def push(pose, objects, target, pushed=0, physics=PHYSICS):
    controls, gripper = _push(_f32(pose), _f32(objects), jnp.int32(pushed), _f32(target), physics)
    return _follow(pose, controls, gripper, physics)


def _f32(x):
    return jnp.asarray(x, jnp.float32)


def _follow(pose, controls, gripper, physics):
    """[T, 3] poses that the controls lead to, [T, 2] end-effector points there, and the gripper."""
    steps = np.asarray(controls, float) * physics.rollout_s / physics.knots
    poses = np.asarray(pose, float) + np.cumsum(steps, 0)
    return poses, np.array([oracle.ee_of(p) for p in poses]), np.asarray(gripper)


@pytest.mark.parametrize("pose", [START, MOVED])
@pytest.mark.parametrize("goal", [(0.5, 0.1), (0.3, -0.3)])
def test_reach_goes_straight_and_stops_0_04_short(pose, goal):
    objects = [(0.4, 0.2), goal]
    _, ee, _ = reach(pose, objects, goal=1)
    start = oracle.ee_of(pose)
    line = np.subtract(goal, start)
    length = math.hypot(*line)
    expected = [start + line / length * (length - 0.04) * k / 8 for k in range(1, 9)]
    np.testing.assert_allclose(ee, expected, atol=1e-6)


@pytest.mark.parametrize("pose", [START, MOVED])
def test_reach_turns_evenly_by_half_the_angle_from_the_base(pose):
    goal = (0.4, 0.25)
    poses, _, _ = reach(pose, [goal])
    seen = math.atan2(goal[1] - pose[1], goal[0] - pose[0]) - pose[2] + math.radians(2.78)
    yaws = [pose[2] + seen / 2 * k / 8 for k in range(1, 9)]
    np.testing.assert_allclose(poses[:, 2], yaws, atol=1e-4)  # 2.78 deg is rounded


def test_reach_turns_the_short_way():
    # The goal is seen 0.2 rad to the right of the hand's back-facing direction.
    pose = (0.5, 0.0, math.pi - 0.1)
    angle = oracle.pointing(pose) + 0.2
    goal = (pose[0] + 0.3 * math.cos(angle), pose[1] + 0.3 * math.sin(angle))
    poses, _, _ = reach(pose, [goal])
    assert poses[-1, 2] == pytest.approx(pose[2] + 0.1, abs=1e-5)


def test_reach_closes_for_four_knots_then_opens():
    _, _, gripper = reach(START, [(0.5, 0.0)])
    assert gripper.tolist() == [255] * 4 + [0] * 4
    _, _, gripper = reach(START, [(0.5, 0.0)], physics=Physics(knots=5))  # floor(3.0) open
    assert gripper.tolist() == [255] * 2 + [0] * 3


@pytest.mark.parametrize(("d", "near"), [(0.149, True), (0.151, False)])
def test_reach_stays_open_within_0_15(d, near):
    angle = oracle.pointing(MOVED)
    goal = oracle.ee_of(MOVED) + d * np.array([math.cos(angle), math.sin(angle)])
    _, _, gripper = reach(MOVED, [goal])
    assert (gripper == 0).all() == near


def test_reach_counts_the_bearing_for_near():
    # 0.12 m away but at 90 degrees: d = sqrt(0.12^2 + (0.09 pi / 2)^2) = 0.186.
    angle = oracle.pointing(START) + math.pi / 2
    goal = oracle.ee_of(START) + 0.12 * np.array([math.cos(angle), math.sin(angle)])
    _, _, gripper = reach(START, [goal])
    assert gripper[0] == 255


@pytest.mark.parametrize("pose", [START, MOVED])
def test_push_goes_behind_the_object_then_towards_the_target(pose):
    o, target = np.array([0.4, 0.1]), np.array([0.46, 0.02])  # 0.1 m apart: 0.6, -0.8
    along = np.array([0.6, -0.8])
    poses, ee, gripper = push(pose, [(0.5, 0.3), o], target, pushed=1)
    start, behind, stop = oracle.ee_of(pose), o - 0.07 * along, target - 0.05 * along
    expected = [start + (behind - start) * k / 4 for k in range(1, 5)]
    expected += [behind + (stop - behind) * k / 4 for k in range(1, 5)]
    np.testing.assert_allclose(ee, expected, atol=1e-6)
    np.testing.assert_allclose(poses[:, 2], pose[2], atol=1e-7)
    assert gripper.tolist() == [255] * 8


def test_push_of_an_object_that_is_there_already_is_finite():
    poses, ee, _ = push(START, [(0.4, 0.1)], (0.4, 0.1))
    assert np.isfinite(poses).all()
    np.testing.assert_allclose(ee[-1], (0.4, 0.1), atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(-0.1, 0.2), st.floats(-0.2, 0.2), st.floats(-1, 1)),
    st.tuples(st.floats(0.2, 0.55), st.floats(-0.35, 0.35)),
    st.floats(-3, 3),
)
def test_nominals_turn_and_shift_with_the_world(pose, o, turn):
    """Nothing in them depends on where the shelf is."""
    c, s = math.cos(turn), math.sin(turn)
    rotation, shift = np.array([[c, -s], [s, c]]), np.array([0.3, -0.2])
    # No direction to speak of leads from a point to itself.
    assume(math.dist(o, pose[:2]) > 0.05 and math.dist(o, oracle.ee_of(pose)) > 0.01)

    def moved(xy):
        return rotation @ np.asarray(xy) + shift

    other = (*moved(pose[:2]), pose[2] + turn)
    target = (o[0] + 0.08, o[1] - 0.05)
    for here, there in (
        (reach(pose, [o]), reach(other, [moved(o)])),
        (push(pose, [o], target), push(other, [moved(o)], moved(target))),
    ):
        np.testing.assert_allclose(there[1], [moved(e) for e in here[1]], atol=2e-5)
        # The half turn is either way where the goal is straight behind the hand.
        behind = math.atan2(o[1] - pose[1], o[0] - pose[0]) - oracle.pointing(pose)
        if abs(abs(math.remainder(behind, math.tau)) - math.pi) > 1e-3:
            np.testing.assert_allclose(there[0][:, 2] - turn, here[0][:, 2], atol=2e-5)
