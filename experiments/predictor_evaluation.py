"""Statistics on predictors: errors of predicted costs, and the worth of bids by predicted gains.

Costs are judged on held-out runs, gains on forks. Intervals are 95 % percentile bootstraps that
resample whole scenes, because rows of one scene are not independent of each other.

Used by `predictor_report.py` and `choose_predictor.py`.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pgf_jax.streams import stream
from pgf_jax.tables.forks import Forks

RESAMPLES = 1000
BID = 1.0  # a robot bids when its predicted gain exceeds this (paper, Alg. 2), units of cost


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g}..{self.high:.3g})"


def bootstrap(
    figure: Callable[[np.ndarray], float], scene: np.ndarray, resamples: int = RESAMPLES
) -> Estimate:
    """A statistic of all rows, with an interval from scenes drawn with replacement.

    Args:
      figure: computes the statistic of the rows with given indices, which may repeat.
      scene: [M] the scene of each row.
      resamples: number of draws.
    """
    names, group = np.unique(scene, return_inverse=True)
    order = np.argsort(group, kind="stable")
    rows = np.split(order, np.cumsum(np.bincount(group))[:-1])
    draw = stream(0, "boot", len(names))
    values = [
        figure(np.concatenate([rows[i] for i in draw.integers(len(names), size=len(names))]))
        for _ in range(resamples)
    ]
    low, high = np.nanquantile(values, (0.025, 0.975))
    return Estimate(figure(np.arange(len(scene))), float(low), float(high))


def rmse(error: np.ndarray) -> float:
    """Root of the mean square of errors."""
    return float(np.sqrt(np.mean(np.square(error))))


def mae(error: np.ndarray) -> float:
    """Mean magnitude of errors, which the published code calls RMSE."""
    return float(np.mean(np.abs(error)))


@dataclasses.dataclass(frozen=True)
class Errors:
    """Errors of predicted costs.

    Attributes:
      rmse, mae: in units of cost.
      to_last, to_mean: RMSE over that of predicting the last cost, or the mean of the targets.
    """

    rmse: Estimate
    mae: Estimate
    to_last: Estimate
    to_mean: Estimate


def cost_errors(
    predicted: np.ndarray, target: np.ndarray, last: np.ndarray, mean: float, scene: np.ndarray
) -> Errors:
    """Compute errors of predicted costs, and compare them with two trivial predictors.

    Args:
      predicted, target: [M] costs.
      last: [M] cost at the moment of prediction; one trivial predictor.
      mean: of the targets that the predictor was trained on; the other one.
      scene: [M] the scene of each row.
    """
    error = predicted - target

    def ratio(trivial: np.ndarray) -> Estimate:
        return bootstrap(lambda i: rmse(error[i]) / rmse(trivial[i]), scene)

    return Errors(
        rmse=bootstrap(lambda i: rmse(error[i]), scene),
        mae=bootstrap(lambda i: mae(error[i]), scene),
        to_last=ratio(last - target),
        to_mean=ratio(mean - target),
    )


def noise_floor(costs: np.ndarray) -> tuple[float, float]:
    """RMSE and MAE of a predictor that knows everything but the future noise.

    Args:
      costs: [F, K] of F states under K keys of the noise.

    Returns:
      The root of the mean unbiased variance over keys; and the mean distance of a cost to the
      median of the state's other costs.
    """
    keys = costs.shape[1]
    others = [np.median(np.delete(costs, k, axis=1), axis=1) for k in range(keys)]
    away = np.abs(costs - np.stack(others, axis=1))
    return float(np.sqrt(costs.var(axis=1, ddof=1).mean())), float(away.mean())


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's rank correlation; equal values share the mean of their ranks.

    Returns:
      nan if `a` or `b` is constant.
    """
    x, y = _ranks(a), _ranks(b)
    x, y = x - x.mean(), y - y.mean()
    scale = np.sqrt((x**2).sum() * (y**2).sum())
    return float((x * y).sum() / scale) if scale > 0 else float("nan")


def _ranks(values: np.ndarray) -> np.ndarray:
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[group]


@dataclasses.dataclass(frozen=True)
class WindowScores:
    """How well bids choose one of the m robots of a window.

    Attributes:
      hit: share of windows in which the robot with the largest true gain is chosen.
      regret: largest true gain less that of the chosen robot, mean over windows, units of cost.
      to: the regret over that of other bids, by their name.
    """

    hit: Estimate
    regret: Estimate
    to: Mapping[str, Estimate]


def windows(
    bids: Mapping[str, np.ndarray],
    truth: np.ndarray,
    m: int,
    *,
    beside: Sequence[str] = (),
    count: int = 4000,
    resamples: int = 200,
) -> dict[str, WindowScores]:
    """Score bids in windows of m states drawn at random, in which the highest bid is chosen.

    Args:
      bids: [F] bids by name, scored in the same windows; among equal bids a random one wins.
      truth: [F] true gains of the states.
      m: robots in a window.
      beside: names of the bids to whose regret that of the others is compared.
      count: number of windows.
      resamples: number of draws of the states, for the intervals.
    """
    stack = np.stack(list(bids.values()))
    states = np.arange(len(truth))
    value = _choose(stack, truth, truth, states, m, count, 0)
    draw = stream(1, "window", m)
    drawn = np.array(
        [
            _choose(stack, truth, truth, draw.integers(len(states), size=len(states)), m, count, r)
            for r in range(1, resamples + 1)
        ]
    )  # [resamples, 2, names]

    def estimate(value: np.ndarray, drawn: np.ndarray) -> Estimate:
        low, high = np.quantile(drawn, (0.025, 0.975))
        return Estimate(float(value), float(low), float(high))

    names = list(bids)
    return {
        name: WindowScores(
            hit=estimate(value[0, i], drawn[:, 0, i]),
            regret=estimate(value[1, i], drawn[:, 1, i]),
            to={
                other: estimate(
                    value[1, i] / value[1, names.index(other)],
                    drawn[:, 1, i] / drawn[:, 1, names.index(other)],
                )
                for other in beside
            },
        )
        for i, name in enumerate(names)
    }


def reachable(forks: Forks, m: int, count: int = 4000) -> float:
    """Regret of choosing by the true gains under half of the keys, judged by the other half.

    The two halves take turns. This regret is due to the noise of the true gains alone.
    """
    half = forks.alone.shape[1] // 2
    gains = forks.alone - forks.helped
    a, b = gains[:, :half].mean(axis=1), gains[:, half:].mean(axis=1)
    states = np.arange(len(gains))
    both = [_choose(x[None], y, y, states, m, count, 0)[1, 0] for x, y in ((a, b), (b, a))]
    return float(np.mean(both))


def _choose(
    bids: np.ndarray,
    known: np.ndarray,
    judged: np.ndarray,
    states: np.ndarray,
    m: int,
    count: int,
    seed: int,
) -> np.ndarray:
    """Share of windows with the best robot by `known` chosen; mean regret by `judged`: [2, B]."""
    draw = stream(seed, "windows", m)
    # In each window m different states: the first m of a random order.
    robots = states[np.argpartition(draw.random((count, len(states))), m - 1, axis=1)[:, :m]]
    luck = draw.random((count, m))
    every = np.arange(count)
    best = robots[every, np.argmax(known[robots], axis=1)]
    out = np.empty((2, len(bids)))
    for i, bid in enumerate(bids):
        chosen = robots[every, np.lexsort((luck, bid[robots]), axis=1)[:, -1]]
        # Gains are equal only at states at which help changes nothing.
        out[:, i] = (known[chosen] >= known[best]).mean(), (judged[best] - judged[chosen]).mean()
    return out


@dataclasses.dataclass(frozen=True)
class BidStatistics:
    """True gains of states at which a robot bids, because its predicted gain exceeds 1, and others.

    Attributes:
      ask_rate: share of the states at which the robot bids.
      pays: share of the states at which help pays: the true gain exceeds 1.
      pays_if_bid, pays_if_not: the same among states with a bid, and among the others.
      harms_if_bid, harms_if_not: share of the states at which the true gain is below -1.
      gain_if_bid, gain_if_not: mean true gain.
    """

    ask_rate: float
    pays: float
    pays_if_bid: float
    pays_if_not: float
    harms_if_bid: float
    harms_if_not: float
    gain_if_bid: float
    gain_if_not: float


def bid_statistics(bid: np.ndarray, forks: Forks) -> BidStatistics:
    """Compare the true gains of states with a bid and without."""
    asks, truth = bid > BID, forks.gain

    def mean(values: np.ndarray) -> float:
        return float(values.mean()) if len(values) else float("nan")

    return BidStatistics(
        ask_rate=mean(asks),
        pays=mean(truth > BID),
        pays_if_bid=mean(truth[asks] > BID),
        pays_if_not=mean(truth[~asks] > BID),
        harms_if_bid=mean(truth[asks] < -BID),
        harms_if_not=mean(truth[~asks] < -BID),
        gain_if_bid=mean(truth[asks]),
        gain_if_not=mean(truth[~asks]),
    )


def calibration(bid: np.ndarray, forks: Forks, groups: int = 5) -> list[tuple[float, Estimate]]:
    """Mean predicted and mean true gain of groups of equally many states, by predicted gain."""
    truth = forks.gain
    out = []
    for part in np.array_split(np.argsort(bid, kind="stable"), groups):
        true = bootstrap(lambda i, part=part: float(truth[part][i].mean()), forks.scene[part])
        out.append((float(bid[part].mean()), true))
    return out
