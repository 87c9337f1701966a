"""The network: against NumPy, its normalisation, its gain, and independence of the batch."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.guidance.predictors.features import STATE, history_features
from pgf_jax.guidance.predictors.network import (
    LANES,
    CostDifference,
    FailureClassifier,
    Predictor,
    combine,
    forward,
    init,
    normalisation,
)


@pytest.fixture(autouse=True, scope="module")
def strict():
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        yield


def sample(rows, seed=0):
    rng = np.random.default_rng(seed)
    return np.c_[np.full(rows, 20.0), rng.gamma(1.0, 400.0, (rows, 9))]


def states(features):
    """States whose first ten columns are the paper's features; nobody reads the others."""
    return np.c_[features, np.full((len(features), len(STATE) - 10), np.nan)]


def random_predictor(seed=0, hidden=(64, 32, 8)):
    x = sample(50, seed)
    return init(jax.random.key(seed), x, x[:, 1] + x[:, 9], hidden=hidden)


def numpy_forward(predictor, features, member=0):
    x = (features - np.asarray(predictor.mean, np.float64)) / np.asarray(predictor.scale)
    for i in range(len(predictor.hidden) + 1):
        layer = predictor.params[f"Dense_{i}"]
        x = x @ np.asarray(layer["kernel"][member], np.float64) + np.asarray(layer["bias"][member])
        x = np.maximum(x, 0) if i < len(predictor.hidden) else x
    return x[:, 0]


def constant(value):
    """A predictor that says `value` whatever it is shown."""
    predictor = random_predictor()
    params = {**jax.tree.map(jnp.zeros_like, predictor.params)}
    params["Dense_3"]["bias"] = jnp.array([[value]], jnp.float32)
    return dataclasses.replace(predictor, params=params)


@pytest.mark.parametrize("hidden", [(64, 32, 8), (64, 32, 16), (3,)])
def test_forward_is_the_mlp_of_the_paper(hidden):
    predictor = random_predictor(1, hidden)
    shapes = [predictor.params[f"Dense_{i}"]["kernel"].shape for i in range(len(hidden) + 1)]
    assert shapes == [(1, a, b) for a, b in zip((10, *hidden), (*hidden, 1), strict=True)]
    x = sample(77, seed=5)
    expected = numpy_forward(predictor, x)
    np.testing.assert_allclose(predictor.predict(x), expected, rtol=1e-5, atol=1e-2)
    batched = jax.jit(jax.vmap(forward, in_axes=(None, 0)))(predictor, jnp.asarray(x, jnp.float32))
    np.testing.assert_allclose(batched, expected, rtol=1e-5, atol=1e-2)


def test_normalisation_by_hand():
    x = np.tile(np.arange(10.0), (4, 1))
    x[:, 0] = 20
    x[:, 1] = [1, 3, 1, 3]
    x[:, 2] = [0, 0, 0, 8]
    x[:, 3] = 0.1 + 0.2  # a constant whose computed deviation need not be exactly zero
    mean, scale = normalisation(np.repeat(x, 7, axis=0))
    np.testing.assert_allclose(mean, [20, 2, 2, 0.3, 4, 5, 6, 7, 8, 9], rtol=1e-6)
    np.testing.assert_allclose(scale, [1, 1, np.sqrt(12), 1, 1, 1, 1, 1, 1, 1], rtol=1e-6)
    assert mean.dtype == scale.dtype == np.float32


def test_untrained_predictor_has_the_mean_and_the_scale_of_its_target():
    x = sample(400)
    low = init(jax.random.key(0), x, np.full(400, 500.0))
    assert float(low.params["Dense_3"]["bias"][0, 0]) == 500
    high = init(jax.random.key(0), x, np.array([300.0, 700.0] * 200))
    assert float(high.params["Dense_3"]["bias"][0, 0]) == 500
    ratio = high.params["Dense_3"]["kernel"] / low.params["Dense_3"]["kernel"]
    np.testing.assert_allclose(ratio, 200, rtol=1e-6)


def test_predictor_is_a_pytree():
    predictor = random_predictor()
    assert len(jax.tree.leaves(predictor)) == 8 + 2
    doubled = jax.tree.map(lambda leaf: 2 * leaf, predictor)
    assert isinstance(doubled, Predictor)
    assert doubled.hidden == (64, 32, 8)


@pytest.mark.parametrize(
    ("auto", "human", "expected"),
    [(300, 120, 180), (100, 250, -150), (-40, 30, -30), (70, -5, 70), (-1, -2, 0)],
)
def test_gain_clips_each_at_zero(auto, human, expected):
    x = states(sample(3))
    assert CostDifference(constant(auto), constant(human)).gain(x).tolist() == [expected] * 3


def test_predictions_are_not_clipped_but_gains_are():
    assert constant(-40).predict(sample(2)).tolist() == [-40, -40]


def test_no_prediction_without_a_history_or_with_a_broken_one():
    full = [(900.0, 0.0, 450.0), (800.0, 10.0, 450.0), (700.0, 0.0, 0.0)]
    x = np.stack(
        [
            history_features(20, full),
            history_features(20, full[:2]),
            history_features(20, [*full[:2], (np.inf, 0.0, 0.0)]),
            history_features(20, [(np.inf, 0.0, 0.0), *full]),
        ]
    )
    value = CostDifference(random_predictor(1), random_predictor(2)).gain(states(x))
    assert np.isnan(value).tolist() == [False, True, True, False]
    assert value[0] == value[3]


def test_empty_and_malformed_batches():
    predictor = random_predictor()
    assert predictor.predict(np.zeros((0, 10))).shape == (0,)
    for shape in [(10,), (3, 9), (1, 3, 10)]:
        with pytest.raises(ValueError, match=r"features must be \[B, 10\]"):
            predictor.predict(np.zeros(shape))


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 2 * LANES + 3), st.integers(0, 2**32 - 1))
def test_a_prediction_depends_on_its_own_row_alone(size, seed):
    """Bit for bit: any batch size, any order, any content of the other rows, nan included."""
    pair = CostDifference(random_predictor(3), combine([random_predictor(4), random_predictor(5)]))
    rng = np.random.default_rng(seed)
    x = states(sample(size, seed))
    together = pair.gain(x)
    order = rng.permutation(size)
    assert pair.gain(x[order]).tobytes() == together[order].tobytes()
    i = rng.integers(size)
    assert pair.gain(x[i : i + 1]).tobytes() == together[i : i + 1].tobytes()
    others = rng.normal(0, 1e6, x.shape)
    others[rng.random(size) < 0.3] = np.nan
    others[i] = x[i]
    assert pair.gain(others)[i].tobytes() == together[i].tobytes()


def ensemble(seeds):
    """Members trained on the same rows: one normalisation, weights of their own."""
    first = random_predictor(seeds[0])
    return [first] + [
        dataclasses.replace(first, params=random_predictor(seed).params) for seed in seeds[1:]
    ]


def test_an_ensemble_predicts_the_mean_of_its_members():
    members = ensemble((1, 2, 3))
    together = combine(members)
    x = sample(40, seed=7)
    single = np.stack([one.predict(x) for one in members])
    assert np.ptp(single, axis=0).min() > 1  # they disagree, so that a mean is something
    np.testing.assert_allclose(together.predict(x), single.mean(axis=0), rtol=1e-6)
    by_hand = np.mean([numpy_forward(together, x, member) for member in range(3)], axis=0)
    np.testing.assert_allclose(together.predict(x), by_hand, rtol=1e-5, atol=1e-2)
    np.testing.assert_allclose(combine(members[::-1]).predict(x), together.predict(x), rtol=1e-6)
    one = combine(members[:1])
    assert one.predict(x).tobytes() == members[0].predict(x).tobytes()


def test_a_predictor_takes_its_features_by_name():
    rng = np.random.default_rng(0)
    rows = rng.normal(0, 5, (30, len(STATE)))
    names = ("turn", "distance", "n_objects")
    x = rows[:, [STATE.index(name) for name in names]]
    chooser = init(jax.random.key(0), x, rng.normal(0, 9, 30), hidden=(5,), names=names)
    assert chooser.features == names
    value = chooser.of_states(rows)
    assert value.tobytes() == chooser.predict(x).tobytes()
    others = [i for i, name in enumerate(STATE) if name not in names]
    rows[:, others] = np.nan
    assert chooser.of_states(rows).tobytes() == value.tobytes()
    rows[4, STATE.index("turn")] = np.inf
    assert np.flatnonzero(np.isnan(chooser.of_states(rows))).tolist() == [4]
    with pytest.raises(ValueError, match=r"features must be \[B, 3\]"):
        chooser.predict(rows)


def test_a_failure_s_gain_is_the_logistic_of_its_network():
    x = states(sample(5))
    for odds in (-3.0, 0.0, 0.25, 40.0, -200.0):
        value = FailureClassifier(constant(odds)).gain(x)
        np.testing.assert_allclose(value, 1 / (1 + np.exp(-odds)), rtol=1e-6, atol=1e-40)
        assert value.dtype == np.float32
    x[2, 3] = np.nan
    assert np.isnan(FailureClassifier(constant(1.0)).gain(x)).tolist() == [
        False,
        False,
        True,
        False,
        False,
    ]


def test_dropout_needs_a_key_and_is_off_without():
    predictor = random_predictor(1)
    x = jnp.asarray(sample(1)[0], jnp.float32)
    plain = float(forward(predictor, x))
    assert float(forward(predictor, x, dropout=0.5)) == plain  # no key: nothing is dropped
    drawn = [float(forward(predictor, x, dropout=0.5, key=jax.random.key(k))) for k in range(8)]
    assert len(set(drawn)) > 4
    assert float(forward(predictor, x, dropout=0.5, key=jax.random.key(3))) == drawn[3]
