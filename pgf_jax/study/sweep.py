"""`pgf_jax.sweep`: fleets of every size under every policy on the same scenes, and their files."""

import dataclasses
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
from rich.console import Console

from pgf_jax.errors import BadInput, shown
from pgf_jax.fleet.metrics import CellSummary, summarise
from pgf_jax.guidance.tables import write_atomically
from pgf_jax.study import results
from pgf_jax.study.event_log import read_log
from pgf_jax.study.figures import figure6, png
from pgf_jax.study.manifest import manifest
from pgf_jax.study.recording import LIVE, compare, replaying
from pgf_jax.study.sweep_config import Cell, SweepConfig
from pgf_jax.study.sweep_report import Report, summary_tables
from pgf_jax.study.sweep_run import Effort, Job, run_cells, run_cells_in_processes
from pgf_jax.study.sweep_setup import Loaded, Setup, identity, prepare

MANIFEST = "manifest.json"
RESULTS = ("tasks.parquet", "events.parquet", "summary.csv", "paired.csv", "fig6.png")


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """What a sweep found; all of it is in files too.

    Attributes:
      out: their folder.
      summaries: one a cell, by policy, then by fleet size.
      paired: differences of every two policies on the same tasks.
      computed: names of the cells computed now; the others were finished before.
    """

    out: Path
    summaries: tuple[CellSummary, ...]
    paired: tuple[results.Paired, ...]
    computed: tuple[str, ...]

    def tasks(self) -> pl.DataFrame:
        """`tasks.parquet`: one row a task."""
        return results.read_results(self.out / "tasks.parquet", results.MERGED_TASK_SCHEMA)

    def events(self) -> pl.DataFrame:
        """`events.parquet`: one row an event."""
        return results.read_results(self.out / "events.parquet", results.MERGED_EVENT_SCHEMA)


def sweep(config: SweepConfig, *, quiet: bool = False) -> SweepResult:
    """Run a sweep: every policy at every fleet size.

    All cells of a process are computed in one queue of work (see `sweeps`); each is written as soon
    as it is finished. With several workers, a script must call this under
    `if __name__ == "__main__"`.

    Args:
      config: what to run.
      quiet: no progress (standard error), no table at the end (standard output).

    Returns:
      The summaries. Files are in `config.out`: `tasks.parquet`, `events.parquet`, `summary.csv`,
      `paired.csv`, `fig6.png`, `manifest.json`, and each cell's in `cells/POLICY_RN`. The same
      configuration gives the same files, but for the manifest's times, whatever the workers.

    Raises:
      BadInput: the configuration, or a file it names, cannot be used; or the folder holds results
        of another configuration, or, on resuming, corrupt ones. Nothing has been written then.
      KeyboardInterrupt: interrupted; finished cells are kept.
    """
    return sweeps([config], quiet=quiet)[0]


def sweeps(
    configs: Sequence[SweepConfig], *, quiet: bool = False, tables: bool = True
) -> list[SweepResult]:
    """Run several sweeps as one: calls of the engine are fuller, and nothing is computed twice.

    Fleets of one seed, class and operator go the same way until somebody is served at another
    moment (`trees.py`), so a second policy, window, service time or fleet size costs little.

    Args:
      configs: each with a folder of its own; `workers` is the largest of theirs.
      quiet: as in `sweep`.
      tables: show the tables at the end, unless quiet.

    Returns:
      What each found, and wrote, as if it had been run alone.

    Raises:
      BadInput: as in `sweep`; or two have the same folder.
      KeyboardInterrupt: interrupted; finished cells are kept.
    """
    start = time.perf_counter()
    configs = [_as_recorded(config) for config in configs]
    folders = [config.out.resolve() for config in configs]
    for i, folder in enumerate(folders):
        if folder in folders[:i]:
            raise BadInput(f"out: {configs[i].out} is the folder of two sweeps")
    loaded: Loaded = {}
    setups = [prepare(config, loaded) for config in configs]
    kept = [check_folder(setup) for setup in setups]
    for config in configs:
        _make_folder(config.out)
    jobs = [Job(i, cell) for i, config in enumerate(configs) for cell in config.cells()]
    finished = [job for job in jobs if job.cell in kept[job.sweep]]
    workers = max((config.processes() for config in configs), default=1)
    with Report(jobs, finished, Console(stderr=True), quiet=quiet) as report:
        try:
            todo = [job for job in jobs if job not in finished]
            efforts = _compute(setups, todo, workers, report)
        except KeyboardInterrupt:
            report.interrupted(*(config.out for config in configs))
            raise
    outcomes = []
    for setup, cells in zip(setups, kept, strict=True):
        outcome = _conclude(setup, cells, efforts, time.perf_counter() - start, len(configs))
        outcomes.append(outcome)
        _compare(setup.config, outcome)
        if tables and not quiet:
            Console().print(summary_tables(outcome.summaries))
            Console().print(
                f"engine {setup.config.engine}, {setup.config.engine_lanes()} lanes; results in "
                f"{setup.config.out}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
    return outcomes


def _compute(setups: list[Setup], jobs: list[Job], workers: int, report: Report) -> list[Effort]:
    if not jobs:
        return []
    if min(workers, len(jobs)) == 1:
        return [run_cells(setups, jobs, report)]
    return run_cells_in_processes(setups, jobs, workers, report)


def _conclude(
    setup: Setup, kept: set[Cell], efforts: list[Effort], wall_s: float, together: int
) -> SweepResult:
    """Summarise from the cells' files, so that kept and computed cells are treated alike."""
    config, cells = setup.config, setup.config.cells()
    tables = {cell: results.read_cell(config.out, cell) for cell in cells}
    records = {cell: results.task_records(tasks) for cell, (tasks, _) in tables.items()}
    summaries = [
        summarise(config.fleet(cell), records[cell], results.event_log(events))
        for cell, (_, events) in tables.items()
    ]
    paired = results.paired(records)
    content = (
        results.parquet(results.merge([(cell, tasks) for cell, (tasks, _) in tables.items()])),
        results.parquet(results.merge([(cell, events) for cell, (_, events) in tables.items()])),
        results.csv(results.summary_frame(summaries)),
        results.csv(results.paired_frame(paired)),
        png(figure6(summaries)),
    )
    files: dict[str, bytes] = dict(zip(RESULTS, content, strict=True))
    for name, data in files.items():
        write_atomically(config.out / name, data)
    about = manifest(
        setup,
        kept=kept,
        efforts=efforts,
        wall_s=wall_s,
        together=together,
        files=files,
    )
    write_atomically(config.out / MANIFEST, results.json_bytes(about))
    computed = tuple(cell.name for cell in cells if cell not in kept)
    return SweepResult(config.out, tuple(summaries), tuple(paired), computed)


def _as_recorded(config: SweepConfig) -> SweepConfig:
    if config.operator == LIVE:
        raise BadInput("operator: live is for pgf-jax console; expected a simulated one")
    return config if config.log is None else replaying(config, read_log(config.log))


def _compare(config: SweepConfig, outcome: SweepResult) -> None:
    """A replay that is no replay must not pass for one."""
    if config.log is None:
        return
    events = results.event_log(outcome.events().select(list(results.EVENT_SCHEMA)))
    difference = compare(events, read_log(config.log))
    if difference is not None:
        raise BadInput(difference)


# -- the folder of results ---------------------------------------------------------------------


def check_folder(setup: Setup) -> set[Cell]:
    """Compare the results in the folder, if any, with the configuration.

    Returns:
      The cells that are finished and to be kept: none unless the configuration says `resume`.

    Raises:
      BadInput: the folder holds results of another configuration, or something that is neither;
        or, on resuming, a corrupt file.
    """
    config = setup.config
    out = config.out
    if not out.exists():
        return set()
    if not out.is_dir():
        raise BadInput(f"out: {out} is a file, expected a folder")
    known = {cell.name: cell for cell in config.cells()}
    found: set[Cell] = set()
    for folder in sorted((out / "cells").glob("*/")):
        path = folder / results.CELL_RECORD
        if not path.is_file():
            continue  # never finished: computed again
        if folder.name not in known:
            raise _foreign(path, f"cell {folder.name}, which this configuration has not", out)
        cell = known[folder.name]
        theirs = results.read_json(path).get("identity")
        differences = _differences(theirs, identity(setup, cell))
        if differences:
            raise _foreign(path, f"of another configuration ({differences})", out)
        found.add(cell)
        if config.resume:
            results.read_cell(out, cell)
    leftover = [name for name in (*RESULTS, MANIFEST) if (out / name).exists()]
    if leftover and not found:
        # Their cells are gone, and only they could say what these were computed from.
        raise _foreign(out / leftover[0], "without the cells they were merged from", out)
    return found if config.resume else set()


def _foreign(path: Path, what: str, out: Path) -> BadInput:
    return BadInput(f"{path}: results {what}; choose another folder with --out, or delete {out}")


def _differences(theirs: Any, ours: Mapping[str, Any]) -> str:
    """Where two identities differ, in words; empty where they do not."""
    if not isinstance(theirs, dict):
        return "it does not say which"
    words = []
    for key in [*ours, *(key for key in theirs if key not in ours)]:
        a, b = theirs.get(key), ours.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            inner = _differences(a, b)
            words += [inner] if inner else []
        elif a != b or (key in theirs) != (key in ours):
            words.append(f"{key} {_short(a)}, now {_short(b)}")
    return "; ".join(words)


def _short(value: object) -> str:
    text = value if isinstance(value, str) else shown(value, 40)
    return text if len(text) <= 40 else text[:37] + "..."


def _make_folder(out: Path) -> None:
    """Make the folder now: that it cannot be written should not turn up after hours."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"out: {out} cannot be made ({error.strerror})") from error
    if not os.access(out, os.W_OK | os.X_OK):
        raise BadInput(f"out: {out} cannot be written to")
