"""The queue in front of the engine: who shares a call, and in which order."""

import types
from typing import Any

import numpy as np
import pytest
from deliberations import HOPELESS, native, run, run_all, turn, unsolved
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.guidance.state import STATE, describe
from pgf_jax.guidance.trials import Gain, Retreat, Step, attempt, own_words
from pgf_jax.study.computer import Queue


class Counting:
    """A predictor that says what is in a column, and how often it was asked for how many."""

    def __init__(self, column: str) -> None:
        self.column, self.asked = STATE.index(column), []

    def gain(self, states: np.ndarray) -> np.ndarray:
        self.asked.append(len(states))
        return states[:, self.column].astype(np.float32)


class Recorder:
    """A computer that answers with the requests themselves, and remembers its calls."""

    def __init__(self, lanes: int) -> None:
        self.engine = types.SimpleNamespace(lanes=lanes)
        self.calls: list[list[Any]] = []

    def compute(self, requests):
        self.calls.append(list(requests))
        return list(requests)


def step(*name) -> Step:
    """A request that is told from others by its name alone."""
    return Step(name, (0, 0, 0, 0, 0))  # pyright: ignore[reportArgumentType]


def stepping(name, counts) -> Any:
    """Asks for so many iterations at a time; returns what it was sent."""
    heard = []
    for turn_, count in enumerate(counts):
        heard += yield [step(name, turn_, i) for i in range(count)]
    return heard


def drain(queue: Queue) -> None:
    while len(queue):
        queue.round()


def test_first_come_first_served():
    computer, ended = Recorder(lanes=2), []
    queue = Queue(computer)  # pyright: ignore[reportArgumentType]
    for name, counts in (("a", [1, 1]), ("b", [3]), ("c", [1])):
        queue.add(stepping(name, counts), lambda heard, name=name: ended.append(name))
    assert len(queue) == 5 and not computer.calls
    drain(queue)
    calls = [[request.search for request in call] for call in computer.calls if call]
    # What `a` asks next waits behind all that was asked before.
    assert calls == [
        [("a", 0, 0), ("b", 0, 0)],
        [("b", 0, 1), ("b", 0, 2)],
        [("c", 0, 0), ("a", 1, 0)],
    ]
    assert ended == ["b", "c", "a"]


@settings(max_examples=80, deadline=None)
@given(
    plans=st.lists(st.lists(st.integers(0, 4), max_size=4), max_size=6),
    lanes=st.integers(1, 5),
)
def test_everyone_is_sent_their_own_answers_in_full_calls(plans, lanes):
    computer, results = Recorder(lanes), {}
    queue = Queue(computer)  # pyright: ignore[reportArgumentType]
    for name, counts in enumerate(plans):
        queue.add(stepping(name, counts), lambda heard, name=name: results.update({name: heard}))
    while waiting := len(queue):
        before = len(computer.calls)
        queue.round()
        assert len(computer.calls[before]) == min(lanes, waiting)
    assert results == {
        name: [step(name, k, i) for k, count in enumerate(counts) for i in range(count)]
        for name, counts in enumerate(plans)
    }


def test_a_deliberation_that_asks_nothing_ends_at_once():
    def silent(asks: int):
        for _ in range(asks):
            assert (yield []) == []
        return asks

    ended: list[int] = []
    queue = Queue(native())
    for asks in (0, 1, 3):
        queue.add(silent(asks), ended.append)
    assert ended == [0, 1, 3] and len(queue) == 0


@pytest.fixture(scope="module")
def alone():
    return [run(deliberation, native(1)) for deliberation in mixed(native(1).planner)]


def mixed(planner) -> list:
    """Deliberations of several kinds."""

    def described(seed: int, number: int):
        (search,) = yield [Step(unsolved(seed), (seed, 0, 0, 5, number))]
        a, b = yield [Gain(DISTANCE, describe(search)), Gain(ITERATION, describe(search))]
        return a, b, float(search.value.total)

    def retreating(seed: int):
        search = unsolved(seed)
        world, after, gain = yield [
            Retreat(search),
            Step(search, (seed, 0, 0, 5, 77)),
            Gain(DISTANCE, describe(search)),
        ]
        return world.objects.tobytes(), float(after.value.total), gain

    trials = [
        attempt(planner, unsolved(seed), push, own_words(*turn(seed)), push_limit=1, reach_limit=1)
        for seed in (0, 2)
        for push in (None, HOPELESS[seed])
    ]
    return [*trials, *(described(s, n) for s in (0, 2) for n in (1, 2)), retreating(0)]


DISTANCE, ITERATION = Counting("distance"), Counting("iteration")


@pytest.mark.parametrize("lanes", [1, 2, 5])
def test_results_do_not_depend_on_who_shares_a_call(alone, lanes):
    """Bit for bit, whatever else is in the queue."""
    planner = native(lanes).planner
    assert run_all(mixed(planner), native(lanes)) == alone
    assert run_all(mixed(planner)[::-1], native(lanes))[::-1] == alone
    assert alone[4] != alone[5] and alone[4] != alone[6]


def test_gains_of_a_call_are_asked_for_together():
    predictors = Counting("distance"), Counting("iteration")

    def job(seed: int, which: int, number: int) -> Any:
        (search,) = yield [Step(unsolved(seed), (seed, 0, 0, 5, number))]
        (gain,) = yield [Gain(predictors[which], describe(search))]
        return gain, search

    computer = native(4)
    jobs = [(0, 0, 1), (2, 1, 1), (2, 0, 2), (0, 0, 3)]
    results = run_all([job(*each) for each in jobs], computer)
    assert computer.calls == 1
    assert [predictor.asked for predictor in predictors] == [[3], [1]]
    for (_, which, _), (gain, search) in zip(jobs, results, strict=True):
        expected = describe(search)[STATE.index(("distance", "iteration")[which])]
        assert type(gain) is float and gain == np.float32(expected)


def test_a_computer_counts_what_it_does():
    computer = native(3)
    run_all([stepping_reach(number, 2) for number in range(4)], computer)
    # 4 robots in lanes of 3: 3 + 1, whoever is first, and again.
    assert computer.calls == 3 and computer.lanes_used == 8
    assert computer.occupancy() == (8, 9) and computer.occupancy() == (0, 0)
    # Its copies share what is compiled, not what is counted.
    other = native(3)
    assert other.planner is computer.planner and other.calls == 0


def stepping_reach(number: int, times: int) -> Any:
    search = unsolved(0)
    for i in range(times):
        (search,) = yield [Step(search, (0, number, 0, 5 + i, 0))]
    return search


def test_requests_beyond_the_lanes_are_computed_all_the_same():
    computer = native(2)
    requests = [Step(unsolved(0), (0, n, 0, 5, 0)) for n in range(5)]
    requests += [Retreat(unsolved(2))] * 3  # pyright: ignore[reportOperatorIssue]
    results = computer.compute(requests)
    assert computer.calls == 3
    for request, result in zip(requests, results, strict=True):
        (single,) = native(2).compute([request])
        if isinstance(request, Step):
            assert result.value.total == single.value.total
        else:
            assert result.objects.tobytes() == single.objects.tobytes()
