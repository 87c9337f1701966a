"""The statistics on predictors, against values worked out by hand or by brute force."""

import itertools

import numpy as np
import predictor_evaluation as ev
import pytest

from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.tables.forks import Forks


def forks(alone, helped) -> Forks:
    alone, helped = np.asarray(alone, float), np.asarray(helped, float)
    count = len(alone)
    return Forks(
        scene=np.array([f"tight_{i}" for i in range(count)]),
        scene_class=np.full(count, "tight"),
        iteration=np.full(count, 3),
        push=np.full(count, True),
        state=np.zeros((count, len(STATE))),
        alone=alone,
        helped=helped,
    )


def of_gains(gains) -> Forks:
    gains = np.asarray(gains, float)
    return forks(np.repeat(gains[:, None], 2, axis=1), np.zeros((len(gains), 2)))


def test_noise_floor_by_hand():
    # Variances 2 and 8, mean 5. Of two keys, the other one is the median: distances 2 and 4.
    rmse, mae = ev.noise_floor(np.array([[1.0, 3.0], [10.0, 14.0]]))
    assert rmse == pytest.approx(np.sqrt(5.0))
    assert mae == pytest.approx(3.0)


def test_the_noise_floor_is_what_a_perfect_predictor_scores():
    rng = np.random.default_rng(0)
    means = rng.normal(0, 50, 4000)
    costs = means[:, None] + rng.normal(0, 7, (4000, 16))
    rmse, _ = ev.noise_floor(costs)
    assert rmse == pytest.approx(ev.rmse(means[:, None] - costs), rel=0.01)


def test_rank_correlation_by_hand():
    assert ev.rank_correlation(np.array([1.0, 2, 3]), np.array([10.0, 100, 1000])) == 1.0
    assert ev.rank_correlation(np.array([1.0, 2, 3]), np.array([3.0, 2, 1])) == -1.0
    # Ranks 1, 2.5, 2.5, 4 against 1, 2, 3, 4: 4.5 / sqrt(4.5 * 5).
    tied = ev.rank_correlation(np.array([0.0, 5, 5, 9]), np.array([1.0, 2, 3, 4]))
    assert tied == pytest.approx(4.5 / np.sqrt(4.5 * 5))
    assert np.isnan(ev.rank_correlation(np.ones(3), np.arange(3.0)))


def test_cost_errors_against_the_trivial_predictors():
    target = np.array([0.0, 100, 200, 300])
    errors = ev.cost_errors(
        target + 10, target, last=target + 20, mean=150.0, scene=np.array(list("abcd"))
    )
    assert errors.rmse.value == errors.mae.value == 10
    assert errors.rmse.low == errors.rmse.high == 10  # the same in every resample
    assert errors.to_last.value == 0.5
    assert errors.to_mean.value == pytest.approx(10 / np.sqrt((150**2 + 50**2) / 2))
    assert errors.to_mean.low < errors.to_mean.value < errors.to_mean.high


def test_the_bootstrap_resamples_scenes_not_rows():
    # Two scenes of 200 rows, 0 and 1: the mean of rows is sure, that of scenes is not.
    values = np.repeat([0.0, 1.0], 200)
    estimate = ev.bootstrap(lambda i: float(values[i].mean()), np.repeat(["a", "b"], 200))
    assert (estimate.value, estimate.low, estimate.high) == (0.5, 0.0, 1.0)


@pytest.mark.parametrize("m", [2, 3])
def test_windows_agree_with_every_window_counted(m):
    gains = np.array([5.0, -3, 40, 12, 0, 90])
    bid = np.array([1.0, 2, 3, 9, 5, 4])
    every = [list(w) for w in itertools.combinations(range(len(gains)), m)]
    hit = np.mean([gains[w].argmax() == bid[w].argmax() for w in every])
    regret = np.mean([gains[w].max() - gains[w][bid[w].argmax()] for w in every])
    by_chance = np.mean([gains[w].max() - gains[w].mean() for w in every])
    bids = {"bid": bid, "chance": np.zeros(6), "truth": gains}
    chosen = ev.windows(
        bids, of_gains(gains).gain, m, beside=("chance",), count=20_000, resamples=5
    )
    assert chosen["bid"].hit.value == pytest.approx(hit, abs=0.02)
    assert chosen["bid"].regret.value == pytest.approx(regret, rel=0.04)
    assert chosen["chance"].regret.value == pytest.approx(by_chance, rel=0.04)
    assert chosen["chance"].hit.value == pytest.approx(1 / m, abs=0.02)
    assert (chosen["truth"].hit.value, chosen["truth"].regret.value) == (1.0, 0.0)
    assert chosen["bid"].to["chance"].value == pytest.approx(regret / by_chance, rel=0.06)
    assert chosen["chance"].to["chance"] == ev.Estimate(1.0, 1.0, 1.0)


def test_reachable_regret_is_zero_without_noise_and_that_of_chance_with_noise_alone():
    assert ev.reachable(of_gains(np.arange(10.0)), 4) == 0
    rng = np.random.default_rng(0)
    noise = forks(rng.normal(size=(400, 8)), np.zeros((400, 8)))
    halves = noise.alone[:, :4].mean(1), noise.alone[:, 4:].mean(1)
    chance = np.mean(
        [
            ev.windows({"x": np.zeros(400)}, of_gains(half).gain, 4, resamples=1)["x"].regret.value
            for half in halves
        ]
    )
    assert ev.reachable(noise, 4) == pytest.approx(chance, rel=0.1)


def test_bid_statistics_and_calibration_by_hand():
    states = of_gains([10.0, 0.5, -20, 30, 0, 50])
    bid = np.array([5.0, 2, 0.5, -1, 0, 100])
    found = ev.bid_statistics(bid, states)
    assert found.ask_rate == 0.5
    assert found.pays == 0.5
    assert found.pays_if_bid == pytest.approx(2 / 3)
    assert found.pays_if_not == pytest.approx(1 / 3)
    assert (found.harms_if_bid, found.harms_if_not) == (0, pytest.approx(1 / 3))
    assert found.gain_if_bid == pytest.approx(60.5 / 3)
    groups = ev.calibration(bid, states, groups=2)
    assert [p for p, _ in groups] == [pytest.approx(-0.5 / 3), pytest.approx(107 / 3)]
    assert [t.value for _, t in groups] == [pytest.approx(10 / 3), pytest.approx(60.5 / 3)]
