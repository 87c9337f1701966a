"""`pgf_jax.sweep`: fleets of every size under every policy on the same scenes, and their files."""

import contextlib
import dataclasses
import functools
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import polars as pl
from rich.console import Console

from pgf_jax.errors import BadInput
from pgf_jax.files import json_bytes, png, sha256, write_atomically
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.metrics import CellSummary, summarise
from pgf_jax.parallel.cluster import open_cluster
from pgf_jax.parallel.local import LocalPool
from pgf_jax.simulation.recorded_operator import LIVE
from pgf_jax.sweeping import cell_store
from pgf_jax.sweeping.cell_store import (
    MANIFEST,
    RESULTS,
    RUN,
    check_folder,
    check_writable,
    keys_of,
    reopen,
)
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.dispatch import dispatch
from pgf_jax.sweeping.figure6 import figure6
from pgf_jax.sweeping.manifest import about, manifest, run_record
from pgf_jax.sweeping.replay import compare, replaying
from pgf_jax.sweeping.report import Report, numbers, summary_tables
from pgf_jax.sweeping.resolve import Loaded, Setup, prepare
from pgf_jax.sweeping.run_cells import Job
from pgf_jax.sweeping.summary import Paired, csv, paired_frame, summary_frame
from pgf_jax.tables import results
from pgf_jax.tables.event_log import read_log

TASKS_A_PROCESS = 60  # to fewer a process of their own is not worth its start


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """What a sweep found; all of it is in files too.

    Attributes:
      out: their folder.
      summaries: one a cell, by policy, then by fleet size.
      paired: differences of every two policies on the same tasks.
      computed: names of the cells computed now; the others were finished before.
      files: the cells' own.
      origins: how many kinds of processor and code the cells were computed by.
    """

    out: Path
    summaries: tuple[CellSummary, ...]
    paired: tuple[Paired, ...]
    computed: tuple[str, ...]
    files: Mapping[Cell, Path]
    origins: int = 1

    def tasks(self) -> pl.DataFrame:
        """`tasks.parquet`: one row a task."""
        return results.read_results(self.out / "tasks.parquet", results.MERGED_TASK_SCHEMA)

    def events(self) -> pl.DataFrame:
        """`events.parquet`: one row an event."""
        return results.read_results(self.out / "events.parquet", results.MERGED_EVENT_SCHEMA)

    def cell(self, cell: Cell) -> cell_store.Content:
        """One cell's tables, and where they come from."""
        return cell_store.read(self.files[cell])


def sweep(
    config: SweepConfig, *, quiet: bool = False, executor: Executor | None = None
) -> SweepResult:
    """Run a sweep: every policy at every fleet size.

    All cells of a process are computed in one queue of work (see `sweeps`); each is written as soon
    as it is finished. With several workers, a script must call this under
    `if __name__ == "__main__"`.

    Args:
      config: what to run.
      quiet: no progress (standard error), no table at the end (standard output).
      executor: what computes the cells, in place of processes of this computer or of the
        configuration's scheduler; it stays open.

    Returns:
      The summaries. Files are in `config.out`: `tasks.parquet`, `events.parquet`, `summary.csv`,
      `paired.csv`, `fig6.png`, `manifest.json`, and each cell's in `cells`, with `run.json` and
      what stands beside each cell about how they came about. On one type of processor the same
      configuration gives the same files, but for these, whoever computes it.

    Raises:
      BadInput: the configuration, or a file it names, cannot be used; or the folder holds results
        of another configuration, or, on resuming, corrupt ones (nothing has been written then); or
        a file cannot be written (finished cells are kept).
      Lost: what computes the cells is gone; finished cells are kept.
      KeyboardInterrupt: interrupted; finished cells are kept.
    """
    return sweeps([config], quiet=quiet, executor=executor)[0]


def sweeps(
    configs: Sequence[SweepConfig],
    *,
    quiet: bool = False,
    tables: bool = True,
    executor: Executor | None = None,
) -> list[SweepResult]:
    """Run several sweeps as one: calls of the engine are fuller, and nothing is computed twice.

    Fleets of one seed, class and operator go the same way until somebody is served at another
    moment (`trees.py`), so a second policy, window, service time or fleet size costs little.

    Args:
      configs: each with a folder of its own; `workers` is the largest of theirs.
      quiet: as in `sweep`.
      tables: show the tables at the end, unless quiet.
      executor: as in `sweep`.

    Returns:
      What each found, and wrote, as if it had been run alone.

    Raises:
      BadInput: as in `sweep`; or two have the same folder, or different schedulers.
      Lost: as in `sweep`.
      KeyboardInterrupt: interrupted; finished cells are kept.
    """
    start = time.perf_counter()
    configs = [_as_recorded(config) for config in configs]
    _check_together(configs)
    loaded: Loaded = {}
    setups = [prepare(config, loaded) for config in configs]
    keys = [keys_of(setup) for setup in setups]
    kept = [check_folder(setup, names) for setup, names in zip(setups, keys, strict=True)]
    jobs = [Job(i, cell) for i, config in enumerate(configs) for cell in config.cells()]
    finished = {job for job in jobs if job.cell in kept[job.sweep]}
    _allow_files(len(configs))
    with contextlib.ExitStack() as stack:
        for config in configs:
            stack.enter_context(cell_store.only_writer(config.out))
            check_writable(config.out)
        as_json = any(config.json for config in configs)
        report = Report(jobs, finished, Console(stderr=True), quiet=quiet, json=as_json)
        with report:
            try:
                todo = [job for job in jobs if job not in finished]
                names = {job: keys[job.sweep][job.cell] for job in jobs}
                opener = _executor(configs, todo, executor)
                for i in {job.sweep for job in todo}:
                    reopen(configs[i].out)
                begin = time.perf_counter()
                efforts = dispatch(setups, todo, names, report, opener) if todo else []
                cells_s = time.perf_counter() - begin
            except KeyboardInterrupt:
                report.interrupted(*(config.out for config in configs))
                raise
        wall_s = time.perf_counter() - start
        outcomes = []
        for setup, own, cells_kept in zip(setups, keys, kept, strict=True):
            outcome = _conclude(setup, own, cells_kept)
            record = run_record(
                setup.config,
                kept=cells_kept,
                efforts=efforts,
                wall_s=wall_s,
                cells_s=cells_s,
                together=len(configs),
                again=report.sent_again,
            )
            write_atomically(outcome.out / RUN, json_bytes(record))
            outcomes.append(outcome)
    for config, outcome in zip(configs, outcomes, strict=True):
        _compare(config, outcome)
        if tables and not quiet and not config.json:
            _show(config, outcome)
    return outcomes


def _check_together(configs: Sequence[SweepConfig]) -> None:
    folders: set[Path] = set()
    for config in configs:
        folder = config.out.resolve()
        if folder in folders:
            raise BadInput(f"out: {config.out} is the folder of two sweeps")
        folders.add(folder)
    schedulers = {config.scheduler for config in configs}
    if len(schedulers) > 1:
        raise BadInput(f"scheduler: expected one for all, got {sorted(map(str, schedulers))}")


def _allow_files(folders: int) -> None:
    """Each folder is kept open, and systems let a process open no more than 1024 unless it asks."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = folders + 512
    if soft != resource.RLIM_INFINITY and soft < needed:
        most = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))


class _Borrowed(Executor):
    """An executor of somebody else's: it stays open."""

    def __init__(self, executor: Executor) -> None:
        self.submit = executor.submit
        self.claim = getattr(executor, "claim", False)


def _executor(
    configs: Sequence[SweepConfig], todo: Sequence[Job], given: Executor | None
) -> Callable[[], tuple[Executor, int]] | None:
    """What opens the executor; None where this process computes."""
    workers = max((config.processes() for config in configs), default=1)
    if given is not None:
        return lambda: (_Borrowed(given), workers)
    if configs and configs[0].scheduler is not None:
        return functools.partial(open_cluster, configs[0].scheduler)
    workers = min(workers, len(todo))
    if all(config.workers is None for config in configs):
        tasks = sum(cell.robots * cell.tasks for _, cell in todo)
        workers = min(workers, 1 + tasks // TASKS_A_PROCESS)
    if workers <= 1:
        return None
    return lambda: (LocalPool(workers), workers)


def _conclude(setup: Setup, keys: Mapping[Cell, str], kept: set[Cell]) -> SweepResult:
    """Summarise from the cells' files, so that kept and computed cells are treated alike."""
    config = setup.config
    files = {cell: cell_store.path(config.out, key) for cell, key in keys.items()}
    tables = {cell: cell_store.read(file) for cell, file in files.items()}
    records = {cell: results.task_records(content.tasks) for cell, content in tables.items()}
    summaries = [
        summarise(config.fleet(cell), records[cell], results.event_log(content.events))
        for cell, content in tables.items()
    ]
    paired = results.paired_differences(records)
    merged = merged_files(setup, tables, summaries, paired)
    for name, data in merged.items():
        write_atomically(config.out / name, data)
    digests = {cell: sha256(file.read_bytes()) for cell, file in files.items()}
    said = manifest(setup, keys, tables, digests, merged)
    write_atomically(config.out / MANIFEST, json_bytes(said))
    computed = tuple(cell.name for cell in config.cells() if cell not in kept)
    mixed = len(said["origins"])
    return SweepResult(config.out, tuple(summaries), tuple(paired), computed, files, mixed)


def merged_files(
    setup: Setup,
    tables: Mapping[Cell, cell_store.Content],
    summaries: Sequence[CellSummary],
    paired: Sequence[Paired],
) -> dict[str, bytes]:
    """The files of `RESULTS`, from the cells."""
    origin = about(setup)
    tasks = results.merge([(cell, content.tasks) for cell, content in tables.items()])
    events = results.merge([(cell, content.events) for cell, content in tables.items()])
    content = (
        results.parquet(tasks, origin),
        results.parquet(events, origin),
        csv(summary_frame(summaries)),
        csv(paired_frame(paired)),
        png(figure6(summaries), origin),
    )
    return dict(zip(RESULTS, content, strict=True))


def _show(config: SweepConfig, outcome: SweepResult) -> None:
    console = Console()
    console.print(summary_tables(outcome.summaries))
    for line in (
        numbers(outcome.summaries, outcome.tasks(), config.seed),
        f"engine {config.engine}, {config.engine_lanes()} lanes; results in {config.out}",
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if outcome.origins > 1:
        console.print(
            f"computed by {outcome.origins} kinds of processor or code, see origins in {MANIFEST}: "
            "results are the same to the last bit on one only",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )


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
