"""How good predictions are: of costs on held-out runs, and of gains on forks.

Intervals are 95 % percentile bootstraps that resample whole scenes, because rows of one scene are
not independent of each other.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pgf_jax.streams import stream
from pgf_jax.tables.forks import Forks

RESAMPLES = 1000
BID = 1.0  # a robot bids when its gain exceeds this (D6)


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g}..{self.high:.3g})"


def bootstrap(
    figure: Callable[[np.ndarray], float], scene: np.ndarray, resamples: int = RESAMPLES
) -> Estimate:
    """`figure(index)` of all rows, with an interval from scenes drawn with replacement.

    Args:
      figure: of the rows with these indices; an index may come more than once.
      scene: [M] the scene of each row.
      resamples: how many.
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
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(error))))


def mae(error: np.ndarray) -> float:
    """Mean magnitude; what the published code calls RMSE."""
    return float(np.mean(np.abs(error)))


@dataclasses.dataclass(frozen=True)
class Errors:
    """Errors of a prediction of costs.

    Attributes:
      rmse, mae: in units of cost.
      to_last: its RMSE over that of the last cost, and `to_mean` over that of the mean.
    """

    rmse: Estimate
    mae: Estimate
    to_last: Estimate
    to_mean: Estimate


def cost_errors(
    predicted: np.ndarray, target: np.ndarray, last: np.ndarray, mean: float, scene: np.ndarray
) -> Errors:
    """Errors of predicted costs, beside those of two trivial predictors.

    Args:
      predicted, target: [M] costs.
      last: [M] the cost at the moment of prediction, as if nothing would change.
      mean: of the targets that the predictor was trained on.
      scene: [M].
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
    """RMSE and MAE of who knows a state's costs but for the noise to come.

    Args:
      costs: [F, K] of F states under K keys.

    Returns:
      The root of the mean variance over keys, unbiased; and the mean distance of a cost to the
      median of the state's other ones.
    """
    keys = costs.shape[1]
    others = [np.median(np.delete(costs, k, axis=1), axis=1) for k in range(keys)]
    away = np.abs(costs - np.stack(others, axis=1))
    return float(np.sqrt(costs.var(axis=1, ddof=1).mean())), float(away.mean())


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's; equal values share the mean of their ranks. nan where one is constant."""
    x, y = _ranks(a), _ranks(b)
    x, y = x - x.mean(), y - y.mean()
    scale = np.sqrt((x**2).sum() * (y**2).sum())
    return float((x * y).sum() / scale) if scale > 0 else float("nan")


def _ranks(values: np.ndarray) -> np.ndarray:
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[group]


@dataclasses.dataclass(frozen=True)
class Choice:
    """How bids choose among m robots.

    Attributes:
      hit: share of windows in which the robot with the largest true gain is chosen.
      regret: the largest true gain less the chosen robot's, mean over windows, units of cost.
      to: its regret over that of another one's bids, by name.
    """

    hit: Estimate
    regret: Estimate
    to: Mapping[str, Estimate]


def windows(
    bids: Mapping[str, np.ndarray],
    forks: Forks,
    m: int,
    *,
    beside: Sequence[str] = (),
    count: int = 4000,
    resamples: int = 200,
) -> dict[str, Choice]:
    """Choose one of m robots by their bids, in windows of m states drawn at random.

    Args:
      bids: [F] of each kind of bidder, in the same windows; of equal bids, a random one wins.
      forks: the states.
      m: robots in a window.
      beside: names of bidders to whose regret the others' is compared.
      count: windows.
      resamples: of the states, for the intervals.
    """
    truth, stack = forks.gain, np.stack(list(bids.values()))
    states = np.arange(len(truth))
    value = _choose(stack, truth, truth, states, m, count, 0)
    draw = stream(1, "window", m)
    drawn = np.array(
        [
            _choose(stack, truth, truth, draw.integers(len(states), size=len(states)), m, count, r)
            for r in range(1, resamples + 1)
        ]
    )  # [resamples, 2, bidders]

    def estimate(value: np.ndarray, drawn: np.ndarray) -> Estimate:
        low, high = np.quantile(drawn, (0.025, 0.975))
        return Estimate(float(value), float(low), float(high))

    names = list(bids)
    return {
        name: Choice(
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
    """Regret of who knows the gains under half the keys, judged by the other half: truth's noise.

    The halves take turns; regret is against the best by the half that judges.
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
    """[2, bidders]: share of windows with the best by `known` chosen, mean regret by `judged`."""
    draw = stream(seed, "windows", m)
    # m different ones of the states: the first m of a random order, window by window.
    robots = states[np.argpartition(draw.random((count, len(states))), m - 1, axis=1)[:, :m]]
    luck = draw.random((count, m))
    every = np.arange(count)
    best = robots[every, np.argmax(known[robots], axis=1)]
    out = np.empty((2, len(bids)))
    for i, bid in enumerate(bids):
        chosen = robots[every, np.lexsort((luck, bid[robots]), axis=1)[:, -1]]
        # Two gains are seldom equal, but for those of states at which help changes nothing.
        out[:, i] = (known[chosen] >= known[best]).mean(), (judged[best] - judged[chosen]).mean()
    return out


@dataclasses.dataclass(frozen=True)
class Bids:
    """What bidding when the predicted gain exceeds 1 is worth.

    Attributes:
      ask_rate: share of the states at which the robot would bid.
      pays: share at which help pays: the true gain exceeds 1.
      pays_if_bid, pays_if_not: the same among those that bid, and among the others.
      harms_if_bid, harms_if_not: share at which the true gain is below -1.
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


def bids(bid: np.ndarray, forks: Forks) -> Bids:
    """Whether the predicted sign says when not to ask."""
    asks, truth = bid > BID, forks.gain

    def mean(values: np.ndarray) -> float:
        return float(values.mean()) if len(values) else float("nan")

    return Bids(
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
    """Mean predicted gain and mean true gain of equally many states each, by predicted gain."""
    truth = forks.gain
    out = []
    for part in np.array_split(np.argsort(bid, kind="stable"), groups):
        true = bootstrap(lambda i, part=part: float(truth[part][i].mean()), forks.scene[part])
        out.append((float(bid[part].mean()), true))
    return out
