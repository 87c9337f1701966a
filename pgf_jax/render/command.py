"""The command `render`: draws a plan or a recorded session as a picture or a film."""

import math
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.fleet.records import State
from pgf_jax.render import fleet_view, movie
from pgf_jax.render.config import RenderConfig
from pgf_jax.render.view import ShelfView, make_view
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot

_LOOK_NS = 250_000_000  # simulated time between snapshots in the search for the first service

Size = tuple[int, int]
Draw = Callable[[Size, ShelfView], np.ndarray]  # draws one picture, [H, W, 3] uint8


def render(config: RenderConfig) -> str:
    """Draw a picture or a film and write its file; returns a line that describes the file.

    Raises:
      BadInput: the plan or the recording cannot be read or does not hold what is asked for, the
        view cannot be drawn, or the file cannot be written.
    """
    if not config.file.exists():
        what = {"plan": "a plan (NAME.plan.json)", "sweep": "a sweep's folder"}.get(
            config.what, "a recorded session or a sweep's folder"
        )
        raise BadInput(f"{config.file}: no such file, expected {what}")
    if config.what == "sweep":
        return _sweep_figure(config)
    if config.is_film:
        movie.check_films()
    with closing(make_view(config.view)) as view:
        if not config.is_film:
            movie.write_picture(config.out, _picture(config)(config.size, view))
            return f"{config.out}: {config.size[0]} x {config.size[1]} pixels"
        draws, total = _film(config)
        size = movie.even(config.size)
        frames = (draw(size, view) for draw in draws)
        count = movie.write_film(config.out, frames, config.fps, total=total)
    return (
        f"{config.out}: {count} frames of {size[0]} x {size[1]} pixels, "
        f"{count / config.fps:.1f} s of film"
    )


def _sweep_figure(config: RenderConfig) -> str:
    """Draw the figure of a sweep once more, under a name of one's choice."""
    from pgf_jax.files import read_json, write_figure
    from pgf_jax.sweeping.cell_store import MANIFEST
    from pgf_jax.sweeping.figure6 import figure6
    from pgf_jax.sweeping.load import summaries_of

    summaries = summaries_of(config.file)
    manifest = read_json(config.file / MANIFEST)
    about = {name: manifest.get(name) for name in ("config", "versions", "code", "processor")}
    write_figure(config.out, figure6(summaries), about)
    return f"{config.out}: {len(summaries)} fleets"


def _picture(config: RenderConfig) -> Draw:
    """The function that draws the picture."""
    if config.what == "plan":
        motion = _motion(config)
        time_s = motion.duration_s if config.at is None else config.at
        if time_s > motion.duration_s:
            raise BadInput(
                f"{config.file}: ends after {motion.duration_s:.3f} s, expected --at within it, "
                f"got {time_s:g}"
            )
        return _draw_plan(motion.at(time_s))
    if config.at is not None:
        at_ns = _ns(config.at)
        fleet = next(iter(_recorded(config, every_ns=_LOOK_NS, start_ns=at_ns)), None)
        if fleet is None:
            raise BadInput(f"{config.file}: ends before --at {config.at:g} s")
        if fleet.ended_ns is not None and fleet.ended_ns < at_ns:
            raise BadInput(
                f"{config.file}: ends after {fleet.ended_ns / 1e9:.3f} s, expected --at within it, "
                f"got {config.at:g}"
            )
        if config.what == "fleet":
            return _draw_fleet(fleet)
        robot = _robot(fleet, config)
        if not _on_task(robot, config):
            raise BadInput(
                f"{config.file}: robot {config.robot} is not at its task {config.task} at "
                f"{config.at:g} s, but at {robot.task} ({robot.state})"
            )
        return _draw_robot(robot, fleet.tasks)
    return _first_served(config)


def _first_served(config: RenderConfig) -> Draw:
    """The function that draws the first moment of a service, or the last moment if none occurs."""
    draw: Draw | None = None
    if config.what == "fleet":
        for fleet in _recorded(config, every_ns=_LOOK_NS):
            draw = _draw_fleet(fleet)
            if fleet.serving is not None:
                break
    else:
        for robot, tasks in _task(config, every_ns=_LOOK_NS):
            draw = _draw_robot(robot, tasks)
            if robot.state is State.SERVED:
                break
    if draw is None:
        raise BadInput(f"{config.file}: holds nothing to draw")
    return draw


def _film(config: RenderConfig) -> tuple[Iterator[Draw], int | None]:
    """The functions that draw the frames, and the number of frames if it is known."""
    step_s = config.speed / config.fps
    if config.what == "plan":
        motion = _motion(config)
        times = (step_s, config.start, config.stop)
        frames = map(_draw_plan, motion.film(*times))
        return frames, motion.frames(*times)
    span = {"every_ns": max(_ns(step_s), 1), "start_ns": _ns(config.start)}
    stop_ns = None if config.stop is None else _ns(config.stop)
    if config.what == "task":
        return (
            _draw_robot(robot, tasks) for robot, tasks in _task(config, **span, stop_ns=stop_ns)
        ), None
    total = None
    if config.stop is not None:
        total = math.floor((config.stop - config.start) / step_s + 1e-9) + 1
    return (_draw_fleet(fleet) for fleet in _recorded(config, **span, stop_ns=stop_ns)), total


def _draw_fleet(fleet: FleetSnapshot) -> Draw:
    return lambda size, view: fleet_view.draw(fleet, size, view)


def _draw_robot(robot: RobotSnapshot, tasks: int) -> Draw:
    return lambda size, view: fleet_view.draw_one(robot, size, view, tasks=tasks)


def _draw_plan(robot: RobotSnapshot) -> Draw:
    """The robot of a plan has no number, so the picture has the name of the scene."""
    return lambda size, view: fleet_view.draw_one(robot, size, view, name=robot.scene)


def _motion(config: RenderConfig):
    from pgf_jax.plans.config import ExecuteConfig
    from pgf_jax.plans.file import load_plan

    executed = None
    if config.world is not None or config.world_error:
        executed = ExecuteConfig(config.world, config.world_error, scenes=config.scenes)
    return load_plan(config.file).motion(executed, config.repeat)


def _recorded(
    config: RenderConfig, *, every_ns: int, start_ns: int = 0, stop_ns: int | None = None
) -> Iterator[FleetSnapshot]:
    from pgf_jax.sweeping import stored_fleet

    choice = stored_fleet.CellChoice(config.policy, config.robots, config.seed)
    return stored_fleet.snapshots(
        config.file, every_ns=every_ns, start_ns=start_ns, stop_ns=stop_ns, choice=choice
    )


def _task(
    config: RenderConfig, *, every_ns: int, start_ns: int = 0, stop_ns: int | None = None
) -> Iterator[tuple[RobotSnapshot, int]]:
    """Snapshots of one task of one robot, each with the number of tasks of a robot."""
    began = False
    fleets = _recorded(config, every_ns=every_ns, start_ns=start_ns, stop_ns=stop_ns)
    for fleet in fleets:
        robot = _robot(fleet, config)
        if config.task >= fleet.tasks:
            raise BadInput(
                f"{config.file}: expected --task within 0..{fleet.tasks - 1}, got {config.task}"
            )
        if _on_task(robot, config):
            began = True
            yield robot, fleet.tasks
        elif began or robot.task > config.task:
            break
    if not began:
        raise BadInput(
            f"{config.file}: robot {config.robot} is not at its task {config.task} in that time"
        )


def _robot(fleet: FleetSnapshot, config: RenderConfig) -> RobotSnapshot:
    if config.robot >= len(fleet.robots):
        raise BadInput(
            f"{config.file}: expected --robot within 0..{len(fleet.robots) - 1}, got {config.robot}"
        )
    return fleet.robots[config.robot]


def _on_task(robot: RobotSnapshot, config: RenderConfig) -> bool:
    """Whether the robot is at the task that is asked for; it is at none once all are done."""
    return robot.task == config.task and robot.state is not State.IDLE


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
