"""The scheduler: who shares a call, and in which order; and memoised requests."""

import functools
import threading
import types
from typing import Any

import pytest
from coroutines import native
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.batching.requests import Execute, Memoised, Step
from pgf_jax.batching.scheduler import BatchScheduler


class Recorder:
    """A planner service that answers with the requests themselves, and remembers its calls."""

    def __init__(self, lanes: int) -> None:
        self.engine = types.SimpleNamespace(lanes=lanes)
        self.calls: list[list[Any]] = []

    def compute(self, requests):
        self.calls.append(list(requests))
        return list(requests)


class Name(tuple):
    """In place of a search; its program is its first part, if that is in capitals."""

    @property
    def program(self):
        return self[0] if str(self[0]).isupper() else ""


def step(*name) -> Step:
    """A request that is told from others by its name alone."""
    return Step(Name(name), (0, 0, 0, 0, 0))  # pyright: ignore[reportArgumentType]


def stepping(name, counts) -> Any:
    """Asks for so many iterations at a time; returns what it was sent."""
    heard = []
    for turn_, count in enumerate(counts):
        heard += yield [step(name, turn_, i) for i in range(count)]
    return heard


def drain(scheduler: BatchScheduler) -> None:
    while len(scheduler):
        scheduler.run_batch()


def test_first_come_first_served():
    planner_service, ended = Recorder(lanes=2), []
    scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    for name, counts in (("a", [1, 1]), ("b", [3]), ("c", [1])):
        scheduler.submit(stepping(name, counts), lambda heard, name=name: ended.append(name))
    assert len(scheduler) == 5 and not planner_service.calls
    drain(scheduler)
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
    scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    for name, counts in enumerate(plans):
        scheduler.submit(
            stepping(name, counts), lambda heard, name=name: results.update({name: heard})
        )
    while waiting := len(scheduler):
        before = len(planner_service.calls)
        scheduler.run_batch()
        assert len(planner_service.calls[before]) == min(lanes, waiting)
    assert results == {
        name: [step(name, k, i) for k, count in enumerate(counts) for i in range(count)]
        for name, counts in enumerate(plans)
    }


def test_a_coroutine_that_asks_nothing_ends_at_once():
    def silent(asks: int):
        for _ in range(asks):
            assert (yield []) == []
        return asks

    ended: list[int] = []
    scheduler = BatchScheduler(native())
    for asks in (0, 1, 3):
        scheduler.submit(silent(asks), ended.append)
    assert ended == [0, 1, 3] and len(scheduler) == 0


def test_a_single_coroutine_is_run_to_its_end():
    planner_service = Recorder(lanes=2)
    scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    assert scheduler.run(stepping("a", [1, 3])) == [
        step("a", 0, 0),
        *(step("a", 1, i) for i in range(3)),
    ]
    assert [len(call) for call in planner_service.calls] == [1, 2, 1] and len(scheduler) == 0


# -- memoised requests ---------------------------------------------------------------------------


def asking(requests):
    """Asks for these; returns what it was sent."""
    return (yield list(requests))


def test_memoised_for_those_who_ask_at_once_under_way_and_afterwards():
    planner_service, made, heard = Recorder(lanes=4), [], {}
    scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    cache: dict = {}

    def once():
        return Memoised(cache, "key", lambda: made.append(1) or stepping("made", [1, 1]))

    def ask(name, on=scheduler):
        on.submit(asking([once()]), lambda answers: heard.update({name: answers}))

    result = [step("made", 0, 0), step("made", 1, 0)]
    ask("first")
    ask("at once")
    assert made == [1] and len(scheduler) == 1
    scheduler.run_batch()
    ask("under way")
    assert heard == {} and len(scheduler) == 1
    scheduler.run_batch()
    assert heard == {name: [result] for name in ("first", "at once", "under way")}
    ask("afterwards")
    assert heard["afterwards"] == [result]  # without another batch
    other = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    ask("elsewhere", other)
    assert heard["elsewhere"] == [result] and len(scheduler) == len(other) == 0
    assert made == [1] and sum(planner_service.calls, []) == result  # noqa: RUF017
    # Another key, or the same of another node, is another thing.
    scheduler.submit(asking([once()._replace(key="x"), once()._replace(cache={})]), lambda _: None)
    assert made == [1] * 3 and len(scheduler) == 2


def test_what_is_made_stands_in_line_like_the_rest():
    planner_service, ended = Recorder(lanes=2), []
    scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    cache: dict = {}
    once = Memoised(cache, "key", lambda: stepping("made", [1, 1]))
    for name, requests in (("a", [step("a"), once]), ("b", [once, step("b")]), ("c", [step("c")])):
        scheduler.submit(asking(requests), lambda answers, name=name: ended.append((name, answers)))
    drain(scheduler)
    calls = [[request.search for request in call] for call in planner_service.calls if call]
    assert calls == [[("a",), ("made", 0, 0)], [("b",), ("c",)], [("made", 1, 0)]]
    made = [step("made", 0, 0), step("made", 1, 0)]
    assert ended == [("c", [step("c")]), ("a", [step("a"), made]), ("b", [made, step("b")])]


def test_what_is_made_without_any_request_is_there_at_once():
    cache: dict = {}
    made: list[int] = []

    def nothing(value):
        made.append(value)
        return value
        yield

    def nested() -> Any:
        a, b = yield [
            Memoised(cache, "x", lambda: nothing(7)),
            Memoised(cache, "x", lambda: nothing(8)),
        ]
        (c,) = yield [Memoised(cache, "none", lambda: nothing(None))]
        (d,) = yield [Memoised(cache, "none", lambda: nothing(9))]
        return a, b, c, d

    ended: list = []
    scheduler = BatchScheduler(Recorder(lanes=1))  # pyright: ignore[reportArgumentType]
    for _ in range(2):
        scheduler.submit(asking([Memoised(cache, "nested", nested)]), ended.append)
    assert ended == [[(7, 7, None, None)]] * 2 and len(scheduler) == 0
    assert made == [7, None]  # a result of None is a result


def test_many_known_results_in_a_row_need_no_recursion():
    """As by a fleet that comes second: everything that it asks for is there."""
    cache: dict = {}

    def walk(steps) -> Any:
        total = 0
        for i in range(steps):
            (value,) = yield [Memoised(cache, i, lambda i=i: asking([step(i)]))]
            total += value == [step(i)]
        return total

    ended: list = []
    planner_service = Recorder(lanes=1)
    for _ in range(2):
        scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
        scheduler.submit(walk(3000), ended.append)
        drain(scheduler)
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
def test_memoised_against_making_everything_again(made, askers, lanes):
    """Askers begin at different batches; answers are those of one who makes all for itself."""
    cache: dict = {}
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
                step(name, k, i) if x == "step" else Memoised(cache, x, lambda x=x: make(x))
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
    scheduler = BatchScheduler(planner_service)  # pyright: ignore[reportArgumentType]
    for now in range(5):
        for number, (begins, program) in enumerate(askers):
            if begins == now:
                name = f"asker {number}"
                scheduler.submit(
                    perform(name, program), lambda heard, name=name: results.update({name: heard})
                )
        scheduler.run_batch()
    drain(scheduler)
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


class Slow(Recorder):
    """A planner service whose calls wait until so many are under way at a time."""

    def __init__(self, lanes: int, together: int) -> None:
        super().__init__(lanes)
        self.barrier = threading.Barrier(together, timeout=30)

    def compute(self, requests):
        self.barrier.wait()
        return super().compute(requests)


def test_with_threads_calls_are_made_side_by_side():
    """Both calls are under way at once, each with half of the iterations; or the barrier breaks."""
    service = Slow(lanes=8, together=2)
    scheduler, ended = BatchScheduler(service, 2), []  # pyright: ignore[reportArgumentType]
    scheduler.submit(stepping("a", [6]), ended.append)
    scheduler.run_batch()
    assert len(scheduler) in (0, 3)  # whether the second has ended too
    drain(scheduler)
    assert sorted(len(call) for call in service.calls) == [3, 3]
    assert [request.search for request in ended[0]] == [("a", 0, i) for i in range(6)]


def test_a_call_is_of_one_program():
    """Those of another wait for the next call, and keep their order."""
    service = Recorder(lanes=3)
    scheduler, ended = BatchScheduler(service), []  # pyright: ignore[reportArgumentType]
    for name, count in (("A", 1), ("B", 2), ("A", 3), ("B", 1)):
        scheduler.submit(stepping(name, [count]), ended.append)
    drain(scheduler)
    calls = [[request.search[0] for request in call] for call in service.calls if call]
    assert calls == [["A"] * 3, ["B"] * 3, ["A"]]
    assert len(ended) == 4


def test_with_threads_an_execution_has_a_thread_of_its_own():
    service = Slow(lanes=8, together=2)
    scheduler, ended = BatchScheduler(service, 2), []  # pyright: ignore[reportArgumentType]
    execution = Execute("world", "command")  # pyright: ignore[reportArgumentType]

    def both():
        return (yield [execution, step("b"), step("b")])

    scheduler.submit(both(), ended.append)
    drain(scheduler)
    assert sorted(len(call) for call in service.calls) == [1, 2]
    assert ended == [[execution, step("b"), step("b")]]


@settings(max_examples=60, deadline=None)
@given(
    plans=st.lists(st.lists(st.integers(0, 4), max_size=4), max_size=6),
    lanes=st.integers(1, 5),
    threads=st.integers(2, 4),
)
def test_with_threads_everybody_hears_the_same(plans, lanes, threads):
    heard = []
    for count in (1, threads):
        scheduler = BatchScheduler(Recorder(lanes), count)  # pyright: ignore[reportArgumentType]
        results: dict[int, Any] = {}
        for i, counts in enumerate(plans):
            scheduler.submit(stepping(i, counts), functools.partial(results.__setitem__, i))
        drain(scheduler)
        heard.append([results[i] for i in range(len(plans))])
    assert heard[0] == heard[1]


def test_with_threads_what_a_call_raises_is_raised():
    class Broken(Recorder):
        def compute(self, requests):
            raise RuntimeError("no such world")

    scheduler = BatchScheduler(Broken(2), 2)  # pyright: ignore[reportArgumentType]
    scheduler.submit(stepping("a", [1]), lambda heard: None)
    with pytest.raises(RuntimeError, match="no such world"):
        drain(scheduler)
