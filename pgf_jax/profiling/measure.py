"""What the processes of `profile` do: build an engine, time its calls, split an iteration.

The rollouts are like the planner's: sampled scenes, and reach nominals with the planner's
noise. A process keeps the engines that it has built.
"""

import dataclasses
import functools
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from pgf_jax.cores import usable
from pgf_jax.parallel.jax_settings import adopt
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import Engine, Rollout, World, make_engine
from pgf_jax.physics.sized import SizedEngine
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import start_world
from pgf_jax.plugins.registry import Plugin, require
from pgf_jax.profiling.config import MeasuredClass
from pgf_jax.scene import PUBLISHED_CLASSES, Scene, sample_scene
from pgf_jax.scene.shelf import Shelf

PEAK_SIZE, PEAK_TRIES = 512, 30  # of the matrices, and of their products


@dataclasses.dataclass(frozen=True)
class Job:
    """An engine with its settings, and the rollouts that it is measured on.

    Attributes:
      engine: its name.
      settings: pairs of name and value.
      lanes: L.
      physics: name of the constants.
      scene_class: of the scenes; "all": the three published ones in turn.
      seed: of scenes and noise.
      compiled: folder of compiled programs, with one inside for each number of cores: XLA compiles
        for the threads that it has, but JAX finds a program whatever their number.
      jax: JAX's settings, as pairs of name and value.
      plugin: that the engine is of.
    """

    engine: str
    settings: tuple[tuple[str, Any], ...]
    lanes: int
    physics: str
    scene_class: MeasuredClass
    seed: int
    compiled: str
    jax: tuple[tuple[str, Any], ...]
    plugin: Plugin | None


class Call(NamedTuple):
    """A timed call of an engine, in one process.

    Attributes:
      begin: time of the computer's clock, s.
      end: the same.
      rollouts: B.
      work: lanes of work whose result was used, and that were computed; None where the engine does
        not tell.
      flops: floating-point operations; None likewise.
    """

    begin: float
    end: float
    rollouts: int
    work: tuple[int, int] | None
    flops: float | None


class Nominals(NamedTuple):
    """Noisy reach nominals, B of them, with the worlds that they start in.

    Attributes:
      start: [B, N, 2] and so on.
      controls: [B, T, 3].
      gripper: [B, T].
      shelf: [B, N] and so on; None: all is standard.
    """

    start: World
    controls: np.ndarray
    gripper: np.ndarray
    shelf: Shelf | None

    def roll(self, engine: Engine | SizedEngine, substeps: int) -> Rollout:
        """Roll all of them out in one call."""
        named: dict[str, Any] = {} if self.shelf is None else {"shelf": self.shelf}
        return engine.rollout(*self[:3], substeps, **named)


def warm(job: Job) -> float:
    """Build the engine, and call it for the first time; how long that call took, s."""
    first = _call(job)
    return first.end - first.begin


def timed(job: Job, start: float) -> Call:
    """Call the engine at a time of `time.monotonic`, which is one clock for all processes."""
    _built(job)
    time.sleep(max(0.0, start - time.monotonic()))
    return _call(job)


def _call(job: Job) -> Call:
    built, work = _built(job)
    engine: Any = built  # some have more methods than an `Engine` needs
    begin = time.monotonic()
    jax.block_until_ready(work.roll(engine, engine.physics.substeps))
    end = time.monotonic()
    lanes = engine.occupancy() if hasattr(engine, "occupancy") else None
    flops = engine.flops() if hasattr(engine, "flops") else None
    return Call(begin, end, len(work.controls), lanes, flops)


@functools.cache
def _built(job: Job) -> tuple[Engine, Nominals]:
    compiled = str(Path(job.compiled, f"{len(usable())}"))
    adopt({**dict(job.jax), "jax_compilation_cache_dir": compiled})
    if job.plugin is not None:
        require(job.plugin, "worker process")
    scenes = _scenes(job)
    engine = make_engine(
        job.engine,
        physics=PHYSICS[job.physics],
        n_objects=len(scenes[0].objects),
        lanes=job.lanes,
        **dict(job.settings),
    )
    return engine, noisy_nominals(engine, scenes, job.seed)


def peak() -> float:
    """The most floating-point operations a second that products of float32 matrices reach here."""
    a, b = np.random.default_rng(0).random((2, PEAK_SIZE, PEAK_SIZE), np.float32)
    out, seconds = np.empty_like(a), []
    for _ in range(PEAK_TRIES):
        begin = time.monotonic()
        np.matmul(a, b, out=out)
        seconds.append(time.monotonic() - begin)
    return 2 * PEAK_SIZE**3 / min(seconds)


def memory(job: Job) -> float | None:
    """Peak resident memory of this process after a call of the engine, MiB; None: not Linux."""
    _call(job)
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    # ru_maxrss would include the parent's peak; VmHWM is this program's own.
    values = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return float(values["VmHWM"].split()[0]) / 1024


def _scenes(job: Job) -> list[Scene]:
    """A scene for each lane."""
    classes = PUBLISHED_CLASSES if job.scene_class == "all" else (job.scene_class,)
    return [sample_scene(job.seed + i, classes[i % len(classes)]) for i in range(job.lanes)]


def noisy_nominals(engine: Engine | SizedEngine, scenes: Sequence[Scene], seed: int) -> Nominals:
    """The reach nominal of each scene, K times, with the planner's noise.

    Args:
      engine: its physics counts, and how many places it gives a scene.
      scenes: of one program: as many places, and all standard or none.
      seed: of the noise.
    """
    planner = BatchPlanner(engine)
    k = planner.config.rollouts
    searches = [planner.begin_reach(start_world(s.positions), s.goal, s.shelf) for s in scenes]
    start, controls, gripper, shelf = jax.tree.map(
        lambda *xs: np.repeat(np.stack(xs), k, 0),
        *[(s.start, s.controls, s.gripper, s.shelf) for s in searches],
    )
    noise = np.random.default_rng(seed).standard_normal(controls.shape)
    noisy = controls + np.array(planner.config.sigma) * noise
    return Nominals(start, noisy.astype(np.float32), gripper, shelf)


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


def split_iteration(job: Job, repeats: int) -> dict[str, float]:
    """Time of the parts of a planner iteration of L robots, ms; medians of some iterations.

    `rollout` is the engine's part; `propose` draws the noise, `absorb` computes cost terms and the
    update, both jitted; `host` is the rest: collecting lanes into a batch and returning results.
    """
    engine, _ = _built(job)
    watch = _Stopwatch(engine)
    planner = BatchPlanner(watch)  # pyright: ignore[reportArgumentType]
    searches = [planner.begin_reach(start_world(s.positions), s.goal) for s in _scenes(job)]
    keys = np.random.default_rng(job.seed).integers(
        0, 2**32, (repeats + 1, engine.lanes, 2), dtype=np.uint32
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
    # The first call does not count: it compiles, and rolls out nominals.
    ms = {name: 1e3 * statistics.median(values[1:]) for name, values in parts.items()}
    ms["host"] = ms["total"] - ms["rollout"] - ms["propose"] - ms["absorb"]
    return {f"{name}_ms": value for name, value in ms.items()}
