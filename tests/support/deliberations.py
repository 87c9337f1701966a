"""Deliberations run to their ends, and robots' states to begin them from."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.batching.requests import Coroutine, Request
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.planning.config import Planner
from pgf_jax.planning.planner import Search, start_world
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene

# Of tight scenes: not solved in 4 iterations. What is pushed, in each: one that the planner finds
# at once, one that it does not find at all.
DONE = 5  # iterations, iteration 0 included
FOUND = {0: Push(16, 0.55, 0.3), 2: Push(15, 0.4156, 0.0128)}
HOPELESS = {0: Push(6, 0.3, 0.0), 2: Push(6, 0.3, 0.0)}


def native(lanes: int = 2) -> PlannerService:
    """A computer of C MuJoCo."""
    return make_planner_service("native", "default", Planner(), lanes, 20)


def run(deliberation: Coroutine, on: PlannerService | None = None) -> Any:
    """The result of one deliberation."""
    return run_all([deliberation], on)[0]


def run_all(deliberations: Sequence[Coroutine], on: PlannerService | None = None) -> list[Any]:
    """The results of several that share a queue."""
    queue = BatchScheduler(on or native())
    results: dict[int, Any] = {}
    for i, deliberation in enumerate(deliberations):
        queue.submit(deliberation, functools.partial(results.__setitem__, i))
    while len(queue):
        queue.run_batch()
    return [results[i] for i in range(len(deliberations))]


def traced(deliberation: Coroutine, on: PlannerService | None = None) -> tuple[Any, list[Request]]:
    """The result of one, and all that it asked."""
    on, asked, answers = on or native(), [], None
    while True:
        try:
            requests = deliberation.send(answers)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            return end.value, asked
        asked += requests
        answers = on.compute(requests)


def key(words: Sequence[int]) -> np.ndarray:
    """The planner's key of some words, folded in one after another."""
    folded = jax.random.key(0)
    for word in words:
        folded = jax.random.fold_in(folded, word)
    return np.asarray(jax.random.key_data(folded))


def stepped(search: Search, words: Sequence[int]) -> Search:
    """A search after an iteration, without any queue."""
    (after,) = native().planner.step([search], [key(words)])
    return after


@functools.cache
def unsolved(seed: int) -> Search:
    """The reach of robot 0, task 0 in a tight scene, after iterations 0 to 4 with its own keys."""
    scene = sample_scene(seed, "tight")
    planner = native().planner
    search = planner.begin_reach(start_world(scene.positions), scene.goal)
    for i in range(DONE):
        search = stepped(search, (seed, 0, 0, i, 0))
        assert not planner.terminate(search)
    return search


def turn(seed: int) -> tuple[int, int, int, int]:
    """Whose turn it is then."""
    return seed, 0, 0, DONE
