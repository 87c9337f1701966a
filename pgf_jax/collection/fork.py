"""Forks of a robot's state: its future with help and without, computed (see `tables.forks`).

A scene gives one state: the robot plans alone, and of its unsolved reach iterations from `first` to
`last` one is drawn by (seed, scene), so that states with long histories count like those with short
ones. A scene that is solved before gives none.
"""

import zlib
from typing import Any

import polars as pl

from pgf_jax.batching.places import iterate
from pgf_jax.batching.requests import (
    Coroutine,
    gather,
    robot_key_path,
    trial_key_path,
)
from pgf_jax.guidance.operators.base import AnyOperator, ask_operator
from pgf_jax.guidance.predictors.features import STATE, state_features
from pgf_jax.guidance.trials import Trial, simulate_input
from pgf_jax.guidance.view import View
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search, start_world
from pgf_jax.planning.types import LOOK_AHEAD
from pgf_jax.scene.sampling import class_of
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.task_worlds import WorldSpec
from pgf_jax.streams import stream
from pgf_jax.tables.forks import FORK_SCHEMA


def fork(
    planner: BatchPlanner,
    scene: Scene,
    seed: int,
    operator: AnyOperator,
    *,
    keys: int,
    first: int,
    last: int,
    world: WorldSpec | None = None,
) -> Coroutine:
    """Plan a scene alone, and fork one of its states; returns a frame of `FORK_SCHEMA`, or None.

    Args:
      planner: of the searches.
      scene: to plan, by robot 0 as its task 0.
      seed: of the noise.
      operator: gives the input, as the first in the task.
      keys: futures, each with help and without.
      first, last: reach iterations after which the state may be taken.
      world: in which solutions are checked; None: the engine is believed.
    """
    search = planner.begin_reach(start_world(scene.positions), scene.goal, scene.shelf)
    unsolved: list[Search] = []
    place = None
    if world is not None:
        worlds = world.worlds(scene)
        place = worlds.to_act(worlds.start())
    for i in range(last + 1):
        search = yield from iterate(planner, search, robot_key_path(seed, 0, 0, i)(0), place)
        if planner.terminate(search):
            break
        if i >= first:
            unsolved.append(search)
    if not unsolved:
        return None
    draw = stream(seed, "fork-at", zlib.crc32(scene.name.encode()))
    search = unsolved[int(draw.integers(len(unsolved)))]
    done = int(search.iteration)
    decision_key = (seed, 0, 0, done + 1)
    push = yield from ask_operator(
        operator, View.of(search, place=place), search, planner, decision_key
    )

    def futures(given: Any) -> list[Coroutine]:
        return [
            simulate_input(
                planner,
                search,
                given,
                trial_key_path(*decision_key, key),
                reach_limit=LOOK_AHEAD,
                place=place,
            )
            for key in range(keys)
        ]

    # "Go on" leaves the trajectory as it is: the future without help, key by key.
    trials = yield from gather(futures(None) + (futures(push) if push is not None else []))
    alone, helped = trials[:keys], trials[-keys:]
    return _frame(scene, seed, search, push is not None, alone, helped)


def _frame(
    scene: Scene, seed: int, search: Search, push: bool, alone: list[Trial], helped: list[Trial]
) -> pl.DataFrame:
    state = dict(
        zip((f"state:{name}" for name in STATE), state_features(search).tolist(), strict=True)
    )
    rows = [
        {
            "scene": scene.name,
            "seed": seed,
            "class": class_of(scene),
            "iteration": int(search.iteration),
            "input": "push" if push else "go_on",
            "key": key,
            "alone": a.cost,
            "helped": h.cost,
            "alone_solved": a.solved,
            "helped_solved": h.solved,
            "alone_iterations": a.iterations,
            "helped_iterations": h.iterations,
            "pushed": h.pushed,
            **state,
        }
        for key, (a, h) in enumerate(zip(alone, helped, strict=True))
    ]
    return pl.DataFrame(rows, schema=FORK_SCHEMA)
