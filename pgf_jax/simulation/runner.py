"""One fleet, run step by step: as the wall clock goes, or as somebody wants to look at it."""

import dataclasses
import functools
from collections.abc import Callable

from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.simulation.observer import FleetObserver
from pgf_jax.simulation.planned_robots import PlannedRobots, Robot
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.sweeping.resolve import Setup


@dataclasses.dataclass(eq=False)
class FleetRunner:
    """A fleet with its robots, the queue of their work, and who watches.

    Attributes:
      fleet, crew, computer, queue, watch: these.
    """

    fleet: Fleet
    planned: PlannedRobots
    planner_service: PlannerService
    queue: BatchScheduler
    watch: FleetObserver

    @classmethod
    def of(
        cls,
        setup: Setup,
        cell: Cell,
        *,
        new_fleet: Callable[[PlannedRobots], Fleet] | None = None,
        operator: AnyOperator | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> "FleetRunner":
        """The fleet of a cell.

        Args:
          setup: of the sweep that the cell is of.
          cell: policy and sizes.
          new_fleet: makes the fleet; None: as a sweep does.
          operator: gives the input; None: as in a sweep.
          on_task_end: see `Crew`.
        """
        machine = make_planner_service(*setup.compile_key())
        search_cache = SearchCache(
            machine,
            scenes=setup.scene,
            operator=operator or setup.operator(),
            seed=setup.config.seed,
        )
        planned = PlannedRobots(
            search_cache,
            robots=cell.robots,
            tasks=cell.tasks,
            predictor=setup.bidder_of(cell),
            on_task_end=on_task_end,
        )
        fleet = new_fleet(planned) if new_fleet is not None else setup.new_fleet(cell, planned)
        return cls(fleet, planned, machine, BatchScheduler(machine), FleetObserver(fleet, planned))

    def step(self, until_ns: int | None = None) -> None:
        """Let happen what can, up to `until_ns`, without computing anything."""
        while pending := self.fleet.advance(until_ns):
            self.watch.update()
            for work in pending:
                self.queue.submit(
                    self.planned.coroutine(work), functools.partial(self.fleet.deliver, work)
                )
        self.watch.update()

    def run_until(self, until_ns: int | None = None) -> None:
        """Let everything happen up to `until_ns`."""
        self.step(until_ns)
        while self._lacks_a_result(until_ns):
            if not len(self.queue):
                raise RuntimeError("the fleet waits for something that nobody computes")
            self.queue.run_batch()
            self.step(until_ns)

    def _lacks_a_result(self, until_ns: int | None) -> bool:
        waits_for_ns = self.fleet.waits_for_ns
        if self.fleet.done or waits_for_ns is None:
            return False
        return until_ns is None or waits_for_ns <= until_ns
