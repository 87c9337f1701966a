"""Computes the runs of the study, many sweeps as one, and stores one row per fleet.

A *run* is a sweep with labels. A *row* is one fleet of a run (one cell: policy, R, seed): its line
of `summary.csv`, the account of the operators' attention, and the labels of the run. The figures
and tables of the study are made from rows alone (`study_rows.py`), and rows are stored in the
repository. The raw results of the sweeps (every task and event) are not: the same command computes
them again, and continues where it was interrupted.
"""

import dataclasses
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
import tyro
from rich.console import Console

from pgf_jax import BadInput, SweepConfig, configure, sweeps
from pgf_jax.files import write_atomically
from pgf_jax.metrics.attention import attention
from pgf_jax.metrics.effort import effort
from pgf_jax.metrics.identities import verify
from pgf_jax.metrics.summary import NS_PER_HOUR, summarise
from pgf_jax.sweeping.resolve import Loaded, resolve
from pgf_jax.sweeping.summary import csv
from pgf_jax.sweeping.sweep import SweepResult
from pgf_jax.tables import results

ROOT = Path(__file__).resolve().parent.parent
RAW = ROOT / "results/study"  # ignored by git
BATCH = 250_000  # tasks that are computed together; their search caches take some GiB

Labels = Mapping[str, str | int | float]


def script(main: Callable[[Any], None], config: type) -> None:
    """Run a script with its command line; bad input gives one line and exit code 2."""
    configure()
    try:
        main(tyro.cli(config))
    except BadInput as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)  # finished cells are kept, and a message has said so


@dataclasses.dataclass(frozen=True)
class Run:
    """A sweep of the study, with labels.

    Attributes:
      labels: additional columns of its rows; no two runs have the same labels, policies and seed.
      config: of the sweep; its folder is replaced by `folder`.
    """

    labels: Labels
    config: SweepConfig

    def folder(self, raw: Path) -> Path:
        """Folder of the raw results of the run."""
        parts = [*map(str, self.labels.values()), *(self.config.policies or ())]
        return raw / re.sub(r"[^\w.=-]+", "-", "_".join([*parts, f"seed{self.config.seed}"]))


def stored(preset: str) -> Path:
    """Folder of the rows, figures and tables; git ignores that of the quick preset."""
    return ROOT / ("experiments/results" if preset == "full" else "results/study_quick")


def compute(name: str, runs: Sequence[Run], out: Path, raw: Path = RAW) -> None:
    """Compute the missing runs, and store the rows of all runs as `OUT/NAME.csv`.

    Sweeps of one seed, class and operator share most of their iterations, so such a family is
    computed together. Several families are computed at a time, so that calls stay full while the
    last robots of one family finish.
    """
    console = Console(stderr=True)
    configs = [
        dataclasses.replace(run.config, out=run.folder(raw / name), resume=True) for run in runs
    ]
    families: dict[object, list[int]] = {}
    loaded: Loaded = {}
    for i, config in enumerate(configs):
        # All cells of a sweep have the same key.
        families.setdefault(resolve(config, loaded).cells[0].fleet.cache_key, []).append(i)

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


def rows_of(config: SweepConfig, outcome: SweepResult) -> list[dict]:
    """The rows of a finished sweep; checks the sample-path identities of each fleet.

    Args:
      config: of the sweep.
      outcome: of that sweep.

    Raises:
      ValueError: an identity does not hold.
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
        row |= dataclasses.asdict(effort(fleet, records, log))
        # Intervals within a fleet are left out: intervals are made over fleets of several seeds.
        row = {k: v for k, v in row.items() if not k.endswith(("_low", "_high"))}
        robot_hours = sum(r.end_ns - r.start_ns for r in records) / NS_PER_HOUR
        rows.append(row | {"robot_hours": robot_hours, "identities": identities})
    return rows
