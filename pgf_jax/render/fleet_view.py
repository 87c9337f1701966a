"""The warehouse's wall: all robots' shelves at an instant, the one that is served large."""

import math

import numpy as np

from pgf_jax.fleet.records import State
from pgf_jax.planning.types import Status
from pgf_jax.render import panel
from pgf_jax.render.paint import BACKGROUND, CARD, INK, MUTED, Box, Canvas, text_width
from pgf_jax.render.view import ASPECT, View
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot
from pgf_jax.terminal import clock

_GAP = 6
_FOCUS = 0.40  # share of the width for the robot that is served
_WAITING = (State.IN_WINDOW, State.IN_LINE)


def draw(fleet: FleetSnapshot, size: tuple[int, int], view: View) -> np.ndarray:
    """Draw a fleet.

    A header, every robot's cell, and beside them the robot that is served; while nobody is, those
    that wait. Cells keep their places as long as an operator is there. A single robot fills it all.

    Args:
      fleet: what.
      size: width and height, pixels.
      view: draws the shelves.

    Returns:
      [height, width, 3] uint8.
    """
    width, height = size
    canvas = Canvas(width, height, BACKGROUND)
    header = min(max(0.055 * height, 26.0), 52.0)
    _draw_header(canvas, header, fleet)
    body = (_GAP, header + _GAP, width - _GAP, height - _GAP)
    if len(fleet.robots) == 1:
        panel.draw(canvas, body, fleet.robots[0], fleet.tasks, view)
        return canvas.finish()
    right = body[2]
    if fleet.attended or fleet.serving is not None:
        right -= _FOCUS * width
        beside = (right + _GAP, body[1], body[2], body[3])
        if fleet.serving is None:
            _draw_waiting(canvas, beside, fleet)
        else:
            panel.draw(canvas, beside, fleet.robots[fleet.serving], fleet.tasks, view)
    grid = (body[0], body[1], right, body[3])
    cells = layout(len(fleet.robots), grid)
    for robot, cell in zip(fleet.robots, cells, strict=True):
        panel.draw_cell(canvas, cell, robot, fleet.tasks, view)
    return canvas.finish()


def draw_one(
    robot: RobotSnapshot,
    size: tuple[int, int],
    view: View,
    *,
    name: str | None = None,
    tasks: int = 1,
) -> np.ndarray:
    """Draw one robot alone, [height, width, 3] uint8; `name` and `tasks` as in `panel.draw`."""
    width, height = size
    canvas = Canvas(width, height, BACKGROUND)
    box = (_GAP, _GAP, width - _GAP, height - _GAP)
    panel.draw(canvas, box, robot, tasks, view, name=name)
    return canvas.finish()


def layout(count: int, box: Box) -> list[Box]:
    """Cells for so many robots, row by row: the grid whose shelves come out largest."""
    left, top, right, bottom = box

    def shelf_width(columns: int) -> float:
        width = (right - left) / columns - _GAP
        height = (bottom - top) / math.ceil(count / columns) - _GAP
        room = height - panel.title_height(height) - panel.strip_height(width, height)
        return min(width, room * ASPECT)

    columns = max(range(1, count + 1), key=shelf_width)
    rows = math.ceil(count / columns)
    wide = (right - left - (columns - 1) * _GAP) / columns
    tall = (bottom - top - (rows - 1) * _GAP) / rows
    cells = []
    for i in range(count):
        row, column = divmod(i, columns)
        x, y = left + column * (wide + _GAP), top + row * (tall + _GAP)
        cells.append((x, y, x + wide, y + tall))
    return cells


def _draw_header(canvas: Canvas, height: float, fleet: FleetSnapshot) -> None:
    canvas.rectangle((0, 0, canvas.width, height), INK)
    middle, size = height / 2, 0.42 * height
    x = 14.0
    time = clock(fleet.time_ns // 1_000_000_000)
    canvas.text((x, middle), time, 0.55 * height, CARD, bold=True)
    x += text_width(time, 0.55 * height, bold=True) + size
    words, color = _operator(fleet)
    chip = text_width(words, size, bold=True) + 1.4 * size
    from_right = canvas.width - 12 - chip
    top, bottom = 0.14 * height, 0.86 * height
    canvas.rectangle((from_right, top, from_right + chip, bottom), color, radius=0.3 * height)
    canvas.text((from_right + chip / 2, middle), words, size, CARD, anchor="mm", bold=True)
    ended = [status for robot in fleet.robots for status in robot.done]
    robots = len(fleet.robots)
    text = (
        f"policy {fleet.policy}   {robots} robot{'s' * (robots != 1)}   "
        f"{len(ended)} of {robots * fleet.tasks} tasks done, "
        f"{sum(status is Status.SOLVED for status in ended)} solved"
    )
    canvas.text((x, middle), text, size, "#d5dde7", room=from_right - x - size)


def _operator(fleet: FleetSnapshot) -> tuple[str, str]:
    """What the operator does, and the colour of it."""
    if fleet.serving is not None:
        return f"operator serves robot {fleet.serving}", panel.SERVED
    if fleet.window_open:
        return "window open for bids", panel.WAITING
    return ("operator free", panel.PLANNING) if fleet.attended else ("no operator", panel.DONE)


def _draw_waiting(canvas: Canvas, box: Box, fleet: FleetSnapshot) -> None:
    """Who waits, the highest bid first, and what the others do."""
    left, top, right, bottom = box
    words, color = _operator(fleet)
    canvas.rectangle(box, CARD, radius=6, outline=color, width=3)
    size = min(max((right - left) / 24, 13.0), 22.0)
    step, x = 1.7 * size, left + size
    y = top + 1.5 * size
    canvas.text((x, y), words, 1.25 * size, color, bold=True)
    y += 2 * size
    counts: dict[tuple[str, str], int] = {}
    for robot in fleet.robots:
        key = ("waiting", panel.WAITING) if robot.state in _WAITING else panel.state_words(robot)
        counts[key] = counts.get(key, 0) + 1
    most = max(counts.values())
    tab = x + text_width("planning push  ", size)
    for (state, ink), count in sorted(counts.items(), key=lambda item: -item[1]):
        canvas.text((x, y), state, size, INK)
        length = max((right - size - tab - 2.4 * size) * count / most, 3.0)
        canvas.rectangle((tab, y - 0.45 * size, tab + length, y + 0.45 * size), ink, radius=3)
        canvas.text((tab + length + 0.5 * size, y), str(count), size, INK, bold=True)
        y += step
    waiting = [robot for robot in fleet.robots if robot.state in _WAITING]
    if not waiting:
        return
    y += 0.6 * size
    for offset, heading in enumerate(("waits for input", "bid", "since")):
        at = (x + offset * 0.37 * (right - x), y)
        canvas.text(at, heading, 0.85 * size, MUTED)
    y += step
    for robot in sorted(waiting, key=lambda r: -(r.bid if r.bid is not None else -math.inf)):
        if y > bottom - size:
            break
        row = (f"robot {robot.robot}", panel.bid_words(robot.bid), f"{robot.waited_s:.1f} s")
        for offset, value in enumerate(row):
            at = (x + offset * 0.37 * (right - x), y)
            canvas.text(at, value, size, INK, bold=offset == 0)
        y += step
