"""The engine `planar` against MuJoCo's C engine: single steps, whole rollouts, its own lists."""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from physics_cases import PHYSICS, ByHand, sampled, world

from pgf_jax import load_scene, sample_scene
from pgf_jax.errors import BadInput
from pgf_jax.physics import hand, model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, make_engine
from pgf_jax.physics.planar import constants, contact, motion, reach, solver
from pgf_jax.physics.planar.motion import Motion

B = 16
CONSTANTS = constants.read(PHYSICS, 20)
SHAPE = motion.fit_shape(PHYSICS)
ONE = jnp.int32(1)


def single(tree: Any) -> Any:
    return jax.tree.map(lambda x: np.asarray(x, np.float32), tree)


def hand_at_start(lanes: Motion) -> contact.Hand:
    turn = motion.turn_at(PHYSICS, lanes, 0)
    return motion.hand_at(PHYSICS, SHAPE, lanes, 0.0, PHYSICS.substeps, turn, ONE)


@pytest.fixture(scope="module")
def planar():
    return make_engine("planar", lanes=2)


@pytest.fixture(scope="module")
def case():
    return single(sampled(B, seed=1))


@pytest.fixture(scope="module")
def rolled(planar, case) -> Rollout:
    return jax.tree.map(np.asarray, planar.rollout(*case, PHYSICS.substeps))


# -- single steps ------------------------------------------------------------------------------


class Step:
    """States on the way of pushing rollouts, jams included, and what a converged MuJoCo makes of
    them: the next accelerations, and the value of its cost."""

    def __init__(self, count: int):
        start, controls, gripper = sampled(count, seed=2)
        # Every other hand drives on into the walls, with all that is in between.
        controls[::2, 2:, :2] *= 2.5
        by_hand = ByHand(20)
        by_hand.model.opt.tolerance = 1e-10 / model.KINEMATIC_ARMATURE
        by_hand.model.opt.iterations = 200
        rng = np.random.default_rng(0)
        rows = []
        for i in range(count):
            stop = int(rng.integers(60, 286))
            for substep, velocity, finger in by_hand.roll(start, i, controls, gripper, stop):
                state = by_hand.state()
                acceleration = by_hand.step(velocity, finger)
                if substep == stop:
                    rows.append((*state, velocity, finger, acceleration))
        self.objects, self.speeds, self.pose, self.velocity, self.gripper, self.acceleration = (
            np.array(column) for column in zip(*rows, strict=True)
        )

    def problem(self) -> tuple[contact.Problem, np.ndarray]:
        """The contact problem of each state, and w of MuJoCo's solution, [2, N, count]."""
        held = Motion(jnp.asarray(self.pose.T), jnp.asarray(self.velocity.T), self._gripper())
        return self._build(hand_at_start(held)), self.w(self.acceleration)

    def _gripper(self):
        return jnp.asarray(np.stack([self.gripper, self.gripper]))

    def _build(self, now) -> contact.Problem:
        x, y, vx, vy = (
            jnp.asarray(a[..., i].T) for a in (self.objects, self.speeds) for i in (0, 1)
        )
        return contact.build(CONSTANTS, x, y, vx, vy, now, len(x), ONE)

    def w(self, acceleration: np.ndarray) -> np.ndarray:
        return (acceleration + CONSTANTS.reference * self.speeds).transpose(2, 1, 0)


def cost(p: contact.Problem, w: np.ndarray) -> np.ndarray:
    """The cost as `planar.contact` states it, row by row in float64; [count]."""
    c = CONSTANTS
    p = jax.tree.map(lambda a: np.asarray(a, float), p)

    def edges(P, Q, D):
        rows = (P, P, P + Q, P - Q)
        return sum(D / 2 * np.minimum(row, 0) ** 2 for row in rows)

    nx, ny, hand_p, hand_q = p.hand
    P, Q = nx * w[0] + ny * w[1] + hand_p, c.hand_friction * (nx * w[1] - ny * w[0]) + hand_q
    total = edges(P, Q, c.hand_weight).sum((0, 1))
    for P, Q, mu, D in (
        (p.back_p - w[0], w[1], c.wall_friction[0], c.wall_weight[0]),
        (p.side_p - p.side * w[1], w[0], c.wall_friction[1], c.wall_weight[1]),
    ):
        total += edges(P, mu * Q, D).sum(0)
    first, second = contact.pairs(w.shape[1])
    ex, ey = (w[i][first] - w[i][second] for i in (0, 1))
    nx, ny = p.pair_n
    P, Q = nx * ex + ny * ey + p.pair_p, c.pair_friction * (nx * ey - ny * ex)
    total += edges(P, Q, c.pair_weight).sum(0)
    limit, D = c.friction_loss, c.friction_weight
    for axis in (0, 1):
        total += (c.mass / 2 * (w[axis] - p.free[axis]) ** 2).sum(0)
        s = np.abs(w[axis] + p.friction[axis])
        linear = limit * s - limit**2 / (2 * D)
        total += np.where(s <= limit / D, D / 2 * s**2, linear).sum(0)
    return total


@pytest.fixture(scope="module")
def step() -> Step:
    return Step(48)


def test_the_states_are_worth_solving(step):
    """Contacts in most of them, several in most of those, and objects at the walls."""
    p, _ = step.problem()
    in_contact = (np.asarray(p.hand[2]) < contact.APART / 2).sum((0, 1))
    in_contact += (np.asarray(p.pair_p) < contact.APART / 2).sum(0)
    assert (in_contact > 0).mean() > 0.7
    assert np.median(in_contact) >= 5
    walls = np.minimum(p.back_p, p.side_p) < contact.APART / 2
    assert walls.any(0).sum() >= 5


def test_mujoco_s_solution_is_the_minimum_of_our_cost(step):
    """No step along our own gradient from it lowers the cost by more than rounding would."""
    p, w = step.problem()
    slopes = contact.slopes(CONSTANTS, p, *jnp.asarray(w), one=ONE)
    gradient = np.asarray(slopes.gradient)
    scale = 1 + CONSTANTS.mass * np.linalg.norm(w, axis=(0, 1))
    assert np.median(np.linalg.norm(gradient, axis=(0, 1)) / scale) < 5e-5
    assert (np.linalg.norm(gradient, axis=(0, 1)) / scale).max() < 1e-3


def test_the_solver_finds_it(step):
    """Accelerations and cost, from a cold start, with more iterations than ship."""
    p, w = step.problem()
    zero = tuple(jnp.asarray(step.w(np.zeros_like(step.acceleration))))
    got = np.asarray(solver.solve(CONSTANTS, p, zero, 12, 20, ONE))
    off = np.linalg.norm(got - w, axis=0)  # m / s^2
    assert np.median(off) < 1e-3
    assert np.quantile(off, 0.99) < 0.05
    best, ours = cost(p, w), cost(p, got)
    assert ((ours - best) / (1 + best)).max() < 1e-5


def test_the_shipped_iterations_are_close(step):
    """From the guess that a rollout has: the last substep's acceleration."""
    engine = make_engine("planar")
    p, w = step.problem()
    rng = np.random.default_rng(0)
    guess = tuple(jnp.asarray(w + rng.normal(0, 0.5, w.shape)))
    many = engine.iterations, engine.cg_iterations
    got = np.asarray(solver.solve(CONSTANTS, p, guess, *many, ONE))
    best, ours, before = cost(p, w), cost(p, got), cost(p, np.asarray(guess))
    assert np.median((ours - best) / (before - best)) < 1e-2
    assert (ours < before).mean() > 0.95


def test_derivatives_are_those_of_the_cost(step):
    p, w = step.problem()
    rng = np.random.default_rng(1)
    w = w + rng.normal(0, 1, w.shape)
    slopes = contact.slopes(CONSTANTS, p, *jnp.asarray(w), one=ONE)
    along = rng.normal(0, 1, w.shape)
    epsilon = 1e-4
    numeric = (cost(p, w + epsilon * along) - cost(p, w - epsilon * along)) / (2 * epsilon)
    analytic = (np.asarray(slopes.gradient) * along).sum((0, 1))
    np.testing.assert_allclose(analytic, numeric, rtol=1e-3, atol=1e-2)
    hessian = np.asarray(slopes.coupling)  # xx, xy, yy
    xx, xy, yy = np.asarray(slopes.diagonal)
    (ax, ay) = along
    times = np.stack([xx * ax + xy * ay, xy * ax + yy * ay])
    times[0] -= (hessian[0] * ax[None] + hessian[1] * ay[None]).sum(1)
    times[1] -= (hessian[1] * ax[None] + hessian[2] * ay[None]).sum(1)
    step_ = 1e-3
    up = contact.slopes(CONSTANTS, p, *jnp.asarray(w + step_ * along), one=ONE).gradient
    down = contact.slopes(CONSTANTS, p, *jnp.asarray(w - step_ * along), one=ONE).gradient
    off = np.abs((np.asarray(up) - np.asarray(down)) / (2 * step_) - times)
    # Where no row changes sides in between; float32.
    assert np.quantile(off, 0.9) < 0.1


# -- the hand ----------------------------------------------------------------------------------


@pytest.mark.parametrize("gripper", [0.0, 1.0, 2.0, 63.0, 170.0, 255.0])
def test_the_hand_is_where_its_links_are(gripper):
    pose, velocity = np.array([0.1, -0.2, 0.3]), np.array([0.05, 0.02, -0.4])
    lane = Motion(
        jnp.asarray(pose[:, None]), jnp.asarray(velocity[:, None]), jnp.full((2, 1), gripper)
    )
    now = hand_at_start(lane)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s], [s, c]])
    ends = hand.capsule_segments(gripper) @ turn.T + pose[:2]
    np.testing.assert_allclose(np.stack(now.start)[..., 0].T, ends[:, 0], atol=2e-7)
    np.testing.assert_allclose(np.stack(now.along)[..., 0].T, ends[:, 1] - ends[:, 0], atol=2e-7)
    # The surface's velocity at a point of each capsule.
    creep = PHYSICS.finger_creep * hand.creep(gripper).reshape(2, 3)
    for k, body in enumerate(hand.CAPSULE_BODY):
        point = ends[k, 1]
        arm = point - pose[:2]
        twist = velocity.copy()
        if body:
            twist[:2] += turn @ creep[body - 1, :2]
            twist[2] += creep[body - 1, 2]
        expected = twist[:2] + twist[2] * np.array([-arm[1], arm[0]])
        ux, uy, spin = (float(v[body, 0]) for v in now.twist)
        got = np.array([ux - spin * point[1], uy + spin * point[0]])
        np.testing.assert_allclose(got, expected, atol=5e-6)


# -- rollouts ----------------------------------------------------------------------------------


def converged(case: Any, **kw) -> Rollout:
    tolerance = 1e-10 / model.KINEMATIC_ARMATURE
    engine = make_engine("native", tolerance=tolerance, iterations=200, sleep=False, **kw)
    start, controls, gripper = case
    return engine.rollout(start, controls, gripper, PHYSICS.substeps)


def apart(case: Any, ours: Rollout, theirs: Rollout) -> np.ndarray:
    moved = np.linalg.norm(theirs.objects[:, -1] - case[0].objects, axis=-1) > 5e-3
    return np.linalg.norm(ours.objects[:, -1] - theirs.objects[:, -1], axis=-1)[moved]


def test_objects_end_where_native_puts_them(case, rolled):
    theirs = converged(case)
    off = apart(case, rolled, theirs)
    assert len(off) > 60
    assert np.median(off) < 0.5e-3
    assert off.mean() < 1.5e-3
    assert np.quantile(off, 0.95) < 6e-3
    np.testing.assert_allclose(rolled.hand, theirs.hand, atol=1e-5)


def test_objects_end_where_mjx_puts_them(mjx_engine, case, rolled):
    theirs = jax.tree.map(np.asarray, mjx_engine.rollout(*case, PHYSICS.substeps))
    off = apart(case, rolled, theirs)
    assert np.median(off) < 0.5e-3
    assert off.mean() < 1.5e-3


def test_published_scenes(authors):
    scenes = [load_scene(p) for p in sorted((authors / "models").glob("*.xml"))[::8]]
    from pgf_jax.profiling.measure import noisy_nominals

    engine = make_engine("planar", lanes=len(scenes))
    case: Any = noisy_nominals(engine, scenes, 0)[:3]
    off = apart(case, engine.rollout(*case, substeps=PHYSICS.substeps), converged(case))
    assert len(off) > 200
    assert np.median(off) < 0.5e-3
    assert off.mean() < 1.5e-3


def test_forces_at_the_first_contact_are_native_s(case, rolled):
    theirs, errors = converged(case), []
    for i in range(B):
        for knot in range(PHYSICS.knots):
            ours = _by_pair(rolled, i, knot)
            strong = {pair: f for pair, f in _by_pair(theirs, i, knot).items() if f > 1}
            errors += [abs(ours.get(pair, 0.0) - f) / f for pair, f in strong.items()]
            if strong:
                break
    assert len(errors) >= B - 2
    assert np.median(errors) < 0.01


def _by_pair(rollout: Rollout, i: int, knot: int) -> dict[tuple[int, ...], float]:
    sums: dict[tuple[int, ...], float] = {}
    for force, bodies in zip(rollout.force[i, knot], rollout.bodies[i, knot], strict=True):
        if force > 0:
            pair = tuple(sorted(bodies.tolist()))
            sums[pair] = sums.get(pair, 0.0) + float(force)
    return sums


@pytest.mark.parametrize("sizes", [(), ((2, 1), (4, 4)), ((6, 3), (14, 6))])
def test_lists_change_no_result(case: Any, rolled, sizes):
    """All objects in every knot (no list at all) gives what the lists give, to the last bit."""
    engine = make_engine("planar", lanes=2, sizes=sizes)
    out = engine.rollout(*case, substeps=PHYSICS.substeps)
    for a, b in zip(out, rolled, strict=True):
        assert np.asarray(a).tobytes() == b.tobytes()


def test_a_wrong_guess_is_done_again(planar, case, rolled, monkeypatch):
    """Lists that begin with what the hand touches alone, and grow: the same result, more work."""

    def computed(engine) -> tuple[Rollout, int, int]:
        engine.occupancy()
        return engine.rollout(*case, PHYSICS.substeps), *engine.occupancy()

    _, used_before, before = computed(planar)
    monkeypatch.setattr(reach, "ROUNDS", 0)
    out, used, after = computed(make_engine("planar", lanes=2))
    assert used <= used_before  # where nothing is known to move, nothing is computed
    assert after > before
    off = np.linalg.norm(np.asarray(out.objects) - rolled.objects, axis=-1)[:, -1]
    assert np.median(off) < 2e-5
    assert np.mean(off) < 1e-3


def test_what_is_not_wanted_costs_nothing(planar, case, rolled):
    wanted = np.arange(B) % 3 == 0
    planar.occupancy()
    out = planar.rollout(*case, PHYSICS.substeps, wanted)
    used, computed = planar.occupancy()
    assert 0 < used <= PHYSICS.knots * wanted.sum()
    assert used <= computed
    for a, b in zip(out, rolled, strict=True):
        np.testing.assert_array_equal(np.asarray(a)[wanted], b[wanted])


def test_operations_are_counted(planar, case, rolled):
    """More for more objects; and a call that does a third of the substeps has a third of them."""
    few, all_of_them = planar._substep_flops
    assert 5_000 < few < all_of_them < 200_000
    planar.flops()
    planar.occupancy()
    planar.rollout(*case, PHYSICS.substeps)
    _, computed = planar.occupancy()
    whole = planar.flops()
    assert few <= whole / (computed * PHYSICS.substeps) <= all_of_them
    assert planar.flops() == 0
    start, controls, gripper = case
    planar.rollout(start, 0 * controls, gripper, PHYSICS.substeps)
    assert planar.flops() < whole  # a hand that stands moves less


def test_what_can_move_is_known_beforehand(case, rolled):
    """Objects that are in no list have not moved: those far from the hand stay to the bit."""
    start = case[0].objects
    still = np.linalg.norm(rolled.objects - start[:, None], axis=-1).max(1) == 0
    assert 0.3 < still.mean() < 0.9


def test_lanes_do_not_see_each_other(planar, case, rolled):
    order = np.random.default_rng(0).permutation(B)
    order[3] = order[4]
    shuffled = jax.tree.map(lambda x: x[order], case)
    again = planar.rollout(*shuffled, PHYSICS.substeps)
    for a, b in zip(again, rolled, strict=True):
        np.testing.assert_array_equal(np.asarray(a), b[order])


def test_nothing_is_traced_twice(planar, case, rolled, monkeypatch):
    """Neither other values nor another number of substeps (a retreat's) trace the program again."""

    def traced(*_):
        raise AssertionError("traced again")

    monkeypatch.setattr(contact, "build", traced)
    start, controls, gripper = case
    slow = planar.rollout(start, controls / 2, gripper, PHYSICS.substeps // 3)
    np.testing.assert_allclose(slow.hand, np.asarray(rolled.hand) / 6, atol=1e-5)


def test_a_diverged_rollout_is_not_finite(planar, case, rolled):
    start, controls, gripper = case
    controls = controls.copy()
    controls[2, 4] = np.nan
    out = planar.rollout(start, controls, gripper, PHYSICS.substeps)
    assert not np.isfinite(np.asarray(out.hand)[2, 4:]).any()
    np.testing.assert_array_equal(np.asarray(out.hand)[2, :4], rolled.hand[2, :4])
    others = np.arange(B) != 2
    np.testing.assert_array_equal(np.asarray(out.objects)[others], rolled.objects[others])


def test_an_object_on_its_way_coasts_as_in_mujoco(planar):
    one = world([(0.3, 0.1)] + [(0.4, 0.07 * k - 0.35) for k in range(1, 8)], None)
    engine = make_engine("planar", n_objects=8)
    one.velocities[0, 0] = (0.0, 0.3)
    start = World._make(np.repeat(x, 8, 0) for x in one)
    controls, gripper = np.zeros((8, 8, 3)), np.zeros((8, 8))
    out = engine.rollout(single(start), controls, gripper, PHYSICS.substeps)
    theirs = converged((start, controls, gripper), n_objects=8)
    np.testing.assert_allclose(out.objects, theirs.objects, atol=1e-5)
    assert np.linalg.norm(theirs.objects[0, -1, 0] - start.objects[0, 0]) > 0.01


def test_another_number_of_objects_and_substeps():
    scene = sample_scene(3, "tight")
    few = World(
        np.repeat(scene.positions[None, :3], 8, 0),
        np.zeros((8, 3, 2)),
        np.zeros((8, 3)),
        np.zeros(8),
    )
    engine = make_engine("planar", n_objects=3)
    controls = np.tile(np.array([0.1, 0.0, 0.0]), (8, 8, 1))
    gripper = np.full((8, 8), 255.0)
    out = engine.rollout(single(few), controls, gripper, 12)
    theirs = make_engine("native", n_objects=3).rollout(few, controls, gripper, 12)
    np.testing.assert_allclose(out.objects, theirs.objects, atol=1e-3)
    np.testing.assert_allclose(out.hand, theirs.hand, atol=1e-5)


def lengths(segments: np.ndarray) -> np.ndarray:
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)


def test_constants_come_from_the_compiled_model():
    soft = dataclasses.replace(PHYSICS, frictionloss=2.5, impedance=0.3, object_friction=0.2)
    c, m = constants.read(soft, 4), model.compile_model(soft, 4)
    assert c.friction_loss == m.dof_frictionloss[-1] == 2.5
    assert c.pair_friction == 0.2
    assert c.mass == pytest.approx(m.body_mass[-1] + m.dof_armature[-1])
    assert c.reference == pytest.approx(2 / (0.3 * soft.solref_timeconst))
    of_hand = m.geom_friction[model.hand_geoms(m)[0], 0]
    walls = [m.geom(name).friction[0] for name in ("back", "left")]
    assert c.hand_friction == max(of_hand, 0.2)
    assert c.wall_friction == tuple(max(of_wall, 0.2) for of_wall in walls)
    np.testing.assert_allclose(c.capsule_lengths, lengths(hand.capsule_segments(0.0)), atol=1e-9)


def test_a_model_of_two_softnesses_is_refused(monkeypatch):
    text = model.mjcf(Physics(), 3).replace('name="back"', 'name="back" solimp="0.9 0.95"', 1)
    compiled = mujoco.MjModel.from_xml_string(text)
    monkeypatch.setattr(model, "compile_model", lambda *_: compiled)
    with pytest.raises(BadInput, match="engine planar: solimp must be one constant"):
        constants.read(Physics(), 3)


@pytest.mark.slow
def test_ten_thousand_rollouts_stay_finite():
    """Sampled scenes, hands that drive anywhere, half of them hard into what is there."""
    lanes = 40
    engine = make_engine("planar", lanes=lanes)
    rng = np.random.default_rng(0)
    b = 8 * lanes
    total = fast = 0
    while total < 10_000:
        scenes = [sample_scene(total + i, ("tight", "medium", "wide")[i % 3]) for i in range(lanes)]
        start, controls, gripper = sampled(b, seed=total)
        positions = np.repeat(np.stack([s.positions for s in scenes]), 8, 0)
        start = start._replace(objects=positions)
        controls = controls + rng.normal(0, 0.1, controls.shape)
        controls[::2] *= 3
        out = engine.rollout(start, controls, gripper, PHYSICS.substeps)
        for value in (out.objects, out.hand, out.velocities, out.force):
            assert np.isfinite(np.asarray(value)).all()
        fast += (np.asarray(out.force).max((1, 2)) > 100).sum()
        total += b
    assert fast > 1000  # jams: more than 100 N
