"""Fits a log-normal distribution to service times, some of which are right-censored.

A service that ended without an input (at the task's limit, at the horizon, because the operator did
not answer, or because the robot found its way meanwhile) would have lasted longer: it is
right-censored at its length. The fit maximises the
likelihood of such data. Its intervals are bias-corrected percentiles of a bootstrap over services
with a fixed seed. In 1000 simulated samples with sd = mean / 2, the 95 % intervals contained the
mean and the sd in 89 % and 80 % of the samples at 10 answers each, in 93 % and 88 % at 20, in 92 %
and 91 % at 40.
"""

import dataclasses
import math
from collections.abc import Hashable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.streams import stream

ANSWERS = ("push", "go_on")
NO_ANSWER = ("expired", "unanswered", "censored", "solved_meanwhile")
FEW = 20  # with fewer answers, the fit has a warning
BOOTSTRAP = 1000  # number of bootstrap samples
LONGEST = 1e9  # s, of mean + sd; times in a log end at 9.2e9

Range = tuple[float, float]


class Service(NamedTuple):
    """One service.

    Attributes:
      seconds: from its grant to its end.
      outcome: one of `ANSWERS`, or of `NO_ANSWER`: then it would have lasted longer.
      draw: key of the random draw; services with the same key are not independent, and the
        bootstrap keeps them together. The fleets of one sweep draw the time of a task's n-th input
        only once (common random numbers).
    """

    seconds: float
    outcome: str
    draw: Hashable


@dataclasses.dataclass(frozen=True)
class ServiceSample:
    """The services of one log or of several logs.

    Attributes:
      services: in the order of their ends.
      cut_off: grants without an end, where a log breaks off; they are not among the services.
    """

    services: tuple[Service, ...]
    cut_off: int = 0


@dataclasses.dataclass(frozen=True)
class Fit:
    """A fitted log-normal distribution of service times, as `LogNormal` and sweeps take it.

    Attributes:
      mean_s, sd_s: `--service-mean` and `--service-sd` of a sweep.
      median_s: exp(mu), of the mean mu of ln(s).
      sigma: standard deviation of ln(s).
      mean_interval_s, sd_interval_s, median_interval_s: 95 %, by the bootstrap; None where there
        are fewer than two draws with an answer.
      answered: services with an answer.
      without_answer: services without an answer; they are right-censored.
      draws: independent draws among the answers; fewer than answers only in logs of sweeps.
      cut_off: services whose end is not in the logs; they are left out.
      push_share: share of the answers that are pushes.
      ks: largest distance between the fit's distribution function and the empirical one
        (Kaplan-Meier's, which allows for censoring). It is no test, because the distribution was
        fitted to the same data.
    """

    mean_s: float
    sd_s: float
    median_s: float
    sigma: float
    mean_interval_s: Range | None
    sd_interval_s: Range | None
    median_interval_s: Range | None
    answered: int
    without_answer: int
    draws: int
    cut_off: int
    push_share: float
    ks: float

    @property
    def command(self) -> str:
        """The command line of a sweep with this distribution."""
        return f"pgf-jax sweep --service-mean {self.mean_s:.3g} --service-sd {self.sd_s:.3g}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the fit, one line each."""
        lines = []
        if self.draws < FEW:
            lines.append(f"fewer than {FEW} answers ({self.draws}): the intervals are too narrow")
        if self.without_answer > self.answered:
            lines.append("most services had no answer: the fit is an extrapolation")
        return tuple(lines)

    def cdf(self, seconds: np.ndarray) -> np.ndarray:
        """Share of services that take at most this time."""
        if self.sigma == 0:
            return (seconds >= self.median_s).astype(float)
        return 1 - _survival((_log(seconds) - math.log(self.median_s)) / self.sigma)


def fit(sample: ServiceSample, *, seed: int = 0) -> Fit:
    """Fit the log-normal distribution of maximum likelihood.

    Services of equal length give sd 0. An answer after 0 s beside longer answers is refused: it has
    no place in a log-normal distribution, and any length given to it would decide the fit.

    Args:
      sample: has one answer or more.
      seed: seed of the bootstrap.

    Raises:
      BadInput: no answer, an answer after 0 s, or an unbounded spread.
    """
    seconds, answered = arrays(sample)
    times, limits = seconds[answered], seconds[~answered]
    if len(times) == 0:
        raise BadInput(
            f"no service had an answer ({len(limits)} without): nothing says how long one takes"
        )
    zeros = int(np.sum(times == 0))
    if zeros and times.max() > 0:
        raise BadInput(
            f"{zeros} of {len(times)} answers took 0 s, which no log-normal service time does"
        )
    ids = {draw: i for i, draw in enumerate(dict.fromkeys(s.draw for s in sample.services))}
    draws = np.array([ids[s.draw] for s in sample.services])
    if _constant(times, limits):
        mean = median = float(times[0])
        sd = sigma = 0.0
        intervals = [(mean, mean), (sd, sd), (median, median)]
    else:
        logs = _log(seconds)
        mu, sigma = _maximum(logs, answered, np.ones(len(logs)))
        mean, sd, median = _moments(mu, sigma)
        if not mean + sd < LONGEST:
            raise BadInput(
                f"{len(times)} answers beside {len(limits)} services without one are too few to fit"
            )
        intervals = _bootstrap(logs, answered, draws, (mean, sd, median), seed)
    independent = len(np.unique(draws[answered]))
    if independent < 2:
        intervals = [None] * 3
    pushes = sum(service.outcome == "push" for service in sample.services)
    result = Fit(
        mean_s=mean,
        sd_s=sd,
        median_s=median,
        sigma=sigma,
        mean_interval_s=intervals[0],
        sd_interval_s=intervals[1],
        median_interval_s=intervals[2],
        answered=len(times),
        without_answer=len(limits),
        draws=independent,
        cut_off=sample.cut_off,
        push_share=pushes / len(times),
        ks=math.nan,
    )
    return dataclasses.replace(result, ks=_distance(result, seconds, answered))


def arrays(sample: ServiceSample) -> tuple[np.ndarray, np.ndarray]:
    """[n] lengths of a sample's services, s, and [n] bool: whether they were answered."""
    seconds = np.array([service.seconds for service in sample.services], dtype=float)
    answered = np.array([service.outcome in ANSWERS for service in sample.services], dtype=bool)
    return seconds, answered


def _log(seconds: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(seconds)  # -inf at 0


def _constant(times: np.ndarray, limits: np.ndarray) -> bool:
    """Whether the likelihood is unbounded at a constant; for times or their logarithms."""
    return times.min() == times.max() and limits.max(initial=-np.inf) <= times[0]


def _moments(mu: float, sigma: float) -> tuple[float, float, float]:
    """(mean, sd, median) of the log-normal distribution; inf where too large for a float."""
    with np.errstate(over="ignore"):
        median, mean = float(np.exp(mu)), float(np.exp(mu + sigma**2 / 2))
        sd = mean * float(np.sqrt(np.expm1(sigma**2))) if sigma else 0.0
    return mean, sd, median


def _maximum(logs: np.ndarray, answered: np.ndarray, weights: np.ndarray) -> Range:
    """(mu, sigma) of maximum weighted likelihood of ln(s), some of which are right-censored.

    Newton's method on gamma = 1 / sigma and delta = mu / sigma, in which the log-likelihood is
    concave (Olsen 1978, Econometrica 46, 1211). Steps never lower it, so that the method finds the
    only maximum.
    """
    # Services of weight 0 are not in the sample; those censored at 0 s (-inf) carry no information.
    keep = (weights > 0) & (logs > -np.inf)
    logs, answered, weights = logs[keep], answered[keep], weights[keep]
    if _constant(logs[answered], logs[~answered]):
        return float(logs[answered][0]), 0.0
    centre, scale = float(logs[answered].mean()), float(logs.std())
    logs = (logs - centre) / scale
    x, w = logs[answered], weights[answered]
    c, v = logs[~answered], weights[~answered]
    total, first, second = float(w.sum()), float(w @ x), float(w @ x**2)
    if len(c) == 0:
        mu = first / total
        return centre + scale * mu, scale * math.sqrt(float(w @ (x - mu) ** 2) / total)

    def value(gamma: float, delta: float) -> float:
        squares = gamma**2 * second - 2 * gamma * delta * first + delta**2 * total
        return total * math.log(gamma) - squares / 2 + float(v @ _log_survival(gamma * c - delta))

    gamma, delta = 1.0, 0.0
    current = value(gamma, delta)
    for _ in range(100):
        z = gamma * c - delta
        hazard = _hazard(z)
        bend = v * hazard * (hazard - z)
        gradient = np.array(
            [
                total / gamma - gamma * second + delta * first - float(v @ (hazard * c)),
                gamma * first - delta * total + float(v @ hazard),
            ]
        )
        cross = first + float(bend @ c)
        hessian = np.array(
            [
                [total / gamma**2 + second + float(bend @ c**2), -cross],
                [-cross, total + float(bend.sum())],
            ]
        )
        step = np.linalg.solve(hessian, gradient)
        rise = float(gradient @ step)  # twice what a whole step gains, if the step is small
        if rise < 1e-12 * total:  # the next rise would be of the order of its square
            gamma, delta = gamma + step[0], delta + step[1]
            break
        part = 1.0
        while gamma + part * step[0] <= 0 or (
            (new := value(gamma + part * step[0], delta + part * step[1])) < current
        ):
            part /= 2
        gamma, delta, current = gamma + part * step[0], delta + part * step[1], new
    return centre + scale * float(delta / gamma), scale / float(gamma)


def _survival(z: np.ndarray) -> np.ndarray:
    """P(Z > z) of a standard normal variable."""
    return np.array([math.erfc(value) / 2 for value in (z * math.sqrt(0.5)).tolist()])


def _hazard(z: np.ndarray) -> np.ndarray:
    """Density over survival; above z = 30, where both vanish, Laplace's continued fraction."""
    far = np.maximum(z, 30.0)
    fraction = far
    for k in range(6, 0, -1):
        fraction = far + k / fraction
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.exp(-(z**2) / 2) / (math.sqrt(2 * math.pi) * _survival(z))
    return np.where(z > 30.0, fraction, near)


def _log_survival(z: np.ndarray) -> np.ndarray:
    far = np.maximum(z, 30.0)
    tail = -(far**2) / 2 - np.log(math.sqrt(2 * math.pi) * _hazard(far))
    return np.where(z > 30.0, tail, _log(_survival(np.minimum(z, 30.0))))


def _bootstrap(
    logs: np.ndarray, answered: np.ndarray, draws: np.ndarray, fitted: Sequence[float], seed: int
) -> list[Range | None]:
    """95 % ranges of mean, sd and median over samples of draws, taken with replacement.

    They are corrected for bias (Efron 1981): small samples understate the sd, and bootstrap samples
    understate it more.
    """
    rng = stream(seed, "bootstr")
    count = int(draws.max()) + 1
    rows = []
    while len(rows) < BOOTSTRAP:
        weights = np.bincount(rng.integers(count, size=count), minlength=count)[draws]
        if weights[answered].any():  # a sample without an answer has no fit
            rows.append(_moments(*_maximum(logs, answered, weights)))
    ranges: list[Range | None] = []
    normal = NormalDist()
    for values, value in zip(np.array(rows).T, fitted, strict=True):
        below = float(np.mean(values < value) + np.mean(values == value) / 2)
        bias = normal.inv_cdf(min(max(below, 1 / BOOTSTRAP), 1 - 1 / BOOTSTRAP))
        levels = [normal.cdf(2 * bias + normal.inv_cdf(p)) for p in (0.025, 0.975)]
        # No interpolation between values, because some may be infinite.
        low, high = np.quantile(values, levels, method="nearest")
        ranges.append((float(low), float(high)))
    return ranges


def kaplan_meier(seconds: np.ndarray, answered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Kaplan-Meier estimate: (all lengths in order, share of services of at most each)."""
    lengths, where = np.unique(seconds, return_inverse=True)
    ended = np.bincount(where, weights=answered)
    at_risk = np.cumsum(np.bincount(where)[::-1])[::-1]  # services of at least each length
    return lengths, 1 - np.cumprod(1 - ended / at_risk)


def _distance(result: Fit, seconds: np.ndarray, answered: np.ndarray) -> float:
    """Kolmogorov-Smirnov distance up to the longest service; 0 by definition for a constant."""
    if result.sd_s == 0:
        return 0.0
    lengths, after = kaplan_meier(seconds, answered)
    fitted = result.cdf(lengths)
    before = np.concatenate([[0.0], after[:-1]])
    return float(np.maximum(np.abs(fitted - before), np.abs(fitted - after)).max())
