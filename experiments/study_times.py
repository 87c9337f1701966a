"""How long the study took: noted for each part as it is computed, and shown as a table.

Times are of the processor, so that other programs and interruptions do not count.
"""

import os
from collections.abc import Iterable
from pathlib import Path

import polars as pl
from study_rows import table
from study_tables import section

from pgf_jax.files import write_atomically
from pgf_jax.sweeping.summary import csv

NAME = "study_times.csv"  # beside the rows
CORES = 2  # for which the whole time is given
HOUR = 3600.0  # s


def processor_s() -> float:
    """Time that this process, its threads and its ended processes have computed, s."""
    return sum(os.times()[:4])


def note(path: Path, fleets: Iterable[tuple[str, str, int, int]], core_s: float) -> None:
    """Add the time of fleets that were computed together to a file.

    Args:
      path: of the file.
      fleets: part of the study, set, seed and number of tasks of each.
      core_s: time of the processor that all of them took, which they share by tasks.
    """
    noted = pl.DataFrame(list(fleets), ("part", "set", "seed", "tasks"), orient="row")
    share = pl.col("tasks") / pl.col("tasks").sum()
    noted = noted.with_columns(core_s=(core_s * share).round(3))
    frame = noted.group_by("part", "set", "seed").sum()
    if path.exists():
        frame = pl.concat([pl.read_csv(path), frame])
    write_atomically(path, csv(frame.sort("part", "set", "seed", "tasks")))


def times(rows: pl.DataFrame, path: Path) -> str:
    """The time of each part, and of the whole on `CORES` cores; empty where none was noted.

    Rows of which no time was noted are taken to have been computed as fast as others of their set.
    """
    if not path.exists():
        return ""
    noted = pl.read_csv(path)
    lines = [
        [part, str(its["tasks"].sum()), f"{float(its['core_s'].sum()) / HOUR:.2f}"]
        for (part,), its in noted.group_by("part", maintain_order=True)
    ]
    core_s = float(noted["core_s"].sum())
    others, others_s = 0, 0.0
    for (name,), its in rows.group_by("set", maintain_order=True):
        like = of_set if len(of_set := noted.filter(set=name)) else noted
        left = int(its["tasks"].sum()) - int(noted.filter(set=name)["tasks"].sum())
        others += left
        others_s += left * float(like["core_s"].sum()) / int(like["tasks"].sum())
    if others:
        lines.append(["without a time", str(others), f"about {others_s / HOUR:.2f}"])
    hours = (core_s + others_s) / HOUR / CORES
    words = f"{'About' if others else 'In all'} {hours:.1f} hours of {CORES} cores."
    return section("How long it took", [table(["part", "tasks", "hours of a core"], lines), words])
