"""Candidates are checked cheapest first; what a world refutes counts as it went there."""

import functools
from typing import Any

import numpy as np
import pytest

from pgf_jax.batching.planner_service import make_planner_service
from pgf_jax.physics.config import Physics
from pgf_jax.planning.candidates import MOST_CHECKS, Candidates, candidates_of
from pgf_jax.planning.config import Cost, Planner
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Rolled, Search, start_world
from pgf_jax.scene import sample_scene

SCENE = sample_scene(2, "tight")
K = 8


@functools.cache
def planner() -> BatchPlanner:
    return make_planner_service("native", Physics(), Planner(), 1).planner


@functools.cache
def rolled_out() -> tuple[Search, Rolled]:
    """A search after its iteration 0, and eight rollouts of the next, none of them feasible."""
    search = planner().begin_reach(start_world(SCENE.positions), SCENE.goal)
    (search,) = planner().step([search], [np.array([0, 1], np.uint32)])
    ((_, rolled),) = planner().step_valued([search], [np.array([0, 2], np.uint32)])
    assert rolled.value.feasible.shape == (K,) and not rolled.value.feasible.any()
    return search, rolled


def feasible_at(costs: dict[int, float]) -> tuple[Search, Rolled]:
    """The same, where some rollouts are feasible at these costs."""
    search, rolled = rolled_out()
    total, distance = rolled.value.total.copy(), rolled.value.distance.copy()
    feasible = np.zeros(K, bool)
    for i, cost in costs.items():
        total[i], distance[i], feasible[i] = cost, 0.03, True
    value = rolled.value._replace(total=total, distance=distance, feasible=feasible)
    return search, rolled._replace(value=value)


def candidates(costs: dict[int, float]) -> Candidates:
    found = candidates_of(*feasible_at(costs), planner())
    assert found is not None
    return found


def missed(found: Candidates, i: int = 7) -> Candidates:
    """What is next has missed: in the world it went as rollout i did, which is not feasible."""
    _, rolled = rolled_out()
    return found.checked(planner(), False, type(rolled.rollout)(*(x[i] for x in rolled.rollout)))


def same(a: Any, b: Any) -> bool:
    return all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


def test_without_a_feasible_rollout_there_is_nothing_to_check():
    assert candidates_of(*rolled_out(), planner()) is None


def test_a_push_has_no_candidates():
    search, rolled = feasible_at({2: 3.0})
    pushing = search._replace(task=search.task._replace(pushing=np.array(True)))
    assert candidates_of(pushing, rolled, planner()) is None


def test_the_cheapest_is_next_also_after_misses():
    found = candidates({5: 2.0, 1: 7.0, 3: 4.0})
    order = []
    while found.next is not None:
        order.append(found.next)
        found = missed(found)
    assert order == [5, 3, 1]


def test_at_most_three_are_checked():
    found = candidates({i: 1.0 + i for i in range(6)})
    for _ in range(MOST_CHECKS):
        found = missed(found)
    assert found.checks == MOST_CHECKS == 3 and found.next is None and found.open.sum() == 3


def test_what_passes_is_the_best_and_solves_the_search():
    found = missed(candidates({5: 2.0, 3: 4.0}))
    assert found.next == 3
    _, rolled = rolled_out()
    passed = found.checked(planner(), True, type(rolled.rollout)(*(x[0] for x in rolled.rollout)))
    assert passed.next is None
    search = passed.search(planner())
    assert planner().terminate(search)
    # Its rollout stays the engine's, and so does its cost.
    assert np.array_equal(search.controls, rolled.controls[3]) and search.value.total == 4.0
    assert same(search.best, [x[3] for x in rolled.rollout])


def test_what_is_refuted_costs_what_it_did_in_the_world():
    search = missed(candidates({5: 2.0}), i=7).search(planner())
    before, rolled = rolled_out()
    # As if the rollout number 5 had always been what it was in the world.
    total = rolled.value.total.copy()
    total[5] = np.float32(planner().evaluate(before, _row(rolled, 7)).total)
    winner = int(np.argmin(total))
    better = total[winner] < before.value.total
    expected = total[winner] if better else before.value.total
    assert search.value.total == expected and not planner().terminate(search)
    assert search.iteration == before.iteration + 1
    if winner == 5 and better:
        assert same(search.best, _row(rolled, 7))


def _row(rolled: Rolled, i: int):
    return type(rolled.rollout)(*(x[i] for x in rolled.rollout))


def test_the_winner_may_be_the_refuted_one_with_its_controls():
    """It stays the best so far where it is the cheapest, with what it does in the world."""
    _, rolled = rolled_out()
    cheapest = int(np.argmin(rolled.value.total))
    other = (cheapest + 1) % K
    search, value = rolled_out()[0], rolled.value
    assert value.total[cheapest] < search.value.total
    found = missed(candidates({other: 1.0}), i=cheapest)
    after = found.search(planner())
    # Rollout `other` now ties with `cheapest`; the first of equals wins.
    first = min(other, cheapest)
    assert np.array_equal(after.controls, rolled.controls[first])
    assert after.value.total == pytest.approx(float(value.total[cheapest]), abs=1e-3)


def test_what_was_left_over_is_tried_in_the_next_iteration():
    found = candidates({i: 1.0 + i for i in range(5)})
    for _ in range(MOST_CHECKS):
        found = missed(found)
    search = found.search(planner())
    # Rollout 3 is feasible to the engine, and nobody has checked it.
    assert search.value.total == 4.0 and not planner().terminate(search)
    again = candidates_of(search, rolled_out()[1], planner())
    assert again is not None and again.next == K  # after the K of the iteration
    _, rolled = rolled_out()
    solved = again.checked(planner(), True, _row(rolled, 0)).search(planner())
    assert planner().terminate(solved)
    assert np.array_equal(solved.controls, search.controls) and solved.value.total == 4.0
    refuted = missed(again).search(planner())
    assert not planner().terminate(refuted) and refuted.value.total > 20
    assert candidates_of(refuted, rolled, planner()) is None


def test_a_miss_counts_as_one_whatever_the_cost_allows():
    """With a wider goal radius the cost may still call it feasible: it is refuted all the same."""
    wide = BatchPlanner(planner().engine, Planner(cost=Cost(goal_radius=10.0, feasible_cost=1e9)))
    search, rolled = feasible_at({2: 3.0})
    found = candidates_of(search, rolled, wide)
    assert found is not None and found.next == 2
    after = found.checked(wide, False, _row(rolled, 7))
    assert np.isposinf(after.rolled.value.total[2]) and not after.rolled.value.feasible[2]


def test_values_of_an_iteration_are_those_that_decide():
    search, _ = rolled_out()
    key = np.array([0, 9], np.uint32)
    ((after, rolled),) = planner().step_valued([search], [key])
    (plain,) = planner().step([search], [key])
    assert after.value.total == min(float(rolled.value.total.min()), float(search.value.total))
    assert same(after.best, plain.best) and np.array_equal(after.controls, plain.controls)
    assert same(planner().take(search, rolled).value, after.value)
    nominal = planner().begin_reach(start_world(SCENE.positions), SCENE.goal)
    ((_, first),) = planner().step_valued([nominal], [key])
    assert first.value.total.shape == (1,)  # of the nominal only one rollout is wanted
