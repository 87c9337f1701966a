"""The random winner, an ablation, on the engines that the planner's own tests use."""

import math
from typing import Any

import jax
import numpy as np
import planning_oracle as oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_planning_planner import INF, PAIR, POSITIONS, Bulldozer, Scripted, key, reach

from pgf_jax.errors import BadInput
from pgf_jax.planning.config import Planner
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search, start_world

K = 8
COSTS = (500, 300, 700, 100, 800, 400, 600, 200)  # of rollouts 0..7: the cheapest is number 3


class Script:
    """A planner whose iterations' costs can be dictated."""

    def __init__(self, q: float, rollouts: int = K) -> None:
        self.engine = Scripted()
        config = Planner(rollouts=rollouts, random_winner=q, cost=Scripted.COST)
        self.planner = BatchPlanner(self.engine, config)

    def begin(self, c_0: float, rest: float = INF) -> Search:
        """After iteration 0; what the K - 1 other rollouts cost must not matter then."""
        search = self.planner.begin_reach(start_world(PAIR), 0)
        return self.step(search, [c_0, *[rest] * (self.planner.config.rollouts - 1)], key(0, 0))

    def step(self, search: Search, costs, key) -> Search:
        self.engine.script = [np.array(costs, float)]
        (after,) = self.planner.step([search], [key])
        return after


def assert_same(one: Search, other: Search) -> None:
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(x, y)


def chosen(script: Script, count: int) -> np.ndarray:
    """Number of the winner under each of `count` keys, as its cost tells it."""
    search = script.begin(1000)
    costs = [int(script.step(search, COSTS, key(3, i)).last_cost) for i in range(count)]
    return np.array([COSTS.index(c) for c in costs])


def test_never_is_the_default_and_draws_nothing(monkeypatch):
    assert Planner() == Planner(random_winner=0.0)

    def perhaps_any(*_):
        raise AssertionError("drew")

    monkeypatch.setattr(BatchPlanner, "_perhaps_any", perhaps_any)
    default = BatchPlanner(Bulldozer())
    never = BatchPlanner(Bulldozer(), Planner(random_winner=0.0))
    one, other = reach(default), reach(never)
    for i in range(6):
        (one,), (other,) = default.step([one], [key(7, i)]), never.step([other], [key(7, i)])
        assert_same(one, other)
    assert set(chosen(Script(0.0), 20)) == {3}


def test_always_is_any_of_them_alike():
    winners = chosen(Script(1.0), 480)
    counts = np.bincount(winners, minlength=K)
    # Chi-squared, 7 degrees of freedom: 24.3 is exceeded once in a thousand.
    assert ((counts - 60) ** 2 / 60).sum() < 24.3


def test_sometimes_is_the_cheapest_else():
    winners = chosen(Script(0.4), 480)
    counts = np.bincount(winners, minlength=K)
    cheapest = 0.6 + 0.4 / K
    assert abs(counts[3] / 480 - cheapest) < 4 * math.sqrt(cheapest * (1 - cheapest) / 480)
    others = np.delete(counts, 3)  # 24 of each expected
    assert ((others - 24) ** 2 / 24).sum() < 24.3


def test_the_winner_is_of_its_own_cost_and_controls():
    script = Script(1.0)
    search = script.begin(450)
    replaced = 0
    for i in range(40):
        after = script.step(search, COSTS, key(5, i))
        winner = COSTS.index(int(after.last_cost))
        if COSTS[winner] < 450:
            noise = np.array(jax.random.normal(key(5, i), (K, 8, 3))) * 0.04
            np.testing.assert_allclose(after.controls, search.controls + noise[winner], atol=1e-7)
            assert after.value.total == COSTS[winner]
            replaced += 1
        else:
            np.testing.assert_array_equal(after.controls, search.controls)
            assert after.value.total == 450
    assert 5 < replaced < 35


@pytest.fixture(scope="module")
def always():
    return Script(1.0, rollouts=3)


costs = st.one_of(st.integers(0, 3000), st.sampled_from([INF, 0, 50, 1000, 1050, 2000]))


@settings(max_examples=60, deadline=None)
@given(
    c_0=costs,
    rest=costs,
    rows=st.lists(st.tuples(costs, costs, costs), min_size=1, max_size=8),
    seed=st.integers(0, 1000),
)
def test_counter_and_best_for_any_costs(always, c_0, rest, rows, seed):
    """As ever, of whichever won; one that failed replaces nothing and counts as infinite."""
    search = always.begin(c_0, rest)
    assert search.value.total == c_0 and search.stuck_count == 0 and search.last_cost == 0
    expected, best = oracle.Stuck(), [float(search.value.total)]
    expected.feed(c_0)
    for i, row in enumerate(rows):
        before, search = search, always.step(search, row, key(seed, i))
        c_i = float(search.last_cost)
        assert c_i in row
        expected.feed(c_i)
        assert search.stuck_count == expected.n
        assert search.value.total == expected.best
        if c_i == INF:
            np.testing.assert_array_equal(search.controls, before.controls)
        assert np.isfinite(search.controls).all()
        best.append(float(search.value.total))
    assert best == sorted(best, reverse=True)
    assert search.non_finite == sum(row.count(INF) for row in rows) + (c_0 == INF)


def test_iteration_0_and_the_noise_are_those_of_q_0():
    engines = Bulldozer(failures=False), Bulldozer(failures=False)
    planners = [
        BatchPlanner(engine, Planner(random_winner=q))
        for engine, q in zip(engines, (0.0, 1.0), strict=True)
    ]
    searches = [planner.step([reach(planner)], [key(2, 0)])[0] for planner in planners]
    assert_same(*searches)
    differ = 0
    for i in range(1, 6):
        after = [
            planner.step([search], [key(2, i)])[0]
            for planner, search in zip(planners, searches, strict=True)
        ]
        np.testing.assert_array_equal(engines[0].calls[-1][1], engines[1].calls[-1][1])
        differ += after[0].last_cost != after[1].last_cost
        searches = [after[0]] * 2  # the noise is added to the best, so that must be the same
    assert differ > 1


def test_lanes_do_not_see_each_other():
    """Bit for bit, whatever the others hold and in any order; and each draws for itself."""
    planner = BatchPlanner(Bulldozer(lanes=4), Planner(random_winner=0.7))
    rng = np.random.default_rng(0)
    searches = [reach(planner, POSITIONS + rng.normal(0, 0.01, POSITIONS.shape)) for _ in range(4)]
    for i in range(4):
        keys = [key(lane, i) for lane in range(4)]
        together = planner.step(searches, keys)
        backwards = planner.step(searches[::-1], keys[::-1])[::-1]
        alone = [planner.step([s], [k])[0] for s, k in zip(searches, keys, strict=True)]
        for one, two, three in zip(together, backwards, alone, strict=True):
            assert_same(one, two)
            assert_same(one, three)
        searches = together
    twins = planner.step([searches[0]] * 4, [key(9, i) for i in range(4)])
    assert len({float(search.last_cost) for search in twins}) > 1
    absorb: Any = planner._absorb
    assert absorb._cache_size() == 1  # traced once


@pytest.mark.parametrize("q", [-0.1, 1.1, math.nan, math.inf, "0.5", True, None])
def test_what_is_no_probability(q):
    with pytest.raises(BadInput, match=r"^random_winner: expected a number within 0\.\.1, got "):
        Planner(random_winner=q)


def test_stomp_has_no_winner():
    with pytest.raises(BadInput, match=r"^random_winner: expected 0 with update stomp .*got 0\.5"):
        Planner(update="stomp", random_winner=0.5)
    assert Planner(update="stomp", random_winner=0.0) == Planner(update="stomp")
