"""What all robots of a process share: an engine and a planner, and the queue in front of them.

Robots, operators that try pushes, and forks ask in the form of deliberations (`guidance.trials`);
`Queue` turns what they ask into fixed-shape calls of L lanes, so that no result depends on who
shares a call (D8).
"""

import contextlib
import copy
import functools
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.guidance.trials import (
    Deliberation,
    Gain,
    Later,
    Once,
    Request,
    Retreat,
    Step,
    own_words,
)
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import Engine, make_engine
from pgf_jax.planning.config import Cost
from pgf_jax.planning.config import Planner as PlannerConfig
from pgf_jax.planning.planner import BatchPlanner, Rolled, Search
from pgf_jax.study.checks import Planning


class Computer:
    """Engine and planner of one process.

    Args:
      engine: rolls out L lanes of K rollouts at a time.
      config: of the planner.
    """

    def __init__(self, engine: Engine, config: PlannerConfig | None = None) -> None:
        self.engine = engine
        self.planner = BatchPlanner(engine, config)
        self.steps = 0  # iterations computed
        self.calls = 0  # iteration calls made
        self.lanes_used = 0  # lanes in them that held work
        self.seconds = 0.0  # of the wall clock spent in `compute`
        self.answering_s = 0.0  # that, and what was thought between requests (`crew.drive`)
        self.warm: list[bool] = []  # shared by copies: whether its programs are compiled
        self._keys = jax.jit(jax.vmap(_key))

    def occupancy(self) -> tuple[int, int]:
        """(work whose result was used, work computed) since this was last called.

        In the units of an engine that leaves lanes out and counts what it does; else in lanes of
        iteration calls.
        """
        own = getattr(self.engine, "occupancy", None)
        used, computed = self.lanes_used, self.calls * self.engine.lanes
        self.calls = self.lanes_used = 0
        return (used, computed) if own is None else own()

    def compute(self, requests: Sequence[Request]) -> list[Any]:
        """Results of requests, in order: a `Search` of each step, a `World` of each retreat.

        A `Gain` gives a float.
        """
        start = time.perf_counter()
        try:
            return self._compute(requests)
        finally:
            self.seconds += time.perf_counter() - start

    def _compute(self, requests: Sequence[Request]) -> list[Any]:
        results: list[Any] = [None] * len(requests)
        asked: dict[int, list[int]] = {}  # predictor -> who asked for its gain
        for i, request in enumerate(requests):
            if isinstance(request, Gain):
                asked.setdefault(id(request.predictor), []).append(i)
        for places in asked.values():
            gains: list[Any] = [requests[i] for i in places]
            states = np.stack([gain.state for gain in gains])
            for i, value in zip(places, gains[0].predictor.gain(states), strict=True):
                results[i] = float(value)
        steps = [(i, r) for i, r in enumerate(requests) if isinstance(r, Step)]
        retreats = [(i, r) for i, r in enumerate(requests) if isinstance(r, Retreat)]
        for part in _parts(retreats, self.engine.lanes):
            worlds = self.planner.retreat([retreat.search for _, retreat in part])
            for (i, _), world in zip(part, worlds, strict=True):
                results[i] = world
        for part in _parts(steps, self.engine.lanes):
            after = self._iterate([step for _, step in part])
            for (i, _), search in zip(part, after, strict=True):
                results[i] = search
        return results

    def rolled(self, step: Step) -> tuple[Search, Rolled]:
        """An iteration, and all that it rolls out; to look at it again, so it counts nowhere."""
        return self.planner.rolled(step.search, self._keys_of([step])[0])

    def _iterate(self, steps: Sequence[Step]) -> list[Any]:
        self.calls += 1
        self.steps += len(steps)
        self.lanes_used += len(steps)
        return self.planner.step([step.search for step in steps], self._keys_of(steps))

    def _keys_of(self, steps: Sequence[Step]) -> list[np.ndarray]:
        words = [step.words for step in steps]
        words += [words[0]] * (self.engine.lanes - len(steps))
        return list(np.asarray(self._keys(np.array(words, np.uint32)))[: len(steps)])


class _Job:
    """A deliberation under way, and the results it still waits for."""

    def __init__(self, deliberation: Deliberation, done: Callable[[Any], None]) -> None:
        self.deliberation, self.done = deliberation, done
        self.answers: list[Any] = []
        self.missing = 0


Asked = tuple[_Job, int, Request]  # a request, who asks, and as which of theirs


class _Shared:
    """The result of a `Once`, and who waits for it."""

    def __init__(self) -> None:
        self.there, self.value = False, None
        self.waiting: list[tuple[_Job, int]] = []


class Queue:
    """Deliberations, all their requests in one line: first come, first served."""

    def __init__(self, computer: Computer) -> None:
        self._computer = computer
        self._steps: deque[Asked] = deque()
        self._others: list[Asked] = []
        self.seconds = 0.0  # of the wall clock spent in it, what is thought between requests too
        self._clocking = False

    def __len__(self) -> int:
        """Requests in line."""
        return len(self._steps) + len(self._others)

    def add(self, deliberation: Deliberation, done: Callable[[Any], None]) -> None:
        """Start a deliberation; `done` is called with its result, perhaps at once."""
        with self._clocked():
            self._resume(_Job(deliberation, done), None)

    def round(self) -> None:
        """One call's worth of iterations, and what else is asked meanwhile."""
        with self._clocked():
            self._answer(self.take_steps())
            while self._others:  # gains of the iterations just made, say
                self._answer(self.take_others())

    @contextlib.contextmanager
    def _clocked(self) -> Iterator[None]:
        """Counts towards `seconds`; deliberations start others, which counts once."""
        start = None if self._clocking else time.perf_counter()
        self._clocking = True
        try:
            yield
        finally:
            if start is not None:
                self.seconds += time.perf_counter() - start
                self._clocking = False

    def take_steps(self) -> list[Asked]:
        """Take one call's worth of iterations off the line, for `tell`."""
        lanes = self._computer.engine.lanes
        return [self._steps.popleft() for _ in range(min(lanes, len(self._steps)))]

    def take_others(self) -> list[Asked]:
        """Take all that is no iteration off the line, for `tell`."""
        others, self._others = self._others, []
        return others

    def tell(self, batch: Sequence[Asked], results: Sequence[Any]) -> None:
        """Pass results on to who asked, whose further requests join the line."""
        for (job, place, _), result in zip(batch, results, strict=True):
            self._tell(job, place, result)

    def _answer(self, batch: Sequence[Asked]) -> None:
        self.tell(batch, self._computer.compute([request for *_, request in batch]))

    def _tell(self, job: _Job, place: int, result: Any) -> None:
        job.answers[place] = result
        job.missing -= 1
        if not job.missing:
            self._resume(job, job.answers)

    def _resume(self, job: _Job, answers: list[Any] | None) -> None:
        while True:
            try:
                requests = job.deliberation.send(answers)  # pyright: ignore[reportArgumentType]
            except StopIteration as end:
                job.done(end.value)
                return
            # One more is missing until all are asked, so that none goes on from within the loop.
            job.answers, job.missing = [None] * len(requests), len(requests) + 1
            for place, request in enumerate(requests):
                self._ask(job, place, request)
            job.missing -= 1
            if job.missing:
                return
            answers = job.answers

    def _ask(self, job: _Job, place: int, request: Request) -> None:
        if isinstance(request, Once):
            self._ask_once(job, place, request)
        elif isinstance(request, Later):
            request.subscribe(functools.partial(self._tell, job, place))
        else:
            line = self._steps if isinstance(request, Step) else self._others
            line.append((job, place, request))

    def _ask_once(self, job: _Job, place: int, request: Once) -> None:
        shared = request.kept.get(request.label)
        if shared is None:
            shared = request.kept[request.label] = _Shared()
            shared.waiting.append((job, place))
            self.add(request.make(), functools.partial(self._keep, shared))
        elif shared.there:
            self._tell(job, place, shared.value)
        else:
            shared.waiting.append((job, place))

    def _keep(self, shared: _Shared, result: Any) -> None:
        shared.there, shared.value = True, result
        waiting, shared.waiting = shared.waiting, []
        for job, place in waiting:
            self._tell(job, place, result)


def warm_up(computer: Computer, search: Search, seed: int) -> float:
    """One iteration for nobody, so that its compilation is not mistaken for its time.

    Returns:
      What it took, s: 0 where a computer of this kind has been warmed up before.
    """
    if computer.warm:
        return 0.0
    computer.compute([Step(search, own_words(seed, 0, 0, 0)(0))])
    seconds = computer.seconds
    computer.warm.append(True)
    computer.occupancy()
    computer.steps = 0
    computer.seconds = 0.0
    return seconds


def planning_computer(config: Planning, n_objects: int) -> Computer:
    """A computer for the engine, physics, cost, update and lanes of `config`.

    What it compiles is kept: a second one of the same settings traces nothing again.
    """
    planner = PlannerConfig(update=config.update, cost=Cost(variant=config.cost))
    return computer(config.engine, config.physics, planner, config.lanes or 1, n_objects)


def computer(
    engine: str, physics: str, planner: PlannerConfig, lanes: int, n_objects: int
) -> Computer:
    """A computer with counters of its own; what it compiles is kept for the next of its kind."""
    return copy.copy(_compiled(engine, physics, planner, lanes, n_objects))


@functools.lru_cache(maxsize=8)
def _compiled(
    engine: str, physics: str, planner: PlannerConfig, lanes: int, n_objects: int
) -> Computer:
    return Computer(
        make_engine(engine, physics=PHYSICS[physics], n_objects=n_objects, lanes=lanes), planner
    )


def _key(words: jax.Array) -> jax.Array:
    key = jax.random.key(0)
    for word in words:
        key = jax.random.fold_in(key, word)
    return jax.random.key_data(key).astype(jnp.uint32)


def _parts(items: Sequence, size: int) -> list:
    return [items[i : i + size] for i in range(0, len(items), size)]
