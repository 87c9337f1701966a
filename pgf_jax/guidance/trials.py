"""Trials: simulate a human input by rollouts, before anything is decided.

A trial is a coroutine (see `batching.requests`): it yields requests for iterations and retreats,
and returns a `Trial`. So the requests of many trials, and of the robots that plan meanwhile, go
into the same calls of the engine.
"""

import dataclasses
import math

import numpy as np

from pgf_jax.batching.places import Place, execute_and_retreat, iterate
from pgf_jax.batching.requests import Coroutine, KeyPaths, Retreat
from pgf_jax.physics.engine import World
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push

# Iterations within a push's limit of 30 s: 1.5 s for its nominal, then 3 s for each.
PUSH_ITERATIONS = 9


@dataclasses.dataclass(frozen=True)
class Trial:
    """Result of one trial.

    Attributes:
      cost: c_d + c_f + c_b of the best trajectory at the trial's end.
      total: the whole cost of that trajectory.
      solved: whether that trajectory is feasible.
      iterations: all iterations, those of the push and iteration 0s included.
      rollouts: the simulated time of the trial without executions, in rollouts: an iteration takes
        two, one for the noisy ones and one for the winner's own; iteration 0 and a check take one.
      pushed: the push was found (False: dropped, or there was none).
      reach: the reach as the trial leaves it.
    """

    cost: float
    total: float
    solved: bool
    iterations: int
    rollouts: int
    pushed: bool
    reach: Search = dataclasses.field(compare=False, repr=False)


def simulate_input(
    planner: BatchPlanner,
    search: Search,
    push: Push | None,
    key_paths: KeyPaths,
    *,
    push_limit: int = PUSH_ITERATIONS,
    reach_limit: float,
    total_limit: int | None = None,
    rollout_limit: float = math.inf,
    keep: bool = False,
    place: Place | None = None,
) -> Coroutine:
    """Simulate one input, given to a reach as it stands; returns a `Trial`.

    The trial does what a robot does: a push is planned and executed, and reaching starts again. A
    push that is not found within its limit is dropped, and reaching starts again from the shelf as
    it was, or goes on as it was.

    Args:
      planner: of the searches.
      search: a reach that is not solved.
      push: the input; None: go on reaching.
      key_paths: of the trial's iterations, which are counted from 0.
      push_limit: iterations of the push, without its nominal's.
      reach_limit: reach iterations, likewise: the look-ahead.
      total_limit: iterations of both kinds, likewise; None: no such limit.
      rollout_limit: no iteration begins that would end later, in rollouts (see `Trial`).
      keep: after a push that was dropped, go on with the search as it was.
      place: where the search stands in a world, in which solutions are checked and the push is
        executed; None: the engine is believed.
    """
    steps = counted = spent = 0
    found = False
    reach = planner.go_on(search)
    left = math.inf if total_limit is None else total_limit

    def carry_on(current: Search, last: float) -> Coroutine:
        """Iterate until it is solved, or no iteration is left."""
        nonlocal steps, spent
        while not planner.terminate(current) and int(current.iteration) < last:
            takes = 1 if int(current.iteration) < 0 else 2
            if spent + takes > rollout_limit:
                break
            current, checks = yield from iterate(planner, current, key_paths(steps), place)
            steps, spent = steps + 1, spent + takes + checks
        return current

    if push is not None:
        current = planner.begin_push(search.start, int(search.task.goal), push, search.shelf)
        current = yield from carry_on(current, min(push_limit, left))
        counted = int(current.iteration)
        found = planner.terminate(current)
        world: World = search.start
        if found and place is not None:
            after: Place = yield from execute_and_retreat(planner, place, current)
            place, world = after, after.seen
        elif found:
            (world,) = yield [Retreat(current)]
        if found or not keep:
            reach = planner.begin_reach(world, int(search.task.goal), search.shelf)
    last = max(0, int(reach.iteration)) + min(reach_limit, left - counted)
    reach = yield from carry_on(reach, last)
    value = reach.value
    cost = float(np.sum(value.terms[:3]))
    return Trial(cost, float(value.total), planner.terminate(reach), steps, spent, found, reach)
