"""Runs blocks of a study without people: a fleet each, with an operator in a person's place."""

import dataclasses
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.fleet import Fleet
from pgf_jax.fleet.events import Event
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
      events: all of them.
    """

    block: Simulated
    records: Sequence[TaskRecord]
    inputs: Sequence[Input]
    events: Sequence[Event]

    @property
    def measures(self) -> dict[str, float]:
        """See `analysis.block_measures`."""
        seconds = max((event.time_ns for event in self.events), default=0) / 1e9
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
    alike: dict[Hashable, list[int]] = {}  # blocks with the same programs
    for number, spec in enumerate(specs):
        alike.setdefault(spec.compile_key, []).append(number)
    done: dict[int, Outcome] = {}
    for numbers in alike.values():
        service = make_planner_service(*specs[numbers[0]].compile_key)
        chosen = [(blocks[number], specs[number], number) for number in numbers]
        # No more at a time than keep calls full, so that memory does not grow with their number.
        fewest = min(spec.config.robots for _, spec, _ in chosen)
        at_once = max(1, 2 * service.engine.lanes // fewest)
        for fleet, _, number in run_fleets(_fleets(chosen, service), service, at_once=at_once):
            inputs = inputs_of(fleet.events, ())
            done[number] = Outcome(blocks[number], fleet.records, inputs, fleet.events)
            said(len(done))
    return [done[number] for number in range(len(blocks))]


def _fleets(
    chosen: Sequence[tuple[Simulated, FleetSpec, int]], service: PlannerService
) -> Iterator[PlannedFleet]:
    shared: dict[Hashable, SearchCache] = {}
    for block, spec, number in chosen:
        if block.operator is not None:
            cache = spec.search_cache(service, block.operator)
        else:
            if spec.cache_key not in shared:
                shared[spec.cache_key] = spec.search_cache(service)
            cache = shared[spec.cache_key]
        robots = spec.planned_robots(cache)
        block.bind(robots)
        yield PlannedFleet(Fleet(spec.config, robots, service=block.service), robots, number)


def fleet_of(config: ConsoleConfig) -> FleetSpec:
    """The fleet of a session, with a simulated operator in place of a person."""
    alone = dataclasses.replace(config, operator=SOMEBODY, out=Path())
    return resolve(alone.sweep()).cells[0].fleet
