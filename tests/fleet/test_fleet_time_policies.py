"""The policies that rank by time, against integrals done by hand and by quadrature."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from fleet_script import PUSH, log, run
from registered import registered

from pgf_jax.fleet import FleetConfig
from pgf_jax.fleet.index import GainRate, RobotState, TimeSaved, Urgency
from pgf_jax.fleet.policies import POLICIES, TaskProgress, make_policy
from pgf_jax.fleet.robots import TimeLeft
from pgf_jax.fleet.stub import outcome
from pgf_jax.metrics.identities import verify

STEP = 3.0  # s: two rollouts of 1.5 s
LEFT = {0: (3, 1), 1: (6, 1)}  # iterations alone and helped, of two robots


def policy(name: str, **settings) -> Any:
    return make_policy(FleetConfig(policy=name, **{"service_sd_s": 0.0, **settings}))


def robot(alone, helped, *, remaining=1000.0, switch=0.0, robot=0) -> RobotState:
    state = RobotState(TaskProgress(robot, 0, 5, 0, remaining), outcome(), 0.0, switch)
    return seen(state, TimeLeft(tuple(alone), tuple(helped)))


def seen(state: RobotState, left: TimeLeft | None) -> RobotState:
    return state._replace(result=dataclasses.replace(state.result, time_left=left))


def certain(iterations: int) -> list[float]:
    """Solved at the end of that iteration."""
    return [float(k < iterations) for k in range(1, iterations + 1)]


def geometric(chance: float, number: int = 60) -> np.ndarray:
    return (1 - chance) ** np.arange(1, number + 1)


def value(name: str, one: RobotState, **settings) -> float:
    (found,) = policy(name, reservation=-1e9, **settings).index([one])
    return found


def test_time_saved_with_certain_times():
    """Alone 10 iterations (30 s), 2 from the answer on (6 s), which takes 8 s: 30 - 8 - 6 = 16."""
    one = robot(certain(10), certain(2))
    assert value("time-saved", one, service_mean_s=8.0) == pytest.approx(16.0)
    # Waiting: the service is spent as well, and that is the same here.
    assert value("time-saved", one, service_mean_s=8.0, while_served="wait") == pytest.approx(16.0)
    assert value("gain-rate", one, service_mean_s=8.0) == pytest.approx(24 / 8)
    assert value("gain-rate", one, service_mean_s=8.0, while_served="wait") == pytest.approx(2.0)
    assert value("urgency", one, service_mean_s=8.0) == pytest.approx(1 / 8)
    # Who has found its way before the answer comes is not helped by it.
    assert value("time-saved", robot(certain(2), certain(1)), service_mean_s=8.0) == 0.0
    assert value("time-saved", robot(certain(4), certain(2)), service_mean_s=8.0) == -2.0


def test_switching_counts_as_service():
    one = robot(certain(10), certain(2), switch=4.0)
    assert value("time-saved", one, service_mean_s=8.0) == pytest.approx(12.0)
    assert value("gain-rate", one, service_mean_s=8.0) == pytest.approx(2.0)
    assert value("urgency", one, service_mean_s=8.0) == pytest.approx(1 / 12)


def test_time_is_counted_up_to_the_limit_and_a_failure_costs_beside_it():
    """20 s are left, of 30 that it takes: 20 - 8 - 6 = 6; failing costs 100 s more."""
    one = robot(certain(10), certain(2), remaining=20.0)
    assert value("time-saved", one, service_mean_s=8.0) == pytest.approx(6.0)
    assert value("time-saved", one, service_mean_s=8.0, failure_cost_s=100.0) == pytest.approx(106)
    # An answer that comes after the limit, or too late for the push, saves nothing.
    assert value("time-saved", one, service_mean_s=21.0, failure_cost_s=100.0) == 0.0
    assert value("time-saved", one, service_mean_s=16.0, failure_cost_s=100.0) == 0.0


def test_time_saved_is_the_expectation_over_services_and_both_futures():
    """By quadrature over the same eight services, and against a Monte Carlo of the definition."""
    alone, helped, remaining = geometric(0.06), geometric(0.3), 100.0
    one = robot(alone, helped, remaining=remaining)
    found = value("time-saved", one, service_mean_s=8.0, service_sd_s=4.0)
    rng = np.random.default_rng(1)
    number = 400_000
    first = np.minimum(STEP * rng.geometric(0.06, number), remaining)
    second = STEP * rng.geometric(0.3, number)
    sigma = math.sqrt(math.log1p(0.25))
    service = 8.0 * np.exp(sigma * rng.standard_normal(number) - sigma**2 / 2)
    saved = first - np.minimum(service + second, remaining)
    assert found == pytest.approx(saved[service < first].sum() / number, rel=0.01)


@pytest.mark.parametrize("name", ["time-saved", "gain-rate", "urgency"])
def test_beyond_what_is_predicted_the_chance_stays(name):
    """Short curves of a constant chance are as good as long ones."""
    short = value(name, robot(geometric(0.1, 5), geometric(0.4, 5), remaining=300.0))
    long = value(name, robot(geometric(0.1, 200), geometric(0.4, 200), remaining=300.0))
    assert short == pytest.approx(long, rel=1e-9)


def test_with_equal_services_and_help_that_solves_at_once_all_order_alike():
    """Exponential times: who is least likely to get on alone comes first."""
    chances = [0.3, 0.02, 0.1, 0.5, 0.05]
    robots = [robot(geometric(c, 900), certain(1), remaining=2600.0) for c in chances]
    for name in ("time-saved", "gain-rate", "urgency"):
        found = policy(name, reservation=-1e9).index(robots)
        assert np.argsort(found).tolist() == np.argsort(chances)[::-1].tolist(), name


def test_a_short_history_and_the_reservation_value_mask_robots():
    one = robot(certain(10), certain(2))
    unknown = seen(one, None)
    index = policy("time-saved", reservation=20.0, service_mean_s=8.0).index
    assert index([one, unknown]) == [None, None]
    index = policy("time-saved", service_mean_s=8.0).index
    assert index([one, unknown]) == [16.0, None]
    assert index([]) == []


def test_names_and_defaults():
    kinds = {"time-saved": TimeSaved, "oracle-time": TimeSaved, "gain-rate": GainRate}
    for name, kind in {**kinds, "urgency": Urgency}.items():
        made = policy(name)
        assert type(made) is kind and made.plans_on and made.discipline == "index"
        assert made.step_s == STEP
    services = policy("time-saved", service_sd_s=4.0).services_s
    assert len(services) == 8 and np.mean(services) == pytest.approx(8.0, rel=0.03)


def test_the_robot_that_saves_most_is_served_first():
    """Both plan on; at 4.5 s robot 1 could save more, and is given its answer at 8.5 s."""

    class ByScript(TimeSaved):
        def index(self, robots):
            left = {n: TimeLeft(*(tuple(certain(k)) for k in LEFT[n])) for n in LEFT}
            return super().index([seen(one, left[one.progress.robot]) for one in robots])

    def make(config):
        return ByScript(STEP, (4.0,), 4.0, 0.0, 0.0, True)

    with registered(POLICIES, scripted=make):
        fleet, _ = run(
            {0: ". . . . f", 1: ". . . . . . f"},
            robots=2,
            policy="scripted",
            service=4.0,
            inputs={(1, 0, 0): PUSH},
        )
        verify(fleet.config, fleet.records, fleet.events)
    grants = [line for line in log(fleet) if " grant " in line or " bid " in line]
    # Robot 1 could save 18 - 4 - 3 s; then robot 0, by its last iteration, 9 - 4 - 3 s.
    assert grants[:2] == ["1.5 bid r1.0 q0 i0 gain=11", "1.5 grant r1.0 q0 o0"]
    assert grants[2] == "5.5 bid r0.0 q0 i1 gain=2"
