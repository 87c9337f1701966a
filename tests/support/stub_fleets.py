"""Fleets whose robots do as a test says, to make tables of."""

import math

from pgf_jax.fleet import Fleet, FleetConfig
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.planning.types import Push


def run(policy="or-hitl", *, robots=1, tasks=3, iterate=None, decide=lambda work: None, **changes):
    stub = StubRobots(iterate or (lambda work: outcome(feasible=True)), decide)
    config = FleetConfig(robots=robots, tasks=tasks, policy=policy, **changes)
    fleet = Fleet(config, stub)
    drive([(fleet, stub)])
    return fleet


def solved_after(iterations):
    """Task i is solved in iterations[i] iterations; None: never, and stuck all along."""

    def iterate(work):
        wanted = iterations[work.task]
        return outcome(
            feasible=wanted is not None and work.iteration >= wanted,
            stuck=wanted is None,
            gain=float(work.iteration) if work.iteration > 3 else math.nan,
        )

    return iterate


def mixed(work):
    """Pushes, failures, gains and costs that are not finite."""
    if work.task == 1:
        return outcome(cost=math.inf, non_finite=True, stuck=work.iteration > 4)
    return outcome(
        feasible=work.iteration > 6, stuck=work.iteration == 2 + work.robot, gain=work.iteration
    )


def mixed_fleet(**changes):
    return run(
        "pgf",
        robots=3,
        tasks=3,
        iterate=mixed,
        decide=lambda work: Push(work.robot, 0.4, 0.1),
        **changes,
    )
