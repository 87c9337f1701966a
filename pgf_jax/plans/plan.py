"""Plans of single scenes: a fleet of one robot and one task each, all in one batch.

The fleet owns limits, asks and time, and `crew.drive` the loop, as in a sweep; what is planned is
the same, only for robots that share nobody's operator.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, overload

import numpy as np

from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet
from pgf_jax.guidance.predictors.registry import predictor_spec
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plans.file import TERMS, Plan
from pgf_jax.scene.scene import Scene
from pgf_jax.settings import MAX_SEED
from pgf_jax.simulation.loop import run_fleets
from pgf_jax.simulation.planned_robots import PlannedRobots, Robot
from pgf_jax.simulation.single_robot import single_robot


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
      BadInput: not a key, or a checkpoint that `config` names or needs cannot be used.
    """
    seed = seed_of(key)
    if isinstance(scene, Scene):
        return plan_scenes([(scene, seed)], config)[0]
    return plan_scenes([(one, seed) for one in scene], config)


def plan_scenes(
    scenes: Iterable[tuple[Scene, int]],
    config: PlanConfig | None = None,
    *,
    on_plan: Callable[[Plan], None] | None = None,
) -> list[Plan]:
    """Plan scenes, each with its own seed, in one batch; see `plan`.

    Args:
      scenes: (scene, seed) pairs.
      config: settings; None: the defaults.
      on_plan: called with each plan when it is done.

    Returns:
      Their plans, in order.
    """
    scenes, config = list(scenes), config or PlanConfig()
    bidder = None
    # One that is named is checked even where nothing will be asked: it was meant to be used.
    if config.policy == "pgf" or config.predictor != "paper":
        bidder, _ = predictor_spec(config.predictor).load()
    plans: dict[int, Plan] = {}
    sizes = sorted({len(scene.objects) for scene, _ in scenes})
    for n_objects in sizes:  # an engine is compiled for one number of objects
        planner_service = planner_service_of(config, n_objects)

        def one(
            index: int, scene: Scene, seed: int, planner_service=planner_service
        ) -> tuple[Fleet, PlannedRobots]:
            fleet, planned = single_robot(
                planner_service,
                scene,
                seed,
                operator=config.operator,
                policy=config.policy,
                predictor=bidder if config.policy == "pgf" else None,
                task_limit_s=config.task_limit,
                service_s=(config.service_mean, config.service_sd),
                on_end=lambda robot: done(index, seed, fleet, planned, robot),
            )
            return fleet, planned

        def done(index: int, seed: int, fleet: Fleet, planned: PlannedRobots, robot: Robot) -> None:
            plans[index] = result = _result(config, seed, fleet, planned, robot)
            if on_plan is not None:
                on_plan(result)

        fleets = [
            one(i, scene, seed)
            for i, (scene, seed) in enumerate(scenes)
            if len(scene.objects) == n_objects
        ]
        run_fleets(fleets, planner_service)
    return [plans[i] for i in range(len(scenes))]


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
        got = type(key).__name__ if dtype is None else f"{dtype} of shape {words.shape}"
        raise BadInput(f"key: expected one JAX key (uint32 words) or a whole number, got {got}")
    words = np.asarray(words)
    if not words[:-1].any():
        return int(words[-1])
    digest = hashlib.sha256(words.astype("<u4").tobytes()).digest()
    return int.from_bytes(digest[:4], "little")


def _result(
    config: PlanConfig, seed: int, fleet: Fleet, planned: PlannedRobots, robot: Robot
) -> Plan:
    (record,) = fleet.records
    terms = [float(term) for term in robot.reach.value.terms]
    log = robot.log.frame()
    reach = log.filter(log["kind"] == "reach")
    segments = reach["segment"].to_numpy()
    return Plan(
        scene=robot.scene,
        status=record.status,
        seed=seed,
        engine=config.engine,
        lanes=config.lanes,
        physics=config.physics,
        cost_variant=config.cost,
        update=config.update,
        operator=config.operator,
        ask=config.ask,
        segments=(*robot.executed, planned.segment(robot.reach)),
        cost={**dict(zip(TERMS, terms, strict=True)), "total": float(robot.reach.value.total)},
        history=reach.select("c_d", "c_f", "c_b").to_numpy().reshape(-1, 3),
        history_starts=tuple(int(i) for i in np.flatnonzero(np.diff(segments, prepend=-1))),
        iterations=record.iterations,
        reach_iterations=record.reach_iterations,
        planning_time_s=record.planning_time_s,
        waiting_s=record.waiting_s,
        interaction_s=record.interaction_s,
        execution_s=record.execution_s,
        pushes=record.pushes_succeeded,
        requests=record.requests,
        grants=record.grants,
        non_finite=record.non_finite,
    )
