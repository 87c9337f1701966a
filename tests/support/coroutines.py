"""Coroutines run to their ends, and robots' states to begin them from."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.batching.requests import Coroutine, Request
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.guidance.view import View
from pgf_jax.physics.config import Physics
from pgf_jax.planning.config import Planner
from pgf_jax.planning.search import Search, start_world
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene

# Of tight scenes: not solved in 4 iterations. What is pushed, in each: one that the planner finds
# at once, one that it does not find at all.
DONE = 5  # iterations, iteration 0 included
FOUND = {0: Push(16, 0.55, 0.3), 2: Push(15, 0.4156, 0.0128)}
HOPELESS = {0: Push(6, 0.3, 0.0), 2: Push(6, 0.3, 0.0)}


class Says:
    """Gives one input, whatever it sees."""

    name = "says"

    def __init__(self, push) -> None:
        self.push = push

    def decide(self, view: View):
        return self.push


def native(lanes: int = 2) -> PlannerService:
    """A planner service of C MuJoCo."""
    return make_planner_service("native", Physics(), Planner(), lanes)


def run(coroutine: Coroutine, on: PlannerService | None = None) -> Any:
    """The result of one coroutine."""
    return run_all([coroutine], on)[0]


def run_all(coroutines: Sequence[Coroutine], on: PlannerService | None = None) -> list[Any]:
    """The results of several that share a scheduler."""
    scheduler = BatchScheduler(on or native())
    results: dict[int, Any] = {}
    for i, coroutine in enumerate(coroutines):
        scheduler.submit(coroutine, functools.partial(results.__setitem__, i))
    while len(scheduler):
        scheduler.run_batch()
    return [results[i] for i in range(len(coroutines))]


def traced(coroutine: Coroutine, on: PlannerService | None = None) -> tuple[Any, list[Request]]:
    """The result of one, and all that it asked."""
    on, asked, answers = on or native(), [], None
    while True:
        try:
            requests = coroutine.send(answers)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            return end.value, asked
        asked += requests
        answers = on.compute(requests)


def key(path: Sequence[int]) -> np.ndarray:
    """The planner's key of a key path, whose numbers are folded in one after another."""
    folded = jax.random.key(0)
    for number in path:
        folded = jax.random.fold_in(folded, number)
    return np.asarray(jax.random.key_data(folded))


def stepped(search: Search, path: Sequence[int]) -> Search:
    """A search after an iteration, without any scheduler."""
    (after,) = native().planner.step([search], [key(path)])
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
    """The decision key of that moment."""
    return seed, 0, 0, DONE
