"""Requests for computation, and coroutines that yield them."""

from collections.abc import Callable, Generator, Hashable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from pgf_jax.planning.planner import Search


class GainPredictor(Protocol):
    """Says what robots may bid."""

    def gain(self, states: np.ndarray) -> np.ndarray:
        """[B, S] states (`guidance.state`) -> [B]; nan where a state lacks what it takes."""
        ...


NOISE = 0  # purpose of a robot's own noise; the trials' purposes come after it


TRIAL_STEPS = 256  # iterations that one trial may take, for the purposes of its keys


class Step(NamedTuple):
    """One iteration of a search; its result is the `Search` after it."""

    search: Search
    key_path: tuple[int, int, int, int, int]  # of its key: seed, robot, task, iteration, purpose


class Retreat(NamedTuple):
    """The retreat after a push that was found; its result is the `World` then."""

    search: Search


class PredictGain(NamedTuple):
    """What a robot may bid; its result is a float."""

    predictor: GainPredictor
    state: np.ndarray  # [S], see `guidance.state`


class Memoised(NamedTuple):
    """What others may ask for as well: the first who does has it made, all are sent the result."""

    cache: dict[Hashable, Any]  # whoever answers keeps results here, and who waits for them
    key: Hashable
    make: "Callable[[], Coroutine]"


class External(NamedTuple):
    """Something from outside the computer, such as a person's answer; it comes in its own time."""

    subscribe: Callable[[Callable[[Any], None]], None]  # is given what to call with the result


Request = Step | Retreat | PredictGain | Memoised | External


Coroutine = Generator[list[Request], list[Any], Any]


KeyPath = Callable[[int], tuple[int, int, int, int, int]]


def robot_key_path(seed: int, robot: int, task: int, iteration: int) -> KeyPath:
    """Keys that the robot itself will use from iteration `iteration` on: step -> words."""
    return lambda step: (seed, robot, task, iteration + step, NOISE)


def trial_key_path(seed: int, robot: int, task: int, iteration: int, number: int) -> KeyPath:
    """Keys of trial number `number` (0-based) made when the robot had done `iteration` iterations.

    No robot plans with them, nor any other trial.
    """
    purpose = NOISE + 1 + number * TRIAL_STEPS
    return lambda step: (seed, robot, task, iteration, purpose + step)


def gather(deliberations: Sequence[Coroutine]) -> Coroutine:
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
