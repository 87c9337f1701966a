"""Measures the throughput of the engines in one run, and the parts of a planner iteration.

The rollouts are like the planner's: sampled scenes of the three classes, and reach nominals with
the planner's noise. Engines take turns call by call, so that other load on the computer affects all
of them equally. Compile time is measured separately.
"""

import json
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from pgf_jax.cores import pin, usable
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import Engine, World, make_engine
from pgf_jax.planning.planner import BatchPlanner, start_world
from pgf_jax.profiling.config import ProfileConfig
from pgf_jax.scene import PRESETS, Scene, sample_scene

ITERATION_S = 3.0  # simulated s: K parallel rollouts, then the winner's own, 1.5 s each

# Settings to try for each engine; the fastest counts. All of them solve the same problem:
# `experiments/parity.py` measures how far the cheap ones end from the converged solution.
SETTINGS: dict[str, list[dict[str, Any]]] = {
    "planar": [{}],
    "mjx": [{}],
    "native": [
        {"solver": solver, "jacobian": jacobian, "sleep": True}
        for solver in ("newton", "cg")
        for jacobian in ("dense", "sparse")
    ],
}


def profile(config: ProfileConfig) -> dict[str, Any]:
    """Measure, print (a table or JSON) and return `{"machine": ..., "engines": {NAME: ...}}`.

    An engine's `steps_per_s` is that of its best settings and lane count, which are in the same
    entry (`settings`, `lanes`, `workers`: cores that its threads may use). `by_lanes` has all
    settings and lane counts. `robot_s_per_s` is the simulated planning time of robots per second of
    real time. `iteration` has the parts of a planner iteration at the best settings: see
    `split_iteration`.
    """
    if config.cores is not None:
        pin(usable()[: config.cores])
    console = Console(stderr=config.json)
    if not console.is_terminal:
        console.width = 110
    engines = {name: _measure_all(name, config, console) for name in config.engines}
    _take_turns(engines, config)
    result: dict[str, Any] = {"machine": _machine(), "engines": {}}
    for name, runs in engines.items():
        best = max(runs, key=lambda run: run["steps_per_s"])
        result["engines"][name] = {
            **_json_entry(best),
            "iteration": split_iteration(best["engine"], config),
            "memory_lanes": config.memory_lanes,
            "memory_mib": _memory_mib(name, config),
            "by_lanes": [_json_entry(run) for run in runs],
        }
    reference = result["engines"].get("native")
    if reference:
        for entry in result["engines"].values():
            entry["ratio_to_native"] = entry["steps_per_s"] / reference["steps_per_s"]
    if config.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
    else:
        _print(result, console)
    return result


def rollouts(engine: Engine, seed: int) -> tuple[World, np.ndarray, np.ndarray]:
    """The arguments of a typical call: L lanes of K rollouts; see `noisy_nominals`."""
    scenes = [sample_scene(seed + i, PRESETS[i % len(PRESETS)]) for i in range(engine.lanes)]
    return noisy_nominals(engine, scenes, seed)


def noisy_nominals(
    engine: Engine, scenes: Sequence[Scene], seed: int
) -> tuple[World, np.ndarray, np.ndarray]:
    """The reach nominal of each scene, K times, with the planner's noise.

    Returns:
      [scenes K] worlds, [scenes K, T, 3] controls and [scenes K, T] gripper values.
    """
    planner = BatchPlanner(engine)
    k = planner.config.rollouts
    searches = [planner.begin_reach(start_world(s.positions), s.goal) for s in scenes]

    def repeat(of_scenes: Iterable[Any]) -> np.ndarray:
        return np.repeat(np.stack(list(of_scenes)), k, 0)

    start = World(*(repeat(field) for field in zip(*(s.start for s in searches), strict=True)))
    controls = repeat(s.controls for s in searches)
    noise = np.random.default_rng(seed).standard_normal(controls.shape)
    noisy = controls + np.array(planner.config.sigma) * noise
    return start, noisy.astype(np.float32), repeat(s.gripper for s in searches)


def _measure_all(name: str, config: ProfileConfig, console: Console) -> list[dict[str, Any]]:
    runs = []
    for settings in SETTINGS.get(name, [{}]):
        for lanes in config.lanes:
            physics = PHYSICS[config.physics]
            engine = make_engine(name, physics=physics, lanes=lanes, **settings)
            work = rollouts(engine, config.seed)
            first = _seconds(engine, work)
            second = _seconds(engine, work)
            runs.append(
                {
                    "engine": engine,
                    "work": work,
                    "seconds": [],
                    "settings": settings,
                    "lanes": lanes,
                    "workers": len(usable()),
                    "substep_s": physics.substep_s,
                    "compile_s": max(0.0, first - second),
                }
            )
            console.print(f"{name} {settings or ''} {lanes} lanes: warm", style="dim")
    return runs


def _take_turns(engines: dict[str, list[dict[str, Any]]], config: ProfileConfig) -> None:
    runs = [run for of_engine in engines.values() for run in of_engine]
    for _ in range(config.repeats):
        for run in runs:
            run["seconds"].append(_seconds(run["engine"], run["work"]))
    for run in runs:
        physics = run["engine"].physics
        rolled = len(run["work"][1])
        seconds = statistics.median(run["seconds"])
        run["call_s"] = seconds
        run["rollouts_per_s"] = rolled / seconds
        run["steps_per_s"] = rolled * physics.knots * physics.substeps / seconds
        run["iterations_per_s"] = run["lanes"] / seconds
        run["robot_s_per_s"] = run["iterations_per_s"] * ITERATION_S
        if hasattr(run["engine"], "occupancy"):
            used, computed = run["engine"].occupancy()
            run["occupancy"] = used / computed


class _Stopwatch:
    """An engine that adds up the time of its rollouts."""

    def __init__(self, engine: Engine) -> None:
        self._engine, self.seconds = engine, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._engine, name)

    def rollout(self, *args: Any) -> Any:
        begin = time.perf_counter()
        out = jax.block_until_ready(self._engine.rollout(*args))
        self.seconds += time.perf_counter() - begin
        return out


def split_iteration(engine: Engine, config: ProfileConfig) -> dict[str, float]:
    """Time of the parts of a planner iteration of L robots, ms; medians.

    `rollout` is the engine's part; `propose` draws the noise, `absorb` computes cost terms and the
    update, both jitted; `host` is the rest: collecting lanes into a batch and returning results.
    """
    watch = _Stopwatch(engine)
    planner = BatchPlanner(watch)  # pyright: ignore[reportArgumentType]
    scenes = [sample_scene(config.seed + i, PRESETS[i % 3]) for i in range(engine.lanes)]
    searches = [planner.begin_reach(start_world(s.positions), s.goal) for s in scenes]
    keys = np.random.default_rng(config.seed).integers(
        0, 2**32, (config.repeats + 2, engine.lanes, 2), dtype=np.uint32
    )
    parts = {"total": [], "rollout": [], "propose": [], "absorb": []}
    calls = {"propose": planner._propose, "absorb": planner._absorb}

    def timed(name: str) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            begin = time.perf_counter()
            out = jax.block_until_ready(calls[name](*args))
            parts[name].append(time.perf_counter() - begin)
            return out

        return call

    for name in calls:
        setattr(planner, f"_{name}", timed(name))
    for of_call in keys:
        watch.seconds, begin = 0.0, time.perf_counter()
        searches = planner.step(searches, list(of_call))
        parts["total"].append(time.perf_counter() - begin)
        parts["rollout"].append(watch.seconds)
    # The first two calls do not count: the nominals' rollouts, and compilation.
    ms = {name: 1e3 * statistics.median(values[2:]) for name, values in parts.items()}
    ms["host"] = ms["total"] - ms["rollout"] - ms["propose"] - ms["absorb"]
    return {f"{name}_ms": value for name, value in ms.items()}


def _seconds(engine: Engine, work: tuple[World, np.ndarray, np.ndarray]) -> float:
    begin = time.perf_counter()
    jax.block_until_ready(engine.rollout(*work, engine.physics.substeps))
    return time.perf_counter() - begin


def _json_entry(run: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in run.items() if k not in ("engine", "work", "seconds")}


_MEMORY_PROBE = """
import sys, jax
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import make_engine
from pgf_jax.profiling.profile import rollouts
engine = make_engine(sys.argv[1], physics=PHYSICS[sys.argv[2]], lanes=int(sys.argv[3]))
jax.block_until_ready(engine.rollout(*rollouts(engine, 0), engine.physics.substeps))
# On Linux ru_maxrss includes the parent's peak; VmHWM is this program's own.
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(float(status["VmHWM"].split()[0]) / 1024)
"""


def _memory_mib(name: str, config: ProfileConfig) -> float:
    """Peak resident memory, MiB, of a new process that rolls out a batch of `memory_lanes`.

    nan on systems other than Linux.
    """
    if not Path("/proc/self/status").exists():
        return float("nan")
    probe = [sys.executable, "-c", _MEMORY_PROBE, name, config.physics, str(config.memory_lanes)]
    return float(subprocess.run(probe, check=True, capture_output=True, text=True).stdout)


def _machine() -> dict[str, Any]:
    return {
        "platform": platform.platform(),
        "cores": len(usable()),
        "device": str(jax.devices()[0]),
        "jax": jax.__version__,
    }


def _print(result: dict[str, Any], console: Console) -> None:
    table = Table(title="rollout throughput, engines taking turns in one run")
    for column in ("engine", "lanes", "cores", "substep ms", "steps/s", "rollouts/s"):
        table.add_column(column, justify="left" if column == "engine" else "right")
    for column in ("iterations/s", "robot s/s", "full", "compile s", "to native", "settings"):
        table.add_column(column, justify="left" if column == "settings" else "right")
    native = result["engines"].get("native", {}).get("steps_per_s")
    for name, entry in result["engines"].items():
        for run in entry["by_lanes"]:
            best = run["steps_per_s"] == entry["steps_per_s"]
            table.add_row(
                name,
                str(run["lanes"]),
                str(run["workers"]),
                f"{1e3 * run['substep_s']:.2f}",
                f"{run['steps_per_s']:,.0f}",
                f"{run['rollouts_per_s']:.1f}",
                f"{run['iterations_per_s']:.2f}",
                f"{run['robot_s_per_s']:.1f}",
                f"{100 * run['occupancy']:.0f} %" if "occupancy" in run else "",
                f"{run['compile_s']:.1f}",
                f"{run['steps_per_s'] / native:.2f}" if native else "",
                " ".join(str(v) for v in run["settings"].values() if not isinstance(v, bool)),
                style="bold" if best else "",
            )
    console.print(table)
    for name, entry in result["engines"].items():
        split = entry["iteration"]
        console.print(
            f"{name}: an iteration of {entry['lanes']} robots takes {split['total_ms']:.0f} ms: "
            + ", ".join(
                f"{part} {split[part + '_ms']:.1f}"
                for part in ("rollout", "propose", "absorb", "host")
            )
        )
        console.print(
            f"{name}: {entry['memory_mib']:,.0f} MiB resident for a batch of "
            f"{entry['memory_lanes']} robots"
        )
