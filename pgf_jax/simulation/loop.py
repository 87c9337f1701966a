"""The loop that runs fleets: events, requests, results, until every fleet is done."""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.simulation.planned_robots import PlannedRobots


class PlannedFleet(NamedTuple):
    """A fleet and its robots.

    Attributes:
      fleet: its events.
      robots: that plan for it.
      label: of the caller's, to tell fleets apart.
    """

    fleet: Fleet
    robots: PlannedRobots
    label: Any = None


def run_fleets(
    fleets: Iterable[PlannedFleet],
    planner_service: PlannerService,
    *,
    at_once: int | None = None,
    threads: int = 1,
    on_batch: Callable[[], None] | None = None,
) -> Iterator[PlannedFleet]:
    """Run fleets to their ends, with one queue for all their work; yields each when it is done.

    A batch takes as many iterations from the queue as a call has lanes, first come, first served.
    What follows from their results joins the queue before the next batch, so that calls stay full
    while there is work.

    Args:
      fleets: may be a generator: the next one is taken when another has ended.
      planner_service: of all their robots.
      at_once: how many fleets run at a time; None: all.
      threads: calls of the planner service at a time.
      on_batch: called after each batch; what it raises ends the run.
    """
    waiting = iter(fleets)
    running: list[PlannedFleet] = []
    scheduler = BatchScheduler(planner_service, threads)
    while True:
        still_running: list[PlannedFleet] = []
        source = itertools.chain(running, waiting)
        while at_once is None or len(still_running) < at_once:
            planned = next(source, None)
            if planned is None:
                break
            fleet, robots, _ = planned
            # An input may be there at once, and the fleet go on with it.
            while pending := fleet.advance():
                for work in pending:
                    deliver = functools.partial(fleet.deliver, work)
                    scheduler.submit(robots.coroutine(work), deliver)
            if fleet.done:
                robots.finish()
                yield planned
            else:
                still_running.append(planned)
        running = still_running
        if not running:
            planner_service.answering_s += scheduler.seconds
            return
        scheduler.run_batch()
        if on_batch is not None:
            on_batch()
