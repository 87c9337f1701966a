"""Plans of single scenes: a fleet of one robot and one task each, all in one batch.

The fleet owns limits, asks and time, and `crew.drive` the loop, as in a sweep; what is planned is
the same, only for robots that share nobody's operator.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, overload

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet, FleetConfig
from pgf_jax.guidance.bidders import choice
from pgf_jax.guidance.operators import make_operator
from pgf_jax.guidance.predictor import Bidder
from pgf_jax.scene.scene import Scene
from pgf_jax.study.checks import MAX_SEED
from pgf_jax.study.computer import Computer, planning_computer
from pgf_jax.study.crew import Crew, Robot, drive
from pgf_jax.study.plan_config import PlanConfig
from pgf_jax.study.plan_file import TERMS, Plan
from pgf_jax.study.trees import Trees


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
        bidder, _ = choice(config.predictor).load()
    plans: dict[int, Plan] = {}
    sizes = sorted({len(scene.objects) for scene, _ in scenes})
    for n_objects in sizes:  # an engine is compiled for one number of objects
        computer = planning_computer(config, n_objects)

        def one(index: int, scene: Scene, seed: int, computer=computer) -> tuple[Fleet, Crew]:
            fleet, crew = single_robot(
                computer,
                scene,
                seed,
                operator=config.operator,
                policy=config.policy,
                predictor=bidder if config.policy == "pgf" else None,
                task_limit_s=config.task_limit,
                service_s=(config.service_mean, config.service_sd),
                on_end=lambda robot: done(index, seed, fleet, crew, robot),
            )
            return fleet, crew

        def done(index: int, seed: int, fleet: Fleet, crew: Crew, robot: Robot) -> None:
            plans[index] = result = _result(config, seed, fleet, crew, robot)
            if on_plan is not None:
                on_plan(result)

        fleets = [
            one(i, scene, seed)
            for i, (scene, seed) in enumerate(scenes)
            if len(scene.objects) == n_objects
        ]
        drive(fleets, computer)
    return [plans[i] for i in range(len(scenes))]


def single_robot(
    computer: Computer,
    scene: Scene,
    seed: int,
    *,
    operator: str,
    policy: str,
    predictor: Bidder | None = None,
    task_limit_s: float,
    service_s: tuple[float, float],
    on_end: Callable[[Robot], None],
) -> tuple[Fleet, Crew]:
    """A fleet of one robot whose one task is `scene`.

    Args:
      computer: of the scene's number of objects.
      scene: the task.
      seed: of noise and service times.
      operator: who gives input.
      policy: when it is asked for.
      predictor: of what it bids.
      task_limit_s: planning, waiting and interaction allowed, s.
      service_s: mean and standard deviation of the service time, s.
      on_end: called with the robot when the task has ended.
    """
    trees = Trees(computer, scenes=lambda *_: scene, operator=make_operator(operator), seed=seed)
    crew = Crew(trees, predictor=predictor, on_task_end=lambda index, robot: on_end(robot))
    config = FleetConfig(
        robots=1,
        tasks=1,
        policy=policy,
        seed=seed,
        rollouts=computer.planner.config.rollouts,
        task_limit_s=task_limit_s,
        service_mean_s=service_s[0],
        service_sd_s=service_s[1],
    )
    return Fleet(config, crew), crew


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


def _result(config: PlanConfig, seed: int, fleet: Fleet, crew: Crew, robot: Robot) -> Plan:
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
        segments=(*robot.executed, crew.segment(robot.reach)),
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
