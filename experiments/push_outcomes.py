"""Measures what single pushes are worth on scenes that planning alone solves slowly.

    python experiments/push_outcomes.py [--scenes 90] [--pushes 12]

Scenes that are not solved after 3 iterations are continued in several ways from the same shelf:
alone; with the push that the heuristic operator puts first by geometry; with random pushes among
those that it considers. A push gets 3 iterations, and the reach after it the rest of 11; planning
alone gets 11. The last column counts scenes in which any of the tried pushes succeeded: this is the
best of several noisy tries, so more than a perfect choice of one push would reach. The rows are by
the distance of the goal to the nearer side wall.
"""

import dataclasses
import itertools

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax import Push, configure, make_engine, sample_scene
from pgf_jax.guidance.operators import heuristic
from pgf_jax.guidance.view import View
from pgf_jax.metrics.summary import rate_interval
from pgf_jax.physics.engine import World
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search, start_world
from pgf_jax.scene import PUBLISHED_CLASSES
from pgf_jax.scene.shelf import SIDE_WALL_Y

ALONE, PUSH, TOTAL, LIMIT = 3, 3, 11, 30  # iterations
ROOMS = (0.05, 0.08, 0.10, 0.15, 0.40)  # m


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: int = 90  # a third of each class
    pushes: int = 12  # random ones, a scene
    seed: int = 20_000
    engine: str = "planar"
    lanes: int = 32


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Iterations that each way took on one scene; inf if it failed."""

    room: float  # m, from the goal to the nearer side wall
    alone: float
    chosen: float
    random: list[float]


class Tries:
    """Iterates the searches of many scenes in full batches."""

    def __init__(self, config: Config) -> None:
        engine = make_engine(config.engine, lanes=config.lanes)
        self.planner = BatchPlanner(engine)
        self.rng = np.random.default_rng(config.seed)

    def iterate(self, searches: list[Search], limits: list[int]) -> list[Search]:
        """Iterate each search until it is feasible or reaches its limit of iterations."""
        searches = list(searches)
        while todo := [
            i
            for i, (s, limit) in enumerate(zip(searches, limits, strict=True))
            if not self.planner.terminate(s) and int(s.iteration) < limit
        ]:
            part = todo[: self.planner.engine.lanes]
            keys = self.rng.integers(0, 2**32, (len(part), 2), dtype=np.uint32)
            after = self.planner.step([searches[i] for i in part], list(keys))
            for i, search in zip(part, after, strict=True):
                searches[i] = search
        return searches

    def push(self, jobs: list[tuple[World, int, Push]]) -> list[float]:
        """Number of iterations of each push and the reach after it; inf if they fail."""
        pushes = [self.planner.begin_push(*job) for job in jobs]
        pushes = self.iterate(pushes, [PUSH] * len(pushes))
        done = [i for i, s in enumerate(pushes) if self.planner.terminate(s)]
        lanes = self.planner.engine.lanes
        worlds: list[World] = []
        for k in range(0, len(done), lanes):
            worlds += self.planner.retreat([pushes[i] for i in done[k : k + lanes]])
        used = [int(pushes[i].iteration) for i in done]
        reaches = [
            self.planner.begin_reach(world, jobs[i][1])
            for i, world in zip(done, worlds, strict=True)
        ]
        reaches = self.iterate(reaches, [TOTAL - n for n in used])
        took = np.full(len(jobs), np.inf)
        for i, n, reach in zip(done, used, reaches, strict=True):
            if self.planner.terminate(reach):
                took[i] = n + int(reach.iteration)
        return took.tolist()


def outcomes(config: Config, seeds: range, tries: Tries) -> list[Outcome]:
    """Outcomes of the slow scenes among those of some seeds."""
    planner = tries.planner
    scenes = [sample_scene(seed, preset) for seed in seeds for preset in PUBLISHED_CLASSES]
    worlds = [start_world(s.positions) for s in scenes]
    begun = [planner.begin_reach(w, s.goal) for w, s in zip(worlds, scenes, strict=True)]
    slow = [
        (scene, world, search)
        for scene, world, search in zip(
            scenes, worlds, tries.iterate(begun, [ALONE] * len(begun)), strict=True
        )
        if not planner.terminate(search)
    ]
    alone = tries.iterate([search for *_, search in slow], [LIMIT] * len(slow))
    jobs: list[tuple[World, int, Push]] = []
    for scene, world, search in slow:
        seen = View.of(search)
        chosen = heuristic.HeuristicOperator().ranked(seen, 1)[0]
        pushed, targets = heuristic.candidates(seen)
        some = tries.rng.choice(len(pushed), config.pushes, replace=False)
        for push in [chosen, *(Push(int(pushed[k]), *map(float, targets[k])) for k in some)]:
            assert push is not None, f"{scene.name}: nothing to push"
            jobs.append((world, scene.goal, push))
    took = np.reshape(tries.push(jobs), (len(slow), -1))
    return [
        Outcome(
            room=SIDE_WALL_Y - abs(float(scene.positions[scene.goal, 1])),
            alone=int(end.iteration) - ALONE if planner.terminate(end) else np.inf,
            chosen=row[0],
            random=row[1:].tolist(),
        )
        for (scene, *_), end, row in zip(slow, alone, took, strict=True)
    ]


def main(config: Config) -> None:
    """Try the pushes, and print the table."""
    configure()
    console, tries, found = Console(), Tries(config), []
    seeds = range(config.seed, config.seed + -(-config.scenes // len(PUBLISHED_CLASSES)))
    for k in range(0, len(seeds), 10):
        found += outcomes(config, seeds[k : k + 10], tries)
        console.print(f"{len(seeds[: k + 10]) * len(PUBLISHED_CLASSES)} scenes, {len(found)} slow")
    table = Table(title=f"slow scenes: solved within {TOTAL} more iterations, %")
    for column in (
        "goal to side wall, m",
        "scenes",
        f"unsolved at {LIMIT} alone",
        "going on",
        "first by geometry",
        "random push",
        f"any of {config.pushes + 1}",
    ):
        table.add_column(column, justify="right")
    for low, high in [*itertools.pairwise(ROOMS), (ROOMS[0], ROOMS[-1])]:
        rows = [o for o in found if low <= o.room < high]
        if not rows:
            continue
        every = [t for o in rows for t in o.random]
        counts = (
            [np.isinf(o.alone) for o in rows],
            [o.alone <= TOTAL for o in rows],
            [o.chosen <= TOTAL for o in rows],
            [t <= TOTAL for t in every],
            [min([o.chosen, *o.random]) <= TOTAL for o in rows],
        )
        rates = [rate_interval(int(sum(c)), len(c)) for c in counts]
        cells = [f"{100 * r.mean:.0f} ({100 * r.low:.0f}..{100 * r.high:.0f})" for r in rates]
        table.add_row(f"{low:.2f} to {high:.2f}", str(len(rows)), *cells)
    console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Config))
