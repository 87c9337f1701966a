"""Measures the throughput of the engines in one run, as a sweep uses them, on one core and on all.

Engines take turns call by call, so that other load on the computer affects all of them equally; the
others idle meanwhile. Compile time is measured separately, in an empty cache.
"""

import contextlib
import dataclasses
import json
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

import jax
from rich.console import Console

from pgf_jax.cores import usable
from pgf_jax.errors import WorkersLost
from pgf_jax.parallel.jax_settings import jax_settings
from pgf_jax.parallel.local import LocalPool, WorkerDied
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import ENGINES, default_lanes, default_processes
from pgf_jax.plugins.registry import check_importable
from pgf_jax.profiling import measure
from pgf_jax.profiling.config import ProfileConfig
from pgf_jax.profiling.measure import Call, Job
from pgf_jax.profiling.report import print_report

ITERATION_S = 3.0  # simulated s: K parallel rollouts, then the winner's own, 1.5 s each
LEAST_LANES = 8  # `native` has L = 1 in a sweep, which is not its fastest
_TRIES = 2  # timed calls of each setting before one is chosen
_START_S = 0.05  # from asking processes for a call to its start: they have all heard of it then

# Settings to try for each engine; the fastest counts. All of them solve the same problem:
# `experiments/parity.py` measures how far the cheap ones end from the converged solution.
SETTINGS: dict[str, list[dict[str, Any]]] = {
    "native": [
        {"solver": solver, "jacobian": jacobian, "sleep": True}
        for solver in ("newton", "cg")
        for jacobian in ("dense", "sparse")
    ],
}


def profile(config: ProfileConfig) -> dict[str, Any]:
    """Measure, print (tables or JSON) and return the figures.

    Returns:
      `machine`: `platform`, `cores` (used), `device`, `jax` (its version), and `peak_gflops`, 1e9
      operations a second that products of float32 matrices reach on one core.

      `engines`: for each name `settings` (the fastest), `tried` (`settings` and `steps_per_s` of
      each, on one core at the first L, where there are several), `one_core` (one process),
      `all_cores` (as many processes as a sweep starts; absent with one core), `iteration` (parts of
      one on one core at its best L, see `split_iteration`), and `memory_mib` (resident memory of a
      process that only does the call of it; null where the system does not tell).

      `one_core` and `all_cores` have the figures of the fastest L, and `by_lanes`, those of all:
      `lanes` (L, of each process), `processes`, `cores` (of all processes together), `substep_s`,
      `call_s` (median, until the last process is done), `rollouts_per_s`, `steps_per_s` (physics
      substeps of all rollouts), `iterations_per_s`, `robot_s_per_s` (simulated planning time of
      robots, s, a second), `ratio_to_native` (of `steps_per_s`, to the fastest of `native` on as
      many cores, where that is measured), and `compile_s` (one core, nothing cached). Of an engine
      that tells them, `occupancy` (share of the computed work that was used), `flops_per_step`,
      `gflops` (1e9 operations a second) and `peak_share` (of the `peak_gflops` of all `cores`).

    Raises:
      BadInput: other processes cannot import the plugin that an engine is of.
      WorkersLost: a measured process ended early.
    """
    console = Console(stderr=config.json)
    if not console.is_terminal:
        console.width = 120
    try:
        with contextlib.ExitStack() as stack:
            result = _Measurement(config, console, stack).result()
    except WorkerDied as error:
        raise WorkersLost(f"{error}, maybe for want of memory; nothing is kept") from None
    if config.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
    else:
        print_report(result, console)
    return result


def lanes_of(config: ProfileConfig, engine: str) -> tuple[int, ...]:
    """The values of L to try for an engine, each once."""
    least = max(default_lanes(engine), LEAST_LANES)
    return tuple(dict.fromkeys(config.lanes or (least,)))


@dataclasses.dataclass
class _Run:
    """An engine at one L on some cores, and its calls: one of each process in each round."""

    job: Job
    pool: LocalPool
    processes: int
    cores: int
    first_s: float = 0.0  # the first call
    rounds: list[list[Call]] = dataclasses.field(default_factory=list)

    def submit(self, fn: Callable, *args: Any) -> list[Future]:
        """Call `fn(job, *args)` in each process."""
        return [self.pool.submit(fn, self.job, *args) for _ in range(self.processes)]

    def round(self) -> None:
        """One call of each process, all at once."""
        start = time.monotonic() + _START_S
        self.rounds.append([future.result() for future in self.submit(measure.timed, start)])


class _Measurement:
    """The processes, and what has been measured in them."""

    def __init__(
        self, config: ProfileConfig, console: Console, stack: contextlib.ExitStack
    ) -> None:
        self.config, self.console, self.stack = config, console, stack
        self.cores = usable()[: config.cores]
        self.names = list(dict.fromkeys(config.engines))
        self.compiled = stack.enter_context(tempfile.TemporaryDirectory())
        self.pools: dict[tuple[int, int], LocalPool] = {}
        self.one: dict[str, list[_Run]] = {}  # on one core
        self.every: dict[str, list[_Run]] = {}  # on all, where there are more
        self.tried: dict[str, list[dict[str, Any]]] = {name: [] for name in self.names}
        self.peak = 0.0  # floating-point operations a second

    def result(self) -> dict[str, Any]:
        """Measure all."""
        self._warm_all()
        runs = [run for name in self.names for run in (*self.one[name], *self.every[name])]
        for number in range(self.config.repeats):
            self.peak = max(self.peak, self._pool(1, 1).submit(measure.peak).result())
            for run in runs:
                run.round()
            self.console.print(f"round {number + 1} of {self.config.repeats}", style="dim")
        engines = {name: self._engine(name) for name in self.names}
        self._measure_memory(engines)
        for where in ("one_core", "all_cores"):
            entries = {name: e[where] for name, e in engines.items() if where in e}
            if "native" in entries:
                native = entries["native"]["steps_per_s"]
                for entry in entries.values():
                    for figures in (entry, *entry["by_lanes"]):
                        figures["ratio_to_native"] = figures["steps_per_s"] / native
        machine = {
            "platform": platform.platform(),
            "cores": len(self.cores),
            "device": str(jax.devices()[0]),
            "jax": jax.__version__,
            "peak_gflops": self.peak / 1e9,
        }
        return {"machine": machine, "engines": engines}

    def _warm_all(self) -> None:
        """Compile everything, and choose settings where there are several."""
        plain = [name for name in self.names if len(SETTINGS.get(name, [{}])) == 1]
        for name in plain:
            self._add(name, *SETTINGS.get(name, [{}]))
        one, every = ([run for n in plain for run in of[n]] for of in (self.one, self.every))
        # A process that has all cores compiles for itself, while the one core is busy; several
        # processes find what the one core has compiled.
        meanwhile = [(run, run.submit(measure.warm)) for run in every if run.processes == 1]
        for run in (*one, *(run for run in every if run.processes > 1)):
            self._warm(run, run.submit(measure.warm))
        for run, futures in meanwhile:
            self._warm(run, futures)
        for name in self.names:
            if name not in plain:
                self._add(name, self._fastest(name))
                for run in (*self.one[name], *self.every[name]):
                    self._warm(run, run.submit(measure.warm))

    def _add(self, name: str, settings: dict[str, Any]) -> None:
        jobs = [self._job(name, settings, lanes) for lanes in lanes_of(self.config, name)]
        self.one[name] = [self._run(job, 1, 1) for job in jobs]
        count = len(self.cores)
        processes = min(default_processes(name), count)
        self.every[name] = [self._run(job, processes, count) for job in jobs if count > 1]

    def _fastest(self, name: str) -> dict[str, Any]:
        """The fastest settings on one core at the first L."""
        lanes = lanes_of(self.config, name)[0]
        runs = [self._run(self._job(name, s, lanes), 1, 1) for s in SETTINGS[name]]
        for run in runs:
            self._warm(run, run.submit(measure.warm))
        for _ in range(_TRIES):
            for run in runs:
                run.round()
        self.tried[name] = [
            {"settings": dict(run.job.settings), "steps_per_s": self._figures(run)["steps_per_s"]}
            for run in runs
        ]
        return max(self.tried[name], key=lambda tried: tried["steps_per_s"])["settings"]

    def _warm(self, run: _Run, futures: list[Future]) -> None:
        run.first_s = max(future.result() for future in futures)
        several = f" in {run.processes} processes" if run.processes > 1 else ""
        self._say(run.job, f"warm{several}, cores: {run.cores}")

    def _job(self, name: str, settings: dict[str, Any], lanes: int) -> Job:
        plugin = ENGINES.plugin(name)
        if plugin is not None:
            check_importable(plugin, "here")
        return Job(
            name,
            tuple(settings.items()),
            lanes,
            self.config.physics,
            self.config.scene_class,
            self.config.seed,
            self.compiled,
            tuple(jax_settings().items()),
            plugin,
        )

    def _run(self, job: Job, processes: int, cores: int) -> _Run:
        return _Run(job, self._pool(processes, cores), processes, cores)

    def _pool(self, processes: int, cores: int) -> LocalPool:
        """Processes that share out the first so many of the cores."""
        if (processes, cores) not in self.pools:
            self.pools[processes, cores] = self._start(processes, self.cores[:cores])
        return self.pools[processes, cores]

    def _start(self, processes: int, cores: Sequence[int]) -> LocalPool:
        pool = LocalPool(processes, cores=cores)
        self.stack.callback(pool.shutdown, cancel_futures=True)
        return pool

    def _say(self, job: Job, what: str) -> None:
        words = [job.engine, *(str(v) for _, v in job.settings if not isinstance(v, bool))]
        self.console.print(f"{' '.join(words)}, {job.lanes} lanes: {what}", style="dim")

    def _engine(self, name: str) -> dict[str, Any]:
        one = self._entry(self.one[name])
        best = next(run for run in self.one[name] if run.job.lanes == one["lanes"])
        (split,) = best.submit(measure.split_iteration, self.config.repeats)
        entry = {"settings": dict(best.job.settings), "tried": self.tried[name], "one_core": one}
        if self.every[name]:
            entry["all_cores"] = self._entry(self.every[name])
        entry["iteration"] = split.result()
        self._say(best.job, "iteration measured")
        return entry

    def _measure_memory(self, engines: dict[str, Any]) -> None:
        """Add the memory of each engine, in a process of its own; all at once, on a core each."""
        futures = []
        for number, (name, entry) in enumerate(engines.items()):
            core = self.cores[number % len(self.cores)]
            job = self._job(name, entry["settings"], entry["one_core"]["lanes"])
            futures.append(self._start(1, [core]).submit(measure.memory, job))
        for entry, future in zip(engines.values(), futures, strict=True):
            entry["memory_mib"] = future.result()

    def _entry(self, runs: list[_Run]) -> dict[str, Any]:
        by_lanes = [self._figures(run) for run in runs]
        return {**max(by_lanes, key=lambda f: f["steps_per_s"]), "by_lanes": by_lanes}

    def _figures(self, run: _Run) -> dict[str, Any]:
        physics = PHYSICS[self.config.physics]
        seconds = statistics.median(
            max(call.end for call in calls) - min(call.begin for call in calls)
            for calls in run.rounds
        )
        calls = [call for of_round in run.rounds for call in of_round]
        rollouts = calls[0].rollouts * run.processes
        steps = rollouts * physics.knots * physics.substeps
        iterations = run.job.lanes * run.processes / seconds
        figures = {
            "lanes": run.job.lanes,
            "processes": run.processes,
            "cores": run.cores,
            "substep_s": physics.substep_s,
            "call_s": seconds,
            "rollouts_per_s": rollouts / seconds,
            "steps_per_s": steps / seconds,
            "iterations_per_s": iterations,
            "robot_s_per_s": iterations * ITERATION_S,
        }
        if run.cores == 1:
            figures["compile_s"] = max(0.0, run.first_s - seconds)
        work = [call.work for call in calls if call.work is not None]
        used, computed = (sum(lanes) for lanes in zip(*work, strict=True)) if work else (0, 0)
        if computed:
            figures["occupancy"] = used / computed
        counted = [call.flops for call in calls if call.flops is not None]
        if counted:
            flops = sum(counted) / len(run.rounds)
            figures["flops_per_step"] = flops / steps
            figures["gflops"] = flops / seconds / 1e9
            if self.peak:  # measured by now
                figures["peak_share"] = flops / seconds / (self.peak * run.cores)
        return figures
