"""Computes planner requests in calls of fixed shape: L lanes, padded where there are fewer.

A lane's result does not depend on what is in the other lanes. So no robot's result depends on who
shares its call.
"""

import copy
import functools
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.batching.requests import (
    Execute,
    PredictGain,
    PredictTimes,
    Request,
    Retreat,
    Step,
    robot_key_path,
)
from pgf_jax.physics.config import Physics, physics_of
from pgf_jax.physics.engine import ENGINES, Engine
from pgf_jax.physics.sized import SizedEngine
from pgf_jax.physics.worlds.world import execute_all
from pgf_jax.planning import candidates
from pgf_jax.planning.config import Planner as PlannerConfig
from pgf_jax.planning.config import Planning, planner_of
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Rolled, Search


class PlannerService:
    """An engine and a planner that compute the requests of all robots of a process.

    Several threads may call `compute` at a time.

    Args:
      engine: rolls out L lanes of K rollouts at a time.
      config: of the planner.
    """

    def __init__(self, engine: SizedEngine, config: PlannerConfig | None = None) -> None:
        self.engine = engine
        self.planner = BatchPlanner(engine, config)
        self.steps = 0  # iterations computed
        self.calls = 0  # iteration calls made
        self.lanes_used = 0  # lanes in them that held work
        self.seconds = 0.0  # of the wall clock spent in `compute`
        self.answering_s = 0.0  # that, and the coroutines' own time between requests (`run_fleets`)
        self._counting = threading.Lock()
        self.warm: set[Hashable] = set()  # shared by copies: what has been compiled
        self._keys = jax.jit(jax.vmap(_key))

    def occupancy(self) -> tuple[int, int]:
        """(work whose result was used, work computed) since this was last called.

        In the units of an engine that leaves lanes out and counts what it does; else in lanes of
        iteration calls.
        """
        lanes = self.lanes_used, self.calls * self.engine.lanes
        self.calls = self.lanes_used = 0
        return self.engine.occupancy() or lanes

    def compute(self, requests: Sequence[Request]) -> list[Any]:
        """Results of requests, in order; `requests.py` says what each gives."""
        start = time.perf_counter()
        try:
            return self._compute(requests)
        finally:
            with self._counting:
                self.seconds += time.perf_counter() - start

    def _compute(self, requests: Sequence[Request]) -> list[Any]:
        results: list[Any] = [None] * len(requests)
        asked: dict[int, list[int]] = {}  # predictor -> who asked for its prediction
        for i, request in enumerate(requests):
            if isinstance(request, PredictGain | PredictTimes):
                asked.setdefault(id(request.predictor), []).append(i)
        for places in asked.values():
            alike: list[Any] = [requests[i] for i in places]
            found = alike[0].predict(np.stack([request.state for request in alike]))
            for i, value in zip(places, found, strict=True):
                results[i] = value
        executions = [(i, r) for i, r in enumerate(requests) if isinstance(r, Execute)]
        executed = execute_all([(execute.world, execute.command) for _, execute in executions])
        for (i, _), result in zip(executions, executed, strict=True):
            results[i] = result
        steps = [(i, r) for i, r in enumerate(requests) if isinstance(r, Step)]
        retreats = [(i, r) for i, r in enumerate(requests) if isinstance(r, Retreat)]
        for part in _parts(retreats, lambda retreat: retreat.search.program, self.engine.lanes):
            worlds = self.planner.retreat([retreat.search for _, retreat in part])
            for (i, _), world in zip(part, worlds, strict=True):
                results[i] = world
        # Apart, so that no result depends on what the others of its call asked for.
        for part in _parts(steps, lambda step: step.program, self.engine.lanes):
            alike = [step for _, step in part]
            for (i, _), result in zip(part, self._iterate(alike), strict=True):
                results[i] = result
        return results

    def rolled(self, step: Step) -> tuple[Search, Rolled]:
        """Compute an iteration and return all of its rollouts too; it counts in no statistics."""
        return self.planner.rolled(step.search, self._keys_of([step])[0])

    def _iterate(self, steps: Sequence[Step]) -> list[Any]:
        with self._counting:
            self.calls += 1
            self.steps += len(steps)
            self.lanes_used += len(steps)
        searches, keys = [step.search for step in steps], self._keys_of(steps)
        if not steps[0].candidates:
            return self.planner.step(searches, keys)
        pairs = zip(searches, self.planner.step_valued(searches, keys), strict=True)
        return [
            (after, candidates.candidates_of(before, rolled, self.planner))
            for before, (after, rolled) in pairs
        ]

    def _keys_of(self, steps: Sequence[Step]) -> list[np.ndarray]:
        paths = [step.key_path for step in steps]
        paths += [paths[0]] * (self.engine.lanes - len(steps))
        return list(np.asarray(self._keys(np.array(paths, np.uint32)))[: len(steps)])


def warm_up(
    planner_service: PlannerService, search: Search, seed: int, *, checked: bool = False
) -> float:
    """Compile the programs by one iteration whose result is not used.

    Args:
      planner_service: to warm up.
      search: any.
      seed: of the iteration.
      checked: whether candidates will be checked in a world, which takes programs of its own.

    Returns:
      The time that it took, s; 0 where a service with the same programs has been warmed up before.
    """
    program = (search.program, checked)
    if program in planner_service.warm:
        return 0.0
    start, key_path = time.perf_counter(), robot_key_path(seed, 0, 0, 0)(0)
    planner_service.compute([Step(search, key_path)])
    if checked:
        planner_service.compute([Step(search, key_path, candidates=True)])
        candidates.warm_up(planner_service.planner, search)
    seconds = time.perf_counter() - start
    planner_service.warm.add(program)
    planner_service.occupancy()
    planner_service.steps = 0
    planner_service.seconds = 0.0
    return seconds


def planner_service_of(config: Planning) -> PlannerService:
    """The planner service for the engine, physics, planner and lanes of `config`."""
    return make_planner_service(
        config.engine,
        physics_of(config.physics, config.physics_constants),
        planner_of(config),
        config.lanes or 1,
    )


def make_planner_service(
    engine: str, physics: Physics, planner: PlannerConfig, lanes: int
) -> PlannerService:
    """A planner service with counters of its own.

    Its compiled programs are kept: a second service of the same settings traces nothing again.
    """
    return copy.copy(_compiled(engine, physics, planner, lanes, ENGINES.make(engine)))


@functools.lru_cache(maxsize=8)
def _compiled(
    engine: str,
    physics: Physics,
    planner: PlannerConfig,
    lanes: int,
    make: Callable[..., Engine],  # an engine that is registered again is another one
) -> PlannerService:
    return PlannerService(SizedEngine.of_name(engine, physics, lanes), planner)


def _key(path: jax.Array) -> jax.Array:
    """[5] key path -> [2] key, each number folded in."""
    key = jax.random.key(0)
    for number in path:
        key = jax.random.fold_in(key, number)
    return jax.random.key_data(key).astype(jnp.uint32)


def _parts(
    items: Sequence[tuple[int, Any]], kind: Callable[[Any], Hashable], size: int
) -> Iterator[list[tuple[int, Any]]]:
    """Numbered requests in calls: each of one kind, and of at most `size` of them."""
    kinds: dict[Hashable, list[tuple[int, Any]]] = {}
    for item in items:
        kinds.setdefault(kind(item[1]), []).append(item)
    for alike in kinds.values():
        yield from (alike[i : i + size] for i in range(0, len(alike), size))
