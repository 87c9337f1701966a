"""`pgf-jax reproduce`: an iteration of a sweep, found among its results and computed again."""

from collections.abc import Iterator
from pathlib import Path

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.study import cells, results
from pgf_jax.study.folder import config_of, differences
from pgf_jax.study.reproduce import reproduce
from pgf_jax.study.reproduce_config import ReproduceConfig
from pgf_jax.study.reproduction import Reproduction
from pgf_jax.study.sweep_setup import identity, prepare

_INPUTS = ("scenes", "predictors", "log", "fleet", "planner", "physics", "engine", "lanes")


def find_and_reproduce(config: ReproduceConfig) -> Reproduction:
    """The iteration that `config` names, computed again.

    Raises:
      BadInput: the folder holds no such thing; or it does not come out again.
    """
    for file, content in _cells(config):
        where = _where(config, content)
        if where is not None:
            return _again(config, file, content, where)
    if config.iteration is None:
        raise BadInput(
            f"{config.folder}: every rollout that was asked about was finite; --policy, --robots, "
            "--robot, --task and --iteration name any other"
        )
    raise BadInput(
        f"{config.folder}: holds no fleet of {config.robots} robots under {config.policy}"
    )


def _cells(config: ReproduceConfig) -> Iterator[tuple[Path, cells.Content]]:
    """Fleets that are asked about."""
    if not (config.folder / cells.FOLDER).is_dir():
        raise BadInput(f"{config.folder}: holds no results of a sweep (no folder {cells.FOLDER})")
    for key in sorted(cells.finished(config.folder)):
        file = cells.path(config.folder, key)
        content = cells.read(file)
        settings = content.about.get("config")
        settings = settings if isinstance(settings, dict) else {}
        if config.policy is not None and settings.get("policies") != [config.policy]:
            continue
        if config.robots is not None and settings.get("robots") != [config.robots]:
            continue
        yield file, content


def _where(config: ReproduceConfig, content: cells.Content) -> tuple[int, int, int] | None:
    """Robot, task and iteration: those named, or the first that is not finite."""
    if config.iteration is not None:
        assert config.robot is not None and config.task is not None
        return config.robot, config.task, config.iteration
    lost = content.tasks.filter(pl.col("non_finite_at").list.len() > 0)
    for name in ("robot", "task"):
        if getattr(config, name) is not None:
            lost = lost.filter(pl.col(name) == getattr(config, name))
    if lost.is_empty():
        return None
    row = lost.row(0, named=True)
    return row["robot"], row["task"], row["non_finite_at"][0]


def _again(
    config: ReproduceConfig, file: Path, content: cells.Content, where: tuple[int, int, int]
) -> Reproduction:
    sweep = config_of(content, cells.inputs(file), config.folder)
    setup = prepare(sweep)
    (cell,) = sweep.cells()
    old, new = content.about["identity"], identity(setup, cell)
    words = differences(*({name: each.get(name) for name in _INPUTS} for each in (old, new)))
    if words:
        raise BadInput(f"{file}: its inputs are not what they were ({words})")
    robot, task, iteration = where
    events = results.event_log(content.events)
    return reproduce(setup, cell, events, robot=robot, task=task, iteration=iteration)


def run(config: ReproduceConfig) -> None:
    """The command."""
    found = find_and_reproduce(config)
    if config.out is not None:
        found.save(config.out)
    print(found.text())
    if config.out is not None:
        print(f"arrays in {config.out}")
