"""Computes the scenes of a collection, in this process or in several that share them."""

import zlib
from collections.abc import Callable, Iterator, Sequence

import polars as pl

from pgf_jax.batching.planner_service import planner_service_of
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.collection.config import CollectConfig
from pgf_jax.collection.dataset import Dataset
from pgf_jax.collection.fork import fork
from pgf_jax.errors import WorkersLost
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.policies import once_after
from pgf_jax.guidance.operators.registry import OPERATORS, make_operator
from pgf_jax.jax_setup import configure_early
from pgf_jax.parallel.local import LocalPool, Stopped, WorkerDied, report, stop_requested
from pgf_jax.physics.engine import ENGINES, default_processes
from pgf_jax.plugins.registry import check_importable
from pgf_jax.scene.sampling import sample_scene
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.simulation.single_robot import single_robot
from pgf_jax.simulation.task_worlds import WorldSpec
from pgf_jax.streams import stream

_STORE_S = 60.0  # for a worker to store what it has after the death of its parent

Ended = tuple[int, pl.DataFrame | None]  # number of a scene; its run or forks, None: it gave none


def run_scenes(dataset: Dataset, on_end: Callable[[], None]) -> None:
    """Compute the missing scenes of a data set, and append them as they end.

    Args:
      dataset: of the scenes.
      on_end: called as each scene ends.

    Raises:
      WorkersLost: a worker process died; the scenes that had been written are kept.
    """
    parts = partition(dataset)
    if len(parts) == 1:
        _run_part((dataset, parts[0]), lambda index: on_end())
    elif parts:
        config = dataset.config
        used = ENGINES.plugin(config.engine), OPERATORS.plugin(config.operator)
        plugins = [plugin for plugin in used if plugin is not None]
        for plugin in plugins:
            check_importable(plugin, "here")
        with LocalPool(len(parts), grace_s=_STORE_S) as pool:
            try:
                pool.run(
                    _run_part,
                    [(dataset, part) for part in parts],
                    lambda index: on_end(),
                    plugins=plugins,
                )
            except WorkerDied as error:
                raise WorkersLost(
                    f"{error}; the runs that had been written are kept, and --resume goes on from "
                    "them"
                ) from None


def partition(dataset: Dataset) -> list[tuple[int, ...]]:
    """Partition the missing scenes between worker processes: one part for each."""
    config, missing = dataset.config, dataset.missing
    workers = config.workers or default_processes(config.engine)
    assert config.lanes is not None
    # A process that could not even fill its calls would only compile.
    workers = min(workers, -(-len(missing) // config.lanes))
    return [missing[k::workers] for k in range(workers)]


def scene_of(config: CollectConfig, index: int) -> Scene:
    """The scene number `index`: classes in turn, and a seed of its own."""
    return sample_scene(config.seed + index, config.classes[index % len(config.classes)])


def ask_at(config: CollectConfig, scene: Scene) -> int:
    """The reach iteration after which the input of a scene comes, drawn by (seed, scene)."""
    draw = stream(config.seed, "ask-at", zlib.crc32(scene.name.encode()))
    return int(draw.integers(config.ask_from, config.ask_to, endpoint=True))


def _run_part(part: tuple[Dataset, Sequence[int]], on_end: Callable[[int], None] = report) -> None:
    """Compute some scenes in this process, and append them in chunks."""
    dataset, numbers = part
    configure_early(dataset.config.engine)
    indices: list[int] = []
    frames: list[pl.DataFrame] = []

    def flush() -> None:
        if frames:
            dataset.append(list(indices), list(frames))
            indices.clear()
            frames.clear()

    compute = _forks if dataset.config.forks else _runs
    try:
        for index, frame in compute(dataset.config, numbers):
            indices.append(index)
            if frame is not None:
                frames.append(frame)
            if len(indices) >= dataset.config.chunk:
                flush()
            on_end(index)
    finally:
        flush()


def _check_stop() -> None:
    if stop_requested():
        raise Stopped


def _runs(config: CollectConfig, numbers: Sequence[int]) -> Iterator[Ended]:
    planner_service = planner_service_of(config)
    world = WorldSpec.of(config.world, None)

    def fleets() -> Iterator[PlannedFleet]:
        for i in numbers:
            scene = scene_of(config, i)
            human = config.mode == "human"
            fleet = FleetConfig(
                tasks=1,
                policy=once_after(ask_at(config, scene)) if human else "autonomous",
                service_mean_s=0.0,
                service_sd_s=0.0,
                rollouts=config.rollouts,
                task_limit_s=config.task_limit,
                seed=config.seed + i,
            )
            operator = config.operator if human else "none"
            yield single_robot(
                planner_service, scene, fleet, operator=operator, world=world, label=i
            )

    # No more at a time than fit in a call, so that its lanes stay full to the end.
    done = run_fleets(fleets(), planner_service, at_once=config.lanes, on_batch=_check_stop)
    for _, robots, index in done:
        yield index, robots.robots[0].log.frame()


def _forks(config: CollectConfig, numbers: Sequence[int]) -> Iterator[Ended]:
    planner_service = planner_service_of(config)
    operator = make_operator(config.operator)
    scheduler = BatchScheduler(planner_service)
    world = WorldSpec.of(config.world, None)
    lanes = planner_service.engine.lanes
    waiting = iter(numbers)
    running = 0
    ended: list[Ended] = []
    while True:
        # Enough for the next call, whatever those that are running will request.
        while len(scheduler) < lanes and (i := next(waiting, None)) is not None:
            running += 1
            coroutine = fork(
                planner_service.planner,
                scene_of(config, i),
                config.seed + i,
                operator,
                keys=config.keys,
                states=config.states,
                first=config.ask_from,
                last=config.ask_to,
                world=world,
                limit_s=config.task_limit if config.mode == "futures" else None,
            )
            scheduler.submit(coroutine, lambda frame, i=i: ended.append((i, frame)))
        running -= len(ended)
        yield from ended
        ended.clear()
        if not running:
            return
        scheduler.run_batch()
        _check_stop()
