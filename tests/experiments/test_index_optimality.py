"""The exact solutions against cases done by hand, and against a simulation."""

import index_optimality as exact
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st


def instance(alone, service, share=(1.0,)) -> exact.Instance:
    return exact.Instance(np.array(alone), np.array(service), np.array(share))


def test_one_robot_of_one_type():
    """It is always served: solved at the rate lambda + mu."""
    one = instance([0.1], [0.3])
    assert exact.Stream(one, 1).best() == pytest.approx(0.4)
    assert exact.batch_cost(one, (1,), None) == pytest.approx(1 / 0.4)


def test_two_robots_of_one_type():
    """One is served, the other is not: 0.4 + 0.1. A batch: 2 / 0.5, then 1 / 0.4 or the rest."""
    one = instance([0.1], [0.3])
    assert exact.Stream(one, 2).best() == pytest.approx(0.5)
    assert exact.batch_cost(one, (2,), None) == pytest.approx(2 / 0.5 + 1 / 0.4)


def test_two_robots_of_two_types_by_hand():
    """Serving a first: (2 + 0.9 V(b) + 0.2 V(a, served)) / 1.1, and likewise b first."""
    two = instance([0.1, 0.2], [0.8, 0.5], [0.5, 0.5])
    a, b = 1 / 0.9, 1 / 0.7
    first = (2 + 0.9 * b + 0.2 * a) / 1.1
    second = (2 + 0.7 * a + 0.1 * b) / 0.8
    assert exact.batch_cost(two, (1, 1), [0, 1]) == pytest.approx(first)
    assert exact.batch_cost(two, (1, 1), [1, 0]) == pytest.approx(second)
    assert exact.batch_cost(two, (1, 1), None) == pytest.approx(min(first, second))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), robots=st.integers(1, 4))
def test_no_order_is_better_than_the_best(seed, robots):
    drawn = exact.instance_of(2, seed, 0)
    for stream, batch in exact.losses(drawn, robots, (robots // 2, robots - robots // 2)).values():
        assert stream >= -1e-9 and batch >= -1e-9


def test_a_stream_against_a_simulation():
    drawn = exact.instance_of(3, 7, 0)
    fleet, order = exact.Stream(drawn, 3), drawn.ranked("gain-rate")
    gain, _ = fleet.solve(fleet.by_order(order))
    rng = np.random.default_rng(0)
    tasks, served = list(rng.choice(3, 3, p=drawn.share)), None
    time, solved, end = 0.0, 0, 60_000
    for _ in range(end):
        if served is None:
            served = min(range(3), key=lambda r: order.index(tasks[r]))
        rates = drawn.alone[tasks].copy()
        rates[served] += drawn.service[tasks[served]]
        time += rng.exponential(1 / rates.sum())
        robot = int(rng.choice(3, p=rates / rates.sum()))
        served = None if robot == served else served
        tasks[robot] = rng.choice(3, p=drawn.share)
        solved += 1
    assert gain == pytest.approx(solved / time, rel=0.015)
