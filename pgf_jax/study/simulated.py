"""Runs blocks of a study without people: a fleet each, with an operator in a person's place."""

import dataclasses
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.fleet import Fleet
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.fleet.service import ServiceTimes
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.simulation.fleet_spec import FleetSpec
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.study.analysis import block_measures
from pgf_jax.study.records import Input, inputs_of
from pgf_jax.sweeping.resolve import resolve

SOMEBODY = "heuristic"  # gives the inputs where no person does


class Simulated(NamedTuple):
    """A block to run.

    Attributes:
      config: of its session.
      service: how long services last; None: as the session's settings say.
      operator: gives the inputs; None: the operator `heuristic`.
      label: of the caller's.
      bind: is given the robots before the first event.
    """

    config: ConsoleConfig
    service: ServiceTimes | None = None
    operator: AnyOperator | None = None
    label: Any = None
    bind: Callable[[PlannedRobots], None] = lambda robots: None


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a block.

    Attributes:
      block: that was run.
      records: of its tasks.
      inputs: its services.
      fleet: at its end.
    """

    block: Simulated
    records: Sequence[TaskRecord]
    inputs: Sequence[Input]
    fleet: Fleet

    @property
    def measures(self) -> dict[str, float]:
        """See `analysis.block_measures`."""
        seconds = max((event.time_ns for event in self.fleet.events), default=0) / 1e9
        return block_measures(self.records, self.inputs, seconds)


def run_blocks(
    blocks: Sequence[Simulated], said: Callable[[int], None] = lambda count: None
) -> list[Outcome]:
    """Run blocks to their ends, together; the result of each is the same in any company.

    Args:
      blocks: to run. Those without an operator of their own share their searches.
      said: told how many have ended.

    Returns:
      Their outcomes, in the order of `blocks`.
    """
    specs = [fleet_of(block.config) for block in blocks]
    services: dict[Hashable, PlannerService] = {}
    caches: dict[Hashable, SearchCache] = {}
    fleets: dict[Hashable, list[PlannedFleet]] = {}
    for number, (block, spec) in enumerate(zip(blocks, specs, strict=True)):
        programs = spec.compile_key
        if programs not in services:
            services[programs] = make_planner_service(*programs)
        own = number if block.operator is not None else None
        shared = (spec.cache_key, own)
        if shared not in caches:
            caches[shared] = spec.search_cache(services[programs], block.operator)
        robots = spec.planned_robots(caches[shared])
        block.bind(robots)
        made = Fleet(spec.config, robots, service=block.service)
        fleets.setdefault(programs, []).append(PlannedFleet(made, robots, number))
    done: dict[int, Outcome] = {}
    for programs, together in fleets.items():
        for fleet, _, number in run_fleets(iter(together), services[programs]):
            inputs = inputs_of(fleet.events, ())
            done[number] = Outcome(blocks[number], fleet.records, inputs, fleet)
            said(len(done))
    return [done[number] for number in range(len(blocks))]


def fleet_of(config: ConsoleConfig) -> FleetSpec:
    """The fleet of a session, with a simulated operator in place of a person."""
    alone = dataclasses.replace(config, operator=SOMEBODY, out=Path())
    return resolve(alone.sweep()).cells[0].fleet
