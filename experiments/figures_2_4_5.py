"""Reproduces the paper's figures 2 (two nominals), 4 (an easy and a hard scene) and 5 (a window).

    python experiments/figures_2_4_5.py [--preset quick] [--figures 2 4 5] [--draw]

Each figure is drawn from its data file `OUT/figureN.json` alone, so `--draw` draws it again without
computing. The same options give the same file byte for byte (on one machine). Each file states the
rule by which its scenes were chosen; no rule depends on how planning a scene ended.
`figures_2_4_5_windows.py` makes the data of figure 5, `figures_2_4_5_drawing.py` draws. It takes
about three minutes of one core, less with `--preset quick`.

Source: Papallas & Dogar (2022), figures 2, 4 and 5.
"""

import dataclasses
import json
import re
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
from figures_2_4_5_drawing import FIGURES, rounded, scene_content
from figures_2_4_5_windows import POLICIES, figure5, table
from study_runs import ROOT, script, stored

from pgf_jax import BadInput, PlanConfig, Scene, SweepConfig, sample_scene, sweep
from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.files import png, read_json, write_atomically
from pgf_jax.guidance.geometry import end_effector
from pgf_jax.guidance.operators.heuristic import HeuristicOperator
from pgf_jax.guidance.view import View
from pgf_jax.physics.engine import default_lanes
from pgf_jax.planning import nominal
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search, start_world
from pgf_jax.plans.plan import plan_scenes
from pgf_jax.settings import MAX_SEED, check_int

ENGINE = "planar"
MOVED = 0.05  # m, least distance by which the push of figure 2 moves its object
NO_NOISE = np.zeros(2, np.uint32)  # the rollout of a nominal draws no noise, so any key will do

# What the paper reports on its own scenes (figures 4 and 5).
PAPER_4 = {"easy": 0.0, "hard": 749.56}  # initial costs
PAPER_5 = {"solved_alone_after": [4, 8, 20], "asks_at": [7, 4], "failures": 1}  # under OR-HITL


@dataclasses.dataclass(frozen=True)
class Preset:
    """Amount of computation."""

    scenes: int  # from which those of figures 2 and 4 are chosen
    robots: int  # of the fleet of figure 5
    tasks: int  # of each robot


PRESETS = {"full": Preset(200, 20, 10), "quick": Preset(40, 10, 2)}


@dataclasses.dataclass(frozen=True)
class Config:
    """Compute the data of figures 2, 4 and 5, and draw them.

    Attributes:
      preset: full: 200 scenes, and a sweep of 20 robots with 10 tasks each; quick: 40, 10 and 2.
      figures: which of 2, 4 and 5.
      seed: of the first scene of figures 2 and 4 (the next ones count on), which is also the seed
        of its noise; and of the sweep of figure 5.
      scene_class: of all scenes.
      predictor: what the robots of figure 5 bid by: paper, best, or a folder (see `sweep`).
      draw: only draw again, from the data files that are there.
      out: folder of data and pictures; None: experiments/results for full, and
        results/study_quick, which git ignores, for quick.
    """

    preset: Literal["quick", "full"] = "full"
    figures: tuple[Literal[2, 4, 5], ...] = (2, 4, 5)
    seed: int = 0
    scene_class: Literal["tight", "medium", "wide"] = "tight"
    predictor: str = "paper"
    draw: bool = False
    out: Path | None = None

    def folder(self) -> Path:
        """Folder of data and pictures."""
        if self.out is not None:
            return self.out
        return stored(self.preset)

    def about(self) -> dict[str, Any]:
        """The settings and versions that the data depend on, as JSON."""
        return {
            "seed": self.seed,
            "preset": self.preset,
            "scene_class": self.scene_class,
            "engine": ENGINE,
            "lanes": default_lanes(ENGINE),
            "versions": {name: version(name) for name in ("pgf_jax", "jax", "jaxlib", "numpy")},
        }


# -- figures 2 and 4: nominals -------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class RolledNominal:
    """A sampled scene, and its reach after the rollout of the nominal."""

    seed: int  # of the scene, and of the noise when it is planned
    scene: Scene
    search: Search


def plan_config() -> PlanConfig:
    """Settings of planning alone, with as many lanes as a sweep."""
    return PlanConfig(engine=ENGINE, operator="none", lanes=default_lanes(ENGINE))


def sample(config: Config, planner: BatchPlanner) -> list[RolledNominal]:
    """Sample the scenes to choose from, and roll out their nominals."""
    seeds = range(config.seed, config.seed + PRESETS[config.preset].scenes)
    scenes = [sample_scene(seed, config.scene_class) for seed in seeds]
    searches = roll_nominals(
        planner,
        [planner.begin_reach(start_world(scene.positions), scene.goal) for scene in scenes],
    )
    return [RolledNominal(*each) for each in zip(seeds, scenes, searches, strict=True)]


def roll_nominals(planner: BatchPlanner, searches: Sequence[Search]) -> list[Search]:
    """Run iteration 0 of each search."""
    done, lanes = [], planner.engine.lanes
    for k in range(0, len(searches), lanes):
        part = searches[k : k + lanes]
        done += planner.step(part, [NO_NOISE] * len(part))
    return done


def figure2(
    config: Config, planner: BatchPlanner, sampled: Sequence[RolledNominal]
) -> dict[str, Any]:
    """The data of figure 2: a scene's reach nominal and a push nominal."""
    unsolved = [b for b in sampled if not planner.terminate(b.search)]
    chosen = [HeuristicOperator().ranked(View.of(b.search), 1)[0] for b in unsolved]
    pushes = roll_nominals(
        planner,
        [
            planner.begin_push(b.search.start, b.scene.goal, push)
            for b, push in zip(unsolved, chosen, strict=True)
        ],
    )
    for b, push, search in zip(unsolved, chosen, pushes, strict=True):
        o, target = b.scene.positions[push.object], np.array([push.x, push.y])
        moved = np.linalg.norm(search.best.objects[-1, push.object] - o)
        if not planner.terminate(search) or moved < MOVED:
            continue
        along = (target - o) / np.linalg.norm(target - o)
        content = {
            "object": push.object,
            "target": rounded(target),
            "behind": rounded(o - nominal.PUSH_BEHIND * along),
            "stop": rounded(target - nominal.PUSH_SHORT * along),
        }
        return {
            "figure": 2,
            "about": config.about(),
            "rule": f"of the {len(sampled)} {config.scene_class} scenes from seed {config.seed} "
            "on, the first whose reach nominal is not feasible and for which the nominal of the "
            "push that the heuristic operator puts first by geometry is feasible and moves its "
            f"object by {MOVED} m or more",
            "seed": b.seed,
            "scene": scene_content(b.scene),
            "reach": nominal_content(b.search),
            "push": nominal_content(search) | content,
        }
    raise BadInput(
        f"figure 2: none of {len(sampled)} scenes from seed {config.seed} on fits the rule; "
        "expected a seed, or a preset, with one that does"
    )


def figure4(
    config: Config, planner: BatchPlanner, sampled: Sequence[RolledNominal]
) -> dict[str, Any]:
    """The data of figure 4: an easy scene and a hard one."""
    costs = [three_terms(b.search) for b in sampled]
    feasible = [i for i, b in enumerate(sampled) if planner.terminate(b.search)]
    others = [i for i in range(len(sampled)) if i not in feasible]
    if not feasible or not others:
        raise BadInput(
            f"figure 4: of {len(sampled)} scenes from seed {config.seed} on, the nominals of "
            f"{len(feasible)} are feasible; expected some, and some that are not"
        )
    chosen = {
        "easy": sampled[feasible[0]],
        "hard": sampled[min(others, key=lambda i: abs(costs[i] - PAPER_4["hard"]))],
    }
    plans = plan_scenes([(b.scene, b.seed) for b in chosen.values()], plan_config())
    return {
        "figure": 4,
        "about": config.about(),
        "rule": f"of the {len(sampled)} {config.scene_class} scenes from seed {config.seed} on: "
        f"easy, the first whose nominal is feasible (total cost at most "
        f"{planner.config.cost.feasible_cost:g}, goal in reach); hard, of the others the one whose "
        f"nominal's c_d + c_f + c_b is nearest to the paper's {PAPER_4['hard']}",
        "paper": PAPER_4,
        **{
            name: {
                "seed": b.seed,
                "scene": scene_content(b.scene),
                "reach": nominal_content(b.search),
                "alone": {
                    "status": str(plan.status),
                    "iterations": plan.iterations,
                    "planning_time_s": plan.planning_time_s,
                },
            }
            for (name, b), plan in zip(chosen.items(), plans, strict=True)
        },
        "initial_costs": {
            "what": "c_d + c_f + c_b of the reach nominal of every scene chosen from, by seed",
            "feasible": len(feasible),
            "costs": rounded(costs, 2),
        },
    }


def nominal_content(search: Search) -> dict[str, Any]:
    """A nominal and its rollout as JSON; hand, gripper and ee at the start and the T knot ends."""
    hands = np.concatenate([search.start.hand[None], search.best.hand])  # [T + 1, 3]
    first = "c_h" if search.task.pushing else "c_d"
    names = (first, "c_f", "c_b", "c_e", "c_s", "total")
    values = [*search.value.terms, search.value.total]
    return {
        "hand": rounded(hands),
        "gripper": rounded([search.start.gripper, *search.gripper], 1),
        "ee": rounded([end_effector(pose) for pose in hands]),
        "ends": rounded(search.best.objects[-1]),
        "cost": dict(zip(names, rounded(values, 2), strict=True)),
        "three_terms": rounded(three_terms(search), 2),
        "feasible": bool(search.value.feasible),
    }


def three_terms(search: Search) -> float:
    """The cost of the paper: c_d + c_f + c_b (pushing: c_h in place of c_d)."""
    return float(np.sum(search.value.terms[:3], dtype=np.float64))


# -- figure 5: a sweep ---------------------------------------------------------------------------


def run_sweep(config: Config) -> dict[str, Any]:
    """Run the sweep of figure 5, with its files in results/figure5; returns the figure's data.

    Cells that are there are computed again, because they depend on the code too.
    """
    sizes = PRESETS[config.preset]
    name = f"{config.preset}_{config.scene_class}_{config.predictor}_seed{config.seed}"
    sweep_config = SweepConfig(
        robots=(sizes.robots,),
        policies=POLICIES,
        tasks=sizes.tasks,
        seed=config.seed,
        engine=ENGINE,
        scene_class=config.scene_class,
        predictor=config.predictor,
        out=ROOT / "results" / "figure5" / re.sub(r"[^\w.-]+", "_", name),
    )
    content = figure5(sweep_config, sweep(sweep_config))
    return {"figure": 5, "about": config.about(), "paper": PAPER_5} | content


# -- files ---------------------------------------------------------------------------------------


def json_text(content: dict[str, Any]) -> str:
    """Format as JSON, each innermost list on one line."""
    text = json.dumps(content, indent=1, allow_nan=False)
    return re.sub(r"\[[^][{}\"]*\]", lambda found: " ".join(found[0].split()), text) + "\n"


def compute(config: Config) -> None:
    """Compute and write the data files."""
    folder, content = config.folder(), {}
    if {2, 4} & {*config.figures}:
        planner = planner_service_of(plan_config()).planner
        sampled = sample(config, planner)
        if 2 in config.figures:
            content[2] = figure2(config, planner, sampled)
        if 4 in config.figures:
            content[4] = figure4(config, planner, sampled)
    if 5 in config.figures:
        content[5] = run_sweep(config)
        write_atomically(folder / "figure5.csv", table(content[5]))
    for number, data in content.items():
        write_atomically(folder / f"figure{number}.json", json_text(data).encode())


def run(config: Config) -> None:
    """Compute the data, unless only drawing is asked for, and draw."""
    check_int("--seed", config.seed, 0, MAX_SEED - PRESETS[config.preset].scenes)
    if not config.draw:
        compute(config)
    for number in config.figures:
        path = config.folder() / f"figure{number}.json"
        picture = path.with_suffix(".png")
        if not path.is_file():
            raise BadInput(f"{path}: no such file, expected data that were computed without --draw")
        write_atomically(picture, png(FIGURES[number](read_json(path))))
        print(picture)


if __name__ == "__main__":
    script(run, Config)
