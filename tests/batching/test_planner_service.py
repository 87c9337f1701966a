"""The planner service: results do not depend on who shares a call, and what it counts."""

from typing import Any

import numpy as np
import pytest
from coroutines import HOPELESS, native, run, run_all, turn, unsolved

from pgf_jax.batching.requests import PredictGain, Retreat, Step, robot_key_path
from pgf_jax.guidance.predictors.features import STATE, state_features
from pgf_jax.guidance.trials import simulate_input


class Counting:
    """A predictor that says what is in a column, and how often it was asked for how many."""

    def __init__(self, column: str) -> None:
        self.column, self.asked = STATE.index(column), []

    def gain(self, states: np.ndarray) -> np.ndarray:
        self.asked.append(len(states))
        return states[:, self.column].astype(np.float32)


# -- company -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def alone():
    return [run(coroutine, native(1)) for coroutine in mixed(native(1).planner)]


def mixed(planner) -> list:
    """Coroutines of several kinds."""

    def described(seed: int, number: int):
        (search,) = yield [Step(unsolved(seed), (seed, 0, 0, 5, number))]
        a, b = yield [
            PredictGain(DISTANCE, state_features(search)),
            PredictGain(ITERATION, state_features(search)),
        ]
        return a, b, float(search.value.total)

    def retreating(seed: int):
        search = unsolved(seed)
        world, after, gain = yield [
            Retreat(search),
            Step(search, (seed, 0, 0, 5, 77)),
            PredictGain(DISTANCE, state_features(search)),
        ]
        return world.objects.tobytes(), float(after.value.total), gain

    trials = [
        simulate_input(
            planner, unsolved(seed), push, robot_key_path(*turn(seed)), push_limit=1, reach_limit=1
        )
        for seed in (0, 2)
        for push in (None, HOPELESS[seed])
    ]
    return [*trials, *(described(s, n) for s in (0, 2) for n in (1, 2)), retreating(0)]


DISTANCE, ITERATION = Counting("distance"), Counting("iteration")


@pytest.mark.parametrize("lanes", [1, 2, 5])
def test_results_do_not_depend_on_who_shares_a_call(alone, lanes):
    """Bit for bit, whatever else is in the scheduler."""
    planner = native(lanes).planner
    assert run_all(mixed(planner), native(lanes)) == alone
    assert run_all(mixed(planner)[::-1], native(lanes))[::-1] == alone
    assert alone[4] != alone[5] and alone[4] != alone[6]


def test_gains_of_a_call_are_asked_for_together():
    predictors = Counting("distance"), Counting("iteration")

    def gain_after(seed: int, which: int, number: int) -> Any:
        (search,) = yield [Step(unsolved(seed), (seed, 0, 0, 5, number))]
        (gain,) = yield [PredictGain(predictors[which], state_features(search))]
        return gain, search

    planner_service = native(4)
    cases = [(0, 0, 1), (2, 1, 1), (2, 0, 2), (0, 0, 3)]
    results = run_all([gain_after(*each) for each in cases], planner_service)
    assert planner_service.calls == 1
    assert [predictor.asked for predictor in predictors] == [[3], [1]]
    for (_, which, _), (gain, search) in zip(cases, results, strict=True):
        expected = state_features(search)[STATE.index(("distance", "iteration")[which])]
        assert type(gain) is float and gain == np.float32(expected)


def test_a_planner_service_counts_what_it_does():
    planner_service = native(3)
    run_all([stepping_reach(number, 2) for number in range(4)], planner_service)
    # 4 robots in lanes of 3: 3 + 1, whoever is first, and again.
    assert planner_service.calls == 3 and planner_service.lanes_used == 8
    assert planner_service.occupancy() == (8, 9) and planner_service.occupancy() == (0, 0)
    # Its copies share what is compiled, not what is counted.
    other = native(3)
    assert other.planner is planner_service.planner and other.calls == 0


def stepping_reach(number: int, times: int) -> Any:
    search = unsolved(0)
    for i in range(times):
        (search,) = yield [Step(search, (0, number, 0, 5 + i, 0))]
    return search


def test_requests_beyond_the_lanes_are_computed_all_the_same():
    planner_service = native(2)
    requests = [Step(unsolved(0), (0, n, 0, 5, 0)) for n in range(5)]
    requests += [Retreat(unsolved(2))] * 3  # pyright: ignore[reportOperatorIssue]
    results = planner_service.compute(requests)
    assert planner_service.calls == 3
    for request, result in zip(requests, results, strict=True):
        (single,) = native(2).compute([request])
        if isinstance(request, Step):
            assert result.value.total == single.value.total
        else:
            assert result.objects.tobytes() == single.objects.tobytes()
