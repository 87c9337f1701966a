"""Summarises collected forks: what an operator's input is worth, by the goal's distance to a wall.

pgf-jax collect forks --scenes 240 --seed 500000 --operator oracle --out DIR
python experiments/input_worth.py DIR [DIR ...]
"""

import dataclasses
from pathlib import Path

import polars as pl
import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax.tables.forks import FORK, read_forks
from pgf_jax.tables.parquet import read_provenance
from pgf_jax.tables.runs import Mode, runs_path

NEAR_WALL = 0.10  # m, distance of the goal to the nearer side wall
PARTS = {
    "all": pl.lit(True),
    f"under {NEAR_WALL} m": pl.col("state:room") < NEAR_WALL,
    f"{NEAR_WALL} m or more": pl.col("state:room") >= NEAR_WALL,
}


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    data: tyro.conf.Positional[tuple[Path, ...]]  # folders of collected forks


def main(config: Config) -> None:
    """Print the table."""
    table = Table(title="one state of each scene, 10 reach iterations on")
    for column in ("operator", "goal to wall", "states", "pushes", "alone", "helped", "mean gain"):
        table.add_column(column, justify="left" if column == "operator" else "right")
    for folder in config.data:
        path = runs_path(folder, Mode.FORKS)
        operator = read_provenance(path)["settings"]["operator"]
        frame = read_forks(path)
        for name, part in PARTS.items():
            rows = frame.filter(part)
            if rows.is_empty():
                continue
            shares = (rows["input"] == "push", rows["alone_solved"], rows["helped_solved"])
            table.add_row(
                operator,
                name,
                str(rows.select(FORK).n_unique()),
                *(f"{100 * share.cast(pl.Float64).sum() / len(rows):.0f} %" for share in shares),
                f"{(rows['alone'] - rows['helped']).sum() / len(rows):.1f}",
            )
    Console().print(table)


if __name__ == "__main__":
    main(tyro.cli(Config))
