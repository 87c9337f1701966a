"""The paper's figure 6 and the claims of its section VI, with intervals, and what may explain them.

    python experiments/figure6.py [--preset quick|full] [--draw]

Fleets of 1, 10, 20 and 30 robots with 100 or 50 tasks each (the paper's sizes) under PGF, OR-HITL
(the paper's words, and the published code's window), always asking and never asking; on tight
scenes and on all three classes; with computers of their own or the paper's 96 shared cores; with
rollouts of 1.5 and 0.75 s. Where the paper's figures are not met, its candidate causes are tried.
Each is run with several seeds; intervals are over seeds. `--draw` makes the figures and the table
again from the stored rows.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import figure6_report as report
from study_runs import RAW, Run, compute, script, stored

from pgf_jax import SweepConfig

# Pairs that do not ship; `train_predictors.py` writes them.
ABLATIONS = Path("data/predictors/scale_1")
SIZES = (1, 10, 20, 30)
ASKING = ("pgf", "or-hitl", "or-hitl-window")
SEEDS = 4


@dataclasses.dataclass(frozen=True)
class Config:
    """What is run."""

    preset: Literal["quick", "full"] = "full"
    draw: bool = False  # only draw, from the stored rows
    raw: Path = RAW  # folder of the raw results


def runs(quick: bool) -> list[Run]:
    """All sweeps: scenarios on both sets of scenes, and the candidate causes on tight scenes."""
    found = []
    for scenes in ("tight", "all"):
        for seed in range(2 if quick else SEEDS):
            for scenario, policies, changes in _settings(scenes, seed):
                if scenario in PAIRS and not PAIRS[scenario].is_dir():
                    print(f"{scenario}: left out; {PAIRS[scenario]} is not there")
                    continue
                sizes: dict[str, Any] = (
                    {"robots": (1, 4), "tasks": 3} if quick else {"preset": "paper"}
                )
                config = SweepConfig(
                    **{"scene_class": scenes, "seed": seed, "policies": policies} | changes | sizes
                )
                # Which pair it is, is what the scenario says.
                predictor = "best" if changes.get("predictor") == "best" else "paper"
                labels = {"scenes": scenes, "scenario": scenario, "predictor": predictor}
                found.append(Run(labels, config))
    return found


def _settings(scenes: str, seed: int) -> Iterator[tuple[str, tuple[str, ...], dict[str, Any]]]:
    """Scenario, policies, and what is changed in it."""
    for scenario, changes in SCENARIOS.items():
        if scenes == "tight" or scenario in ("main", "96 shared cores"):
            yield scenario, ASKING, changes
    yield "main", ("pgf",), {"predictor": "best"}
    yield "main", ("autonomous",), {}
    # Every task has an input, which the operator thinks about: dear, so fewer tasks.
    yield "main", ("always",), {"tasks": 10}
    if scenes == "tight":
        for scenario, folder in PAIRS.items():
            yield scenario, ("pgf",), {"predictor": str(folder)}
        for q in (0.5, 1.0) if seed < 2 else ():  # dear: up to four times as long
            changes = {"random_winner": q, "tasks": 20}
            yield f"random winner, q = {q:g}", ("pgf", "or-hitl"), changes


SCENARIOS = {
    "main": {},
    "96 shared cores": {"compute": "shared:96"},
    "rollouts of 0.75 s": {"rollout_time": 0.75},
    "both": {"compute": "shared:96", "rollout_time": 0.75},
}
PAIRS = {
    "published rows": ABLATIONS / "published",
    "pair of tight scenes": ABLATIONS / "tight_alone",
}


def main(config: Config) -> None:
    """Run what is missing, then draw."""
    out = stored(config.preset)
    if not config.draw:
        compute("figure6", runs(config.preset == "quick"), out, config.raw / config.preset)
    report.write("figure6", out)


if __name__ == "__main__":
    script(main, Config)
