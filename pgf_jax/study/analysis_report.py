"""Prints and draws what came of a study, and writes its tables."""

from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from pgf_jax.files import png, write_atomically
from pgf_jax.metrics.summary import Interval
from pgf_jax.study.analysis import Analysis
from pgf_jax.study.design import Design
from pgf_jax.sweeping.summary import csv

FLEET = 40  # robots of the sweep that is proposed
_DRAWN = 4  # measures in the figure: the first ones, and questionnaires


def write(design: Design, found: Analysis, out: Path) -> None:
    """Write conditions.csv, differences.csv, order.csv, participants.csv and analysis.png."""
    out.mkdir(parents=True, exist_ok=True)
    for name, frame in _frames(found).items():
        write_atomically(out / f"{name}.csv", csv(frame))
    write_atomically(out / "analysis.png", png(draw(design, found)))


def show(design: Design, found: Analysis) -> None:
    """Print the tables."""
    console, names = Console(), list(design.conditions)
    print(f"{len(found.participants)} participants have done all blocks")
    if found.unfinished:
        print(f"not counted, because they have not: {_list(found.unfinished)}")
    if found.inattentive:
        print(f"counted, although they failed an attention check: {_list(found.inattentive)}")
    table = Table("measure", *names, box=None)
    for measure, text in found.measures.items():
        cells = [_plus_minus(found.conditions[measure, name]) for name in names]
        table.add_row(text, *cells)
    console.print(table)
    table = Table("difference within participants", "95 %", "d_z", box=None)
    for one in found.differences:
        words = f"{one.measure}: {one.condition} - {one.baseline}"
        table.add_row(words, _range(one.difference), _number(one.effect))
    console.print(table)
    blocks = range(1, len(names) + 1)
    table = Table("by the order of blocks", *map(str, blocks), box=None)
    for measure in found.measures:
        table.add_row(measure, *(_plus_minus(found.order[measure, b]) for b in blocks))
    console.print(table)
    if found.operator is None:
        print("services: too few answers to fit how long one takes")
    else:
        policies = " ".join(dict.fromkeys(design.policy(name) for name in names))
        print(f"a service takes {found.operator.mean_s:.3g} s, sd {found.operator.sd_s:.3g} s")
        print(f"your participants, with {FLEET} robots:")
        print(f"  {found.operator.command} --robots {FLEET} --policies {policies} "
              f"--scene-class {design.fleet.get('scene_class', 'tight')}")  # fmt: skip


def draw(design: Design, found: Analysis) -> Figure:
    """The first measures and the questionnaires: a line a participant, and the means."""
    shown = list(found.measures)
    shown = shown[: _DRAWN - 1] + [name for name in shown if name in design.questionnaires]
    names = list(design.conditions)
    figure = Figure(figsize=(3.2 * len(shown), 3.4), layout="constrained")
    for axes, measure in zip(np.atleast_1d(figure.subplots(1, len(shown))), shown, strict=True):
        for who in found.participants:
            values = [_value(found, who, measure, name) for name in names]
            axes.plot(range(len(names)), values, color="0.7", marker="o", markersize=3)
        means = [found.conditions[measure, name] for name in names]
        for x, mean in enumerate(means):
            axes.errorbar(
                x,
                mean.mean,
                [[mean.mean - mean.low], [mean.high - mean.mean]],
                color="black",
                marker="s",
                capsize=4,
            )
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_ylabel(found.measures[measure], fontsize="small")
    return figure


def _value(found: Analysis, who: int, measure: str, condition: str) -> float:
    for one in found.measured:
        if (one.participant, one.measure, one.condition) == (who, measure, condition):
            return one.value
    return float("nan")


def _frames(found: Analysis) -> dict[str, pl.DataFrame]:
    def row(about: dict, value: Interval) -> dict:
        return about | {"mean": value.mean, "low": value.low, "high": value.high, "n": value.n}

    rows = {
        "participants": [
            {
                "participant": one.participant,
                "block": one.block,
                "condition": one.condition,
                "measure": one.measure,
                "value": one.value,
            }
            for one in found.measured
        ],
        "conditions": [
            row({"measure": measure, "condition": condition}, value)
            for (measure, condition), value in found.conditions.items()
        ],
        "differences": [
            row(
                {"measure": one.measure, "condition": one.condition, "baseline": one.baseline},
                one.difference,
            )
            | {"effect": one.effect}
            for one in found.differences
        ],
        "order": [
            row({"measure": measure, "block": block}, value)
            for (measure, block), value in found.order.items()
        ],
    }
    return {name: pl.DataFrame(of, infer_schema_length=None) for name, of in rows.items()}


def _list(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers))


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}"


def _plus_minus(value: Interval) -> str:
    half = (value.high - value.low) / 2
    return _number(value.mean) + ("" if np.isnan(half) else f" ± {half:.2f}")


def _range(value: Interval) -> str:
    ends = "" if np.isnan(value.low) else f" ({value.low:.2f}..{value.high:.2f})"
    return _number(value.mean) + ends
