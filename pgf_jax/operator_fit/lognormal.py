"""A log-normal distribution fitted to service times, some of which are only known to be longer.

A service that ended without an input (the task's limit, the operator's silence, the horizon) would
have lasted longer: it is right-censored at its length. The fit is the maximum of the likelihood
with that. Its intervals are bias-corrected percentiles of a bootstrap over services with a fixed
seed. Of 1000 simulated samples with sd = mean / 2, those for 95 % held the mean and the sd in: 89 %
and 80 % at 10 answers each, 93 % and 88 % at 20, 92 % and 91 % at 40.
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
NO_ANSWER = ("expired", "unanswered", "censored")
FEW = 20  # answers, below which the fit comes with a warning
BOOTSTRAP = 1000
LONGEST = 1e9  # s; a log's clock counts to 9.2e9

Range = tuple[float, float]


class Service(NamedTuple):
    """One service.

    Attributes:
      seconds: from its grant to its end.
      outcome: of `ANSWERS`, or of `NO_ANSWER`: it would have lasted longer.
      draw: services that share it are not independent: the bootstrap keeps them together. Fleets of
        one sweep draw the n-th input's time of a task only once (common random numbers).
    """

    seconds: float
    outcome: str
    draw: Hashable


@dataclasses.dataclass(frozen=True)
class ServiceSample:
    """Services of one log or of several.

    Attributes:
      services: in the order of their ends.
      cut_off: grants without an end, of logs that break off: they are not among the services.
    """

    services: tuple[Service, ...]
    cut_off: int = 0


@dataclasses.dataclass(frozen=True)
class Fit:
    """A log-normal distribution of service times; what `LogNormal` and the sweeps take.

    Attributes:
      mean_s, sd_s: `--service-mean` and `--service-sd` of a sweep.
      median_s: exp(mu), of the mean mu of ln(s).
      sigma: standard deviation of ln(s).
      mean_interval_s, sd_interval_s, median_interval_s: 95 %, by the bootstrap; None where there
        are less than two draws with an answer.
      answered: services with an answer.
      without_answer: services without, that are right-censored.
      draws: independent ones among the answers; fewer than those only in logs of sweeps.
      cut_off: services whose end the logs do not hold, and that are left out.
      push_share: of the answers, those that are pushes.
      ks: largest distance between the fit's distribution function and the empirical one
        (Kaplan-Meier's, which allows for the censored). No test: its level is not that of a
        distribution chosen beforehand.
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
        """How to sweep with it."""
        return f"pgf-jax sweep --service-mean {self.mean_s:.3g} --service-sd {self.sd_s:.3g}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to keep in mind, one line each."""
        lines = []
        if self.draws < FEW:
            lines.append(f"fewer than {FEW} answers ({self.draws}): the intervals are too narrow")
        if self.without_answer > self.answered:
            lines.append("most services had no answer: the fit is an extrapolation")
        return tuple(lines)

    def cdf(self, seconds: np.ndarray) -> np.ndarray:
        """Share of services that take no longer."""
        if self.sigma == 0:
            return (seconds >= self.median_s).astype(float)
        return 1 - _survival((_log(seconds) - math.log(self.median_s)) / self.sigma)


def fit(sample: ServiceSample, *, seed: int = 0) -> Fit:
    """The log-normal distribution of the greatest likelihood.

    Services that all take equally long have sd 0. A service of 0 s beside others that are longer
    has no place in a log-normal distribution and is refused, rather than given a length that would
    decide the fit.

    Args:
      sample: with one answer or more.
      seed: of the bootstrap.

    Raises:
      BadInput: no answer, an answer after 0 s, or a spread without bounds.
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
    """[n] lengths of a sample's services, s, and [n] whether they were answered."""
    seconds = np.array([service.seconds for service in sample.services], dtype=float)
    answered = np.array([service.outcome in ANSWERS for service in sample.services], dtype=bool)
    return seconds, answered


def _log(seconds: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(seconds)  # -inf at 0


def _constant(times: np.ndarray, limits: np.ndarray) -> bool:
    """Whether the likelihood grows without bounds towards a constant; times or their logarithms."""
    return times.min() == times.max() and limits.max(initial=-np.inf) <= times[0]


def _moments(mu: float, sigma: float) -> tuple[float, float, float]:
    """(mean, sd, median) of the log-normal; inf beyond the floats."""
    with np.errstate(over="ignore"):
        median, mean = float(np.exp(mu)), float(np.exp(mu + sigma**2 / 2))
        sd = mean * float(np.sqrt(np.expm1(sigma**2))) if sigma else 0.0
    return mean, sd, median


def _maximum(logs: np.ndarray, answered: np.ndarray, weights: np.ndarray) -> Range:
    """(mu, sigma) of the greatest weighted likelihood of ln(s), right-censored ones included.

    Newton's method on gamma = 1 / sigma and delta = mu / sigma, in which the log-likelihood is
    concave (Olsen 1978, Econometrica 46, 1211): with steps that never lower it, it finds the one
    maximum.
    """
    # At weight 0 a service is not there, and censored at 0 s (-inf) it says nothing.
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
        rise = float(gradient @ step)  # twice what a whole step gains, if it is small
        if rise < 1e-12 * total:  # and the next would be of its square
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
    """Density over survival; far out, where both vanish, Laplace's continued fraction."""
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

    Corrected for bias (Efron 1981): small samples understate the sd, and samples of samples more.
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
        # Values as they are: between two of them there may be infinity.
        low, high = np.quantile(values, levels, method="nearest")
        ranges.append((float(low), float(high)))
    return ranges


def kaplan_meier(seconds: np.ndarray, answered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(all lengths in order, share of services that take no longer than each)."""
    lengths, where = np.unique(seconds, return_inverse=True)
    ended = np.bincount(where, weights=answered)
    there = np.cumsum(np.bincount(where)[::-1])[::-1]  # no shorter
    return lengths, 1 - np.cumprod(1 - ended / there)


def _distance(result: Fit, seconds: np.ndarray, answered: np.ndarray) -> float:
    """Kolmogorov's and Smirnov's, up to the longest service; 0 for a constant, by definition."""
    if result.sd_s == 0:
        return 0.0
    lengths, after = kaplan_meier(seconds, answered)
    fitted = result.cdf(lengths)
    before = np.concatenate([[0.0], after[:-1]])
    return float(np.maximum(np.abs(fitted - before), np.abs(fitted - after)).max())
