"""Writes the study's report from its stored rows alone: `study.md`, with every table."""

from pathlib import Path

from study_rows import read
from study_served import served
from study_tables import TABLES

from pgf_jax.files import write_atomically

HEAD = """# The study: every table

Written by `python experiments/study.py --draw`, from `study.csv`, a row a fleet. Intervals are 95 %
(Student's t) over seeds; a difference is paired by seed: the same scenes, noise and service times.
Times are means over a fleet's tasks, failures included. Solved an operator minute is the return on
human effort, and fan-out how many robots one operator could serve if none waited
(`pgf_jax/metrics/effort.py`)."""


def write(out: Path) -> str:
    """Write `study.md`, and return it."""
    rows = read("study", out).fill_null("")
    parts = [HEAD, served(rows), *(table(rows) for table in TABLES)]
    report = "\n\n".join(part for part in parts if part) + "\n"
    write_atomically(out / "study.md", report.encode())
    return report
