"""The fleet against queueing theory: stub robots whose every iteration ends in an ask.

An iteration then is the time between asks: it is made exponential through the compute model, which
is free to give every iteration a length of its own. Intervals are 99 %, so that a right simulation
of another seed would fail once in a hundred; each test also bounds the interval's width.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from pgf_jax.fleet import Event, EventKind, Fleet, FleetConfig
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.metrics.summary import Interval, busy_ns, mean_interval

DRAWS = 1 << 16  # per robot; read cyclically, far fewer are used


class Draws:
    """Planning times and service times in s, both drawn beforehand by (robot, number)."""

    def __init__(self, robots: int, think: Callable, serve: Callable, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.think = think(rng, (robots, DRAWS))  # [R, DRAWS]
        self.serve = serve(rng, (robots, DRAWS))  # [R, DRAWS]

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        # A rollout of 0.5 s: iteration 0 would take 0.5 s, every other one 1 s.
        return float(self.think[robot, iteration]) * (1 if iteration else 2)

    def seconds(self, robot: int, task: int, request: int) -> float:
        return float(self.serve[robot, request])


def exponential(mean: float) -> Callable:
    return lambda rng, size: rng.exponential(mean, size)


def constant(value: float) -> Callable:
    return lambda rng, size: np.full(size, value)


def simulate(policy: str, robots: int, think: Callable, serve: Callable, hours: float, **config):
    draws = Draws(robots, think, serve, seed=2)
    stub = StubRobots(lambda work: outcome(gain=9.0, stuck=policy != "pgf"))
    fleet = Fleet(
        FleetConfig(
            robots=robots,
            tasks=1,
            policy=policy,
            rollout_time_s=0.5,
            task_limit_s=1e9,
            horizon_s=3600 * hours,
            **config,
        ),
        stub,
        service=draws,
        compute=draws,
    )
    drive([(fleet, stub)])
    return fleet


def covers(interval: Interval, value: float, *, width: float) -> None:
    """The interval holds the value and is no wider than `width` times it."""
    assert interval.high - interval.low < width * value
    assert interval.low < value < interval.high


def answered(fleet: Fleet) -> list[Event]:
    return [e for e in fleet.events if e.kind is EventKind.SERVICE_END and e.outcome != "censored"]


@pytest.mark.parametrize(
    "serve",
    [
        exponential(2.0),
        constant(2.0),
        lambda rng, size: rng.lognormal(math.log(2.0) - 0.5, 1.0, size),
    ],
    ids=["exponential", "constant", "lognormal"],
)
def test_refuse_when_busy_throughput_whatever_the_service_distribution(serve):
    rate, robots, window, mean = 0.05, 6, 2.0, 2.0
    fleet = simulate("pgf", robots, exponential(1 / rate), serve, hours=25.0, window_s=window)
    expected = robots * rate / (1 + robots * rate * (window + mean))
    # Services end at the epochs of a renewal process: times between them are independent.
    ends = np.array([event.time_ns for event in answered(fleet)]) / 1e9
    covers(mean_interval(np.diff(ends).tolist(), confidence=0.99), 1 / expected, width=0.05)


def test_refuse_when_busy_without_windows():
    rate, robots, mean = 0.05, 6, 2.0
    fleet = simulate("or-hitl", robots, exponential(1 / rate), exponential(mean), hours=15.0)
    expected = robots * rate / (1 + robots * rate * mean)
    ends = np.array([event.time_ns for event in answered(fleet)]) / 1e9
    covers(mean_interval(np.diff(ends).tolist(), confidence=0.99), 1 / expected, width=0.05)
    # The asks themselves come at rate R lam while the operator is free, and from the R - 1 others
    # while it is busy; those are refused. Per service: (R - 1) lam S of them.
    asks = sum(event.kind is EventKind.REFUSED for event in fleet.events)
    per_service = asks / len(ends)
    assert abs(per_service - 0.5) < 4 * math.sqrt(0.75 / len(ends))  # geometric: variance p + p^2


def test_robots_in_line_are_the_machine_repair_model():
    # M/M/1//R with R = 6, lam = 0.05, S = 2, worked out from the birth-death chain.
    robots, rate, mean = 6, 0.05, 2.0
    weights = [math.perm(robots, n) * (rate * mean) ** n for n in range(robots + 1)]
    p = np.array(weights) / sum(weights)
    waiting_or_served = float(np.arange(robots + 1) @ p)
    wait = (waiting_or_served - (1 - p[0])) / (rate * (robots - waiting_or_served))
    assert p[0] == pytest.approx(0.48451, abs=5e-6)
    assert waiting_or_served == pytest.approx(0.84515, abs=5e-6)
    assert wait == pytest.approx(1.27904, abs=5e-6)

    fleet = simulate("queue", robots, exponential(1 / rate), exponential(mean), hours=50.0)
    batches = 30
    horizon = fleet.now_ns
    edges = [horizon * k // batches for k in range(batches + 1)]
    present, busy = time_averages(fleet.events, edges)
    covers(mean_interval((1 - busy).tolist(), confidence=0.99), float(p[0]), width=0.06)
    covers(mean_interval(present.tolist(), confidence=0.99), waiting_or_served, width=0.06)
    waits = [[] for _ in range(batches)]
    since = {}
    for event in fleet.events:
        if event.kind is EventKind.BID:
            since[event.robot] = event.time_ns
        elif event.kind is EventKind.GRANT:
            batch = min(since[event.robot] * batches // horizon, batches - 1)
            waits[batch].append((event.time_ns - since[event.robot]) / 1e9)
    means = [float(np.mean(batch)) for batch in waits]
    covers(mean_interval(means, confidence=0.99), wait, width=0.12)


def time_averages(events: list[Event], edges: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Number of robots in line or served, and of busy operators, averaged within each batch."""
    # Who is still in line or served at the horizon leaves then: no area is left after that.
    moments = np.array(edges, dtype=np.int64)
    leaving = area(events, EventKind.SERVICE_END, moments)
    present = area(events, EventKind.BID, moments) - leaving
    busy = area(events, EventKind.GRANT, moments) - leaving
    return np.diff(present) / np.diff(moments), np.diff(busy) / np.diff(moments)


def area(events: list[Event], kind: EventKind, moments: np.ndarray) -> np.ndarray:
    """Integral over time, up to each moment, of how many events of a kind there were before."""
    times = np.array([event.time_ns for event in events if event.kind is kind], dtype=np.int64)
    return np.array([float((moment - times[times <= moment]).sum()) for moment in moments])


@pytest.mark.parametrize("robots", range(1, 9))
def test_fan_out_knee(robots):
    # Z = 6, S = 2, both constant: X = min(R / (Z + S), 1 / S) exactly, the knee at R* = 4.
    think, serve = 6.0, 2.0
    knee = (think + serve) / serve
    fleet = simulate("queue", robots, constant(think), constant(serve), hours=1.0)
    ends = [event.time_ns / 1e9 for event in answered(fleet)]
    settled = [end for end in ends if 1000 < end <= 3400]  # whole periods of Z + S and of S
    expected = min(robots / (think + serve), 1 / serve)
    assert len(settled) == expected * 2400
    utilisation = busy_ns(fleet.events) / fleet.now_ns
    assert utilisation == pytest.approx(min(1.0, robots / knee), abs=0.01)
