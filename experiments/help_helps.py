"""Compares planning with and without human input on hard scenes, with the same keys.

    python experiments/help_helps.py [--scenes 330] [--operator heuristic|oracle|clairvoyant]

Scenes of the three classes are planned alone; those unsolved after 6 iterations are hard. They are
planned again with the same keys and an operator, who is asked once, after iteration 3 (`--again`:
after every third iteration), and answers at once. Iterations of reaching and of pushing count
alike. `push_outcomes.py` measures what single pushes are worth on such scenes.
"""

import dataclasses

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax import Plan, PlanConfig, configure, sample_scene
from pgf_jax.fleet.policies import once_after
from pgf_jax.metrics.summary import mean_interval, rate_interval
from pgf_jax.plans.plan import plan_scenes
from pgf_jax.scene import PUBLISHED_CLASSES

HARD_AFTER, LIMIT = 6, 30  # iterations


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: int = 330  # sampled, a third of each class
    seed: int = 3000  # of the first scene
    operator: str = "heuristic"
    again: bool = False  # ask after every third iteration, not once
    engine: str = "planar"
    lanes: int = 32


@dataclasses.dataclass(frozen=True)
class Helped(PlanConfig):
    """Settings of a plan that asks for input once."""

    @property
    def policy(self) -> str:
        """The fleet policy."""
        return once_after(3)


def solved_within(plan: Plan, limit: int) -> bool:
    """Whether the plan was solved in at most `limit` iterations."""
    return plan.solved and plan.iterations <= limit


def main(config: Config) -> None:
    """Plan with and without help, and print the comparison."""
    configure(config.engine)
    console = Console()
    scenes = [
        (sample_scene(config.seed + i // 3, PUBLISHED_CLASSES[i % 3]), config.seed + i)
        for i in range(config.scenes)
    ]
    # 1.5 s for iteration 0, 3 s for each further one: a run of exactly LIMIT iterations.
    limit_s = 1.5 + 3.0 * LIMIT
    alone_config = PlanConfig(
        engine=config.engine, lanes=config.lanes, operator="none", task_limit=limit_s
    )
    alone = plan_scenes(scenes, alone_config)
    hard = [i for i, plan in enumerate(alone) if not solved_within(plan, HARD_AFTER)]
    console.print(f"{len(hard)} of {len(scenes)} scenes are hard")
    helped_config = (PlanConfig if config.again else Helped)(
        engine=config.engine,
        lanes=config.lanes,
        operator=config.operator,
        ask="after:3",
        service_mean=0.0,
        service_sd=0.0,
    )
    helped = plan_scenes([scenes[i] for i in hard], helped_config)
    pairs = [(alone[i], with_help) for i, with_help in zip(hard, helped, strict=True)]
    report(console, pairs, config)


def report(console: Console, pairs: list[tuple[Plan, Plan]], config: Config) -> None:
    """Print the table by class, then the statistics of all hard scenes."""
    asked = "every third iteration" if config.again else "once, after iteration 3"
    table = Table(
        title=f"hard scenes: solved within {LIMIT} iterations ({config.operator}, asked {asked})"
    )
    for column in (
        "class",
        "hard",
        "alone",
        "helped",
        "unsolved alone",
        "of them solved with help",
    ):
        table.add_column(column, justify="left" if column == "class" else "right")
    for name in (*PUBLISHED_CLASSES, "all"):
        rows = [p for p in pairs if name in ("all", p[0].scene.name.split("_")[0])]
        unsolved = [p for p in rows if not solved_within(p[0], LIMIT)]
        rates = [
            rate_interval(sum(solved_within(p[side], LIMIT) for p in rows), len(rows))
            for side in (0, 1)
        ]
        rescued = rate_interval(sum(solved_within(p[1], LIMIT) for p in unsolved), len(unsolved))
        table.add_row(
            name,
            str(len(rows)),
            *(f"{100 * r.mean:.0f} % ({100 * r.low:.0f}..{100 * r.high:.0f})" for r in rates),
            str(len(unsolved)),
            f"{100 * rescued.mean:.0f} % ({100 * rescued.low:.0f}..{100 * rescued.high:.0f})",
        )
    console.print(table)
    capped = np.array(
        [[min(p.iterations, LIMIT) if p.solved else LIMIT for p in pair] for pair in pairs]
    )
    difference = mean_interval(list((capped[:, 1] - capped[:, 0]).astype(float)))
    console.print(
        f"iterations, {LIMIT} where unsolved: alone mean {capped[:, 0].mean():.1f}, median "
        f"{np.median(capped[:, 0]):.0f}; helped mean {capped[:, 1].mean():.1f}, median "
        f"{np.median(capped[:, 1]):.0f}; paired difference {difference.mean:.1f} "
        f"({difference.low:.1f}..{difference.high:.1f})"
    )
    pushes = [p[1].pushes for p in pairs]
    console.print(f"pushes executed a helped task: mean {np.mean(pushes):.1f}")


if __name__ == "__main__":
    main(tyro.cli(Config))
