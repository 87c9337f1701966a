"""Runs one fleet step by step: in real time for the console, or to look at it at chosen times."""

import dataclasses
import functools
from collections.abc import Callable

from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.simulation.fleet_spec import FleetSpec
from pgf_jax.simulation.observer import FleetObserver
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.robot import Robot


@dataclasses.dataclass(eq=False)
class FleetRunner:
    """A fleet with its robots, the scheduler of their requests, and an observer.

    Attributes:
      fleet: its events.
      robots: that plan for it.
      planner_service: computes their requests.
      scheduler: batches them.
      observer: what a person may see of the fleet.
    """

    fleet: Fleet
    robots: PlannedRobots
    planner_service: PlannerService
    scheduler: BatchScheduler
    observer: FleetObserver

    @classmethod
    def of(
        cls,
        spec: FleetSpec,
        *,
        new_fleet: Callable[[PlannedRobots], Fleet] | None = None,
        operator: AnyOperator | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> "FleetRunner":
        """Set a fleet up, before its first event.

        Args:
          spec: of the fleet.
          new_fleet: makes the fleet; None: as a sweep does.
          operator: gives the input; None: the one of the fleet.
          on_task_end: see `PlannedRobots`.
        """
        service = make_planner_service(*spec.compile_key)
        robots = spec.planned_robots(spec.search_cache(service, operator), on_task_end)
        fleet = (new_fleet or spec.new_fleet)(robots)
        scheduler = BatchScheduler(service)
        return cls(fleet, robots, service, scheduler, FleetObserver(fleet, robots))

    def step(self, until_ns: int | None = None) -> None:
        """Process the events up to `until_ns` that need no result which is still to be computed."""
        while pending := self.fleet.advance(until_ns):
            self.observer.update()
            for work in pending:
                deliver = functools.partial(self.fleet.deliver, work)
                self.scheduler.submit(self.robots.coroutine(work), deliver)
        self.observer.update()

    def run_until(self, until_ns: int | None = None) -> None:
        """Process all events up to `until_ns`, and compute what they need; None: to the end."""
        self.step(until_ns)
        while self._is_blocked(until_ns):
            if not len(self.scheduler):
                raise RuntimeError("the fleet waits for a result that nothing computes")
            self.scheduler.run_batch()
            self.step(until_ns)

    def _is_blocked(self, until_ns: int | None) -> bool:
        blocked_at_ns = self.fleet.blocked_at_ns
        if self.fleet.done or blocked_at_ns is None:
            return False
        return until_ns is None or blocked_at_ns <= until_ns
