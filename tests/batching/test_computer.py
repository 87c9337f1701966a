"""The queue in front of the engine: who shares a call, and in which order."""

import types
from typing import Any

import numpy as np
import pytest
from deliberations import HOPELESS, native, run, run_all, turn, unsolved
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.batching.requests import Memoised, PredictGain, Retreat, Step, robot_key_path
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.guidance.predictors.features import STATE, state_features
from pgf_jax.guidance.trials import simulate_input


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


def drain(queue: BatchScheduler) -> None:
    while len(queue):
        queue.run_batch()


def test_first_come_first_served():
    planner_service, ended = Recorder(lanes=2), []
    queue = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    for name, counts in (("a", [1, 1]), ("b", [3]), ("c", [1])):
        queue.submit(stepping(name, counts), lambda heard, name=name: ended.append(name))
    assert len(queue) == 5 and not planner_service.calls
    drain(queue)
    calls = [[request.search for request in call] for call in planner_service.calls if call]
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
    planner_service, results = Recorder(lanes), {}
    queue = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    for name, counts in enumerate(plans):
        queue.submit(stepping(name, counts), lambda heard, name=name: results.update({name: heard}))
    while waiting := len(queue):
        before = len(planner_service.calls)
        queue.run_batch()
        assert len(planner_service.calls[before]) == min(lanes, waiting)
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
    queue = BatchScheduler(native())
    for asks in (0, 1, 3):
        queue.submit(silent(asks), ended.append)
    assert ended == [0, 1, 3] and len(queue) == 0


# -- what is made once ---------------------------------------------------------------------------


def asking(requests):
    """Asks for these; returns what it was sent."""
    return (yield list(requests))


def test_once_for_those_who_ask_at_once_under_way_and_afterwards():
    planner_service, made, heard = Recorder(lanes=4), [], {}
    queue = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    kept: dict = {}

    def once():
        return Memoised(kept, "label", lambda: made.append(1) or stepping("made", [1, 1]))

    def ask(name, on=queue):
        on.submit(asking([once()]), lambda answers: heard.update({name: answers}))

    result = [step("made", 0, 0), step("made", 1, 0)]
    ask("first")
    ask("at once")
    assert made == [1] and len(queue) == 1
    queue.run_batch()
    ask("under way")
    assert heard == {} and len(queue) == 1
    queue.run_batch()
    assert heard == {name: [result] for name in ("first", "at once", "under way")}
    ask("afterwards")
    assert heard["afterwards"] == [result]  # without another round
    other = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    ask("elsewhere", other)
    assert heard["elsewhere"] == [result] and len(queue) == len(other) == 0
    assert made == [1] and sum(planner_service.calls, []) == result  # noqa: RUF017
    # Another label, or the same of another node, is another thing.
    queue.submit(asking([once()._replace(label="x"), once()._replace(kept={})]), lambda _: None)
    assert made == [1] * 3 and len(queue) == 2


def test_what_is_made_stands_in_line_like_the_rest():
    planner_service, ended = Recorder(lanes=2), []
    queue = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    kept: dict = {}
    once = Memoised(kept, "label", lambda: stepping("made", [1, 1]))
    for name, requests in (("a", [step("a"), once]), ("b", [once, step("b")]), ("c", [step("c")])):
        queue.submit(asking(requests), lambda answers, name=name: ended.append((name, answers)))
    drain(queue)
    calls = [[request.search for request in call] for call in planner_service.calls if call]
    assert calls == [[("a",), ("made", 0, 0)], [("b",), ("c",)], [("made", 1, 0)]]
    made = [step("made", 0, 0), step("made", 1, 0)]
    assert ended == [("c", [step("c")]), ("a", [step("a"), made]), ("b", [made, step("b")])]


def test_what_is_made_without_any_request_is_there_at_once():
    kept: dict = {}
    made: list[int] = []

    def nothing(value):
        made.append(value)
        return value
        yield

    def nested() -> Any:
        a, b = yield [
            Memoised(kept, "x", lambda: nothing(7)),
            Memoised(kept, "x", lambda: nothing(8)),
        ]
        (c,) = yield [Memoised(kept, "none", lambda: nothing(None))]
        (d,) = yield [Memoised(kept, "none", lambda: nothing(9))]
        return a, b, c, d

    ended: list = []
    queue = BatchScheduler(Recorder(lanes=1))  # pyright: ignore[reportArgumentType]
    for _ in range(2):
        queue.submit(asking([Memoised(kept, "nested", nested)]), ended.append)
    assert ended == [[(7, 7, None, None)]] * 2 and len(queue) == 0
    assert made == [7, None]  # a result of None is a result


def test_a_long_way_that_others_went_is_gone_without_recursion():
    """As by a fleet that comes second: everything that it asks for is there."""
    kept: dict = {}

    def walk(steps) -> Any:
        total = 0
        for i in range(steps):
            (value,) = yield [Memoised(kept, i, lambda i=i: asking([step(i)]))]
            total += value == [step(i)]
        return total

    ended: list = []
    planner_service = Recorder(lanes=1)
    for _ in range(2):
        queue = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
        queue.submit(walk(3000), ended.append)
        drain(queue)
    assert ended == [3000, 3000] and sum(map(len, planner_service.calls)) == 3000


ITEMS = st.one_of(st.just("step"), st.integers(0, 4))
PROGRAMS = st.lists(st.lists(ITEMS, max_size=4), max_size=4)


@settings(max_examples=150, deadline=None)
@given(
    # What is made under a label may ask for what is made under smaller ones.
    made=st.tuples(*(st.lists(st.lists(ITEMS, max_size=3), max_size=3) for _ in range(5))),
    askers=st.lists(st.tuples(st.integers(0, 4), PROGRAMS), min_size=1, max_size=6),
    lanes=st.integers(1, 5),
)
def test_once_against_making_everything_again(made, askers, lanes):
    """Askers begin in different rounds; answers are those of one who makes all for itself."""
    kept: dict = {}
    times: list[int] = []

    def allowed(program, below):
        return [[x for x in items if x == "step" or x < below] for items in program]

    programs = {label: allowed(program, label) for label, program in enumerate(made)}

    def make(label):
        times.append(label)
        return perform(label, programs[label])

    def perform(name, program) -> Any:
        heard = []
        for k, items in enumerate(program):
            heard += yield [
                step(name, k, i) if x == "step" else Memoised(kept, x, lambda x=x: make(x))
                for i, x in enumerate(items)
            ]
        return heard

    def expected(name, program):
        return [
            step(name, k, i) if x == "step" else expected(x, programs[x])
            for k, items in enumerate(program)
            for i, x in enumerate(items)
        ]

    def needed(program):
        labels = {x for items in program for x in items if x != "step"}
        return labels.union(*(needed(programs[x]) for x in labels))

    planner_service, results = Recorder(lanes), {}
    queue = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    for now in range(5):
        for number, (begins, program) in enumerate(askers):
            if begins == now:
                name = f"asker {number}"
                queue.submit(
                    perform(name, program), lambda heard, name=name: results.update({name: heard})
                )
        queue.run_batch()
    drain(queue)
    named = {f"asker {number}": program for number, (_, program) in enumerate(askers)}
    assert results == {name: expected(name, program) for name, program in named.items()}
    labels = set().union(*map(needed, named.values()))
    assert sorted(times) == sorted(labels)
    # And nothing else was computed, nor anything twice.
    steps = [request.search for call in planner_service.calls for request in call]
    named |= {label: programs[label] for label in labels}
    assert sorted(map(str, steps)) == sorted(
        str((name, k, i))
        for name, program in named.items()
        for k, items in enumerate(program)
        for i, x in enumerate(items)
        if x == "step"
    )


# -- company -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def alone():
    return [run(deliberation, native(1)) for deliberation in mixed(native(1).planner)]


def mixed(planner) -> list:
    """Deliberations of several kinds."""

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
    """Bit for bit, whatever else is in the queue."""
    planner = native(lanes).planner
    assert run_all(mixed(planner), native(lanes)) == alone
    assert run_all(mixed(planner)[::-1], native(lanes))[::-1] == alone
    assert alone[4] != alone[5] and alone[4] != alone[6]


def test_gains_of_a_call_are_asked_for_together():
    predictors = Counting("distance"), Counting("iteration")

    def job(seed: int, which: int, number: int) -> Any:
        (search,) = yield [Step(unsolved(seed), (seed, 0, 0, 5, number))]
        (gain,) = yield [PredictGain(predictors[which], state_features(search))]
        return gain, search

    planner_service = native(4)
    jobs = [(0, 0, 1), (2, 1, 1), (2, 0, 2), (0, 0, 3)]
    results = run_all([job(*each) for each in jobs], planner_service)
    assert planner_service.calls == 1
    assert [predictor.asked for predictor in predictors] == [[3], [1]]
    for (_, which, _), (gain, search) in zip(jobs, results, strict=True):
        expected = state_features(search)[STATE.index(("distance", "iteration")[which])]
        assert type(gain) is float and gain == np.float32(expected)


def test_a_computer_counts_what_it_does():
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
