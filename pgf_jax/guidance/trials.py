"""Trials: what would come of an input, found out by rollouts before anything is decided.

A *deliberation* is a generator: it yields lists of requests (iterations, retreats), is sent their
results, and returns what it was for. Who runs it puts the requests of many deliberations, and of
the robots that plan meanwhile, into the same calls of the engine (D8).
"""

import dataclasses
import math
from collections.abc import Callable, Generator, Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgf_jax.guidance.predictor import Bidder
from pgf_jax.physics.engine import World
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import Push

NOISE = 0  # purpose of a robot's own noise; the trials' purposes come after it
TRIAL_STEPS = 256  # iterations that one trial may take, for the purposes of its keys
PUSH_ITERATIONS = 9  # what fits in the 30 s of a push: 1.5 s for its nominal, 3 s for each (D4, D8)


class Step(NamedTuple):
    """One iteration of a search; its result is the `Search` after it."""

    search: Search
    words: tuple[int, int, int, int, int]  # of its key: seed, robot, task, iteration, purpose


class Retreat(NamedTuple):
    """The retreat after a push that was found; its result is the `World` then."""

    search: Search


class Gain(NamedTuple):
    """What a robot may bid; its result is a float."""

    predictor: Bidder
    state: np.ndarray  # [S], see `guidance.state`


class Once(NamedTuple):
    """What others may ask for as well: the first who does has it made, all are sent the result."""

    kept: dict[Hashable, Any]  # whoever answers keeps results here, and who waits for them
    label: Hashable
    make: "Callable[[], Deliberation]"


class Later(NamedTuple):
    """Something from outside the computer, such as a person's answer; it comes in its own time."""

    subscribe: Callable[[Callable[[Any], None]], None]  # is given what to call with the result


Request = Step | Retreat | Gain | Once | Later
Deliberation = Generator[list[Request], list[Any], Any]
Words = Callable[[int], tuple[int, int, int, int, int]]


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


def own_words(seed: int, robot: int, task: int, iteration: int) -> Words:
    """Keys that the robot itself will use from iteration `iteration` on: step -> words."""
    return lambda step: (seed, robot, task, iteration + step, NOISE)


def trial_words(seed: int, robot: int, task: int, iteration: int, number: int) -> Words:
    """Keys of trial number `number` (0-based) made when the robot had done `iteration` iterations.

    No robot plans with them, nor any other trial.
    """
    purpose = NOISE + 1 + number * TRIAL_STEPS
    return lambda step: (seed, robot, task, iteration, purpose + step)


def attempt(
    planner: BatchPlanner,
    search: Search,
    push: Push | None,
    words: Words,
    *,
    push_limit: int = PUSH_ITERATIONS,
    reach_limit: int,
    total_limit: int | None = None,
) -> Deliberation:
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
            (current,) = yield [Step(current, words(steps))]
            steps += 1
        counted = int(current.iteration)
        found = planner.terminate(current)
        world: World = search.start
        if found:
            (world,) = yield [Retreat(current)]
        reach = planner.begin_reach(world, int(search.task.goal))
    last = max(0, int(reach.iteration)) + min(reach_limit, left - counted)
    while not planner.terminate(reach) and int(reach.iteration) < last:
        (reach,) = yield [Step(reach, words(steps))]
        steps += 1
    value = reach.value
    cost = float(np.sum(value.terms[:3]))
    return Trial(cost, float(value.total), planner.terminate(reach), steps, found)


def together(deliberations: Sequence[Deliberation]) -> Deliberation:
    """Run deliberations side by side, their requests in one list; returns their results, in order.

    Each goes on when the requests of all have been answered: how far one gets depends on itself
    alone, so the results do as well.
    """
    results: list[Any] = [None] * len(deliberations)
    asked: dict[int, list[Request]] = {}

    def resume(i: int, answers: list[Any] | None) -> None:
        try:
            asked[i] = deliberations[i].send(answers)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            asked.pop(i, None)
            results[i] = end.value

    for i in range(len(deliberations)):
        resume(i, None)
    while asked:
        order = list(asked.items())
        answers = yield [request for _, requests in order for request in requests]
        start = 0
        for i, requests in order:
            resume(i, answers[start : start + len(requests)])
            start += len(requests)
    return results
