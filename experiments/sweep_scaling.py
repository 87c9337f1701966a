"""Measures the overhead of a sweep's cells, with local processes and with Dask workers.

The same sweep of many cells is computed in turn by persistent local processes and by persistent
workers of a Dask scheduler over TCP on this computer, several times each, after a first time that
compiles. The times are those until the cells are on the disk; the tables are made afterwards.

The overhead of a cell, beyond calls of the engine, the planner and the networks, has three parts:
`thought` (around these calls: the operator's candidates, the features of states), `fleets` (events,
logs, files) and `between` (batches: messages, and at the end the wait for the last batch).

    python experiments/sweep_scaling.py --cells 80
"""

import dataclasses
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax import SweepConfig, configure, sweeps
from pgf_jax.parallel.local import LocalPool
from pgf_jax.sweeping.cell_store import RUN

POLICIES = ("autonomous", "or-hitl", "or-hitl-window", "always", "queue", "pgf")


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the script.

    Attributes:
      cells: least number of cells; each seed has a cell for each of six policies.
      robots: of each fleet.
      tasks: of each robot.
      workers: number of processes.
      rounds: how often each way is timed.
      out: file for the results (JSON).
    """

    cells: int = 80
    robots: int = 4
    tasks: int = 2
    workers: int = 2
    rounds: int = 3
    out: Path | None = None


@contextmanager
def dask(workers: int, folder: Path) -> Iterator[Executor]:
    """Start a Dask scheduler and workers on this computer, as processes."""
    from pgf_jax.parallel.dask_executor import DaskExecutor

    address = "tcp://127.0.0.1:18786"
    options = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "18786"]
    commands = [[sys.executable, *options, "--no-dashboard"]]
    options = ["-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
    commands += [[sys.executable, *options, "--nworkers", str(workers)]]
    with ExitStack() as stack:
        for command in commands:
            process = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=folder
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)
            time.sleep(3.0)
        executor = DaskExecutor(address)
        stack.callback(executor.shutdown)
        while executor.count() < workers:
            time.sleep(0.2)
        yield executor


@dataclasses.dataclass(frozen=True)
class Timed:
    """Times of one sweep.

    Attributes:
      cells: number of cells.
      steps: number of iterations computed.
      wall_s: time until the cells were on the disk, s.
      busy_s: time of the processes in batches, without compilation, s.
      answering_s: part of it for the requests of robots and operators, s.
      engine_s: part of that in calls of the engine, the planner and the networks, s.
    """

    cells: int
    steps: int
    wall_s: float
    busy_s: float
    answering_s: float
    engine_s: float


def run(options: Options, executor: Executor, folder: Path) -> Timed:
    """Compute the sweep once."""
    shutil.rmtree(folder, ignore_errors=True)
    seeds = -(-options.cells // len(POLICIES))
    configs = [
        SweepConfig(
            robots=(options.robots,),
            policies=POLICIES,
            tasks=options.tasks,
            seed=seed,
            workers=options.workers,
            out=folder / str(seed),
        )
        for seed in range(seeds)
    ]
    outcomes = sweeps(configs, quiet=True, executor=executor)
    record = json.loads((configs[0].out / RUN).read_text())
    clock = record["wall_clock"]
    return Timed(
        cells=sum(len(outcome.files) for outcome in outcomes),
        steps=record["iterations"]["computed"],
        wall_s=clock["cells_s"],
        busy_s=sum(clock["batch_s"]) - sum(clock["compile_s"]),
        answering_s=sum(clock["answering_s"]),
        engine_s=sum(clock["engine_s"]),
    )


def _spread(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.1f} ({min(values):.1f}..{max(values):.1f})"


def main(options: Options) -> None:
    configure()
    console = Console()
    times: dict[str, list[Timed]] = {"local processes": [], "Dask over TCP": []}
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        opened: dict[str, Executor] = {
            "local processes": stack.enter_context(LocalPool(options.workers)),
            "Dask over TCP": stack.enter_context(dask(options.workers, folder)),
        }
        for turn in range(options.rounds + 1):
            for way, executor in opened.items():
                timed = run(options, executor, folder / "out")
                if turn:  # the first turn compiles
                    times[way].append(timed)
                    console.print(
                        f"{way}: {timed.cells} cells, {timed.steps} iterations, "
                        f"{timed.wall_s:.1f} s"
                    )
    table = Table("", "cells there (s)", "thought (ms/cell)", "fleets", "between")
    figures = {}
    for way, all_ in times.items():
        walls = [timed.wall_s for timed in all_]
        parts = {
            "thought_ms": [1e3 * (t.answering_s - t.engine_s) / t.cells for t in all_],
            "fleets_ms": [1e3 * (t.busy_s - t.answering_s) / t.cells for t in all_],
            "between_ms": [1e3 * (options.workers * t.wall_s - t.busy_s) / t.cells for t in all_],
        }
        figures[way] = {"cells": all_[0].cells, "iterations": all_[0].steps, "wall_s": walls}
        figures[way] |= parts
        table.add_row(way, *(_spread(values) for values in (walls, *parts.values())))
    console.print(table)
    here, there = (statistics.median(t.wall_s for t in each) for each in times.values())
    figures["efficiency"] = here / there
    console.print(f"Dask's efficiency: {here / there:.3f} of local processes'")
    if options.out is not None:
        options.out.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Options))
