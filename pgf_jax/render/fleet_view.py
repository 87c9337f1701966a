"""Draws all robots of a fleet at one instant; the robot that is served is drawn large as well."""

import math

import numpy as np

from pgf_jax.render import robot_view
from pgf_jax.render.paint import (
    BACKGROUND,
    CARD,
    INK,
    MUTED,
    SHELF_ASPECT,
    Box,
    Canvas,
    text_width,
)
from pgf_jax.render.view import ShelfView
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot
from pgf_jax.terminal import clock

_GAP = 6
_FOCUS = 0.40  # share of the width for the robot that is served


def draw(fleet: FleetSnapshot, size: tuple[int, int], view: ShelfView) -> np.ndarray:
    """Draw a fleet.

    The picture has a header, a cell for each robot, and beside the cells the robot that is served,
    or a list of those that wait. While an operator is present the cells keep their places. A single
    robot fills the picture.

    Args:
      fleet: to draw.
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
        robot_view.draw_large(canvas, body, fleet.robots[0], fleet.tasks, view)
        return canvas.finish()
    right = body[2]
    if fleet.attended or fleet.serving is not None:
        right -= _FOCUS * width
        beside = (right + _GAP, body[1], body[2], body[3])
        if fleet.serving is None:
            _draw_waiting(canvas, beside, fleet)
        else:
            robot_view.draw_large(canvas, beside, fleet.robots[fleet.serving], fleet.tasks, view)
    grid = (body[0], body[1], right, body[3])
    cells = layout(len(fleet.robots), grid)
    for robot, cell in zip(fleet.robots, cells, strict=True):
        robot_view.draw_small(canvas, cell, robot, fleet.tasks, view)
    return canvas.finish()


def draw_one(
    robot: RobotSnapshot,
    size: tuple[int, int],
    view: ShelfView,
    *,
    name: str | None = None,
    tasks: int = 1,
) -> np.ndarray:
    """Draw one robot alone: [height, width, 3] uint8; for the arguments see `draw_large`."""
    width, height = size
    canvas = Canvas(width, height, BACKGROUND)
    box = (_GAP, _GAP, width - _GAP, height - _GAP)
    robot_view.draw_large(canvas, box, robot, tasks, view, name=name)
    return canvas.finish()


def layout(count: int, box: Box) -> list[Box]:
    """Boxes of the cells of `count` robots, row by row, in the grid with the largest shelves."""
    left, top, right, bottom = box

    def shelf_width(columns: int) -> float:
        width = (right - left) / columns - _GAP
        height = (bottom - top) / math.ceil(count / columns) - _GAP
        room = height - robot_view.title_height(height) - robot_view.strip_height(width, height)
        return min(width, room * SHELF_ASPECT)

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
    operator, color = _operator(fleet)
    chip = text_width(operator, size, bold=True) + 1.4 * size
    from_right = canvas.width - 12 - chip
    top, bottom = 0.14 * height, 0.86 * height
    canvas.rectangle((from_right, top, from_right + chip, bottom), color, radius=0.3 * height)
    canvas.text((from_right + chip / 2, middle), operator, size, CARD, anchor="mm", bold=True)
    robots = len(fleet.robots)
    text = f"policy {fleet.policy}   {robots} robot{'s' * (robots != 1)}   {fleet.progress}"
    canvas.text((x, middle), text, size, "#d5dde7", room=from_right - x - size)


def _operator(fleet: FleetSnapshot) -> tuple[str, str]:
    """What the operator does, as text, and the colour of that."""
    if fleet.serving is not None:
        return f"operator serves robot {fleet.serving}", robot_view.SERVED
    if fleet.window_open:
        return "window open for bids", robot_view.WAITING
    if fleet.attended:
        return "operator free", robot_view.PLANNING
    return "no operator", robot_view.DONE


def _draw_waiting(canvas: Canvas, box: Box, fleet: FleetSnapshot) -> None:
    """Count the robots by state, and list those that wait, the highest bid first."""
    left, top, right, bottom = box
    operator, color = _operator(fleet)
    canvas.rectangle(box, CARD, radius=6, outline=color, width=3)
    size = min(max((right - left) / 24, 13.0), 22.0)
    step, x = 1.7 * size, left + size
    y = top + 1.5 * size
    canvas.text((x, y), operator, 1.25 * size, color, bold=True)
    y += 2 * size
    counts: dict[tuple[str, str], int] = {}
    for robot in fleet.robots:
        name = "waiting" if robot.is_waiting else robot.activity
        key = (name, robot_view.state_color(robot))
        counts[key] = counts.get(key, 0) + 1
    most = max(counts.values())
    tab = x + text_width("planning push  ", size)
    for (state, ink), count in sorted(counts.items(), key=lambda item: -item[1]):
        canvas.text((x, y), state, size, INK)
        length = max((right - size - tab - 2.4 * size) * count / most, 3.0)
        canvas.rectangle((tab, y - 0.45 * size, tab + length, y + 0.45 * size), ink, radius=3)
        canvas.text((tab + length + 0.5 * size, y), str(count), size, INK, bold=True)
        y += step
    waiting = [robot for robot in fleet.robots if robot.is_waiting]
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
        row = (f"robot {robot.robot}", robot_view.bid_text(robot), f"{robot.waited_s:.1f} s")
        for offset, value in enumerate(row):
            at = (x + offset * 0.37 * (right - x), y)
            canvas.text(at, value, size, INK, bold=offset == 0)
        y += step
