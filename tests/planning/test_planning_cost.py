import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import planning_oracle as oracle
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pgf_jax.physics import hand
from pgf_jax.physics.engine import Rollout
from pgf_jax.planning.config import Cost
from pgf_jax.planning.cost import Task, end_effector, evaluate, force_cost, reach_distance

SOURCE, PAPER = Cost(), Cost(variant="paper")
C_D, C_F, C_B, C_E, C_S = range(5)
OPEN = np.zeros(oracle.KNOTS, np.float32)
EE = np.array([0.35, 0.0])  # clear of every wall with the hand straight
POSE = oracle.pose_at(EE)
AHEAD = np.array([math.cos(oracle.pointing(POSE)), math.sin(oracle.pointing(POSE))])
FAR = [(0.5, 0.3), (0.5, -0.3)]  # objects 1 and 2: out of the way of everything
REACH = Task(np.int32(0), np.bool_(False), np.int32(0), np.zeros(2, np.float32))

_evaluate = jax.jit(evaluate, static_argnums=3)


def push(target, pushed=1, goal=0):
    return Task(np.int32(goal), np.bool_(True), np.int32(pushed), np.asarray(target, np.float32))


def value(rollout, task=REACH, cost=SOURCE, gripper=OPEN):
    return jax.tree.map(np.asarray, _evaluate(rollout, gripper, task, cost))


def goal_ahead(d):
    """Nothing moves; the goal `d` metres straight ahead of the end effector."""
    return oracle.still([EE + d * AHEAD, *FAR], POSE)


def touching(contacts, knot=-1, d=0.05):
    """The same with contacts [(force, body, body), ...] at a knot's end."""
    rollout = goal_ahead(d)
    for slot, (force, *bodies) in enumerate(contacts):
        rollout.force[knot, slot], rollout.bodies[knot, slot] = force, bodies
    return rollout


def test_end_effector_turns_with_the_hand():
    ex, ey = hand.EE_POINT
    np.testing.assert_allclose(end_effector(jnp.zeros(3)), [ex, ey], atol=1e-7)
    turned = end_effector(jnp.array([1.0, 2.0, math.pi / 2]))
    np.testing.assert_allclose(turned, [1.0 - ey, 2.0 + ex], atol=1e-6)


@pytest.mark.parametrize("bearing", [0.0, 0.5, -2.0, math.pi - 0.01])
@pytest.mark.parametrize("yaw", [0.0, 1.0, 3.0])  # 3.0: the difference of angles wraps
def test_distance_counts_the_bearing_at_the_end_effector(bearing, yaw):
    pose = oracle.pose_at((0.4, 0.1), yaw)
    angle = oracle.pointing(pose) + bearing
    o = oracle.ee_of(pose) + 0.2 * np.array([math.cos(angle), math.sin(angle)])
    d = reach_distance(jnp.asarray(pose, jnp.float32), jnp.asarray(o[None], jnp.float32), SOURCE)
    np.testing.assert_allclose(d, [math.hypot(0.2, 0.09 * bearing)], rtol=1e-5)


def test_reach_term_is_the_plain_distance_within_0_06():
    near, far = value(goal_ahead(0.0599)), value(goal_ahead(0.0601))
    assert near.terms[C_D] == pytest.approx(0.0599, rel=1e-5)
    assert far.terms[C_D] == pytest.approx(4000 * 0.0601, rel=1e-5)
    assert near.distance == pytest.approx(0.0599, rel=1e-5)
    assert near.feasible and not far.feasible


def test_reach_term_of_the_paper_has_neither_threshold_nor_bearing():
    aside = oracle.still([EE + 0.05 * np.array([-AHEAD[1], AHEAD[0]]), *FAR], POSE)
    assert value(aside, cost=PAPER).terms[C_D] == pytest.approx(4000 * 0.05, rel=1e-5)
    # A quarter turn to the side, 0.05 m away: sqrt(0.05^2 + (0.09 pi / 2)^2) counts as not reached.
    d = math.hypot(0.05, 0.09 * math.pi / 2)
    assert value(aside).terms[C_D] == pytest.approx(4000 * d, rel=1e-5)
    assert not value(aside, cost=PAPER).feasible
    assert value(goal_ahead(0.05), cost=PAPER).feasible


def test_reach_term_looks_at_the_last_knot_only():
    rollout = goal_ahead(0.05)
    rollout.hand[:-1, 0] -= 0.1
    assert value(rollout).terms[C_D] == pytest.approx(0.05, rel=1e-5)
    rollout.hand[-1, 0] -= 0.1
    assert value(rollout).terms[C_D] > 400


def test_blocking_counts_each_object_nearer_than_0_075():
    blocked = goal_ahead(0.05)
    blocked.objects[:, 1] = EE + 0.0749 * AHEAD
    assert value(blocked).terms[C_B] == pytest.approx(450 + 0.0749, rel=1e-6)
    blocked.objects[:, 2] = EE + 0.03 * AHEAD
    both = value(blocked)
    assert both.terms[C_B] == pytest.approx(900 + 0.0749 + 0.03, rel=1e-6)
    assert both.distance < 0.06 and not both.feasible
    blocked.objects[-1, 1:] = EE + 0.0751 * AHEAD  # only where they end counts
    assert value(blocked).terms[C_B] == 0.0


def test_blocking_spares_the_goal_or_else_the_pushed_object():
    rollout = oracle.still([EE + 0.05 * AHEAD, EE + 0.06 * AHEAD, FAR[0]], POSE)
    at_target = push(target=EE + 0.06 * AHEAD)
    assert value(rollout).terms[C_B] == pytest.approx(450 + 0.06, rel=1e-6)
    pushed = value(rollout, at_target)
    assert pushed.terms[C_B] == pytest.approx(450 + 0.05, rel=1e-6)  # the goal is in the way
    assert not pushed.feasible
    rollout.objects[:, 0] = FAR[1]
    assert value(rollout, at_target).terms[C_B] == 0.0
    assert value(rollout, at_target).feasible


def test_push_term_is_the_plain_distance_within_0_05():
    rollout = goal_ahead(0.2)
    near = value(rollout, push(np.add(FAR[0], (0.0, 0.0499))))
    far = value(rollout, push(np.add(FAR[0], (0.0, 0.0501))))
    assert near.terms[C_D] == pytest.approx(0.0499, rel=1e-4)
    assert far.terms[C_D] == pytest.approx(300 * 0.0501, rel=1e-4)
    # 15.03 is less than the feasible cost, but the object is not there.
    assert near.feasible and not far.feasible
    assert near.distance == pytest.approx(0.0499, rel=1e-4)
    assert value(rollout, push(np.add(FAR[0], (0.1, 0))), Cost(w_h=4000)).terms[
        C_D
    ] == pytest.approx(400, rel=1e-5)


@pytest.mark.parametrize(
    ("contacts", "expected"),
    [
        ([(40.0, 0, 3)], 0.0),
        ([(40.1, 0, 3)], 0.3 * 40.1),  # an object and the hand (body N = 3): once
        ([(50.0, 4, 1)], 0.3 * 50),  # an object and a wall
        ([(50.0, 0, 1)], 2 * 0.3 * 50),  # two objects: at both
        ([(50.0, 3, 4)], 0.0),  # no movable object
        ([(30.0, 0, 3), (30.0, 0, 3)], 0.0),  # the threshold is per contact, not per object
        ([(math.inf, 0, 3)], 30.0),
        ([(math.nan, 0, 1), (100.0, 2, 4)], 60.0 + 30.0),
    ],
)
def test_force_term(contacts, expected):
    assert value(touching(contacts)).terms[C_F] == pytest.approx(expected, rel=1e-6)


def test_force_term_adds_up_over_knot_ends():
    rollout = touching([(50.0, 0, 3)], knot=2)
    rollout.force[5, 3], rollout.bodies[5, 3] = 60.0, (1, 2)
    assert value(rollout).terms[C_F] == pytest.approx(15.0 + 36.0, rel=1e-6)


def test_force_term_of_the_paper_takes_every_contact_once():
    rollout = touching([(1.0, 0, 3), (2.0, 0, 1), (50.0, 2, 4)])
    assert value(rollout, cost=PAPER).terms[C_F] == pytest.approx(30 * 53, rel=1e-6)
    lost = value(touching([(math.inf, 0, 3)]), cost=PAPER)
    assert lost.total == math.inf and not lost.feasible


def test_edge_term_per_knot_object_and_axis():
    rollout = goal_ahead(0.05)
    for spot, axes in {
        (0.20, 0.38): 0,
        (0.58, -0.38): 0,
        (0.199, 0.0): 1,
        (0.581, 0.0): 1,
        (0.5, 0.381): 1,
        (0.5, -0.381): 1,
        (0.581, -0.381): 2,
    }.items():
        rollout.objects[:, 1] = FAR[0]
        rollout.objects[3, 1] = spot
        assert value(rollout).terms[C_E] == pytest.approx(300 * axes), spot
    rollout.objects[:, 1:] = (0.585, 0.39)
    assert value(rollout).terms[C_E] == pytest.approx(300 * 2 * 2 * oracle.KNOTS)
    assert value(rollout, cost=PAPER).terms[C_E] == 0.0


def reach_of_hand(axis, sign, gripper):
    """How far the straight hand's surface extends from its base point along an axis, m."""
    ends = sign * hand.capsule_segments(gripper)[..., axis]
    return float((ends.max(1) + hand.RADII).max())


@pytest.mark.parametrize("gripper", [0.0, 255.0])
def test_static_term_at_the_back_wall(gripper):
    fingers = np.full(oracle.KNOTS, gripper, np.float32)
    x = 0.59 - reach_of_hand(0, 1, gripper)
    for offset, touches in ((-1e-4, 0), (1e-4, 1)):
        rollout = oracle.still([(0.3, 0.3), *FAR], POSE - [0.2, 0, 0])
        rollout.hand[4] = (x + offset, 0.0, 0.0)
        assert value(rollout, gripper=fingers).terms[C_S] == 300 * touches
        assert value(rollout, cost=PAPER, gripper=fingers).terms[C_S] == 0.0


@pytest.mark.parametrize("side", [1, -1])
def test_static_term_at_a_side_wall_once_inside(side):
    y = side * (0.40 - reach_of_hand(1, side, 0.0))
    for x, offset, touches in ((0.2, 1e-4, 1), (0.2, -1e-4, 0), (-0.3, 0.2, 0)):
        pose = np.array([x, y + side * offset, 0.0])  # at x = -0.3 the whole hand is before 0.20
        rollout = oracle.still([(0.3, 0.0), *FAR], pose)
        assert value(rollout).terms[C_S] == 300 * touches * oracle.KNOTS, (x, offset)


def test_static_term_uses_the_fingers_of_each_knot():
    closed_reach, open_reach = reach_of_hand(0, 1, 255.0), reach_of_hand(0, 1, 0.0)
    assert abs(closed_reach - open_reach) > 1e-3
    fingers = np.where(np.arange(oracle.KNOTS) < 3, 255.0, 0.0).astype(np.float32)
    x = 0.59 - (closed_reach + open_reach) / 2
    rollout = oracle.still([(0.3, 0.3), *FAR], (x, 0, 0))
    longer = 3 if closed_reach > open_reach else oracle.KNOTS - 3
    assert value(rollout, gripper=fingers).terms[C_S] == 300 * longer


def test_feasible_up_to_a_total_of_20():
    dear = touching([(66.7, 0, 3)])  # 0.3 * 66.7 = 20.01
    assert not value(dear).feasible
    assert value(touching([(66.0, 0, 3)])).feasible
    # The paper's text asks for no more than goal and blocking.
    assert value(dear, cost=PAPER).feasible
    assert not value(touching([(70.0, 0, 3)], d=0.2), push(FAR[0])).feasible
    assert value(touching([(60.0, 0, 3)], d=0.2), push(FAR[0])).feasible


@pytest.mark.parametrize("field", ["objects", "hand"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_rollout_that_is_not_finite_costs_infinity(field, bad):
    rollout = goal_ahead(0.05)
    array = getattr(rollout, field).copy()
    array[0].flat[0] = bad  # the first knot, which no distance looks at
    for cost in (SOURCE, PAPER):
        lost = value(rollout._replace(**{field: array}), cost=cost)
        assert lost.total == math.inf and not lost.feasible and not lost.finite
    assert value(rollout).finite


def random_case(seed, pushing):
    """A rollout whose objects crowd around the end effector and the thresholds."""
    rng = np.random.default_rng(seed)
    n = 5
    pose = oracle.pose_at(rng.uniform((0.3, -0.33), (0.56, 0.33)), rng.uniform(-0.5, 0.5))
    poses = (pose + rng.normal(0, 0.03, (oracle.KNOTS, 3))).astype(np.float32)
    near = oracle.ee_of(poses[-1])
    objects = near + rng.normal(0, 0.06, (oracle.KNOTS, n, 2))
    force = np.where(rng.random((oracle.KNOTS, 24)) < 0.2, rng.uniform(0, 120, (8, 24)), 0.0)
    force[rng.random(force.shape) < 0.002] = math.inf
    bodies = rng.integers(0, n + 2, (oracle.KNOTS, 24, 2), np.int32)
    target = objects[-1, 1] + rng.normal(0, 0.04, 2)
    gripper = rng.choice([0.0, 85.0, 255.0], oracle.KNOTS).astype(np.float32)
    rollout = Rollout(
        objects.astype(np.float32), poses, np.zeros((n, 2)), force.astype(np.float32), bodies
    )
    goal = np.int32(rng.integers(n))
    task = Task(goal, np.bool_(pushing), np.int32(1), target.astype(np.float32))
    return rollout, gripper, task


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9), st.booleans(), st.sampled_from([SOURCE, PAPER]))
def test_agrees_with_the_definitions_in_numpy(seed, pushing, cost):
    rollout, gripper, task = random_case(seed, pushing)
    margins = [oracle.shelf_margin(p, g) for p, g in zip(rollout.hand, gripper, strict=True)]
    assume(min(abs(m) for m in margins) > 1e-3)  # the oracle samples the capsules' axes
    terms, total, feasible = oracle.cost(rollout, gripper, task, cost)
    got = value(rollout, task, cost, gripper)
    np.testing.assert_allclose(got.terms, terms, rtol=2e-5, atol=1e-5)
    np.testing.assert_allclose(got.total, total, rtol=2e-5)
    assert got.feasible == feasible


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9), st.booleans())
def test_costs_do_not_change_when_objects_or_contacts_are_renumbered(seed, pushing):
    rollout, gripper, task = random_case(seed, pushing)
    rng = np.random.default_rng(seed)
    order, slots = rng.permutation(5), rng.permutation(24)
    new_number = np.append(np.argsort(order), [5, 6]).astype(np.int32)  # old body -> new one
    renumbered = rollout._replace(
        objects=rollout.objects[:, order],
        force=rollout.force[:, slots],
        bodies=new_number[rollout.bodies[:, slots]][..., ::-1],
    )
    moved = task._replace(goal=new_number[task.goal], pushed=new_number[task.pushed])
    before, after = value(rollout, task, gripper=gripper), value(renumbered, moved, gripper=gripper)
    np.testing.assert_allclose(after.terms, before.terms, rtol=1e-5)
    assert after.feasible == before.feasible


def test_a_rollout_costs_the_same_whatever_else_is_in_the_batch():
    cases = [random_case(seed, seed % 2 == 1) for seed in range(6)]
    batched = jax.jit(jax.vmap(lambda r, g, t: evaluate(r, g, t, SOURCE)))
    stacked = jax.tree.map(lambda *xs: np.stack(xs), *cases)
    whole = batched(*stacked)
    order = np.array([3, 3, 0, 5, 1, 3])
    other = batched(*jax.tree.map(lambda x: x[order], stacked))
    for a, b in zip(other, whole, strict=True):
        np.testing.assert_array_equal(a, np.asarray(b)[order])
    for i, (rollout, gripper, task) in enumerate(cases):
        np.testing.assert_allclose(whole.total[i], value(rollout, task, gripper=gripper).total)


def test_force_weights_are_settings():
    force, bodies = jnp.array([50.0]), jnp.array([[0, 3]])
    doubled = dataclasses.replace(SOURCE, w_f=0.6, force_threshold=50.0)
    assert force_cost(force, bodies, 3, doubled) == 0.0
    assert force_cost(force + 1, bodies, 3, doubled) == pytest.approx(0.6 * 51)
