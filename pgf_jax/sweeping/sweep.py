"""`pgf_jax.sweep`: fleets of every size under every policy on the same scenes, and their files.

Read `sweeps` first: resolve, open the stores, compute the missing cells, read all cells, summarise,
write the results, show them.
"""

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

from pgf_jax.cores import usable
from pgf_jax.errors import BadInput
from pgf_jax.files import json_bytes, png, sha256, write_atomically
from pgf_jax.fleet.config import Cell
from pgf_jax.jax_setup import configure_early, one_engine
from pgf_jax.metrics.summary import CellSummary
from pgf_jax.parallel.cluster import open_cluster
from pgf_jax.parallel.local import LocalPool
from pgf_jax.plugins.digest import is_interactive
from pgf_jax.plugins.registry import check_importable
from pgf_jax.settings import check_type
from pgf_jax.simulation.recorded_operator import LIVE
from pgf_jax.sweeping import cell_file, columns
from pgf_jax.sweeping.cell_store import MANIFEST, RESULTS, RUN, CellStore
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.dispatch import dispatch, share_out
from pgf_jax.sweeping.figure6 import figure6
from pgf_jax.sweeping.manifest import about, manifest, run_record
from pgf_jax.sweeping.replay import replay_config, replay_difference
from pgf_jax.sweeping.report import Report, physics_line, summary_tables
from pgf_jax.sweeping.resolve import CellSpec, Loaded, ResolvedSweep, resolve
from pgf_jax.sweeping.run_cells import BatchStats
from pgf_jax.sweeping.summary import (
    Paired,
    csv,
    fleets_frame,
    over_fleets,
    paired_differences,
    paired_frame,
    summary_frame,
    summary_of,
)
from pgf_jax.tables import results
from pgf_jax.tables.event_log import read_log
from pgf_jax.tables.parquet import encode_table

TASKS_A_PROCESS = 60  # a process for fewer takes longer to start than it saves


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """The results of a sweep; all of them are in files too.

    Attributes:
      out: their folder.
      summaries: one a cell, by policy, then by fleet size, then by seed.
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
        return results.read_results(self.out / "tasks.parquet", columns.TASK_SCHEMA)

    def events(self) -> pl.DataFrame:
        """`events.parquet`: one row an event."""
        return results.read_results(self.out / "events.parquet", columns.EVENT_SCHEMA)

    def cell(self, cell: Cell) -> cell_file.Content:
        """One cell's tables, and where they come from."""
        return cell_file.read(self.files[cell])


def sweep(
    config: SweepConfig, *, quiet: bool = False, executor: Executor | None = None
) -> SweepResult:
    """Run a sweep: every policy at every fleet size.

    All cells of a process share one queue of requests (see `sweeps`); each is written as soon as it
    is finished. With several workers, a script must call this under
    `if __name__ == "__main__"`.

    Args:
      config: what to run.
      quiet: no progress (standard error), no table at the end (standard output).
      executor: computes the cells, in place of processes of this computer or of the configuration's
        scheduler; it stays open.

    Returns:
      The summaries. Files are in `config.out`: `tasks.parquet`, `events.parquet`, `summary.csv`,
      `paired.csv`, `fig6.png`, `manifest.json`, and each cell's in `cells`; `run.json`, and a file
      beside each cell's, say how they were computed. On one type of processor the same
      configuration gives the same files, but for the latter, whoever computes them.

    Raises:
      BadInput: the configuration, or a file it names, cannot be used; or the folder holds results
        of another configuration, or, on resuming, corrupt ones (nothing has been written then); or
        a file cannot be written (finished cells are kept).
      WorkersLost: what computes the cells is gone; finished cells are kept.
      KeyboardInterrupt: interrupted; finished cells are kept.
    """
    hint = "sweeps takes several" if isinstance(config, list | tuple) else ""
    check_type("config", config, SweepConfig, hint=hint)
    return sweeps([config], quiet=quiet, executor=executor)[0]


def sweeps(
    configs: Sequence[SweepConfig],
    *,
    quiet: bool = False,
    tables: bool = True,
    executor: Executor | None = None,
) -> list[SweepResult]:
    """Run several sweeps as one: calls of the engine are fuller, and nothing is computed twice.

    Fleets of one seed, class and operator share their searches until a robot is served at another
    moment (`SearchCache`). So a second policy, window, service time or fleet size costs little.

    Args:
      configs: each with a folder of its own; `workers` is the largest of theirs.
      quiet: as in `sweep`.
      tables: show the tables at the end, unless quiet.
      executor: as in `sweep`.

    Returns:
      The results of each, as if it had been run alone.

    Raises:
      BadInput: as in `sweep`; or two have the same folder, or different schedulers.
      WorkersLost: as in `sweep`.
      KeyboardInterrupt: interrupted; finished cells are kept.
    """
    start = time.perf_counter()
    check_type("configs", configs, Sequence, expected="a list of SweepConfig")
    for config in configs:
        check_type("configs", config, SweepConfig)
    configure_early(one_engine(config.engine for config in configs))
    configs = [_as_recorded(config) for config in configs]
    _check_together(configs)
    loaded: Loaded = {}
    stores = [CellStore(resolve(c, loaded, number=i)) for i, c in enumerate(configs)]
    _allow_files(len(stores))
    with contextlib.ExitStack() as stack:
        for store in stores:
            stack.enter_context(store.open())
        as_json = any(config.json for config in configs)
        cells = [cell for store in stores for cell in store.sweep.cells]
        kept = [cell for store in stores for cell in store.kept]
        with Report(cells, kept, Console(stderr=True), quiet=quiet, json=as_json) as report:
            report.plugin_changed([cell for store in stores for cell in store.changed])
            try:
                stats, cells_s = _compute(stores, report, executor)
            except KeyboardInterrupt:
                report.interrupted(*(config.out for config in configs))
                raise
        wall_s = time.perf_counter() - start
        for store in stores:
            store.remove_changed()
        outcomes = [_write_results(store) for store in stores]
        for store in stores:
            record = run_record(
                store.sweep.config,
                kept=[spec.name for spec in store.kept],
                stats=stats,
                wall_s=wall_s,
                cells_s=cells_s,
                together=len(stores),
                retried=report.retried_cells,
            )
            write_atomically(store.out / RUN, json_bytes(record))
    for config, outcome in zip(configs, outcomes, strict=True):
        _check_replay(config, outcome)
        if tables and not quiet and not config.json:
            _show(config, outcome)
    return outcomes


def _as_recorded(config: SweepConfig) -> SweepConfig:
    """The configuration, with the settings of the recorded session that it replays, if any."""
    if config.operator == LIVE:
        raise BadInput("operator: live is for pgf-jax console; expected a simulated one")
    return config if config.log is None else replay_config(config, read_log(config.log))


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
    """Raise the limit on open files, of which each folder needs one; the usual limit is 1024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = folders + 512
    if soft != resource.RLIM_INFINITY and soft < needed:
        most = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))


def _compute(
    stores: Sequence[CellStore], report: Report, executor: Executor | None
) -> tuple[list[BatchStats], float]:
    """Compute the missing cells; time and work of each batch, and the time of all, s."""
    missing = [cell for store in stores for cell in store.missing]
    if not missing:
        return [], 0.0
    opener = _executor([store.sweep.config for store in stores], missing, executor)
    for store in stores:
        if store.missing:
            store.remove_merged()
    begin = time.perf_counter()
    return dispatch(missing, report, opener), time.perf_counter() - begin


class _Borrowed(Executor):
    """An executor of the caller's, which stays open."""

    def __init__(self, executor: Executor) -> None:
        self.submit = executor.submit
        self.claim = getattr(executor, "claim", False)


def _executor(
    configs: Sequence[SweepConfig], missing: Sequence[CellSpec], given: Executor | None
) -> Callable[[], tuple[Executor, int]] | None:
    """What opens the executor; None where this process computes."""
    workers = max((config.processes() for config in configs), default=1)
    if given is not None:
        return lambda: (_Borrowed(given), workers)
    plugins = {plugin for cell in missing for plugin, _ in cell.plugins}
    if configs and configs[0].scheduler is not None:
        for plugin in plugins:
            check_importable(plugin, "elsewhere")
        return functools.partial(open_cluster, configs[0].scheduler)
    if all(config.workers is None for config in configs):
        workers = min(workers, 1 + sum(cell.tasks for cell in missing) // TASKS_A_PROCESS)
        if any(is_interactive(plugin.module) for plugin in plugins):
            workers = 1
    count, each = share_out(missing, workers)
    if count == 1 and (each is None or each == 1):
        return None
    for plugin in plugins:
        check_importable(plugin, "here")
    some = None if each is None else usable()[: count * each]
    return lambda: (LocalPool(count, cores=some), count)


def _write_results(store: CellStore) -> SweepResult:
    """Merge and summarise the cells' files: kept and computed cells are treated alike."""
    sweep, config = store.sweep, store.sweep.config
    tables = store.read_all()
    summaries = [summary_of(content) for content in tables.values()]
    paired = paired_differences({cell: content.records for cell, content in tables.items()})
    merged = merged_files(sweep, tables, summaries, paired)
    for name, data in merged.items():
        write_atomically(config.out / name, data)
    digests = {spec.cell: sha256(spec.path.read_bytes()) for spec in sweep.cells}
    content = manifest(sweep, tables, digests, merged)
    write_atomically(config.out / MANIFEST, json_bytes(content))
    return SweepResult(
        out=config.out,
        summaries=tuple(summaries),
        paired=tuple(paired),
        computed=tuple(spec.name for spec in store.missing),
        files={spec.cell: spec.path for spec in sweep.cells},
        origins=len(content["origins"]),
    )


def merged_files(
    sweep: ResolvedSweep,
    tables: Mapping[Cell, cell_file.Content],
    summaries: Sequence[CellSummary],
    paired: Sequence[Paired],
) -> dict[str, bytes]:
    """The files of `RESULTS`, from the cells."""
    origin = about(sweep)
    content = (
        encode_table(columns.merged(tables.values(), "tasks"), origin),
        encode_table(columns.merged(tables.values(), "events"), origin),
        csv(summary_frame(summaries)),
        csv(fleets_frame(over_fleets(summaries))),
        csv(paired_frame(paired)),
        png(figure6(summaries), origin),
    )
    return dict(zip(RESULTS, content, strict=True))


def _check_replay(config: SweepConfig, result: SweepResult) -> None:
    """BadInput where the events of a replay are not those of its log."""
    if config.log is None:
        return
    events = results.event_log(result.events().select(list(results.EVENT_SCHEMA)))
    difference = replay_difference(events, read_log(config.log))
    if difference is not None:
        raise BadInput(difference)


def _show(config: SweepConfig, result: SweepResult) -> None:
    console = Console()
    console.print(summary_tables(result.summaries))
    for line in (
        physics_line(result.summaries, result.tasks()),
        f"engine {config.engine}, {config.engine_lanes()} lanes; results in {config.out}",
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if result.origins > 1:
        console.print(
            f"computed by {result.origins} kinds of processor or code, see origins in {MANIFEST}: "
            "results are the same to the last bit on one only",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
