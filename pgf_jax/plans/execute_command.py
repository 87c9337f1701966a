"""The command `pgf-jax execute`: executes plans in a world, and shows what became of them."""

import dataclasses
import json
import sys

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.plans.config import ExecuteCommand
from pgf_jax.plans.execute import Execution, iter_executions
from pgf_jax.plans.file import load_plan
from pgf_jax.provenance import environment
from pgf_jax.tables.parquet import write_table
from pgf_jax.terminal import Progress, show_table

TABLE = "executions.parquet"
_TYPES = {
    str: pl.String(),
    int: pl.Int64(),
    bool: pl.Boolean(),
    float | None: pl.Float64(),
}
EXECUTION_SCHEMA = {f.name: _TYPES[f.type] for f in dataclasses.fields(Execution)}  # pyright: ignore[reportArgumentType]


def run(command: ExecuteCommand) -> None:
    """Execute the plans, write a table of it, and show it.

    Raises:
      BadInput: a plan cannot be read or executed, or the table cannot be written.
    """
    plans = [load_plan(path) for path in command.plans]
    if command.out is not None:
        try:
            command.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(
                f"--out {command.out}: expected a folder to write to ({error.strerror})"
            ) from None
    done: list[Execution] = []
    total = len(plans) * command.config.repeats
    with Progress("executions") as progress:
        progress.update(0, total)
        for _, execution in iter_executions(plans, command.config):
            done.append(execution)
            progress.update(len(done), total)
    if command.out is not None:
        write_executions(done, command)
    if command.json:
        rows = [dataclasses.asdict(execution) for execution in done]
        sys.stdout.write(json.dumps({"executions": rows}, indent=2) + "\n")
        return
    _show(done, command)


def write_executions(done: list[Execution], command: ExecuteCommand) -> None:
    """Write the table of executions, whole or not at all."""
    assert command.out is not None
    rows = [dataclasses.asdict(execution) for execution in done]
    settings = json.loads(json.dumps(dataclasses.asdict(command), default=str))
    about = {"settings": settings, **environment()}
    write_table(command.out / TABLE, pl.DataFrame(rows, schema=EXECUTION_SCHEMA), about)


def _show(done: list[Execution], command: ExecuteCommand) -> None:
    rows = [
        (
            one.scene + (f" {one.repeat}" if command.config.repeats > 1 else ""),
            one.claimed,
            one.world,
            "yes" if one.grasped else "no",
            "diverged" if one.distance_m is None else f"{1e3 * one.distance_m:.1f}",
            "-" if one.tilt_deg is None else f"{one.tilt_deg:.1f}",
            "yes" if one.shelf_touched else "no",
        )
        for one in done
    ]
    head = ("plan", "claimed", "world", "grasped", "off (mm)", "tilt (deg)", "shelf")
    show_table(head, rows)
    grasped = sum(one.grasped for one in done)
    claimed = [one for one in done if one.claimed == "solved"]
    true = sum(one.grasped for one in claimed)
    where = "" if command.out is None else f"; table in {command.out / TABLE}"
    print("off: goal from hand at the end; tilt: largest of an object; shelf: touched by the robot")
    print(
        f"{grasped} of {len(done)} executions grasp; of those of solved plans {true} of "
        f"{len(claimed)}{where}"
    )
