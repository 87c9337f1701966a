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
from pgf_jax.simulation.task_worlds import WorldSpec


def single_robot(
    planner_service: PlannerService,
    scene: Scene,
    config: FleetConfig,
    *,
    operator: str,
    predictor: GainPredictor | None = None,
    world: WorldSpec | None = None,
    label: Any = None,
) -> PlannedFleet:
    """A fleet of one robot whose one task is `scene`.

    Args:
      planner_service: for the scene's number of objects.
      scene: the task.
      config: of the fleet; its seed is also that of the noise.
      operator: who gives input.
      predictor: of what the robot bids.
      world: see `FleetSpec`.
      label: see `PlannedFleet`.
    """
    cache = SearchCache(
        planner_service,
        scenes=lambda *_: scene,
        operator=make_operator(operator),
        seed=config.seed,
        worlds=None if world is None else world.worlds,
    )
    robots = PlannedRobots(cache, predictor=predictor)
    return PlannedFleet(Fleet(config, robots), robots, label)
