"""Fleets of one robot with one task."""

from typing import Any

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.requests import GainPredictor
from pgf_jax.fleet import Fleet, FleetConfig
from pgf_jax.guidance.operators.registry import make_operator
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.loop import PlannedFleet
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.search_cache import SearchCache


def single_robot(
    planner_service: PlannerService,
    scene: Scene,
    seed: int,
    *,
    operator: str,
    policy: str,
    predictor: GainPredictor | None = None,
    task_limit_s: float,
    service_s: tuple[float, float],
    label: Any = None,
) -> PlannedFleet:
    """A fleet of one robot whose one task is `scene`.

    Args:
      planner_service: for the scene's number of objects.
      scene: the task.
      seed: of noise and service times.
      operator: who gives input.
      policy: when the robot asks for it.
      predictor: of what the robot bids.
      task_limit_s: planning, waiting and interaction allowed, s.
      service_s: mean and standard deviation of the service time, s.
      label: see `PlannedFleet`.
    """
    cache = SearchCache(
        planner_service, scenes=lambda *_: scene, operator=make_operator(operator), seed=seed
    )
    robots = PlannedRobots(cache, predictor=predictor)
    config = FleetConfig(
        robots=1,
        tasks=1,
        policy=policy,
        seed=seed,
        rollouts=planner_service.planner.config.rollouts,
        task_limit_s=task_limit_s,
        service_mean_s=service_s[0],
        service_sd_s=service_s[1],
    )
    return PlannedFleet(Fleet(config, robots), robots, label)
