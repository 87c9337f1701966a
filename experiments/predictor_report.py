"""Measures how good the predictors are, as data and as Markdown tables.

Part of `train_predictors.py`.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import predictor_evaluation as ev
from matplotlib.figure import Figure
from predictor_data import Data
from study_rows import estimate, table

from pgf_jax.batching.requests import GainPredictor
from pgf_jax.files import png
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.planning.types import LOOK_AHEAD
from pgf_jax.scene import PRESETS
from pgf_jax.tables.forks import Forks
from pgf_jax.training.fit import Trained

PAPER = {"phi_auto": 58.56, "phi_human": 157.49}  # called RMSE; the published code computes the MAE
SIZES = (2, 4, 8)  # robots in a window
LAST = [STATE.index(f"{term}[t-0]") for term in ("c_d", "c_f", "c_b")]


def _parts(classes: np.ndarray) -> Iterable[tuple[str, np.ndarray]]:
    for name in (*PRESETS, "every"):
        index = np.flatnonzero(np.full(len(classes), True) if name == "every" else classes == name)
        if len(index) >= 10:
            yield name, index


def cost_table(data: Data, networks: Mapping[str, Sequence[Trained]]) -> list[dict[str, Any]]:
    """Errors of the cost networks on the held-out runs, by class."""
    out = []
    judged = [name for name in networks if name.startswith("phi_")]
    for label in judged:
        network = label.split(",")[0]
        rows = data.test[network]
        trained = data.train if label == network else data.tight
        mean = float(trained[network].target.mean())
        every = [done.predictor.predict(rows.features) for done in networks[label]]
        on_forks = networks[label][0].predictor.of_states(data.forks.state)
        for name, index in _parts(data.test_class[network]):
            target, scene = rows.target[index], rows.scene[index]
            last = rows.features[index, -3:].sum(axis=1)
            errors = ev.cost_errors(every[0][index], target, last, mean, scene)
            rmses = [ev.rmse(one[index] - target) for one in every]
            maes = [ev.mae(one[index] - target) for one in every]
            states = np.flatnonzero((data.forks.scene_class == name) | (name == "every"))
            costs = data.forks.alone if network == "phi_auto" else data.forks.helped
            costs = costs[states]
            floor = ev.noise_floor(costs)
            error = on_forks[states, None] - costs
            out.append(
                {
                    "network": label,
                    "class": name,
                    "rows": len(index),
                    "scenes": len(np.unique(scene)),
                    "rmse_seeds": [np.mean(rmses), np.min(rmses), np.max(rmses)],
                    "mae_seeds": [np.mean(maes), np.min(maes), np.max(maes)],
                    **dataclasses.asdict(errors),
                    "last": [ev.rmse(last - target), ev.mae(last - target)],
                    "mean": [ev.rmse(mean - target), ev.mae(mean - target)],
                    "states": len(states),
                    "floor": floor,
                    "on_forks": [ev.rmse(error), ev.mae(error)],
                }
            )
    return out


def gain_table(forks: Forks, predictors: Mapping[str, Sequence[GainPredictor]]) -> dict[str, Any]:
    """Comparison of bids with true gains on the held-out forks, by class."""
    out: dict[str, Any] = {}
    for name, index in _parts(forks.scene_class):
        part = forks.take(index)
        of_seed = [
            {kind: every[seed].gain(part.state) for kind, every in predictors.items()}
            for seed in range(len(next(iter(predictors.values()))))
        ]
        trivial = {
            "random": np.zeros(len(index)),
            "the cost now": part.state[:, LAST].sum(axis=1),
            "oracle": part.gain,
        }
        rows: dict[str, Any] = {kind: {"windows": {}} for kind in (*trivial, *predictors)}
        for m in SIZES:
            chosen = ev.windows({**trivial, **of_seed[0]}, part.gain, m, beside=("random", "paper"))
            others = [ev.windows(bids, part.gain, m, resamples=1) for bids in of_seed[1:]]
            for kind, choice in chosen.items():
                regrets = [choice.regret.value]
                regrets += [other[kind].regret.value for other in others if kind in other]
                rows[kind]["windows"][m] = {
                    **dataclasses.asdict(choice),
                    "regret_seeds": [np.mean(regrets), np.min(regrets), np.max(regrets)],
                }
        for kind in rows:
            bids = [seed[kind] for seed in of_seed] if kind in predictors else [trivial[kind]]
            ranks = [ev.rank_correlation(bid, part.gain) for bid in bids]
            rows[kind]["rank_correlation"] = [np.mean(ranks), np.min(ranks), np.max(ranks)]
            if kind in predictors and kind != "classifier":  # the classifier bids a probability
                rows[kind]["bids"] = dataclasses.asdict(ev.bid_statistics(bids[0], part))
                rows[kind]["calibration"] = [
                    (predicted, dataclasses.asdict(true))
                    for predicted, true in ev.calibration(bids[0], part)
                ]
        out[name] = {
            "states": len(index),
            "pushes": float(part.push.mean()),
            "mean_gain": dataclasses.asdict(
                ev.bootstrap(lambda i, g=part.gain: float(g[i].mean()), part.scene)
            ),
            "pays": float((part.gain > ev.BID).mean()),
            "harms": float((part.gain < -ev.BID).mean()),
            "reachable_regret": {m: ev.reachable(part, m) for m in SIZES},
            "bidders": rows,
        }
    return out


def draw_calibration(forks: Forks, predictors: Mapping[str, Sequence[GainPredictor]]) -> bytes:
    """Draw predicted against true gains, in groups of equally many states, as a PNG."""
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    ax = figure.subplots()
    for kind in ("paper", "best"):
        points = ev.calibration(predictors[kind][0].gain(forks.state), forks)
        predicted, true = [x for x, _ in points], [t for _, t in points]
        spread = [[t.value - t.low for t in true], [t.high - t.value for t in true]]
        ax.errorbar(predicted, [t.value for t in true], spread, marker="o", capsize=2, label=kind)
    limits = ax.get_xlim()
    ax.plot(limits, limits, color="0.7", linestyle=":", label="as predicted")
    ax.set(xlabel="predicted gain (units of cost)", ylabel="true gain, mean and 95 %")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return png(figure)


def _spread(three: Sequence[float], digits: int = 1) -> str:
    mean, low, high = (f"{x:.{digits}f}" for x in three)
    return f"{mean} ({low}..{high})"


def readme(content: Mapping[str, Any], files: Sequence[str]) -> str:
    """Text of `checkpoints/README.md`."""
    content = json.loads(json.dumps(content))  # keys become strings, as in figures.json
    collected = table(
        (
            "data",
            "scenes",
            "of them with rows",
            ", ".join(PRESETS),
            "solved",
            "with input",
            "first seed",
        ),
        [
            (
                c["data"],
                str(c["scenes"]),
                str(c["with_data"]),
                ", ".join(map(str, c["by_class"].values())),
                ", ".join(f"{100 * share:.1f} %" for share in c["solved"]),
                str(c["with_input"]) if c["operator"] else "",
                str(c["seed"]),
            )
            for c in content["collected"]
        ],
    )
    costs = table(
        (
            "network: class of the test",
            "rows (scenes)",
            "RMSE",
            "MAE",
            "RMSE of the last cost",
            "of the mean",
            "RMSE to last cost's",
            "to mean's",
            "on forks: RMSE, MAE",
            "noise floor: RMSE, MAE",
        ),
        [
            (
                f"{c['network']}: {c['class']}",
                f"{c['rows']} ({c['scenes']})",
                _spread(c["rmse_seeds"]),
                _spread(c["mae_seeds"]),
                f"{c['last'][0]:.1f}",
                f"{c['mean'][0]:.1f}",
                estimate(c["to_last"]),
                estimate(c["to_mean"]),
                f"{c['on_forks'][0]:.1f}, {c['on_forks'][1]:.1f}",
                f"{c['floor'][0]:.1f}, {c['floor'][1]:.1f}",
            )
            for c in content["costs"]
        ],
    )
    gains = "\n\n".join(_gains(name, part) for name, part in content["gains"].items())
    return _README.format(
        command="python experiments/train_predictors.py"
        + ("" if content["scale"] == 1 else f" --scale {content['scale']:g}"),
        paper=", ".join(f"{name} {value}" for name, value in PAPER.items()),
        collected=collected,
        costs=costs,
        gains=gains,
        files="\n".join(files),
        look_ahead=LOOK_AHEAD,
    )


def _gains(name: str, part: Mapping[str, Any]) -> str:
    mean = estimate(part["mean_gain"], 1)
    head = (
        f"**{name}**: {part['states']} states; the operator pushes at "
        f"{100 * part['pushes']:.0f} % of them; mean true gain {mean}; help "
        f"pays (gain above 1) at {100 * part['pays']:.0f} %, harms (below -1) at "
        f"{100 * part['harms']:.0f} %. Regret of choosing by half of the keys, judged by the "
        f"others: "
        + ", ".join(f"{value:.1f} (m = {m})" for m, value in part["reachable_regret"].items())
        + "."
    )
    rows = []
    for kind, row in part["bidders"].items():
        cells = [kind, "" if kind == "random" else _spread(row["rank_correlation"], 2)]
        for m in map(str, SIZES):
            window = row["windows"][m]
            cells.append(estimate(window["hit"]))
            cells.append(estimate(window["regret"], 1))
        last = row["windows"][str(SIZES[-1])]["to"]
        cells += [estimate(last["random"]), estimate(last["paper"])]
        asking = row.get("bids")
        cells += (
            [
                f"{100 * asking['ask_rate']:.0f} %",
                f"{100 * asking['pays_if_bid']:.0f}, {100 * asking['pays_if_not']:.0f} %",
                f"{asking['gain_if_bid']:.1f}, {asking['gain_if_not']:.1f}",
            ]
            if asking
            else ["", "", ""]
        )
        rows.append(cells)
    headings = ["bids by", "rank correlation"]
    for m in SIZES:
        headings += [f"m = {m}: hit", "regret"]
    headings += [
        f"regret m = {SIZES[-1]}: to random's",
        "to paper's",
        "asks at",
        "help pays if it asks, if not",
        "mean true gain if it asks, if not",
    ]
    return head + "\n\n" + table(headings, rows)


_README = """# Checkpoints

The predictors that ship, and how good they are. Written, with all figures (`figures.json` has more
digits and the intervals), by

    {command}

`phi_auto` and `phi_human` are the paper's pair (`--predictor paper`, the default), `gain` is the
one of `--predictor best`, `failure` the one of the policy `classifier`. Files are msgpack with a
digest; shapes are checked on loading (`pgf_jax/guidance/predictors/checkpoint.py`).
`time_alone` and `time_helped`, of the policies that rank by time, are in [`TIMES.md`](TIMES.md).

| file | size | sha256 |
|---|---:|---|
{files}

## Data

{collected}

Training and held-out scenes are drawn by different seeds, where there are several classes in turn.
Every class is in turn, and a run goes on to the task's limit of 180 s. The heuristic operator gives
the input: in human runs once, after an iteration from 3 to 39. "With rows" are, of forks, the
scenes unsolved after 3 iterations: each gives one state, at an unsolved iteration from 3 to 39, and
each state has 4 futures with input and 4 without (16 and 16 held out).
"With input" they are where the operator gives a push; "solved" are futures without and with input,
{look_ahead} reach iterations on.
Solutions were checked in the solid world, as by default; one that misses there counts as unsolved.
"Tight alone", where it stands below, is the pair trained on tight scenes (`--tight`). "First" and
"first-best" are the predictors that shipped before solutions were checked (`first/`), judged on
these data.

## Costs 10 iterations on

All unsolved rows of the held-out runs, in units of cost; mean (range) over 5 training seeds. Ratios
and their 95 % intervals (scenes resampled) are of seed 0, which ships. The paper's figures, on
scenes of its own and by a loss that its source takes as a mean magnitude: {paper}.
The noise floor is what remains for who knows each state's costs but for the noise to come, measured
on the held-out forks; beside it the network's error on those same states.

{costs}

## Gains

True gains of the held-out forks: cost without input less cost with it, means over 16 keys. In a
window of m states, drawn at random, the highest bid is chosen: how often it is the best one, and
what is lost (regret, units of cost); 95 % intervals by resampling states. Rank correlations: mean
(range) over 5 seeds.

{gains}

`calibration.png` shows predicted against true gains, `fig3.png` the training (figure 3).
"""
