"""The engine `mjx` against MuJoCo's C engine on sampled scenes."""

from typing import Any

import jax
import numpy as np
import pytest
from physics_cases import PHYSICS, ByHand, sampled

from pgf_jax.physics import hand
from pgf_jax.physics.engine import Rollout, World, make_engine

B = 16  # the batch that `mjx_engine` is compiled for


def single(tree: Any) -> Any:
    return jax.tree.map(lambda x: np.asarray(x, np.float32), tree)


@pytest.fixture(scope="module")
def case():
    """Start, controls, gripper; rounded to float32, so that engines are given the same."""
    return single(sampled(B, seed=1))


@pytest.fixture(scope="module")
def rolled(mjx_engine, case) -> Rollout:
    return jax.tree.map(np.asarray, mjx_engine.rollout(*case, PHYSICS.substeps))


@pytest.fixture(scope="module")
def reference(case) -> Rollout:
    start, controls, gripper = case
    return make_engine("native", threads=2).rollout(start, controls, gripper, PHYSICS.substeps)


def test_objects_end_where_native_puts_them(case, rolled, reference):
    off = np.linalg.norm(rolled.objects - reference.objects, axis=-1)[:, -1]
    moved = np.linalg.norm(reference.objects[:, -1] - case[0].objects, axis=-1) > 1e-3
    assert moved.sum() > 60
    assert np.median(off[moved]) < 1e-3
    assert off[moved].mean() < 3e-3
    assert np.median(off[~moved]) < 1e-6
    np.testing.assert_allclose(rolled.hand, reference.hand, atol=1e-4)


def pair_forces(rollout, i, knot):
    """Sum of the contact forces of each pair of bodies, N."""
    sums = {}
    for force, bodies in zip(rollout.force[i, knot], rollout.bodies[i, knot], strict=True):
        pair = tuple(sorted(bodies.tolist()))
        sums[pair] = sums.get(pair, 0.0) + float(force)
    return sums


def test_forces_at_the_first_contact_are_native_s(rolled, reference):
    errors = []
    for i in range(B):
        for knot in range(PHYSICS.knots):
            ours, theirs = pair_forces(rolled, i, knot), pair_forces(reference, i, knot)
            strong = {pair: force for pair, force in theirs.items() if force > 1}
            errors += [abs(ours.get(p, 0.0) - f) / f for p, f in strong.items()]
            if strong:
                break
    assert len(errors) >= B - 2
    assert np.median(errors) < 0.01


def test_one_substep_from_states_on_the_way(mjx_engine):
    """Accelerations against mj_step, from states of pushing rollouts; the solver starts cold."""
    start, controls, gripper = sampled(B, seed=2)
    by_hand = ByHand(20)
    rng = np.random.default_rng(0)
    states, speeds, fingers, wanted = [], [], [], []
    for i in range(B):
        stop = int(rng.integers(60, 280))
        for substep, velocity, finger in by_hand.roll(start, i, controls, gripper, stop):
            state = by_hand.state()
            acceleration = by_hand.step(velocity, finger)
            if substep == stop:
                states.append(state)
                speeds.append(velocity)
                fingers.append(finger)
                wanted.append(acceleration)
    begin = World._make([*map(np.array, zip(*states, strict=True)), np.array(fingers)])
    begin = single(begin)
    held = single(
        (np.repeat(np.array(speeds)[:, None], 8, 1), np.repeat(begin.gripper[:, None], 8, 1))
    )
    after = np.asarray(mjx_engine.rollout(begin, *held, 1).objects[:, 0], float)
    dt = PHYSICS.substep_s
    got = ((after - begin.objects) / dt - begin.velocities) / dt
    wanted = np.array(wanted)
    size = np.linalg.norm(wanted, axis=-1)
    off = np.linalg.norm(got - wanted, axis=-1)
    working = size > 0.1  # m / s^2
    assert working.sum() > 30
    assert np.median(off[working] / size[working]) < 0.05
    assert np.quantile(off[working] / size[working], 0.9) < 0.3
    assert np.median(off[~working]) < 1e-3


def test_lanes_do_not_see_each_other(mjx_engine, case, rolled):
    order = np.random.default_rng(0).permutation(B)
    order[3] = order[4]  # and one of them is another's
    shuffled = jax.tree.map(lambda x: x[order], case)
    again = mjx_engine.rollout(*shuffled, PHYSICS.substeps)
    for a, b in zip(again, rolled, strict=True):
        np.testing.assert_array_equal(np.asarray(a), b[order])


def test_nothing_is_traced_twice(mjx_engine, case, rolled, monkeypatch):
    """Neither other values nor another number of substeps (a retreat's) trace the program again."""

    def traced(*_):
        raise AssertionError("traced again")

    monkeypatch.setattr(hand, "capsule_poses", traced)
    start, controls, gripper = case
    slow = mjx_engine.rollout(start, controls / 2, gripper, PHYSICS.substeps // 3)
    np.testing.assert_allclose(slow.hand, np.asarray(rolled.hand) / 6, atol=1e-5)
    with pytest.raises(AssertionError, match="traced again"):
        mjx_engine.rollout(*jax.tree.map(lambda x: x[:4], case), 1)


def test_a_diverged_rollout_is_not_finite(mjx_engine, case, rolled):
    start, controls, gripper = case
    controls = controls.copy()
    controls[2, 4] = np.nan
    out = mjx_engine.rollout(start, controls, gripper, PHYSICS.substeps)
    assert not np.isfinite(np.asarray(out.hand)[2, 4:]).any()
    np.testing.assert_array_equal(np.asarray(out.hand)[2, :4], rolled.hand[2, :4])
    others = np.arange(B) != 2
    np.testing.assert_array_equal(np.asarray(out.objects)[others], rolled.objects[others])
