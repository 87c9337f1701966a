"""Plans single scenes: each is a fleet of one robot and one task, all of them in one batch.

The fleet counts time, limits and asks, and `run_fleets` is the loop, as in a sweep. So a scene is
planned as in a sweep, except that its robot has an operator of its own.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, overload

import numpy as np

from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.batching.requests import GainPredictor
from pgf_jax.errors import BadInput, kind_of
from pgf_jax.jax_setup import configure_early
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plans.file import Plan
from pgf_jax.scene.scene import Scene
from pgf_jax.settings import MAX_SEED, check_int, check_type
from pgf_jax.simulation.loop import run_fleets
from pgf_jax.simulation.single_robot import single_robot
from pgf_jax.simulation.task_worlds import WorldSpec


@overload
def plan(key: Any, scene: Scene, config: PlanConfig | None = None) -> Plan: ...


@overload
def plan(key: Any, scene: Sequence[Scene], config: PlanConfig | None = None) -> list[Plan]: ...


def plan(key, scene, config=None):
    """Plan how to reach the goal of a scene, or of each of several.

    A plan depends on (seed, scene, config) alone: not on the other scenes, nor on their order.

    Args:
      key: a JAX key, typed or raw uint32 words, or a seed in 0..2**32-1; seed `s` is the key
        `jax.random.key(s)`. Consumed; all scenes share it (common random numbers).
      scene: one scene, or a sequence of them, planned in one batch.
      config: settings; None: the defaults.

    Returns:
      The plan, or a list of plans in the scenes' order. An unsolved plan is a result.

    Raises:
      BadInput: not a key, a scene or a configuration, or a checkpoint that `config` names or needs
        cannot be used.
    """
    if isinstance(key, Scene):
        raise BadInput("plan(key, scene): the arguments are swapped, got a Scene first")
    seed = seed_of(key)
    one = isinstance(scene, str) or not isinstance(scene, Iterable)
    scenes: list[Any] = [scene] if one else list(scene)
    plans = plan_scenes([(each, seed) for each in scenes], config)
    return plans[0] if one else plans


def plan_scenes(
    scenes: Iterable[tuple[Scene, int]], config: PlanConfig | None = None
) -> list[Plan]:
    """Plan (scene, seed) pairs in one batch; returns their plans, in order. See `plan`."""
    return [plan for _, plan in sorted(iter_plans(scenes, config), key=lambda done: done[0])]


def iter_plans(
    scenes: Iterable[tuple[Scene, int]], config: PlanConfig | None = None
) -> Iterator[tuple[int, Plan]]:
    """Plan scenes, each with its own seed, in one batch; see `plan`.

    Args:
      scenes: (scene, seed) pairs.
      config: settings; None: the defaults.

    Yields:
      The number of a scene and its plan, as soon as it is done.
    """
    scenes, config = list(scenes), PlanConfig() if config is None else config
    check_type("config", config, PlanConfig)
    for pair in scenes:
        _check_pair(pair)
    configure_early(config.engine)
    predictor = _load_predictor(config)
    world = WorldSpec.of(config.world, [scene for scene, _ in scenes])
    planner_service = planner_service_of(config)
    fleets = [
        single_robot(
            planner_service,
            scene,
            config.fleet(seed),
            operator=config.operator,
            predictor=predictor,
            world=world,
            label=i,
        )
        for i, (scene, seed) in enumerate(scenes)
    ]
    for done in run_fleets(fleets, planner_service):
        yield done.label, Plan.from_task(config, scenes[done.label][1], done)


def _check_pair(pair: Any) -> None:
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise BadInput(f"scenes: expected (scene, seed) pairs, got {kind_of(pair)}")
    scene, seed = pair
    hint = "pgf_jax.load_scene reads a file" if isinstance(scene, str | os.PathLike) else ""
    check_type("scene", scene, Scene, expected="a Scene (or several)", hint=hint)
    check_int("seed", seed, 0, MAX_SEED)


def _load_predictor(config: PlanConfig) -> GainPredictor | None:
    """The predictor of what the robots bid; None where they bid no gain."""
    bids_gain = config.policy == "pgf"
    # One that is named is checked even where no robot bids: it was meant to be used.
    if bids_gain or config.predictor != "paper":
        from pgf_jax.guidance.predictors.registry import predictor_spec  # imports Flax

        predictor, _ = predictor_spec(config.predictor).load()
        return predictor if bids_gain else None
    return None


def seed_of(key: Any) -> int:
    """The 32-bit seed that a key stands for; `jax.random.key(s)` gives s, others a hash.

    Raises:
      BadInput: neither a key nor a seed in 0..2**32-1.
    """
    dtype = getattr(key, "dtype", None)
    plain = isinstance(dtype, np.dtype)
    if (isinstance(key, int) and not isinstance(key, bool)) or (
        plain and np.ndim(key) == 0 and dtype.kind in "iu"
    ):
        if not 0 <= int(key) <= MAX_SEED:
            raise BadInput(f"seed: expected a whole number within 0..{MAX_SEED}, got {key}")
        return int(key)
    words: Any = key
    if dtype is not None and not plain and str(dtype).startswith("key<"):
        import jax

        words = jax.random.key_data(key)
    if dtype is None or words.dtype != np.uint32 or words.ndim != 1 or words.size == 0:
        got = kind_of(key) if dtype is None else f"{dtype} of shape {words.shape}"
        raise BadInput(f"key: expected one JAX key (uint32 words) or a whole number, got {got}")
    words = np.asarray(words)
    if not words[:-1].any():
        return int(words[-1])
    digest = hashlib.sha256(words.astype("<u4").tobytes()).digest()
    return int.from_bytes(digest[:4], "little")
