"""Requests for computation, and the coroutines that yield them.

A coroutine here is a generator: it yields lists of requests, is sent the list of their results, and
returns what it was started for. The scheduler runs many coroutines side by side and puts their
requests into the same calls of the engine.

The key of an iteration is the path (seed, robot, task, iteration, purpose), folded into a JAX key
word by word. So a result depends on whose it is, and not on the batch in which it is computed.
"""

from collections.abc import Callable, Generator, Hashable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from pgf_jax.physics.worlds.world import Command, World3D
from pgf_jax.planning.search import Search

NOISE = 0  # purpose of a robot's own noise; the purposes of trials come after it
TRIAL_STEPS = 256  # iterations that one trial may take: each has a purpose of its own

KeyPath = tuple[int, int, int, int, int]  # seed, robot, task, iteration, purpose
KeyPaths = Callable[[int], KeyPath]  # of the iterations of one search: step -> key path


class GainPredictor(Protocol):
    """Predicts what robots may bid."""

    def gain(self, states: np.ndarray) -> np.ndarray:
        """[B, S] states (`predictors.features`) -> [B]; nan where a state lacks a feature."""
        ...


@runtime_checkable
class TimePredictor(Protocol):
    """Predicts how long reaches still take."""

    def survival(self, states: np.ndarray) -> np.ndarray:
        """[B, S] states -> [B, 2, H], as in `fleet.TimeLeft`; nan where a state lacks a feature."""
        ...


class Step(NamedTuple):
    """Request for one iteration of a search; its result is the `Search` after it.

    With `candidates`, the result is a pair: that, and the `Candidates` that a world has to check,
    None where there are none.
    """

    search: Search
    key_path: KeyPath
    candidates: bool = False

    @property
    def program(self) -> Hashable:
        """What has to be equal in the iterations of one call."""
        return self.search.program, self.candidates


class Retreat(NamedTuple):
    """Request for the retreat after a push that was found; its result is the `World` after it."""

    search: Search


class Execute(NamedTuple):
    """Request for the execution of a segment in a world; its result is an `Executed`."""

    world: World3D
    command: Command


class PredictGain(NamedTuple):
    """Request for the number that a robot may bid; its result is a float."""

    predictor: GainPredictor
    state: np.ndarray  # [S], see `predictors.features`

    def predict(self, states: np.ndarray) -> list[float]:
        """The results for states [B, S] of this predictor."""
        return list(map(float, self.predictor.gain(states)))


class PredictTimes(NamedTuple):
    """Request for the time that a reach still takes; its result is [2, H]: alone, and helped."""

    predictor: TimePredictor
    state: np.ndarray  # [S], see `predictors.features`

    def predict(self, states: np.ndarray) -> list[np.ndarray]:
        """The results for states [B, S] of this predictor."""
        return list(self.predictor.survival(states))


class Memoised(NamedTuple):
    """Memoised request: computed once, its result is shared by all callers."""

    cache: dict[Hashable, Any]  # of the scheduler: results, and who waits for them
    key: Hashable
    make: "Callable[[], Coroutine]"  # computes it


class External(NamedTuple):
    """Result delivered later by a callback, for example a person's answer."""

    subscribe: Callable[[Callable[[Any], None]], None]  # is given what to call with the result


Request = Step | Retreat | Execute | PredictGain | PredictTimes | Memoised | External
Coroutine = Generator[list[Request], list[Any], Any]


def robot_key_path(seed: int, robot: int, task: int, iteration: int) -> KeyPaths:
    """Key paths that the robot itself will use from iteration `iteration` on."""
    return lambda step: (seed, robot, task, iteration + step, NOISE)


def trial_key_path(seed: int, robot: int, task: int, iteration: int, number: int) -> KeyPaths:
    """Key paths of trial number `number` (0-based), made after `iteration` iterations.

    Neither a robot nor another trial uses them.
    """
    purpose = NOISE + 1 + number * TRIAL_STEPS
    return lambda step: (seed, robot, task, iteration, purpose + step)


def gather(coroutines: Sequence[Coroutine]) -> Coroutine:
    """Run coroutines side by side, their requests in one list; returns their results, in order.

    Each goes on when the requests of all have been answered. How far one gets depends on itself
    alone, so its result does as well.
    """
    results: list[Any] = [None] * len(coroutines)
    pending: dict[int, list[Request]] = {}

    def resume(i: int, answers: list[Any] | None) -> None:
        try:
            pending[i] = coroutines[i].send(answers)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            pending.pop(i, None)
            results[i] = end.value

    for i in range(len(coroutines)):
        resume(i, None)
    while pending:
        order = list(pending.items())
        answers = yield [request for _, requests in order for request in requests]
        start = 0
        for i, requests in order:
            resume(i, answers[start : start + len(requests)])
            start += len(requests)
    return results
