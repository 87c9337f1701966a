"""Reproduces the paper's figure 6 and checks the claims of its section VI, with intervals.

    python experiments/figure6.py [--preset quick|full] [--draw]

Fleets of 1, 10, 20 and 30 robots with 100 or 50 tasks each (the paper's sizes) run under PGF,
OR-HITL (as in the paper's text, and with the window of the published code), always asking and never
asking; on tight scenes and on all three classes; with dedicated computers or the paper's 96 shared
cores; with rollouts of 1.5 and 0.75 s. Further scenarios try causes that may explain where the
results differ from the paper. Every scenario runs with several seeds; intervals are over seeds.
`--draw` makes the figures and the table again from the stored rows.

Source: Papallas & Dogar (2022), figure 6 and section VI.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import figure6_report as report
from study_runs import RAW, Run, compute, script, stored

from pgf_jax import SweepConfig

# Pairs of networks that do not ship; `train_predictors.py --tight` writes them.
ABLATIONS = Path("data/predictors/scale_1")
SIZES = (1, 10, 20, 30)
ASKING = ("pgf", "or-hitl", "or-hitl-window")
SEEDS = 4


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    preset: Literal["quick", "full"] = "full"
    draw: bool = False  # only draw, from the stored rows
    raw: Path = RAW  # folder of the raw results


def runs(quick: bool) -> list[Run]:
    """All runs: the scenarios on both sets of scenes, and further causes on tight scenes."""
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
                # The scenario says which pair of networks it is.
                predictor = "best" if changes.get("predictor") == "best" else "paper"
                labels = {"scenes": scenes, "scenario": scenario, "predictor": predictor}
                found.append(Run(labels, config))
    return found


def _settings(scenes: str, seed: int) -> Iterator[tuple[str, tuple[str, ...], dict[str, Any]]]:
    """Yield scenarios, each with its policies and the settings that it changes."""
    for scenario, changes in SCENARIOS.items():
        if scenes == "tight" or scenario in ("main", "96 shared cores"):
            yield scenario, ASKING, changes
    yield "main", ("pgf",), {"predictor": "best"}
    yield "main", ("autonomous",), {}
    # Every task asks for an input, which the operator has to compute: slow, so fewer tasks.
    yield "main", ("always",), {"tasks": 10}
    if scenes == "tight":
        for scenario, folder in PAIRS.items():
            yield scenario, ("pgf",), {"predictor": str(folder)}
        for q in (0.5, 1.0) if seed < 2 else ():  # up to four times as slow
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
    """Compute the missing runs, then draw."""
    out = stored(config.preset)
    if not config.draw:
        compute("figure6", runs(config.preset == "quick"), out, config.raw / config.preset)
    report.write("figure6", out)


if __name__ == "__main__":
    script(main, Config)
