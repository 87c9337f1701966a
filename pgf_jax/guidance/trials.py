"""Trials: what would come of an input, found out by rollouts before anything is decided.

A *deliberation* is a generator: it yields lists of requests (iterations, retreats), is sent their
results, and returns what it was for. Who runs it puts the requests of many deliberations, and of
the robots that plan meanwhile, into the same calls of the engine (D8).
"""

import dataclasses
import math

import numpy as np

from pgf_jax.batching.requests import Coroutine, KeyPath, Retreat, Step
from pgf_jax.physics.engine import World
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import Push

PUSH_ITERATIONS = 9  # what fits in the 30 s of a push: 1.5 s for its nominal, 3 s for each (D4, D8)


@dataclasses.dataclass(frozen=True)
class Trial:
    """What came of one trial.

    Attributes:
      cost: c_d + c_f + c_b of the best trajectory at its end.
      total: its whole cost.
      solved: whether that is feasible.
      iterations: taken, those of the push and iteration 0s included.
      pushed: the push was found (False: dropped, or there was none).
    """

    cost: float
    total: float
    solved: bool
    iterations: int
    pushed: bool


def simulate_input(
    planner: BatchPlanner,
    search: Search,
    push: Push | None,
    key_path: KeyPath,
    *,
    push_limit: int = PUSH_ITERATIONS,
    reach_limit: int,
    total_limit: int | None = None,
) -> Coroutine:
    """Try one input from a reach as it stands, as a robot would (D4); returns a `Trial`.

    A push is planned and executed, and reaching starts again; one that is not found within its
    limit is dropped, and reaching starts again from the shelf as it was.

    Args:
      planner: of the searches.
      search: a reach that is not solved.
      push: the input; None: go on reaching.
      words: key of each iteration, by how many came before it in this trial.
      push_limit: iterations of the push, its nominal's not counted.
      reach_limit: reach iterations, likewise: the look-ahead.
      total_limit: iterations of both kinds, likewise; None: no such limit.
    """
    steps = counted = 0
    found = False
    reach = planner.go_on(search)
    left = math.inf if total_limit is None else total_limit
    if push is not None:
        current = planner.begin_push(search.start, int(search.task.goal), push)
        while not planner.terminate(current) and int(current.iteration) < min(push_limit, left):
            (current,) = yield [Step(current, key_path(steps))]
            steps += 1
        counted = int(current.iteration)
        found = planner.terminate(current)
        world: World = search.start
        if found:
            (world,) = yield [Retreat(current)]
        reach = planner.begin_reach(world, int(search.task.goal))
    last = max(0, int(reach.iteration)) + min(reach_limit, left - counted)
    while not planner.terminate(reach) and int(reach.iteration) < last:
        (reach,) = yield [Step(reach, key_path(steps))]
        steps += 1
    value = reach.value
    cost = float(np.sum(value.terms[:3]))
    return Trial(cost, float(value.total), planner.terminate(reach), steps, found)
