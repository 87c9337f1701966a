"""Runs fleets to their ends, with one queue of work for all of them."""

import functools
import itertools
from collections.abc import Callable, Iterable

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.fleet.robots import WorkKind
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.simulation.planned_robots import PlannedRobots


def run_fleets(
    fleets: Iterable[tuple[Fleet, PlannedRobots]],
    planner_service: PlannerService,
    *,
    at_once: int | None = None,
    on_round: Callable[[], None] | None = None,
) -> int:
    """Run fleets to their ends, all their pending work in one queue.

    A round takes as many iterations off the queue as a call has lanes, first come first served;
    what they lead to joins the queue before the next, so that calls stay full while there is work.

    Args:
      fleets: with their crews; may be a generator, taken from as fleets end.
      computer: of all the crews.
      at_once: how many fleets are under way at a time; None: all.
      on_round: called after each round of calls.

    Returns:
      Iterations that robots asked for.
    """
    iterations = 0
    waiting = iter(fleets)
    running: list[tuple[Fleet, PlannedRobots]] = []
    queue = BatchScheduler(planner_service)
    while True:
        going: list[tuple[Fleet, PlannedRobots]] = []
        source = itertools.chain(running, waiting)
        while at_once is None or len(going) < at_once:
            pair = next(source, None)
            if pair is None:
                break
            fleet, planned = pair
            # An input may be there at once, and the fleet go on with it.
            while pending := fleet.advance():
                for work in pending:
                    iterations += work.kind is WorkKind.ITERATION
                    queue.submit(planned.coroutine(work), functools.partial(fleet.deliver, work))
            if fleet.done:
                planned.finish()
            else:
                going.append(pair)
        running = going
        if not running:
            planner_service.answering_s += queue.seconds
            return iterations
        queue.run_batch()
        if on_round is not None:
            on_round()
