"""Fleets of any settings, whose robots have random outcomes."""

import numpy as np
from fleet_script import PUSH
from hypothesis import strategies as st

from pgf_jax.fleet import Fleet, FleetConfig, IterationResult, Work
from pgf_jax.fleet.policies import policy_names
from pgf_jax.fleet.stub import StubRobots, drive
from pgf_jax.planning.types import Push

CONFIGS = st.builds(
    FleetConfig,
    robots=st.integers(1, 6),
    tasks=st.integers(1, 3),
    policy=st.sampled_from(policy_names()),
    operators=st.integers(1, 3),
    # Multiples of the rollout time make ties the rule and not the exception.
    window_s=st.sampled_from([0.0, 1.5, 2.0, 4.0]),
    service_mean_s=st.sampled_from([0.0, 3.0, 8.0, 40.0]),
    service_sd_s=st.just(0.0),
    context_switch_s=st.sampled_from([0.0, 1.5]),
    compute=st.sampled_from(["dedicated", "shared:16"]),
    horizon_s=st.sampled_from([None, 20.0, 45.0]),
    task_limit_s=st.sampled_from([3.0, 20.0, 60.0]),
    push_limit_s=st.sampled_from([1.0, 6.0, 30.0]),
    seed=st.integers(0, 5),
    while_asking=st.sampled_from([None, "wait", "plan"]),
    while_served=st.sampled_from([None, "wait", "plan"]),
)


def noisy_robots(seed: int) -> StubRobots:
    """Robots of random outcomes, keyed by the work alone."""

    def iterate(work: Work) -> IterationResult:
        rng = np.random.default_rng((seed, 0, work.robot, work.task, work.iteration))
        feasible, stuck, non_finite = rng.random(3) < (0.15, 0.4, 0.05)
        gain = float(rng.choice([np.nan, 0.5, 3.0, 7.0]))
        cost = float("inf") if non_finite else float(rng.random())
        return IterationResult(
            bool(feasible), bool(stuck), gain, (cost, 0.0, 0.0), cost, bool(non_finite)
        )

    def decide(work: Work) -> Push | None:
        rng = np.random.default_rng((seed, 1, work.robot, work.task, work.request or 0))
        return PUSH if rng.random() < 0.6 else None

    return StubRobots(iterate, decide)


def simulate(config: FleetConfig, seed: int) -> tuple[Fleet, StubRobots]:
    robots = noisy_robots(seed)
    fleet = Fleet(config, robots)
    drive([(fleet, robots)])
    return fleet, robots
