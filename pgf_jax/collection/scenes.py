"""The scenes of a collection, computed: in this process, or in several that share them."""

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import polars as pl

from pgf_jax import cores
from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.collection.config import CollectConfig
from pgf_jax.collection.fork import fork
from pgf_jax.fleet import Fleet
from pgf_jax.fleet.policies import once_after
from pgf_jax.guidance.operators.registry import make_operator
from pgf_jax.parallel.processes import Say, Stopped, run_in_processes
from pgf_jax.scene.sampling import OBJECTS, sample_scene
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.loop import run_fleets
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.single_robot import single_robot
from pgf_jax.streams import stream
from pgf_jax.tables.forks import write_forks
from pgf_jax.tables.runs import Mode, runs_path, write_runs

PARTS = "parts"


def run_scenes(
    config: CollectConfig, todo: Sequence[int], about: Mapping[str, Any], ended: Callable[[], None]
) -> None:
    """Compute scenes by their numbers, and write parts as they end.

    Args:
      config: settings.
      todo: numbers of the scenes.
      about: provenance, for the parts.
      ended: called as each scene ends.
    """
    workers = config.workers or (len(cores.usable()) if config.engine == "planar" else 1)
    assert config.lanes is not None
    # A process that could not even fill its calls would only compile.
    workers = min(workers, -(-len(todo) // config.lanes))
    if workers == 1:
        _run((config, todo, about), lambda message: ended(), lambda: False)
    elif workers > 1:
        parts = [(config, todo[k::workers], about) for k in range(workers)]
        run_in_processes(_run, parts, lambda message: ended())


def scene_of(config: CollectConfig, index: int) -> Scene:
    """Scene number `index`: classes in turn, and a seed of its own."""
    return sample_scene(config.seed + index, config.classes[index % len(config.classes)])


def ask_at(config: CollectConfig, scene: Scene) -> int:
    """The reach iteration after which the input of a scene comes, drawn by (seed, scene)."""
    draw = stream(config.seed, "ask-at", zlib.crc32(scene.name.encode()))
    return int(draw.integers(config.ask_from, config.ask_to, endpoint=True))


def _run(
    part: tuple[CollectConfig, Sequence[int], Mapping[str, Any]],
    say: Say,
    stop: Callable[[], bool],
) -> None:
    config, todo, about = part
    store = _Store(config, about)

    def ended(index: int, frame: pl.DataFrame | None) -> None:
        store.add(index, frame)
        say(index)

    def go_on() -> None:
        if stop():
            raise Stopped

    try:
        (_forks if config.mode == "forks" else _runs)(config, todo, ended, go_on)
    finally:
        store.flush()


def _runs(config: CollectConfig, todo: Sequence[int], ended: Callable, go_on: Callable) -> None:
    planner_service = planner_service_of(config, OBJECTS)

    def fleets() -> Iterator[tuple[Fleet, PlannedRobots]]:
        for i in todo:
            scene = scene_of(config, i)
            human = config.mode == "human"
            yield single_robot(
                planner_service,
                scene,
                config.seed + i,
                operator=config.operator if human else "none",
                policy=once_after(ask_at(config, scene)) if human else "autonomous",
                task_limit_s=config.task_limit,
                service_s=(0.0, 0.0),
                on_end=lambda robot, i=i: ended(i, robot.log.frame()),
            )

    # No more under way than fit in a call, so that its lanes stay full to the end.
    run_fleets(fleets(), planner_service, at_once=config.lanes, on_round=go_on)


def _forks(config: CollectConfig, todo: Sequence[int], ended: Callable, go_on: Callable) -> None:
    planner_service = planner_service_of(config, OBJECTS)
    operator = make_operator(config.operator)
    queue = BatchScheduler(planner_service)
    waiting = iter(todo)
    under_way = 0

    def done(index: int, frame: pl.DataFrame | None) -> None:
        nonlocal under_way
        under_way -= 1
        ended(index, frame)

    while True:
        # Enough for the next call, whatever the ones under way will ask.
        while len(queue) < planner_service.engine.lanes and (i := next(waiting, None)) is not None:
            under_way += 1
            job = fork(
                planner_service.planner,
                scene_of(config, i),
                config.seed + i,
                operator,
                keys=config.keys,
                first=config.ask_from,
                last=config.ask_to,
            )
            queue.submit(job, lambda frame, i=i: done(i, frame))
        if not under_way:
            return
        queue.run_batch()
        go_on()


class _Store:
    """Finished scenes on their way to disk."""

    def __init__(self, config: CollectConfig, about: Mapping[str, Any]) -> None:
        self._folder = runs_path(config.out, Mode(config.mode)).parent / PARTS
        self._chunk, self._about = config.chunk, about
        self._write = write_forks if config.mode == "forks" else write_runs
        self._frames: list[pl.DataFrame] = []
        self._indices: list[int] = []

    def add(self, index: int, frame: pl.DataFrame | None) -> None:
        """Keep a scene, and write when there are enough."""
        self._indices.append(index)
        if frame is not None:
            self._frames.append(frame)
        if len(self._indices) >= self._chunk:
            self.flush()

    def flush(self) -> None:
        """Write what is kept as a new part, named after its first scene: no other holds that."""
        if self._frames:
            path = self._folder / f"part_{self._indices[0]:07d}.parquet"
            self._write(path, self._frames, {**self._about, "indices": self._indices})
            self._frames, self._indices = [], []
