"""Does human input help where planning alone is slow? Hard scenes, same keys, with and without.

    python experiments/help_helps.py [--scenes 330] [--operator heuristic] [--brute 8]

Scenes of the three classes are planned alone; those unsolved after 6 iterations are hard.
They are planned again with the same keys and the operator, who is asked once, after iteration 3
(`--again`: after every third), and answers at once. An iteration counts whether it reaches or
pushes. `--brute M` also tries 96 random pushes on each of the first M scenes that stay unsolved
alone (a single push, then up to 6 reach iterations): how many scenes a perfect choice of one push
would solve, at least.
"""

import dataclasses

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax import Plan, PlanConfig, Push, Scene, make_engine, sample_scene
from pgf_jax.fleet.metrics import mean_interval, rate_interval
from pgf_jax.planning.planner import BatchPlanner, Search, start_world
from pgf_jax.scene import PRESETS
from pgf_jax.study.asks import once_after
from pgf_jax.study.plan import plan_scenes

HARD_AFTER, LIMIT = 6, 30  # iterations
PUSHES, PUSH_ITERATIONS, REACH_ITERATIONS = 96, 3, 6


@dataclasses.dataclass(frozen=True)
class Config:
    """What is compared."""

    scenes: int = 330  # sampled, a third of each class
    seed: int = 3000  # of the first scene
    operator: str = "heuristic"
    again: bool = False  # ask after every third iteration, not once
    engine: str = "native"
    brute: int = 0  # unsolved scenes on which pushes are tried by rollouts


@dataclasses.dataclass(frozen=True)
class Helped(PlanConfig):
    """Asks once."""

    @property
    def policy(self) -> str:
        """The fleet policy."""
        return once_after(3)


def solved_within(plan: Plan, limit: int) -> bool:
    """Whether the plan was solved in at most `limit` iterations."""
    return plan.solved and plan.iterations <= limit


def main(config: Config) -> None:
    """Plan, compare, print."""
    console = Console()
    scenes = [
        (sample_scene(config.seed + i // 3, PRESETS[i % 3]), config.seed + i)
        for i in range(config.scenes)
    ]
    # 1.5 s for iteration 0, 3 s for each further one: a run of exactly LIMIT iterations.
    limit_s = 1.5 + 3.0 * LIMIT
    alone_config = PlanConfig(engine=config.engine, operator="none", task_limit=limit_s)
    alone = plan_scenes(scenes, alone_config)
    hard = [i for i, plan in enumerate(alone) if not solved_within(plan, HARD_AFTER)]
    console.print(f"{len(hard)} of {len(scenes)} scenes are hard")
    helped_config = (PlanConfig if config.again else Helped)(
        engine=config.engine,
        operator=config.operator,
        ask="after:3",
        service_mean=0.0,
        service_sd=0.0,
    )
    helped = plan_scenes([scenes[i] for i in hard], helped_config)
    pairs = [(alone[i], with_help) for i, with_help in zip(hard, helped, strict=True)]
    report(console, pairs, config)
    stuck = [scenes[i][0] for i in hard if not solved_within(alone[i], LIMIT)][: config.brute]
    if stuck:
        won = sum(one_push_solves(scene, config.engine) for scene in stuck)
        console.print(
            f"brute force over {PUSHES} random single pushes solves {won} of the first {len(stuck)}"
            " scenes that stay unsolved alone"
        )


def report(console: Console, pairs: list[tuple[Plan, Plan]], config: Config) -> None:
    """The table by class, then the figures over all hard scenes."""
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
    for name in (*PRESETS, "all"):
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


def one_push_solves(scene: Scene, engine: str) -> bool:
    """Whether any of 96 random pushes leads to a solution in a few reach iterations."""
    planner = BatchPlanner(make_engine(engine, n_objects=len(scene.objects), lanes=24))
    rng = np.random.default_rng(0)
    world = start_world(scene.positions)
    pushes = []
    while len(pushes) < PUSHES:
        i, angle, distance = (
            rng.integers(len(scene.objects)),
            rng.uniform(0, 2 * np.pi),
            rng.uniform(0.05, 0.2),
        )
        x, y = scene.positions[i] + distance * np.array([np.cos(angle), np.sin(angle)])
        if i != scene.goal and 0.28 < x < 0.55 and abs(y) < 0.36:
            pushes.append(planner.begin_push(world, scene.goal, Push(int(i), float(x), float(y))))
    found = [s for s in iterate(planner, pushes, PUSH_ITERATIONS, rng) if planner.terminate(s)]
    worlds = [w for part in parts(found) for w in planner.retreat(part)]
    reaches = [planner.begin_reach(w, scene.goal) for w in worlds]
    return any(planner.terminate(s) for s in iterate(planner, reaches, REACH_ITERATIONS, rng))


def iterate(
    planner: BatchPlanner, searches: list[Search], iterations: int, rng: np.random.Generator
) -> list[Search]:
    """Iterate each search until it is feasible, `iterations` times at most after iteration 0."""
    searches = list(searches)
    for _ in range(iterations + 1):
        for part in parts([i for i, s in enumerate(searches) if not planner.terminate(s)]):
            keys = rng.integers(0, 2**32, (len(part), 2), dtype=np.uint32)
            for i, after in zip(
                part, planner.step([searches[i] for i in part], list(keys)), strict=True
            ):
                searches[i] = after
    return searches


def parts(items: list, size: int = 24) -> list:
    """Chunks of at most `size`."""
    return [items[i : i + size] for i in range(0, len(items), size)]


if __name__ == "__main__":
    main(tyro.cli(Config))
