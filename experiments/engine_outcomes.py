"""Compares the outcomes of planning with two engines, on the same scenes and keys.

    python experiments/engine_outcomes.py [--scenes 150] [--engines planar mjx]

Scenes of the three classes are planned alone with each engine, for at most 30 iterations. The
script prints the share of solved scenes, and paired differences (second engine less first): of the
share in points, and of the iterations (30 if unsolved).
"""

import dataclasses

import numpy as np
import tyro
from rich.console import Console

from pgf_jax import PlanConfig, configure, sample_scene
from pgf_jax.metrics.summary import mean_interval, rate_interval
from pgf_jax.plans.plan import plan_scenes
from pgf_jax.scene import PUBLISHED_CLASSES

LIMIT = 30  # iterations
LANES = {"mjx": 8, "planar": 32}


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    engines: tuple[str, str] = ("planar", "mjx")
    scenes: int = 150  # a third of each class
    seed: int = 8000


def main(config: Config) -> None:
    """Plan with both engines, and print the results."""
    configure(None)
    console = Console()
    scenes = [
        (sample_scene(config.seed + i // 3, PUBLISHED_CLASSES[i % 3]), config.seed + i)
        for i in range(config.scenes)
    ]
    solved, iterations = {}, {}
    for engine in config.engines:
        plan_config = PlanConfig(
            engine=engine, lanes=LANES.get(engine, 1), task_limit=1.5 + 3.0 * LIMIT
        )
        plans = plan_scenes(scenes, plan_config)
        solved[engine] = np.array([plan.solved for plan in plans])
        iterations[engine] = np.array([p.iterations if p.solved else LIMIT for p in plans])
        rate = rate_interval(int(solved[engine].sum()), len(plans))
        console.print(
            f"{engine}: {100 * rate.mean:.1f} % ({100 * rate.low:.1f}..{100 * rate.high:.1f}) of "
            f"{len(plans)} solved within {LIMIT} iterations, mean {iterations[engine].mean():.2f}, "
            f"median {np.median(iterations[engine]):.0f}"
        )
    first, second = config.engines
    points = mean_interval(list(100.0 * (solved[second].astype(float) - solved[first])))
    more = mean_interval(list((iterations[second] - iterations[first]).astype(float)))
    console.print(
        f"{second} less {first}, paired: {points.mean:.1f} points ({points.low:.1f}.."
        f"{points.high:.1f}), {more.mean:.2f} iterations ({more.low:.2f}..{more.high:.2f})"
    )


if __name__ == "__main__":
    main(tyro.cli(Config))
