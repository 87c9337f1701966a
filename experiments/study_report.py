"""Writes the study's report from its stored rows alone: every table, and the figures."""

from pathlib import Path

import study_times
from study_claims import paper_claims
from study_figures import FIGURES
from study_numbers import fill
from study_rows import read
from study_served import served
from study_tables import TABLES

from pgf_jax.files import png, write_atomically

HEAD = """# The study: every table

Written by `python experiments/study.py --draw`, from `study.csv`, a row a fleet. Intervals are 95 %
(Student's t) over seeds; a difference is paired by seed: the same scenes, noise and service times.
Times are means over a fleet's tasks, failures included. Solved an operator minute is the return on
human effort, and fan-out how many robots one operator could serve if none waited
(`pgf_jax/metrics/effort.py`)."""


def write(out: Path) -> str:
    """Write `study.md` and the figures of which there are rows, and return the tables."""
    rows = read("study", out).fill_null("")
    parts = [HEAD, served(rows), paper_claims(rows), *(table(rows) for table in TABLES)]
    parts.append(study_times.times(rows, out / study_times.NAME))
    report = "\n\n".join(part for part in parts if part) + "\n"
    write_atomically(out / "study.md", report.encode())
    for name, draw in FIGURES.items():
        figure = draw(rows)
        if any(axes.has_data() for axes in figure.axes):
            write_atomically(out / f"study_{name}.png", png(figure))
    return report


def write_text(out: Path, readme: Path) -> None:
    """Write the section of the README whose numbers are looked up, from `study_text.md`."""
    words = readme.with_name("study_text.md").read_text()
    words = fill(read("study", out).fill_null(""), words, out)
    begin, end = (f"<!-- study: {word} -->\n" for word in ("begin", "end"))
    before, _, rest = readme.read_text().partition(begin)
    write_atomically(readme, f"{before}{begin}\n{words}\n{end}{rest.partition(end)[2]}".encode())
