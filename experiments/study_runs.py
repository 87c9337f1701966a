"""Runs of the study: many sweeps computed as one, condensed to one row a fleet.

A *run* is a sweep with labels; a *row* is one fleet of it (one cell: policy, R, seed) with what
`summary.csv` says of it, how the operators' attention was spent, and its labels. Rows are what the
figures and tables of the study are made from, and they are stored. The raw results of the sweeps
(every task and event) stay in a folder that is not: the same command computes them again, and one
that was interrupted goes on where it was.
"""

import dataclasses
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

# Before JAX is imported: XLA's threads cost the planar engine a third of its speed; and what is
# compiled is kept, as by the command line.
os.environ.setdefault("NPROC", "1")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "pgf_jax"))

import polars as pl
import tyro
from rich.console import Console

from pgf_jax import BadInput, SweepConfig, sweeps
from pgf_jax.files import write_atomically
from pgf_jax.fleet.attention import attention
from pgf_jax.fleet.identities import verify
from pgf_jax.fleet.metrics import NS_PER_HOUR, Interval, mean_interval, summarise
from pgf_jax.sweeping.resolve import prepare
from pgf_jax.sweeping.summary import csv
from pgf_jax.sweeping.sweep import SweepResult
from pgf_jax.tables import results

ROOT = Path(__file__).resolve().parent.parent
RAW = ROOT / "results/study"  # git ignores it


def script(main: Callable[[Any], None], config: type) -> None:
    """Run a script from its command line: bad input is one line and exit code 2."""
    try:
        main(tyro.cli(config))
    except BadInput as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)  # what is finished is kept, and has been said so


# Within 0..1, which an interval of Student's t does not know.
RATES = {"success", "helped", "utilisation", "wasted", "go_on", "refused_share"}
RATES |= {"fairness_grants", "fairness_throughput", "largest_share"}

BATCH = 250_000  # tasks in a batch; its trees take some GiB

Labels = Mapping[str, str | int | float]


@dataclasses.dataclass(frozen=True)
class Run:
    """A sweep of the study.

    Attributes:
      labels: columns of its rows; those of all runs together tell them apart.
      config: of the sweep; its folder is chosen here.
    """

    labels: Labels
    config: SweepConfig

    def folder(self, raw: Path) -> Path:
        """Where its raw results lie."""
        words = [*map(str, self.labels.values()), *(self.config.policies or ())]
        return raw / re.sub(r"[^\w.=-]+", "-", "_".join([*words, f"seed{self.config.seed}"]))


def stored(preset: str) -> Path:
    """Folder of what is stored; that of a quick preset is one that git ignores."""
    return ROOT / ("experiments/results" if preset == "full" else "results/study_quick")


def compute(name: str, runs: Sequence[Run], out: Path, raw: Path = RAW) -> None:
    """Run what has not been run yet, and store the rows as `OUT/NAME.csv`.

    Sweeps of one seed, class and operator share most of their iterations, so they are computed
    together; and several such families at a time, so that calls stay full while the last robots of
    one finish.
    """
    console = Console(stderr=True)
    configs = [
        dataclasses.replace(run.config, out=run.folder(raw / name), resume=True) for run in runs
    ]
    families: dict[object, list[int]] = {}
    for i, config in enumerate(configs):
        families.setdefault(prepare(config).cache_key(), []).append(i)

    def tasks(family: list[int]) -> int:
        return sum(cell.robots * cell.tasks for i in family for cell in configs[i].cells())

    batches: list[list[int]] = []
    room = 0
    for family in sorted(families.values(), key=tasks, reverse=True):
        if not batches or tasks(family) > room:
            batches.append([])
            room = max(BATCH, tasks(family))
        batches[-1] += family
        room -= tasks(family)
    frames: dict[int, list[dict]] = {}
    for number, batch in enumerate(batches, 1):
        console.print(f"{name}: part {number} of {len(batches)}, {len(batch)} sweeps")
        outcomes = sweeps([configs[i] for i in batch], quiet=False, tables=False)
        for i, outcome in zip(batch, outcomes, strict=True):
            frames[i] = [dict(runs[i].labels) | row for row in rows_of(configs[i], outcome)]
    rows = [row for i in range(len(runs)) for row in frames[i]]
    table = pl.DataFrame(rows, infer_schema_length=None)
    write_atomically(out / f"{name}.csv", csv(table))


def read(name: str, out: Path) -> pl.DataFrame:
    """Rows that were stored."""
    path = out / f"{name}.csv"
    if not path.is_file():
        raise BadInput(f"{path}: no such file; run without --draw first")
    return pl.read_csv(path, infer_schema_length=None)


def rows_of(config: SweepConfig, outcome: SweepResult) -> list[dict]:
    """The rows of a finished sweep; the sample-path identities hold in each of its fleets.

    Args:
      config: of the sweep.
      outcome: of that sweep.

    Raises:
      ValueError: one does not.
    """
    rows = []
    for cell in config.cells():
        content = outcome.cell(cell)
        records, log = results.task_records(content.tasks), results.event_log(content.events)
        fleet = config.fleet(cell)
        identities = verify(fleet, records, log)
        spent = attention(fleet, records, log).row()
        spent |= {f"{name}_share": spent.pop(name) for name in ("refused", "expired")}
        row = summarise(fleet, records, log).row() | spent
        # Of one fleet only means and sizes: intervals come from fleets of several seeds.
        row = {k: v for k, v in row.items() if not k.endswith(("_low", "_high"))}
        robot_hours = sum(r.end_ns - r.start_ns for r in records) / NS_PER_HOUR
        rows.append(row | {"robot_hours": robot_hours, "identities": identities})
    return rows


# -- intervals over seeds ----------------------------------------------------------------------


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
    """`mean (low..high)`."""
    mean, low, high = (scale * x for x in (interval.mean, interval.low, interval.high))
    if interval.n == 0:
        return "-"
    if interval.n == 1:
        return f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} ({low:.{digits}f}..{high:.{digits}f})"
