"""Key paths, and coroutines that run side by side."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.batching.requests import (
    NOISE,
    TRIAL_STEPS,
    gather,
    robot_key_path,
    trial_key_path,
)


@settings(max_examples=60, deadline=None)
@given(
    first=st.tuples(st.integers(0, 5), st.integers(0, TRIAL_STEPS - 1), st.integers(0, 900)),
    second=st.tuples(st.integers(0, 5), st.integers(0, TRIAL_STEPS - 1), st.integers(0, 900)),
)
def test_no_two_iterations_share_a_key(first, second):
    (done, step, number), (other_done, other_step, other_number) = first, second
    one = trial_key_path(7, 1, 2, done, number)(step)
    assert one != robot_key_path(7, 1, 2, other_done)(other_step)
    assert one[-1] != NOISE
    same = first == second
    assert (one == trial_key_path(7, 1, 2, other_done, other_number)(other_step)) == same
    assert max(one) < 2**32


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(st.integers(0, 3), max_size=4), max_size=5))
def test_gather_sends_each_coroutine_its_own_results(plans):
    def ask(name, plan) -> Any:
        heard = []
        for round, count in enumerate(plan):
            answers = yield [(name, round, i) for i in range(count)]
            heard.append(list(answers))
        return heard

    jobs = gather([ask(name, plan) for name, plan in enumerate(plans)])
    answers, rounds = None, 0
    with pytest.raises(StopIteration) as end:
        while True:
            requests = jobs.send(answers)  # pyright: ignore[reportArgumentType]
            rounds += 1
            answers = [("answer", *request) for request in requests]  # pyright: ignore
    expected = [
        [[("answer", name, round, i) for i in range(count)] for round, count in enumerate(plan)]
        for name, plan in enumerate(plans)
    ]
    assert end.value.value == expected
    assert rounds == max(map(len, plans), default=0)
