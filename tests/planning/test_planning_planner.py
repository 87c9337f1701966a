"""The planner's logic, on engines that are functions of the controls or of a script."""

import math

import jax
import numpy as np
import planning_oracle as oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, contact_slots
from pgf_jax.planning import planner as planner_module
from pgf_jax.planning.config import Cost, Planner
from pgf_jax.planning.cost import Task
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import start_world
from pgf_jax.planning.types import Push

N = 4
POSITIONS = np.array([(0.42, 0.03), (0.36, -0.02), (0.5, 0.05), (0.45, -0.15)])
GOAL = 2


class Bulldozer:
    """Not physics: the hand moves as told, an object near its end is shoved off to a circle.

    Forces and failures are hashes of the controls, so that they vary, and vary with every knot.
    """

    name = "bulldozer"

    def __init__(self, lanes=1, failures=True):
        self.physics, self.n_objects, self.lanes = Physics(), N, lanes
        self.failures = failures
        self.calls = []

    def rollout(self, start, controls, gripper, substeps, wanted=None):
        self.calls.append((start, controls, gripper, substeps))
        start = World._make(np.asarray(x, float) for x in start)
        controls = np.asarray(controls, float)
        runs = [
            self.one(start.objects[b], start.velocities[b], start.hand[b], controls[b])
            for b in range(len(controls))
        ]
        return Rollout._make(np.stack(arrays) for arrays in zip(*runs, strict=True))

    def one(self, objects, velocities, pose, controls):
        objects, pose = objects.copy(), pose.copy()
        path, poses = [], []
        force = np.zeros((len(controls), contact_slots(20)))
        bodies = np.zeros((len(controls), contact_slots(20), 2), np.int32)
        for k, velocity in enumerate(controls):
            pose = pose + velocity * self.physics.knot_s
            ee = oracle.ee_of(pose)
            for i in range(N):
                off = objects[i] - ee
                if np.hypot(*off) < 0.055:
                    objects[i] = ee + off / np.hypot(*off) * 0.055
                    force[k, i] = 150 * abs(math.sin(100 * controls[k].sum()))
                    bodies[k, i] = i, N
            path.append(objects.copy())
            poses.append(pose)
        if self.failures and math.sin(1e3 * controls.sum()) > 0.9:
            poses[-1] = poses[-1] * np.nan
        return np.array(path), np.array(poses), velocities * 0, force, bodies


def key(seed, number):
    return np.array(jax.random.key_data(jax.random.fold_in(jax.random.key(seed), number)))


def reach(planner, positions=POSITIONS):
    return planner.begin_reach(start_world(positions), GOAL)


class OraclePlanner:
    """Alg. 1 as in the definitions, one robot, in float64."""

    def __init__(self, engine, search, config):
        self.engine, self.config, self.search = engine, config, search
        self.best, self.total = np.asarray(search.controls, float), math.inf
        self.terms = np.full(5, math.inf)
        self.stuck, self.history, self.feasible, self.lost = oracle.Stuck(), [], False, 0

    def evaluate(self, controls):
        objects, velocities, pose, _ = (np.asarray(x, float) for x in self.search.start)
        run = self.engine.one(objects, velocities, pose, controls)
        task = Task(*(np.asarray(x) for x in self.search.task))
        return oracle.cost(Rollout(*run), self.search.gripper, task, self.config.cost)

    def step(self, key):
        noise = np.asarray(jax.random.normal(key, (self.config.rollouts, 8, 3)), float)
        noisy = [self.best + np.array(self.config.sigma) * n for n in noise]
        if self.stuck.iteration < 0:
            noisy = [self.best]
        values = [self.evaluate(u) for u in noisy]
        if self.config.update == "stomp":
            totals = [v[1] for v in values]
            self.lost += totals.count(math.inf)
            noisy = [oracle.stomp_update(self.best, noisy, totals)]
            values = [self.evaluate(noisy[0])]
        self.lost += sum(v[1] == math.inf for v in values)
        winner = min(range(len(values)), key=lambda i: values[i][1])
        terms, total, feasible = values[winner]
        self.stuck.feed(total)
        if total < self.total:
            self.best, self.total, self.feasible = noisy[winner], total, feasible
            self.terms = terms
        if self.stuck.iteration > 0:
            self.history = [*self.history, self.terms[:3]][-3:]


@pytest.mark.parametrize("update", ["greedy", "stomp"])
@pytest.mark.parametrize("kind", ["reach", "push"])
def test_plans_as_the_oracle_does(update, kind):
    config = Planner(update=update)
    engine = Bulldozer()
    planner = BatchPlanner(engine, config)
    if kind == "reach":
        search = reach(planner)
    else:
        search = planner.begin_push(start_world(POSITIONS), GOAL, Push(1, 0.33, -0.12))
    expected = OraclePlanner(engine, search, config)
    counts, improved = set(), 0
    for i in range(16):
        before = expected.total
        (search,) = planner.step([search], [key(7, i)])
        expected.step(key(7, i))
        assert search.iteration == i
        np.testing.assert_allclose(search.value.total, expected.total, rtol=1e-4)
        np.testing.assert_allclose(search.controls, expected.best, atol=1e-5)
        expected.best = np.asarray(search.controls, float)  # else rounding would add up
        assert search.stuck_count == expected.stuck.n
        np.testing.assert_allclose(search.last_cost, expected.stuck.last, rtol=1e-4)
        assert planner.terminate(search) == expected.feasible
        assert planner.is_stuck(search) == (expected.stuck.n >= 2)
        missing = 3 - len(expected.history)
        assert np.isnan(search.history[:missing]).all()
        if expected.history:
            np.testing.assert_allclose(
                search.history[missing:], expected.history, rtol=1e-4, atol=1e-4
            )
        counts.add(int(search.stuck_count))
        improved += expected.total < before
    assert search.non_finite == expected.lost
    assert len(counts) > 1 and improved > 2  # else the case would show nothing


PAIR = np.array([(0.5, 0.0), (0.5, 0.3)])  # the goal and another object, far from the hand


class Scripted:
    """Every rollout costs what the script says: as force, with weight 1 and no threshold.

    The goal stays 0.3 m ahead and the reach costs nothing, so that sums are exact.
    """

    name = "scripted"
    COST = Cost(w_d=0.0, w_f=1.0, force_threshold=0.0, w_edge=0.0, w_static=0.0)

    def __init__(self):
        self.physics, self.n_objects, self.lanes = Physics(), 2, 1
        self.script = []

    def rollout(self, start, controls, gripper, substeps, wanted=None):
        costs = np.broadcast_to(self.script.pop(0), len(controls))
        still = oracle.still(PAIR, (0.0, 0.0, 0.0))
        out = jax.tree.map(lambda x: np.repeat(x[None], len(costs), 0), still)
        out.force[:, -1, 0] = np.where(np.isfinite(costs), costs, 0)
        out.bodies[:, -1, 0] = 0, 2
        out.hand[~np.isfinite(costs)] = np.nan
        return out


class Script:
    """A planner whose iterations' costs can be dictated."""

    def __init__(self):
        self.engine = Scripted()
        self.planner = BatchPlanner(self.engine, Planner(rollouts=3, cost=Scripted.COST))
        self.begin()

    def begin(self):
        self.search = self.planner.begin_reach(start_world(PAIR), 0)

    def step(self, costs):
        self.engine.script = [np.array(costs, float)]
        (self.search,) = self.planner.step([self.search], [key(0, 0)])
        return int(self.search.stuck_count)


@pytest.fixture(scope="module")
def script():
    return Script()


INF = math.inf


@pytest.mark.parametrize(
    ("winners", "counts"),
    [
        ([900, 800, 700, 600], [0, 0, 0, 0]),  # better each time, by 50 or more
        ([900, 800, 751, 702], [0, 0, 1, 1]),  # better, but by less than 50: reset, then counted
        ([900, 950, 1000, 1050], [0, 0, 0, 0]),  # worse by 50 exactly is no standstill
        ([900, 950, 999, 1048, 1097], [0, 0, 1, 2, 3]),
        ([100, 49, 900], [0, 1, 0]),  # c_0 counts as 0: 49 - 0 < 50
        ([100, 50, 900], [0, 0, 0]),
        ([30, 80, 200], [0, 0, 0]),  # and not as 30: 80 - 30 would not be less than 50 either
        ([900, 860, 900], [0, 0, 1]),  # but 860 - 900 would
        ([100, 1100, 1200], [0, 0, 1]),  # more than 1000 above the best, not 1000 exactly
        ([100, 1150, 1250, 1350], [0, 1, 2, 3]),
        ([100, 1150, 1250, 90], [0, 1, 2, 0]),  # an improvement
        ([100, 1150, 1250, 1000], [0, 1, 2, 0]),  # no improvement, but neither still nor far
        ([INF, INF, INF], [0, 1, 2]),
        ([INF, 500, INF, 600], [0, 0, 1, 0]),
    ],
)
def test_stuck_counter_by_hand(script, winners, counts):
    script.begin()
    assert [script.step(c) for c in winners] == counts
    assert script.planner.is_stuck(script.search) == (counts[-1] >= 2)


costs = st.one_of(st.integers(0, 3000), st.sampled_from([INF, 0, 50, 1000, 1050, 2000]))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(costs, costs, costs), min_size=1, max_size=10))
def test_counter_best_and_history_for_any_costs(script, rows):
    script.begin()
    expected, best = oracle.Stuck(), []
    for i, row in enumerate(rows):
        winner = row[0] if i == 0 else min(row)
        count = script.step([row[0]] * 3 if i == 0 else row)
        expected.feed(winner)
        best.append(expected.best)
        assert count == expected.n
        assert script.search.value.total == expected.best
        assert script.search.last_cost == (0 if i == 0 else winner)
    assert best == sorted(best, reverse=True)
    if math.isfinite(best[0]):
        remembered = ([math.nan] * 3 + best[1:])[-3:]
        np.testing.assert_array_equal(script.search.history[:, 1], remembered)
    lost = sum(row.count(INF) for row in rows[1:]) + (rows[0][0] == INF)
    assert script.search.non_finite == lost


def test_the_cheapest_rollout_wins_and_only_if_cheaper(script):
    script.begin()
    nominal = script.search.controls
    script.step(500)
    np.testing.assert_array_equal(script.search.controls, nominal)
    noise = np.array(jax.random.normal(key(0, 0), (3, 8, 3))) * 0.04
    script.step([400, 300, 350])
    np.testing.assert_allclose(script.search.controls, nominal + noise[1], atol=1e-7)
    kept = script.search
    script.step([300, 301, INF])  # equal is not cheaper
    np.testing.assert_array_equal(script.search.controls, kept.controls)
    script.step([INF, INF, 299])
    np.testing.assert_allclose(script.search.controls, kept.controls + noise[2], atol=1e-7)


def test_noise_has_the_standard_deviation_of_each_velocity():
    engine = Bulldozer(failures=False)
    sigma = (0.01, 0.04, 0.2)
    planner = BatchPlanner(engine, Planner(rollouts=512, sigma=sigma))
    (search,) = planner.step([reach(planner)], [key(0, 0)])
    np.testing.assert_array_equal(engine.calls[0][1], np.repeat(search.controls[None], 512, 0))
    planner.step([search], [key(0, 1)])
    noise = engine.calls[1][1] - search.controls
    # 4096 draws each: the estimate's own standard deviation is 1.1 %.
    np.testing.assert_allclose(noise.std((0, 1)), sigma, rtol=0.06)
    np.testing.assert_allclose(noise.mean((0, 1)), 0, atol=0.2 * 0.06)


def test_stomp_weights_by_hand():
    engine = Scripted()
    config = Planner(rollouts=3, update="stomp", cost=Scripted.COST)
    planner = BatchPlanner(engine, config)
    search = planner.begin_reach(start_world(PAIR), 0)
    engine.script = [np.array([500.0]), np.array([500.0])]
    (search,) = planner.step([search], [key(0, 0)])
    noise = np.array(jax.random.normal(key(0, 0), (3, 8, 3)), float) * 0.04
    # 100, 120, 200: exponents 0, -2, -10.
    weights = np.array([1, math.exp(-2), math.exp(-10)])
    blend = np.tensordot(weights / weights.sum(), noise, 1)
    engine.script = [np.array([100.0, 120.0, 200.0]), np.array([90.0])]
    (after,) = planner.step([search], [key(0, 0)])
    np.testing.assert_allclose(after.controls, search.controls + blend, atol=1e-7)
    assert after.value.total == 90 and after.last_cost == 90
    # Failures have no weight, equal costs equal weights.
    engine.script = [np.array([100.0, INF, 100.0]), np.array([80.0])]
    (after,) = planner.step([search], [key(0, 0)])
    np.testing.assert_allclose(
        after.controls, search.controls + (noise[0] + noise[2]) / 2, atol=1e-7
    )
    # Without any finite cost nothing changes, and a dearer blend does not replace the best.
    engine.script = [np.array([INF, INF, INF]), np.array([80.0])]
    (after,) = planner.step([search], [key(0, 0)])
    np.testing.assert_array_equal(after.controls, search.controls)
    engine.script = [np.array([100.0, 120.0, 200.0]), np.array([500.0])]
    (after,) = planner.step([search], [key(0, 0)])
    np.testing.assert_array_equal(after.controls, search.controls)


@pytest.mark.parametrize("update", ["greedy", "stomp"])
def test_all_that_an_iteration_rolls_out(update):
    engine = Bulldozer(lanes=2)
    planner = BatchPlanner(engine, Planner(update=update))
    search, lost = reach(planner), 0
    for i in range(4):
        after, rolled = planner.rolled(search, key(3, i))
        (same,) = planner.step([search], [key(3, i)])
        for ours, theirs in zip(jax.tree.leaves(after), jax.tree.leaves(same), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        count = 8 if i else 1
        assert len(rolled.controls) == count + (update == "stomp")
        noise = np.asarray(jax.random.normal(key(3, i), (8, 8, 3)), float) * (i > 0)
        noisy = search.controls + np.array(Planner().sigma) * noise
        np.testing.assert_allclose(rolled.controls[:count], noisy[:count], atol=1e-6)
        for number, controls in enumerate(rolled.controls):
            objects, velocities, pose, _ = map(np.asarray, search.start)
            run = engine.one(objects, velocities, pose, controls.astype(float))
            for ours, theirs in zip(rolled.rollout, run, strict=True):
                np.testing.assert_allclose(ours[number], theirs, atol=1e-6)
            _, total, _ = oracle.cost(Rollout(*run), search.gripper, search.task, Cost())
            assert rolled.value.total[number] == pytest.approx(total, rel=1e-4)
            assert rolled.value.finite[number] == (total < INF)
        lost += int((~rolled.value.finite).sum())
        assert after.non_finite == lost
        search = after
    assert lost > 0


def test_a_new_segment_starts_afresh(script):
    script.begin()
    for c in (100, 1150, 1250, 1350):
        script.step(c)
    assert script.planner.is_stuck(script.search)
    script.begin()
    search = script.search
    assert search.iteration == -1 and search.stuck_count == 0 and search.non_finite == 0
    assert search.value.total == INF and not script.planner.terminate(search)
    assert np.isnan(search.history).all() and search.last_cost == 0
    # 1340 is like the last cost of the segment before, which must not matter; nor its best.
    assert [script.step(c) for c in (1345, 1340)] == [0, 0]


def test_go_on_keeps_the_trajectory_and_clears_the_counter(script):
    script.begin()
    for c in (100, 1150, 1250):
        script.step(c)
    before = script.search
    script.search = after = script.planner.go_on(before)
    assert before.stuck_count == 2 and after.stuck_count == 0
    assert not script.planner.is_stuck(after)
    same = jax.tree.map(
        np.array_equal, before._replace(stuck_count=0), after._replace(stuck_count=0)
    )
    assert all(jax.tree.leaves(same._replace(history=True)))
    np.testing.assert_array_equal(after.history, before.history)
    assert script.step(1260) == 1  # counts from 0 again


@pytest.mark.parametrize("number", [-1, N, 99])
def test_push_of_an_object_that_is_not_there(number):
    planner = BatchPlanner(Bulldozer())
    with pytest.raises(BadInput, match=rf"push: object must be within 0\.\.{N - 1}, got {number}"):
        planner.begin_push(start_world(POSITIONS), GOAL, Push(number, 0.4, 0.0))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rollouts": 0}, "rollouts: expected a whole number 1 or more, got 0"),
        ({"update": "sgd"}, "update: expected one of greedy, stomp, got 'sgd'"),
        ({"cost": Cost(variant="thesis")}, "cost: expected one of source, paper, got 'thesis'"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_settings_that_cannot_be(settings, message):
    with pytest.raises(BadInput, match=message):
        Planner(**settings)


@pytest.mark.parametrize("count", [0, 3])
def test_more_or_less_work_than_lanes_is_refused(count):
    planner = BatchPlanner(Bulldozer(lanes=2))
    with pytest.raises(ValueError, match=f"{count} lanes of work for an engine of 2"):
        planner.step([reach(planner)] * count, [key(0, 0)] * count)


def test_segments_start_where_the_world_is():
    engine = Bulldozer(failures=False)
    planner = BatchPlanner(engine)
    world = start_world(POSITIONS)._replace(
        hand=np.array([0.05, 0.02, 0.1]), velocities=np.full((N, 2), 0.01), gripper=255.0
    )
    for search in (
        planner.begin_reach(world, GOAL),
        planner.begin_push(world, GOAL, Push(1, 0.3, 0.0)),
    ):
        for i in range(3):
            (search,) = planner.step([search], [key(0, i)])
            start, controls, gripper, substeps = engine.calls.pop()
            for got, want in zip(start, world, strict=True):
                np.testing.assert_allclose(got, np.broadcast_to(want, np.shape(got)), rtol=1e-6)
            assert controls.shape == (8, 8, 3) and substeps == engine.physics.substeps
            np.testing.assert_array_equal(gripper, np.repeat(search.gripper[None], 8, 0))


def test_retreat_moves_straight_back_in_a_second():
    engine = Bulldozer(lanes=2, failures=False)
    planner = BatchPlanner(engine)
    world = start_world(POSITIONS)._replace(hand=np.array([0.02, 0.03, 0.4]))
    search = planner.begin_push(world, GOAL, Push(1, 0.33, -0.12))
    (search,) = planner.step([search], [key(0, 0)])
    engine.calls.clear()
    (after,) = planner.retreat([search])
    (start, controls, gripper, substeps) = engine.calls[0]
    knots, dt = engine.physics.knots, engine.physics.substep_s
    assert substeps * knots * dt == pytest.approx(1.0, rel=0.02)
    end = search.best.hand[-1]
    np.testing.assert_array_equal(start.hand, np.repeat(end[None], 16, 0))
    np.testing.assert_array_equal(start.objects[0], search.best.objects[-1])
    np.testing.assert_array_equal(start.velocities[0], search.best.velocities)
    assert set(gripper.ravel()) == {hand.GRIPPER_CLOSED} and after.gripper == hand.GRIPPER_CLOSED
    angle = oracle.pointing(end)
    way = (controls[0] * substeps * dt).sum(0)
    np.testing.assert_allclose(
        way, [-0.07 * math.cos(angle), -0.07 * math.sin(angle), 0.0], atol=1e-7
    )
    np.testing.assert_array_equal(controls, np.repeat(controls[:1, :1], 16, 0).repeat(8, 1))


@pytest.mark.parametrize("update", ["greedy", "stomp"])
def test_nothing_is_traced_twice(update, monkeypatch):
    traced = []
    evaluate = planner_module.evaluate

    def counting(*args):
        traced.append("evaluate")
        return evaluate(*args)

    reach_nominal = planner_module.nominal.reach

    def counting_nominal(*args):
        traced.append("nominal")
        return reach_nominal(*args)

    monkeypatch.setattr(planner_module, "evaluate", counting)
    monkeypatch.setattr(planner_module.nominal, "reach", counting_nominal)
    planner = BatchPlanner(Bulldozer(lanes=3), Planner(update=update))
    first, second = reach(planner), reach(planner, POSITIONS[::-1])
    (a, b) = planner.step([first, second], [key(0, 0), key(1, 0)])
    once = list(traced)
    assert once.count("nominal") == 1 and "evaluate" in once
    for i in range(1, 4):
        (a,) = planner.step([planner.go_on(a)], [key(0, i)])
        planner.step([a, b, reach(planner)], [key(0, i)] * 3)
        (world,) = planner.retreat([b])
        planner.step([planner.begin_reach(world, 1)], [key(2, i)])
    assert traced == once


def test_lanes_do_not_see_each_other():
    """Bit for bit, whatever the others hold and in any order."""
    planner = BatchPlanner(Bulldozer(lanes=4))
    rng = np.random.default_rng(0)
    searches = [reach(planner, POSITIONS + rng.normal(0, 0.01, (N, 2))) for _ in range(4)]
    keys = [key(i, i) for i in range(4)]
    for _ in range(2):
        together = planner.step(searches, keys)
        backwards = planner.step(searches[::-1], keys[::-1])[::-1]
        alone = [planner.step([s], [k])[0] for s, k in zip(searches, keys, strict=True)]
        for other in (backwards, alone):
            for x, y in zip(jax.tree.leaves(together), jax.tree.leaves(other), strict=True):
                np.testing.assert_array_equal(x, y)
        searches = together
    assert len({float(s.value.total) for s in searches}) == 4
