"""Solved means grasped: plans with their solutions checked in a world, and executed there.

    python experiments/grasped.py [--scenes SCENES_DIR] [--count 200] [--worlds none solid]

Sampled scenes of the three classes, and the published ones in SCENES_DIR, are planned with the
operator `heuristic`. A line each says how many are solved, how many of these grasp when they are
executed from the scene's start in the world `solid` (or `scene`, where they were checked in that),
the iterations of all, and checks a task.
"""

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.console import Console

from pgf_jax import ExecuteConfig, PlanConfig, configure, execute, load_scene, sample_scene
from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.metrics.summary import rate_interval
from pgf_jax.plans.file import Plan
from pgf_jax.scene import PUBLISHED_CLASSES, Scene
from pgf_jax.simulation.loop import run_fleets
from pgf_jax.simulation.single_robot import single_robot
from pgf_jax.simulation.task_worlds import WorldSpec

World = Literal["none", "solid", "scene"]


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: Path | None = None  # folder of published scene files; None: only sampled ones
    count: int = 200  # of sampled scenes, of each class
    worlds: tuple[World, ...] = ("none", "solid")
    classes: tuple[str, ...] = PUBLISHED_CLASSES
    seed: int = 20_000
    physics: Literal["default", "authors"] = "default"


def judge(scenes: list[tuple[Scene, int]], world: World, config: Config) -> str:
    """Plan scenes and execute what is solved; returns a line of it."""
    plan_config = PlanConfig(
        world=world, operator="heuristic", lanes=64, physics=config.physics, predictor="paper"
    )
    service = planner_service_of(plan_config)
    spec = WorldSpec.of(world, [scene for scene, _ in scenes])
    fleets = [
        single_robot(
            service, scene, plan_config.fleet(seed), operator="heuristic", world=spec, label=i
        )
        for i, (scene, seed) in enumerate(scenes)
    ]
    plans, checks, misses = [], [], []
    for done in run_fleets(fleets, service):
        (record,) = done.fleet.records
        plans.append(Plan.from_task(plan_config, scenes[done.label][1], done))
        checks.append(record.checks or 0)
        misses.append(record.check_misses or 0)
    solved = [plan for plan in plans if plan.solved]
    executed_in = "scene" if world == "scene" else "solid"
    options = ExecuteConfig(world=executed_in, scenes=config.scenes)
    grasped = sum(execute(plan, options)[0].grasped for plan in solved)
    iterations = np.array([plan.iterations for plan in plans])
    rate, true = rate_interval(len(solved), len(plans)), rate_interval(grasped, len(solved))
    return (
        f"solved {len(solved)} of {len(plans)} ({_percent(rate)}), grasped {grasped} of "
        f"{len(solved)} ({_percent(true)}), iterations {iterations.mean():.2f} (median "
        f"{np.median(iterations):.0f}), pushes {np.mean([p.pushes for p in plans]):.2f}, checks "
        f"{np.mean(checks):.2f} (most {max(checks)}), missed {np.mean(misses):.2f}"
    )


def _percent(rate) -> str:
    return f"{100 * rate.mean:.1f} %, {100 * rate.low:.1f}..{100 * rate.high:.1f}"


def main(config: Config) -> None:
    """Plan, execute, and print the results."""
    configure()
    console = Console(width=200)
    if config.scenes is not None:
        published = [(load_scene(path), 0) for path in sorted(config.scenes.glob("*.xml"))]
        own: tuple[World, ...] = () if "scene" in config.worlds else ("scene",)
        for world in (*config.worlds, *own):
            console.print(f"published, world {world}: {judge(published, world, config)}")
    for name in config.classes:
        sampled = [
            (sample_scene(config.seed + i, name), config.seed + i)  # pyright: ignore[reportArgumentType]
            for i in range(config.count)
        ]
        for world in config.worlds:
            if world != "scene":  # sampled scenes have none of their own
                console.print(f"{name}, world {world}: {judge(sampled, world, config)}")


if __name__ == "__main__":
    main(tyro.cli(Config))
