"""What help is worth on shelves that are hard, and how that grows with the number of objects.

    python experiments/hard_shelves.py [--classes crowded packed mixed] [--count 100]
    python experiments/hard_shelves.py --numbers 20 28 36 44 50 --out numbers.png

Scenes are planned alone, and with the same keys with an operator who is asked after every third
iteration (`ask after:3`) and takes 8 s for each answer. A line each gives the share of solved
scenes, the iterations, the planning time, and that with the services counted in; differences to
planning alone are paired by scene, and stand beside the last operator's. A scene that is not solved
counts with its whole time. With `--numbers` only the number of objects varies: standard ones in the
rectangle of the class `crowded`, the goal in its back row.
"""

import dataclasses
import itertools
import sys
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from pgf_jax import Plan, PlanConfig, configure, sample_scene
from pgf_jax.files import write_figure
from pgf_jax.metrics.summary import mean_interval, rate_interval
from pgf_jax.plans.plan import iter_plans
from pgf_jax.scene import Scene, Sizes
from pgf_jax.terminal import Progress

SAVED = ("saved, s", "of what the last saves")
HEAD = ("operator", "solved", "iterations", "planning, s", *SAVED, "services in, s", *SAVED)


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    count: int = 100  # scenes of each class, or of each number
    classes: tuple[str, ...] = ("crowded", "packed", "mixed")
    operators: tuple[str, ...] = ("heuristic", "oracle")
    numbers: tuple[int, ...] = ()  # of objects, in place of the classes
    out: Path | None = None  # figure of the numbers
    seed: int = 60_000
    service: float = 8.0  # s
    world: Literal["solid", "none"] = "solid"
    lanes: int = 64


def main(config: Config) -> None:
    """Plan all scenes, and print the comparison."""
    configure()
    console = Console(width=160)
    seeds = range(config.seed, config.seed + config.count)
    sets: dict[str, list[Scene]] = {
        str(n): [sample_scene(seed, "crowded", sizes=Sizes(objects=(n, n))) for seed in seeds]
        for n in config.numbers
    } or {name: [sample_scene(seed, name) for seed in seeds] for name in config.classes}
    found: dict[str, dict[str, list[Plan]]] = {}
    for name, scenes in sets.items():
        found[name] = {
            operator: plans(scenes, operator, config, f"scenes, {name}, {operator}")
            for operator in ("none", *config.operators)
        }
        table = Table(title=f"{name}, {config.count} scenes")
        for column in HEAD:
            table.add_column(column, justify="right" if table.columns else "left")
        for operator, done in found[name].items():
            table.add_row(operator, *row(done, found[name]))
        console.print(table)
        sys.stdout.flush()
    if config.numbers and config.out is not None:
        draw(found, config)


def plans(scenes: list[Scene], operator: str, config: Config, what: str) -> list[Plan]:
    """Plan the scenes; a scene's number in the list is the seed of its noise.

    `what` is shown with the progress.
    """
    settings = PlanConfig(
        operator=operator,
        ask="never" if operator == "none" else "after:3",
        world=config.world,
        lanes=config.lanes,
        service_mean=config.service,
        service_sd=0.0,
        predictor="paper",
    )
    seeded = [(scene, config.seed + i) for i, scene in enumerate(scenes)]
    done: dict[int, Plan] = {}
    with Progress(what, every_s=60.0) as progress:
        for i, plan in iter_plans(seeded, settings):
            done[i] = plan
            progress.update(len(done), len(scenes))
    return [done[i] for i in range(len(scenes))]


def times(done: list[Plan]) -> np.ndarray:
    """[2, scenes] planning time, and with services, s."""
    planning = np.array([plan.planning_time_s for plan in done])
    return np.stack([planning, planning + [plan.interaction_s for plan in done]])


def row(done: list[Plan], every: dict[str, list[Plan]]) -> list[str]:
    """The cells of a line."""
    mine, alone = times(done), times(every["none"])
    last = times(list(every.values())[-1])
    own, without, least = (of.mean(axis=1) for of in (mine, alone, last))
    solved = rate_interval(sum(plan.solved for plan in done), len(done))
    cells = [
        f"{100 * solved.mean:.0f} % ({100 * solved.low:.0f}..{100 * solved.high:.0f})",
        f"{np.mean([plan.iterations for plan in done]):.1f}",
    ]
    for i in range(len(own)):  # without services, and with them
        saved = mean_interval((alone[i] - mine[i]).tolist())
        most = without[i] - least[i]
        share = f"{100 * saved.mean / most:.0f} %" if most else ""
        cells += [f"{own[i]:.1f}", f"{saved.mean:.1f} ({saved.low:.1f}..{saved.high:.1f})", share]
    return cells


def draw(found: dict[str, dict[str, list[Plan]]], config: Config) -> None:
    """Draw solved, iterations and planning time over the number of objects."""
    assert config.out is not None
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    measures = (
        # Drawn as shares, whose intervals stay within 0 and 1.
        ("solved", lambda done: rate_interval(sum(plan.solved for plan in done), len(done))),
        ("iterations", lambda done: mean_interval([float(plan.iterations) for plan in done])),
        ("planning time, s", lambda done: mean_interval(times(done)[0].tolist())),
    )
    numbers = [int(name) for name in found]
    for ax, (label, of) in zip(axes, measures, strict=True):
        for operator, marker in zip(("none", *config.operators), itertools.cycle("osD^v")):
            spread = [of(found[name][operator]) for name in found]
            middle = np.array([s.mean for s in spread])
            errors = [middle - [s.low for s in spread], [s.high for s in spread] - middle]
            name = "alone" if operator == "none" else operator
            ax.errorbar(numbers, middle, errors, marker=marker, capsize=3, label=name)
        ax.set_xlabel("objects")
        ax.set_ylabel(label)
    axes[0].legend(frameon=False)
    write_figure(config.out, figure)


if __name__ == "__main__":
    main(tyro.cli(Config))
