"""The counter of floating-point operations, on functions whose number is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgf_jax.physics.flops import count

X = np.ones((3, 4), np.float32)
WHOLE = np.ones((3, 4), np.int32)


@pytest.mark.parametrize(
    ("fn", "args", "expected"),
    [
        (lambda x: x * x + 1.0, (X,), 24),
        (lambda x: jnp.sqrt(x) / x, (X,), 24),
        (lambda x: jnp.maximum(x, 0.0), (X,), 12),
        (lambda x: jax.lax.clamp(0.0, x, 1.0), (X,), 24),
        (lambda x: jnp.where(x > 0, x, 0.0), (X,), 24),  # a comparison and a choice
        (lambda x: x**5, (X,), 36),  # x², x⁴, x⁵
        (lambda x: x**1, (X,), 0),
        (lambda x: x.sum(), (X,), 11),
        (lambda x: x.max(0), (X,), 8),
        (lambda x: jnp.cumsum(x, 0), (X,), 12),
        (lambda x: jnp.zeros(7).at[jnp.arange(4)].add(x[0]), (X,), 4),
        (lambda x: x @ x.T, (X,), 2 * 3 * 3 * 4),
        (lambda x: jnp.einsum("bij,bjk->bik", x, x), (np.ones((5, 2, 2), np.float32),), 80),
        (lambda x: x.T.reshape(-1)[::2], (X,), 0),
        (lambda i: (i + i) * (i > 0), (WHOLE,), 0),
        (lambda i: jnp.where(i > 0, 1.5, i.astype(float)), (WHOLE,), 12),
        (jax.vmap(lambda x: x + x), (X,), 12),
        (jax.jit(lambda x: jax.jit(lambda y: y + y)(x) * 2.0), (X,), 24),
    ],
)
def test_operations_are_counted(fn, args, expected):
    assert count(fn, *args) == expected


def test_a_loop_counts_as_often_as_it_runs():
    def nested(x):
        inner = lambda _, y: y + 1.0  # noqa: E731
        return jax.lax.fori_loop(2, 7, lambda _, y: jax.lax.fori_loop(0, 3, inner, y * y), x)

    assert count(nested, X) == 5 * (12 + 3 * 12)
    assert count(lambda x: jax.lax.scan(lambda c, a: (c + a, c), x[0], x), X) == 12
    assert count(lambda x: jax.lax.map(jnp.sin, x), X) == 12


def rounds(x, start, end):
    """A loop that stays a `while`: its ends reach it as variables."""
    return jax.lax.fori_loop(start, end, lambda _, y: y * 2.0, x)


def test_a_while_loop_counts_where_its_ends_are_constant():
    assert count(lambda x: jax.jit(rounds)(x, 2, 8), X) == 6 * 12
    assert count(lambda x: jax.jit(rounds)(x, 8, 2), X) == 0

    def own(x):
        def body(carry):
            return carry[0] + 1, carry[1] * 2.0

        return jax.lax.while_loop(lambda carry: carry[0] < 4, body, (1, x))

    assert count(own, X) == 3 * 12


@pytest.mark.parametrize(
    "fn",
    [
        rounds,  # its ends are arguments
        lambda x, _, end: rounds(x, 0, end),
        lambda x, start, _: rounds(x, start, 9),
        lambda x, *_: jax.lax.while_loop(lambda y: y.sum() < 100.0, lambda y: y * 2.0, x),
        # Counts to a constant, but by two; and to an end that moves.
        lambda x, *_: jax.lax.while_loop(
            lambda c: c[0] < 4, lambda c: (c[0] + 2, c[1] * 2.0), (0, x)
        ),
        lambda x, *_: jax.lax.while_loop(
            lambda c: c[0] < c[1], lambda c: (c[0] + 1, c[1] - 1, c[2] * 2.0), (0, 9, x)
        ),
    ],
)
def test_a_loop_that_its_values_decide_is_refused(fn):
    with pytest.raises(ValueError, match="without a constant number of rounds"):
        count(fn, X, 0, 4)


def test_the_costliest_branch_counts():
    def either(x, first):
        return jax.lax.cond(first, lambda y: y + 1.0, lambda y: y * y + y, x)

    assert count(either, X, True) == 24
