"""Numbers in the report's text, looked up in what is stored by keys that stand in the text.

A key is a measure, a set (with a setting in brackets), a fleet size and a policy, or two; or a
figure's data file, and the names that lead to a number in it:

    {time: packed, 10, gain-rate less or-hitl}
    {success: every (2 operators), 20, pgf}
    {served: packed, gain-rate, time in the task}
    {seeds: packed, 10, pgf}
    {figure4: hard.alone.iterations}
"""

import re
from pathlib import Path
from typing import Any

import polars as pl
from study_rows import over_seeds, text
from study_served import fully_served, largest, with_rate
from study_tables import TIME, fleets, less

from pgf_jax.errors import BadInput
from pgf_jax.files import read_json

MEASURES = {  # name -> (column, digits, scale)
    "time": (TIME, 1, 1),
    "planning": ("planning_time_s", 1, 1),
    "success": ("success", 1, 100),
    "grasps": ("rate", 1, 1),
    "utilisation": ("utilisation", 2, 1),
    "fairness": ("fairness_throughput", 2, 1),
    "helped": ("helped", 1, 100),
}
KEY = re.compile(r"\{([^{}]+)\}")


def fill(rows: pl.DataFrame, words: str, folder: Path) -> str:
    """A text with its numbers.

    Args:
      rows: of the study.
      words: the text.
      folder: of the data files of figures.

    Raises:
      BadInput: a key finds nothing.
    """
    rows = with_rate(rows)

    def found(match: re.Match[str]) -> str:
        key = match[1]
        return of_figure(folder, key) if key.startswith("figure") else number(rows, key)

    return KEY.sub(found, words)


def of_figure(folder: Path, key: str) -> str:
    """What a key stands for in the data file of a figure.

    Raises:
      BadInput: there is no such number.
    """
    name, _, way = key.partition(": ")
    one: Any = read_json(folder / f"{name}.json", "the data of a figure")
    try:
        for step in way.split("."):
            one = one[int(step) if isinstance(one, list) else step]
    except (LookupError, TypeError, ValueError):
        one = None
    if isinstance(one, bool) or not isinstance(one, int | float):
        raise BadInput(f"the report's text asks for {{{key}}}, which is no number there")
    return str(one) if isinstance(one, int) else f"{one:.2f}"


def number(rows: pl.DataFrame, key: str) -> str:
    """What one key stands for, at the precision that is printed.

    Args:
      rows: of the study, with `rate`.
      key: see above.

    Raises:
      BadInput: it finds nothing.
    """
    measure, _, rest = key.partition(": ")
    where, *more = rest.split(", ")
    name, _, setting = where.removesuffix(")").partition(" (")
    found = "-"
    if measure == "served" and len(more) == 2:
        settings = setting, fully_served(setting)
        found = largest(rows, name, more[0], settings, more[1]) or "-"
    elif len(more) == 2 and more[0].isdigit():
        robots, policies = int(more[0]), tuple(more[1].split(" less "))
        if measure == "seeds":
            found = str(len(fleets(rows, name, robots, policies[0], setting)) or "-")
        elif measure in MEASURES:
            column, digits, scale = MEASURES[measure]
            if len(policies) == 2:
                interval = less(rows, name, robots, policies, column, setting)
            else:
                interval = over_seeds(fleets(rows, name, robots, policies[0], setting), column)
            found = text(interval, digits, scale)
    if found == "-":
        raise BadInput(f"the report's text asks for {{{key}}}, which the rows do not have")
    return found
