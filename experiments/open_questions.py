"""Studies what the paper left open: when prediction pays, and how many robots one human serves.

    python experiments/open_questions.py [--preset quick|full] [--draw]

Fleets of 5 to 40 robots have eight tasks each, on the three scene classes in turn. One thing is
changed at a time: the service time, the window, the number of operators, the computers, the scene
class, the quality of the operator, and the policy. Every point runs with several seeds; intervals
are over seeds. `--draw` makes the figures and the tables again from the stored rows.
"""

import dataclasses
from pathlib import Path
from typing import Any, Literal

import open_questions_report as report
from study_runs import RAW, Run, compute, script, stored

from pgf_jax import SweepConfig

SIZES = (5, 10, 20, 40)
FEW = (10, 20)
SEEDS = 3
MAIN = ("pgf", "best", "or-hitl", "queue", "autonomous")
CLASSES = ("tight", "medium", "wide")
WINDOWS = ("pgf", "best", "or-hitl-window")


@dataclasses.dataclass(frozen=True)
class Point:
    """One value of one question, with the settings that it changes."""

    question: str
    value: str
    changes: dict[str, Any]
    policies: tuple[str, ...] = ("pgf", "best", "or-hitl", "queue")
    sizes: tuple[int, ...] = SIZES
    tasks: int = 8


POINTS = (
    Point("default", "", {}, (*MAIN, "or-hitl-window")),
    *(
        Point("service time", f"{s:g} s", {"service_mean": s, "service_sd": s / 2})
        for s in (2.0, 4.0, 15.0, 30.0)
    ),
    *(Point("window", f"{s:g} s", {"window": s}, WINDOWS) for s in (0.0, 1.0, 4.0, 8.0)),
    *(Point("operators", str(n), {"operators": n}) for n in (2, 4)),
    # No robot ever waits: the reference of full service.
    Point("operators", "one each", {"operators": max(SIZES)}),
    *(Point("computers", f"{c} cores", {"compute": f"shared:{c}"}, MAIN) for c in (96, 192)),
    Point("computers", "slow: rollouts of 6 s", {"rollout_time": 6.0}, MAIN),
    Point(
        "computers",
        "slow, an operator each",
        {"rollout_time": 6.0, "operators": max(SIZES)},
    ),
    *(Point("scenes", name, {"scene_class": name}, MAIN, FEW) for name in CLASSES),
    *(
        Point(
            "scenes",
            f"{name}, an operator each",
            {"scene_class": name, "operators": max(SIZES)},
            sizes=FEW,
        )
        for name in CLASSES
    ),
    Point("policy", "", {}, ("random", "classifier", "always", "oracle-gain"), (10,)),
    *(
        Point("operator", name, {"operator": name}, ("pgf", "best", "or-hitl"), (10,), 5)
        for name in ("none", "noisy", "heuristic", "oracle")
    ),
)


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    preset: Literal["quick", "full"] = "full"
    draw: bool = False  # only draw, from the stored rows
    raw: Path = RAW  # folder of the raw results


def runs(quick: bool) -> list[Run]:
    """The runs of all points."""
    found = []
    for point in POINTS:
        for seed in range(2 if quick else SEEDS):
            # A sweep has one predictor for all policies, so `best` is a sweep of its own.
            groups = {
                "paper": tuple(p for p in point.policies if p != "best"),
                "best": ("pgf",) if "best" in point.policies else (),
            }
            for predictor, policies in groups.items():
                if not policies:
                    continue
                changes: dict[str, Any] = {"scene_class": "all"} | point.changes
                labels = {"question": point.question, "value": point.value, "predictor": predictor}
                found.append(
                    Run(
                        labels,
                        SweepConfig(
                            robots=(2, 4)[-len(point.sizes) :] if quick else point.sizes,
                            tasks=2 if quick else point.tasks,
                            seed=seed,
                            policies=policies,
                            predictor=predictor,
                            **changes,
                        ),
                    )
                )
    return found


def main(config: Config) -> None:
    """Compute the missing runs, then draw."""
    out = stored(config.preset)
    if not config.draw:
        compute("open_questions", runs(config.preset == "quick"), out, config.raw / config.preset)
    report.write("open_questions", out)


if __name__ == "__main__":
    script(main, Config)
