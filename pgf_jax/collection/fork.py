"""Forks of robots' states: their futures with help and without, computed (see `tables.forks`).

A scene gives one state, or a few: the robot plans alone, and of its unsolved reach iterations from
`first` to `last` they are drawn by (seed, scene), so that states with long histories count like
those with short ones. A scene that is solved before gives none.
"""

import itertools
import math
import zlib
from collections.abc import Hashable
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from pgf_jax.batching.places import iterate
from pgf_jax.batching.requests import (
    Coroutine,
    gather,
    robot_key_path,
    trial_key_path,
)
from pgf_jax.fleet.config import FleetConfig
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

_ROLLOUT_S = FleetConfig().rollout_time_s


def fork(
    planner: BatchPlanner,
    scene: Scene,
    seed: int,
    operator: AnyOperator,
    *,
    keys: int,
    first: int,
    last: int,
    states: int = 1,
    limit_s: float | None = None,
    world: WorldSpec | None = None,
) -> Coroutine:
    """Plan a scene alone, and fork its states; returns a frame of forks, or None.

    Args:
      planner: of the searches.
      scene: to plan, by robot 0 as its task 0.
      seed: of the noise.
      operator: gives the input, as the first in the task.
      keys: futures, each with help and without.
      first, last: reach iterations after which a state may be taken.
      states: how many are taken, where there are as many.
      limit_s: the task's limit, to which futures go on, s: the frame then has the columns of
        futures, of which the first without help is what the robot itself does, under its own noise;
        None: `LOOK_AHEAD` reach iterations.
      world: in which solutions are checked; None: the engine is believed.
    """
    search = planner.begin_reach(start_world(scene.positions), scene.goal, scene.shelf)
    timed = limit_s is not None
    limit = limit_s / _ROLLOUT_S if timed else math.inf
    unsolved: list[_State] = []
    place, spent, done = None, 0, 0
    if world is not None:
        worlds = world.worlds(scene)
        place = worlds.to_act(worlds.start())
    for i in itertools.count() if timed else range(last + 1):
        takes = 2 if i else 1
        if spent + takes > limit:
            break
        search, checks = yield from iterate(
            planner, search, robot_key_path(seed, 0, 0, i)(0), place
        )
        spent, done = spent + takes + checks, i
        if planner.terminate(search):
            break
        if first <= i <= last and spent < limit:
            unsolved.append(_State(search, spent))
        elif i == last and not unsolved:
            break
    if not unsolved:
        return None
    draw = stream(seed, "fork-at", zlib.crc32(scene.name.encode()))
    number = min(states, len(unsolved))
    drawn = [unsolved.pop(int(draw.integers(len(unsolved)))) for _ in range(number)]
    imagined: dict[Hashable, Any] = {}  # the shelf is the same in all of them

    def itself(state: _State) -> Trial:
        """What the robot does after a state."""
        steps = done - int(state.search.iteration)
        cost = float(np.sum(search.value.terms[:3]))
        total, solved = float(search.value.total), planner.terminate(search)
        return Trial(cost, total, solved, steps, spent - state.spent, False, search)

    def carried_on(state: _State) -> Coroutine:
        view = View.of(state.search, place=place, imagined=imagined)
        own = itself(state) if timed else None
        return _carry_on(planner, scene, seed, operator, state, view, keys, limit, own)

    frames = yield from gather([carried_on(state) for state in drawn])
    return pl.concat(frames)


class _State(NamedTuple):
    search: Search
    spent: int  # of the task's time, in rollouts


def _carry_on(
    planner: BatchPlanner,
    scene: Scene,
    seed: int,
    operator: AnyOperator,
    state: _State,
    view: View,
    keys: int,
    limit: float,
    own: Trial | None,
) -> Coroutine:
    """The futures of one state; returns their frame.

    Args:
      planner, scene, seed, operator, keys: see `fork`.
      state: to carry on.
      view: of it.
      limit: of the task's time, in rollouts.
      own: what the robot does after it; None: futures go on for `LOOK_AHEAD` iterations.
    """
    search, place, timed = state.search, view.place, own is not None
    decision_key = (seed, 0, 0, int(search.iteration) + 1)
    push = yield from ask_operator(operator, view, search, planner, decision_key)

    def futures(given: Any, numbers: range) -> list[Coroutine]:
        return [
            simulate_input(
                planner,
                search,
                given,
                trial_key_path(*decision_key, key),
                reach_limit=math.inf if timed else LOOK_AHEAD,
                rollout_limit=limit - state.spent,
                keep=timed,
                place=place,
            )
            for key in numbers
        ]

    # "Go on" leaves the trajectory as it is: the future without help, key by key.
    without = futures(None, range(int(timed), keys))
    trials = yield from gather(without + (futures(push, range(keys)) if push is not None else []))
    alone = ([own] if own is not None else []) + trials[: len(without)]
    helped = trials[len(without) :] if push is not None else alone
    frame = _frame(scene, seed, search, push is not None, alone, helped)
    if not timed:
        return frame
    times = {"alone_s": alone, "helped_s": helped}
    return frame.with_columns(
        pl.Series(name, [_ROLLOUT_S * trial.rollouts for trial in trials])
        for name, trials in times.items()
    )


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
