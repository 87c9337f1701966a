"""The planar model and the engine `native` against closed forms, invariants and MuJoCo by hand."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_cases import AWAY, PHYSICS, ByHand, idle, sampled, world

from pgf_jax.physics import hand, model
from pgf_jax.physics.config import PHYSICS as PRESETS
from pgf_jax.physics.engine import Rollout, World, make_engine

KNOTS = PHYSICS.knots


@pytest.fixture(scope="module")
def two():
    return make_engine("native", n_objects=2, threads=1)


@pytest.fixture(scope="module")
def twenty():
    return make_engine("native", threads=2)


@pytest.fixture(scope="module")
def reaches(twenty):
    """12 rollouts in sampled scenes: start, controls, gripper, rollout."""
    case = sampled(12)
    return *case, twenty.rollout(*case, PHYSICS.substeps)


# -- the model ------------------------------------------------------------------------------------


@pytest.mark.parametrize("physics", PRESETS.values(), ids=PRESETS)
def test_compiled_constants_are_the_settings(physics):
    n = 3
    m = model.compile_model(physics, n)
    assert m.opt.timestep == physics.substep_s
    assert m.nq == m.nv == model.KINEMATIC_DOFS + 2 * n
    objects = slice(model.KINEMATIC_DOFS, None)
    np.testing.assert_allclose(m.dof_armature[objects], physics.armature)
    np.testing.assert_allclose(m.dof_damping[objects], physics.damping)
    np.testing.assert_allclose(m.dof_frictionloss[objects], physics.frictionloss)
    np.testing.assert_allclose(m.dof_solref[objects, 0], physics.solref_timeconst)
    np.testing.assert_allclose(m.dof_solimp[objects, :2], physics.impedance)
    np.testing.assert_allclose(m.dof_frictionloss[: model.KINEMATIC_DOFS], 0)
    np.testing.assert_allclose(m.dof_damping[: model.KINEMATIC_DOFS], 0)
    np.testing.assert_allclose(m.geom_solref[:, 0], physics.solref_timeconst)
    np.testing.assert_allclose(m.geom_solimp[:, :2], physics.impedance)
    codes = model.geom_bodies(m, n)
    assert sorted(codes) == [*range(n), *[n] * hand.N_CAPSULES, *[n + 1] * 3]
    frictions = {0: physics.object_friction, n: physics.hand_friction, n + 1: physics.wall_friction}
    for code, friction in frictions.items():
        np.testing.assert_allclose(m.geom_friction[codes == code, 0], friction)
    for i in range(n):
        body = m.body(f"object_{i + 1}").id
        assert m.body_mass[body] == pytest.approx(physics.mass)
        (geom,) = np.flatnonzero(codes == i)
        assert m.geom_bodyid[geom] == body and m.geom_size[geom, 0] == 0.03
    assert (m.geom_condim == 3).all()


def test_capsules_of_the_model_are_the_hand_s():
    m = model.compile_model(PHYSICS, 1)
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    geoms = model.hand_geoms(m)
    segments = hand.capsule_segments(0.0)
    along = d.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2] * m.geom_size[geoms, 1:2]
    middle = d.geom_xpos[geoms]
    ends = np.stack([middle - along, middle + along], 1)
    np.testing.assert_allclose(ends[..., :2], segments, atol=1e-7)
    np.testing.assert_allclose(ends[..., 2], 0, atol=1e-7)
    np.testing.assert_allclose(m.geom_size[geoms, 0], hand.RADII)
    named = [m.body(int(b)).name for b in m.geom_bodyid[geoms]]
    assert named == [c[0].split("_")[0] for c in hand.CAPSULES]


def test_who_collides_with_whom():
    m = model.compile_model(PHYSICS, 2)
    codes = model.geom_bodies(m, 2)

    def collide(a, b):
        a, b = np.flatnonzero(codes == a)[0], np.flatnonzero(codes == b)[-1]
        masks = (m.geom_contype[a] & m.geom_conaffinity[b]) | (
            m.geom_contype[b] & m.geom_conaffinity[a]
        )
        return bool(masks)

    assert collide(0, 1) and collide(0, 2) and collide(0, 3)
    assert not collide(2, 2) and not collide(2, 3)


# -- one disk -------------------------------------------------------------------------------------


def friction_damper(physics):
    """D and b of the friction D (a + b v) that holds until it reaches the loss (MuJoCo's soft row).

    D = imp / (1 - imp) / w, with w the dof's inverse weight: MuJoCo leaves the armature out of it.
    """
    d = physics.impedance / (1 - physics.impedance) * physics.mass
    return d, 2 / (physics.impedance * physics.solref_timeconst)


def stopping_distance(physics, speed):
    """m v' = -c v - f; the friction f is eta, or less at the slow end, where it is a stiff damper.

    There f = D (a + b v) up to eta, see `friction_damper`.
    """
    m, eta, c = physics.mass + physics.armature, physics.frictionloss, physics.damping
    d, b = friction_damper(physics)
    slow = eta * (1 / d + 1 / m) / (b - c / m)
    assert speed > slow
    fast_part = m / c * ((speed - slow) - eta / c * math.log((eta + c * speed) / (eta + c * slow)))
    return fast_part + slow * (m + d) / (d * b + c)


@pytest.mark.parametrize("physics", PRESETS.values(), ids=PRESETS)
@pytest.mark.parametrize("direction", [(1, 0), (0, -1), (0.6, 0.8)])
def test_a_sliding_disk_stops_where_friction_says(physics, direction):
    fine = dataclasses.replace(physics, substeps=3000)
    # Asleep it would miss the last hundredth of a millimetre.
    engine = make_engine("native", physics=fine, n_objects=1, sleep=False)
    speed = np.multiply(0.25, direction)
    out = engine.rollout(world([(0.3, 0.0)], [speed]), *idle(knots=1), fine.substeps)
    # The loss is a box: each axis stops by itself.
    expected = [math.copysign(stopping_distance(fine, abs(v)), v) if v else 0.0 for v in speed]
    # Semi-implicit Euler moves with the speed at each substep's end: half a substep is lost.
    expected -= speed * fine.substep_s / 2
    np.testing.assert_allclose(out.objects[0, -1, 0] - (0.3, 0.0), expected, rtol=2e-3, atol=1e-12)
    np.testing.assert_allclose(out.velocities[0], 0, atol=1e-6)


def test_a_disk_at_rest_stays(two):
    start = world([(0.3, 0.1), (0.36, 0.1)])  # touching
    out = two.rollout(start, *idle(), PHYSICS.substeps)
    np.testing.assert_array_equal(out.objects[0], np.repeat(start.objects, KNOTS, 0))
    np.testing.assert_array_equal(out.force, 0)


def test_substeps_of_the_call_count(two):
    """Half the substeps of a knot are half its time."""
    moving = world([(0.3, 0.0), (0.5, 0.3)])
    controls, gripper = idle()
    controls[..., 1] = 0.1
    out = two.rollout(moving, controls, gripper, PHYSICS.substeps // 2)
    np.testing.assert_allclose(out.hand[0, -1], (-0.5, 0.15, 0.0), atol=1e-9)


# -- two disks ------------------------------------------------------------------------------------

FRICTIONLESS = dataclasses.replace(PHYSICS, frictionloss=0.0, damping=0.0)


@settings(max_examples=25, deadline=None)
@given(st.floats(0, 2 * math.pi), st.floats(-0.02, 0.02), st.floats(0.05, 0.3))
def test_momentum_is_kept_when_disks_collide(angle, aside, speed):
    engine = frictionless()
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    a = np.array([0.15, 0.0])  # from where neither reaches a wall
    b = a + 0.065 * along + aside * across
    out = engine.rollout(world([a, b], [speed * along, 0 * along]), *idle(knots=2), 36)
    np.testing.assert_allclose(out.velocities[0].sum(0), speed * along, atol=1e-9)
    assert np.linalg.norm(out.velocities[0, 1]) > 0.3 * speed  # they did meet
    assert (out.velocities[0] ** 2).sum() <= speed**2 * (1 + 1e-9)


def frictionless(cache=[]):  # noqa: B006  hypothesis takes no module's fixture per example
    if not cache:
        cache.append(make_engine("native", physics=FRICTIONLESS, n_objects=2, threads=1))
    return cache[0]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_a_mirrored_world_moves_mirrored(seed):
    engine = frictional()
    rng = np.random.default_rng(seed)
    objects = np.array([(0.5, 0.30), (0.5, 0.365)]) + rng.uniform(-0.002, 0.002, (2, 2))
    velocities = rng.uniform(0.2, 0.5, (2, 2)) * rng.choice([-1, 1], (2, 2))
    out = engine.rollout(world(objects, velocities), *idle(knots=2), 36)
    mirror = np.array([1.0, -1.0])
    other = engine.rollout(world(objects * mirror, velocities * mirror), *idle(knots=2), 36)
    np.testing.assert_allclose(other.objects, out.objects * mirror, atol=1e-9)
    np.testing.assert_allclose(other.velocities, out.velocities * mirror, atol=1e-8)
    assert np.abs(out.objects[0, -1] - objects).max() > 1e-3


def frictional(cache=[]):  # noqa: B006
    if not cache:
        cache.append(make_engine("native", n_objects=2, threads=1))
    return cache[0]


@pytest.mark.parametrize(
    ("at", "velocity"), [((0.5, 0.1), (1, 0)), ((0.4, 0.3), (0, 1)), ((0.4, -0.3), (0, -1))]
)
def test_walls_stop_a_disk(two, at, velocity):
    out = two.rollout(world([at, (0.3, 0.0)], [velocity, (0, 0)]), *idle(), PHYSICS.substeps)
    axis = int(np.flatnonzero(velocity)[0])
    inner = (0.59, 0.40)[axis] - 0.03
    deepest = np.abs(out.objects[0, :, 0, axis]).max()
    assert inner - 0.02 < deepest < inner + 0.005
    assert abs(out.objects[0, -1, 0, axis]) < inner + 1e-3


# -- the hand and many disks ----------------------------------------------------------------------


def test_the_hand_moves_as_told_whatever_it_pushes(reaches):
    _, controls, _, out = reaches
    expected = np.cumsum(controls, 1) * PHYSICS.knot_s
    np.testing.assert_allclose(out.hand, expected, atol=1e-4)
    touched = (out.bodies == 20).any(-1) & (out.force > 1)
    assert touched.any(1).any(1).mean() > 0.9  # it did push


def test_objects_stay_within_the_walls(reaches):
    out = reaches[-1]
    # What the hand squeezes against a soft wall goes some way into it.
    assert out.objects[..., 0].max() < 0.56 + 0.02
    assert np.abs(out.objects[..., 1]).max() < 0.37 + 0.02


def test_disks_stay_apart(reaches):
    out = reaches[-1]
    gaps = np.linalg.norm(out.objects[:, :, :, None] - out.objects[:, :, None], axis=-1)
    gaps += np.eye(20)
    assert gaps.min() > 0.06 - 0.015


def test_contacts_name_bodies_that_touch(reaches):
    out = reaches[-1]
    seen = set()
    for b, k, c in zip(*np.nonzero(out.force), strict=True):
        pair = sorted(out.bodies[b, k, c].tolist())
        seen.add((pair[0] < 20, pair[1] if pair[1] >= 20 else 0))
        # A substep after the contact was found, so that things may have moved a little apart.
        if pair[1] < 20:
            gap = np.linalg.norm(np.subtract(*out.objects[b, k, pair]))
            assert gap < 0.0605
        elif pair[1] == 21:
            x, y = out.objects[b, k, pair[0]]
            assert max(x - 0.56, abs(y) - 0.37) > -5e-4
    assert (True, 0) in seen and (True, 20) in seen
    assert all(movable for movable, _ in seen)


def test_results_do_not_depend_on_threads_or_batch(reaches):
    start, controls, gripper, out = reaches
    for threads, order in ((1, range(12)), (2, [5]), (3, [7, 2, 2, 11, 5])):
        engine = make_engine("native", threads=threads)
        order = list(order)
        part = World._make(x[order] for x in start)
        again = engine.rollout(part, controls[order], gripper[order], PHYSICS.substeps)
        for a, b in zip(again, Rollout._make(x[order] for x in out), strict=True):
            np.testing.assert_array_equal(a, b)


def test_sleeping_changes_nothing_that_matters(reaches):
    start, controls, gripper, out = reaches
    awake = make_engine("native", sleep=False)
    again = awake.rollout(start, controls, gripper, PHYSICS.substeps)
    assert np.median(np.abs(again.objects - out.objects)) < 1e-6
    assert np.quantile(np.abs(again.objects - out.objects), 0.99) < 1e-4


def test_the_solver_has_converged(reaches):
    start, controls, gripper, out = reaches
    exact = make_engine("native", tolerance=0.0, iterations=300)
    again = exact.rollout(start, controls, gripper, PHYSICS.substeps)
    np.testing.assert_allclose(out.objects, again.objects, atol=1e-5)


def test_rollouts_and_forces_are_mujoco_s(reaches):
    start, controls, gripper, out = reaches
    by_hand = ByHand(20)
    for i in range(3):
        for substep, velocity, fingers in by_hand.roll(start, i, controls, gripper):
            by_hand.step(velocity, fingers)
            if (substep + 1) % PHYSICS.substeps:
                continue
            knot = substep // PHYSICS.substeps
            objects, _, pose = by_hand.state()
            np.testing.assert_allclose(out.objects[i, knot], objects, atol=1e-4)
            np.testing.assert_allclose(out.hand[i, knot], pose, atol=1e-9)
            wanted = sum(np.linalg.norm(f) for *_, f in by_hand.contact_forces())
            assert out.force[i, knot].sum() == pytest.approx(wanted, rel=0.02, abs=0.02)


def test_contact_forces_balance_friction_damping_and_inertia():
    """(m + armature) a = contacts - damping v - friction, for every object at every substep.

    The friction is the closed form of `stopping_distance`, so this checks the units and signs of
    all that the force cost is made of.
    """
    start, controls, gripper = sampled(1, seed=4)
    by_hand = ByHand(20)
    m = PHYSICS.mass + PHYSICS.armature
    d, b = friction_damper(PHYSICS)
    codes = model.geom_bodies(by_hand.model, 20)
    pushed = 0
    for _, velocity, fingers in by_hand.roll(start, 0, controls, gripper):
        before = by_hand.data.qvel[9:].reshape(-1, 2).copy()
        a = by_hand.step(velocity, fingers)
        contacts = np.zeros((20, 2))
        for first, second, force in by_hand.contact_forces():
            for geom, sign in ((first, -1), (second, 1)):
                if codes[geom] < 20:
                    contacts[codes[geom]] += sign * force[:2]
        friction = np.clip(d * (a + b * before), -PHYSICS.frictionloss, PHYSICS.frictionloss)
        np.testing.assert_allclose(contacts, m * a + PHYSICS.damping * before + friction, atol=1e-6)
        pushed += (np.abs(contacts) > 1).sum()
    assert pushed > 100


def test_a_disk_pushed_steadily_feels_the_table(two):
    """Between both fingers of the open hand: the forces on it add up to friction and damping."""
    speed = 0.1
    start = world([(0.23, -0.0105), (0.5, 0.3)], pose=(0, 0, 0))
    controls, gripper = idle()
    controls[..., 0] = speed
    out = two.rollout(start, controls, gripper, PHYSICS.substeps)
    # It rides along at the hand's speed ...
    np.testing.assert_allclose(out.velocities[0, 0], (speed, 0), atol=0.01)
    np.testing.assert_array_equal(out.objects[0, :, 1], [(0.5, 0.3)] * KNOTS)
    # ... so that the palm's push is at least what holds it back, along with what squeezes it.
    drag = PHYSICS.frictionloss + PHYSICS.damping * speed
    assert drag * 0.98 < out.force[0, -1].sum() < 3 * drag


def test_a_hand_away_touches_nothing(two):
    out = two.rollout(world([(0.3, 0.1), (0.4, 0.0)], pose=AWAY), *idle(), PHYSICS.substeps)
    assert not out.force.any() and out.hand.shape == (1, KNOTS, 3)
    np.testing.assert_allclose(out.hand[0], [AWAY] * KNOTS, atol=1e-12)
