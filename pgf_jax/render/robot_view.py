"""Draws one robot: small, as a cell of the fleet's picture, or large with all that is known."""

import math

from pgf_jax.fleet.records import State
from pgf_jax.planning.config import Cost
from pgf_jax.planning.types import Status
from pgf_jax.render.chart import (
    BID,
    BID_SIGN,
    CURVE,
    FEASIBLE,
    GRANT,
    GRANT_SIGN,
    INPUT,
    INPUT_SIGN,
    draw_costs,
)
from pgf_jax.render.paint import (
    CARD,
    INK,
    MUTED,
    RULE,
    SHELF_ASPECT,
    Box,
    Canvas,
    Point,
    text_width,
)
from pgf_jax.render.view import ShelfView
from pgf_jax.simulation.snapshot import STUCK, RobotSnapshot, short_number

PLANNING, PUSH, WAITING = "#3b6fb6", "#7a55b5", "#b97a00"
SERVED, EXECUTING, DONE = INPUT, "#16808c", "#8a939f"
_STRIP_FROM_PX = 118  # smallest height of a cell with a strip for its cost curve
_COLORS = {
    State.IDLE: DONE,
    State.PLANNING: PLANNING,
    State.IN_WINDOW: WAITING,
    State.IN_LINE: WAITING,
    State.SERVED: SERVED,
    State.EXECUTING: EXECUTING,
}


def state_text(robot: RobotSnapshot) -> str:
    """The activity of a robot, and its bid while it waits."""
    if not robot.is_waiting:
        return robot.activity
    if robot.bid_text == STUCK:
        return f"{robot.activity}, {STUCK}"
    return f"{robot.activity} {bid_text(robot)}" if robot.bid_text else "waiting"


def state_color(robot: RobotSnapshot) -> str:
    """The colour of a robot's state."""
    planning_push = robot.state is State.PLANNING and robot.push is not None
    return PUSH if planning_push else _COLORS[robot.state]


def bid_text(robot: RobotSnapshot) -> str:
    """The bid as text, a predicted gain as `G`; empty where there is none."""
    return robot.bid_text if robot.bid_text in ("", STUCK) else f"G {robot.bid_text}"


def strip_height(width: float, height: float) -> float:
    """Height of the lower strip of a cell, pixels; 0 if there is no room for a strip."""
    if height < _STRIP_FROM_PX:
        return 0.0
    spare = height - title_height(height) - width / SHELF_ASPECT
    return max(min(max(0.21 * height, 30.0), 64.0), min(spare, 0.4 * height))


def title_height(height: float) -> float:
    """Height of the title of a cell, pixels."""
    return min(max(0.12 * height, 15.0), 26.0)


def draw_small(canvas: Canvas, box: Box, robot: RobotSnapshot, tasks: int, view: ShelfView) -> None:
    """Draw a robot small: number, state and shelf, and if there is room cost curve and gain.

    Args:
      canvas: to draw on.
      box: place on the canvas, pixels.
      robot: to draw.
      tasks: of each robot.
      view: draws the shelf.
    """
    left, top, right, bottom = box
    height = bottom - top
    color = state_color(robot)
    title, strip = title_height(height), strip_height(right - left, height)
    served = robot.state is State.SERVED
    canvas.rectangle(box, CARD, radius=4, outline=color, width=2.6 if served else 1.2)
    canvas.rectangle((left, top, right, top + title), color, radius=4)
    canvas.rectangle((left, top + title / 2, right, top + title), color)
    middle, size = top + title / 2, 0.62 * title
    number = str(robot.robot)
    canvas.text((left + 0.4 * title, middle), number, 0.74 * title, CARD, bold=True)
    from_left = left + 0.8 * title + text_width(number, 0.74 * title, bold=True)
    canvas.text((from_left, middle), state_text(robot), size, CARD, room=right - from_left - 4)
    _draw_shelf(canvas, (left + 3, top + title + 1, right - 3, bottom - strip - 3), robot, view)
    below = (right - 7, bottom - strip - 4 - 0.35 * title)
    _draw_tasks(canvas, below, 0.55 * title, robot, tasks, INK)
    if strip:
        _draw_strip(canvas, (left + 5, bottom - strip, right - 5, bottom - 5), robot)


def draw_large(
    canvas: Canvas,
    box: Box,
    robot: RobotSnapshot,
    tasks: int,
    view: ShelfView,
    *,
    name: str | None = None,
) -> None:
    """Draw a robot large: shelf, cost curve with axes, gain, bid and how its tasks ended.

    Args:
      canvas: to draw on.
      box: place on the canvas, pixels; the curve is beside the shelf if the box is wide, else
        below.
      robot: to draw.
      tasks: of each robot.
      view: draws the shelf.
      name: of the robot; by default its number.
    """
    left, top, right, bottom = box
    state, color = state_text(robot), state_color(robot)
    if tasks == 1 and robot.done:
        state += f": {robot.done[0].replace('_', ' ')}"
    canvas.rectangle(box, CARD, radius=6, outline=color, width=3)
    title = min(max(0.055 * (bottom - top), 28.0), 44.0)
    canvas.rectangle((left, top, right, top + title), color, radius=6)
    canvas.rectangle((left, top + title / 2, right, top + title), color)
    middle, pad = top + title / 2, 0.4 * title
    name = f"robot {robot.robot}" if name is None else name
    canvas.text((left + pad, middle), name, 0.55 * title, CARD, bold=True)
    from_left = left + 2 * pad + text_width(name, 0.55 * title, bold=True)
    signs = _draw_tasks(canvas, (right - pad, middle), 0.5 * title, robot, tasks, CARD)
    canvas.text((from_left, middle), state, 0.5 * title, CARD, room=signs - from_left - 4)

    inner = (left + 10, top + title + 10, right - 10, bottom - 12)
    width, height = inner[2] - inner[0], inner[3] - inner[1]
    if width / height > 1.25:
        split = inner[0] + min(height * SHELF_ASPECT, 0.68 * width)
        _draw_shelf(canvas, (inner[0], inner[1], split, inner[3]), robot, view)
        facts = (split + 16, inner[1], inner[2] - 4, inner[3])
    else:
        split = inner[1] + min(width / SHELF_ASPECT, 0.66 * height)
        _draw_shelf(canvas, (inner[0], inner[1], inner[2], split), robot, view)
        facts = (inner[0] + 2, split + 10, inner[2] - 4, inner[3])
    _draw_facts(canvas, facts, robot, tasks)


def _draw_facts(canvas: Canvas, box: Box, robot: RobotSnapshot, tasks: int) -> None:
    """Write what is known of the robot, one fact a line, and draw the cost curve below."""
    left, top, right, bottom = box
    size = min(max((right - left) / 24, 11.0), 17.0)
    scene = f"{robot.scene}, task {robot.task + 1} of {tasks}" if tasks > 1 else robot.scene
    lines = [("shelf", scene, INK)]
    if robot.push is not None:
        push = robot.push
        where = f"{push.object + 1} to ({push.x:.2f}, {push.y:.2f}) m"
        lines.append(("push", where, INK))
    cost = robot.costs[-1] if robot.costs else math.nan
    lines.append(("cost", _number(cost), FEASIBLE if cost < Cost().feasible_cost else INK))
    gain, bid = _signed(robot.gain), bid_text(robot)
    lines.append(("predicted gain", gain + (f", bids {bid}" if bid else ""), INK))
    if robot.news:
        lines.append(("now", robot.news, INPUT))
    inputs = len(robot.inputs_at)
    lines.append(("inputs", f"{inputs}" + (", stuck" if robot.stuck else ""), INK))
    lines.append(("in this state", f"{robot.waited_s:.1f} s", INK))
    tab = left + text_width("predicted gain ", size) + 4
    y = top + 0.8 * size
    for label, value, ink in lines:
        canvas.text((left, y), label, size, MUTED)
        canvas.text((tab, y), value, size, ink, bold=label == "cost", room=right - tab)
        y += 1.45 * size
    y += 0.3 * size
    if bottom - y < 5 * size:
        return
    canvas.text((left, y), "cost after each reach iteration", 0.85 * size, MUTED)
    if robot.bids_at or robot.grants_at or robot.inputs_at:
        y += 1.2 * size
        at = left
        for sign, word, ink in (
            (BID_SIGN, "bid", BID),
            (GRANT_SIGN, "grant", GRANT),
            (INPUT_SIGN, "input", INPUT),
        ):
            canvas.text((at, y), f"{sign} {word}", 0.85 * size, ink)
            at += text_width(f"{sign} {word}   ", 0.85 * size)
    y += size
    # A taller curve would show no more.
    chart = (left, y, right, min(bottom, y + 1.1 * (right - left)))
    draw_costs(
        canvas,
        chart,
        robot.costs,
        robot.inputs_at,
        bids_at=robot.bids_at,
        grants_at=robot.grants_at,
        size=max(0.75 * size, 9.0),
    )


def _draw_strip(canvas: Canvas, box: Box, robot: RobotSnapshot) -> None:
    left, top, right, bottom = box
    size = min(max((bottom - top) / 3.4, 9.0), 13.0)
    split = right - max(text_width("gain -000", size), 0.30 * (right - left))
    draw_costs(canvas, (left, top, split - 5, bottom), robot.costs, robot.inputs_at)
    lines = []
    if robot.costs:
        lines.append((f"cost {_number(robot.costs[-1])}", CURVE))
    if math.isfinite(robot.gain):
        lines.append((f"gain {_signed(robot.gain)}", INK))
    if robot.stuck:
        lines.append(("stuck", INPUT))
    step = min(1.25 * size, (bottom - top) / 2 if len(lines) < 3 else (bottom - top) / 3)
    for i, (text, ink) in enumerate(lines):
        at = (split, top + step * (i + 0.5))
        canvas.text(at, text, size if len(lines) < 3 else min(size, step), ink, room=right - split)


def _draw_shelf(canvas: Canvas, box: Box, robot: RobotSnapshot, view: ShelfView) -> None:
    left, top, right, bottom = (round(v) for v in box)
    if right - left >= 16 and bottom - top >= 16:
        canvas.paste(left, top, view.shelf(robot, right - left, bottom - top))
        canvas.rectangle((left - 1, top - 1, right + 1, bottom + 1), None, outline=RULE)


def _draw_tasks(
    canvas: Canvas, at: Point, size: float, robot: RobotSnapshot, tasks: int, ink: str
) -> float:
    """Write a sign for each task, or a count if they are many; returns the left end, pixels.

    The signs end at `at`. They are text, because shapes would lie under the shelf's picture.
    """
    if tasks > 8:
        signs = [(f"{len(robot.done)} of {tasks}", ink)]
    else:
        done = [status is Status.SOLVED for status in robot.done][:tasks]
        signs = [("✔" if solved else "✘", ink) for solved in done]
        signs += [("○", ink)] * (tasks - len(done))
    x = at[0]
    for text, color in reversed(signs):
        canvas.text((x, at[1]), text, size, color, anchor="rm")
        x -= text_width(text, round(size))
    return x


def _number(value: float) -> str:
    if math.isnan(value):
        return "none yet"
    if math.isinf(value):
        return "not finite"
    return short_number(value)


def _signed(value: float) -> str:
    return f"{value:+.0f}" if math.isfinite(value) else "none"
