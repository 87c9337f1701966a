"""Orders of conditions and scenes: everything is balanced."""

import collections
import itertools

import pytest

from pgf_jax.study.orders import balanced_orders, blocks_of


@pytest.mark.parametrize("n", range(1, 9))
def test_each_condition_is_as_often_at_each_place_and_after_each_other_one(n):
    orders = balanced_orders(n)
    assert len(orders) == (n if n % 2 == 0 or n == 1 else 2 * n)
    assert all(sorted(order) == list(range(n)) for order in orders)
    times = len(orders) // n
    for place in range(n):
        assert set(collections.Counter(order[place] for order in orders).values()) == {times}
    follows = collections.Counter(pair for order in orders for pair in itertools.pairwise(order))
    pairs = set(itertools.permutations(range(n), 2))
    assert set(follows) == pairs and len(set(follows.values())) <= 1


@pytest.mark.parametrize("n", range(1, 7))
def test_each_condition_meets_each_set_of_scenes_as_often_at_each_place(n):
    participants = n * len(balanced_orders(n))
    seen = collections.Counter()
    for participant in range(participants):
        blocks = blocks_of(participant, n)
        assert sorted(block.condition for block in blocks) == list(range(n))
        assert sorted(block.scenes for block in blocks) == list(range(n))
        seen.update((place, b.condition, b.scenes) for place, b in enumerate(blocks))
    assert len(seen) == n**3 and len(set(seen.values())) == 1
    assert blocks_of(participants, n) == blocks_of(0, n)
