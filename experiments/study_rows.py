"""The stored rows of the study: reads them, finds fleets, and makes intervals over seeds."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.metrics.summary import Interval, mean_interval

POLICIES = {  # name in tables and figures: (policy, predictor) of the rows
    "PGF": ("pgf", "paper"),
    "PGF, best": ("pgf", "best"),
    "OR-HITL": ("or-hitl", "paper"),
    "OR-HITL, window": ("or-hitl-window", "paper"),
    "queue": ("queue", "paper"),
    "always": ("always", "paper"),
    "random": ("random", "paper"),
    "classifier": ("classifier", "paper"),
    "oracle-gain": ("oracle-gain", "paper"),
    "autonomous": ("autonomous", "paper"),
}
# Values within 0..1; an interval of Student's t may exceed these bounds.
RATES = {"success", "helped", "utilisation", "wasted", "go_on", "refused_share"}
RATES |= {"fairness_grants", "fairness_throughput", "largest_share"}


def read(name: str, out: Path) -> pl.DataFrame:
    """Read the stored rows of a study.

    Raises:
      BadInput: there are none.
    """
    path = out / f"{name}.csv"
    if not path.is_file():
        raise BadInput(f"{path}: no such file; run without --draw first")
    return pl.read_csv(path, infer_schema_length=None)


def fleets(frame: pl.DataFrame, policy: str, robots: int, **labels: str) -> pl.DataFrame:
    """The rows of one policy (a name of `POLICIES`), fleet size and labels: one fleet per seed."""
    name, predictor = POLICIES[policy]
    return frame.filter(policy=name, predictor=predictor, robots=robots, **labels)


def over_seeds(rows: pl.DataFrame, value: str) -> Interval:
    """Mean of a value over fleets of different seeds, with its 95 % t interval.

    Tasks of one fleet share its operators and are not independent; fleets of different seeds are
    (independent replications).
    """
    assert rows["seed"].n_unique() == len(rows), "one fleet a seed"
    found = mean_interval([x for x in rows[value].to_list() if x is not None and x == x])
    if value not in RATES:
        return found
    return dataclasses.replace(found, low=max(found.low, 0.0), high=min(found.high, 1.0))


def difference(ours: pl.DataFrame, theirs: pl.DataFrame, value: str) -> Interval:
    """Mean difference of a value between fleets of the same seed: the same scenes and noise."""
    both = ours.join(theirs, on="seed", suffix="_theirs").filter(
        pl.col(value).is_not_nan() & pl.col(f"{value}_theirs").is_not_nan()
    )
    assert both["seed"].n_unique() == len(both), "one fleet a seed"
    return mean_interval((both[value] - both[f"{value}_theirs"]).to_list())


def text(interval: Interval, digits: int = 1, scale: float = 1.0) -> str:
    """An interval as text: `mean (low..high)`."""
    mean, low, high = (scale * x for x in (interval.mean, interval.low, interval.high))
    if interval.n == 0:
        return "-"
    if interval.n == 1:
        return f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} ({low:.{digits}f}..{high:.{digits}f})"


def table_row(cells: Iterable[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of numbers, the first column of which names the rows."""
    return "\n".join(map(table_row, [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]))


def estimate(of: Mapping[str, float], digits: int = 2, scale: float = 1.0, unit: str = "") -> str:
    """A stored estimate (`value`, `low`, `high`) as text: `value (low..high)`."""
    value, low, high = (f"{scale * of[name]:.{digits}f}" for name in ("value", "low", "high"))
    return f"{value}{unit} ({low}..{high})"
