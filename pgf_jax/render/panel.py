"""One robot's panel: a cell of the wall, or large with all that is known of it."""

import math

from pgf_jax.fleet.records import State
from pgf_jax.planning.types import Status
from pgf_jax.render.chart import CURVE, FEASIBLE, INPUT, draw_costs
from pgf_jax.render.paint import CARD, INK, MUTED, RULE, Box, Canvas, Point, text_width
from pgf_jax.render.view import ASPECT, View
from pgf_jax.simulation.snapshot import RobotSnapshot

PLANNING, PUSH, WAITING = "#3b6fb6", "#7a55b5", "#b97a00"
SERVED, EXECUTING, DONE = INPUT, "#16808c", "#8a939f"
_STRIP_FROM_PX = 118  # height of a cell that has a strip with its cost curve
_STUCK = "stuck"
_WAITING = (State.IN_WINDOW, State.IN_LINE)


def state_words(robot: RobotSnapshot) -> tuple[str, str]:
    """What a robot does, in words, and the colour of it."""
    if robot.state is State.PLANNING:
        return ("planning", PLANNING) if robot.push is None else ("planning push", PUSH)
    if robot.state is State.EXECUTING:
        return ("executing" if robot.push is None else "pushing"), EXECUTING
    if robot.state in _WAITING:
        words = "bids" if robot.state is State.IN_WINDOW else "waiting"
        bid = bid_words(robot.bid)
        return (f"{words}{',' * (bid == _STUCK)} {bid}" if bid else "waiting"), WAITING
    return ("served", SERVED) if robot.state is State.SERVED else ("done", DONE)


def bid_words(bid: float | None) -> str:
    """A bid in words; empty where there is none."""
    if bid is None or math.isnan(bid):
        return ""
    return _STUCK if math.isinf(bid) else f"G {_number(bid)}"


def strip_height(width: float, height: float) -> float:
    """Of a cell's lower strip, pixels; 0 where there is no room for one."""
    if height < _STRIP_FROM_PX:
        return 0.0
    spare = height - title_height(height) - width / ASPECT
    return max(min(max(0.21 * height, 30.0), 64.0), min(spare, 0.4 * height))


def title_height(height: float) -> float:
    """Of a cell's title, pixels."""
    return min(max(0.12 * height, 15.0), 26.0)


def draw_cell(canvas: Canvas, box: Box, robot: RobotSnapshot, tasks: int, view: View) -> None:
    """Draw a robot small: number and state, shelf, and where there is room cost curve and gain.

    Args:
      canvas: to draw on.
      box: where, pixels.
      robot: what.
      tasks: of each robot.
      view: draws the shelf.
    """
    left, top, right, bottom = box
    height = bottom - top
    words, color = state_words(robot)
    title, strip = title_height(height), strip_height(right - left, height)
    served = robot.state is State.SERVED
    canvas.rectangle(box, CARD, radius=4, outline=color, width=2.6 if served else 1.2)
    canvas.rectangle((left, top, right, top + title), color, radius=4)
    canvas.rectangle((left, top + title / 2, right, top + title), color)
    middle, size = top + title / 2, 0.62 * title
    number = str(robot.robot)
    canvas.text((left + 0.4 * title, middle), number, 0.74 * title, CARD, bold=True)
    from_left = left + 0.8 * title + text_width(number, 0.74 * title, bold=True)
    canvas.text((from_left, middle), words, size, CARD, room=right - from_left - 4)
    _draw_shelf(canvas, (left + 3, top + title + 1, right - 3, bottom - strip - 3), robot, view)
    below = (right - 7, bottom - strip - 4 - 0.35 * title)
    _draw_tasks(canvas, below, 0.55 * title, robot, tasks, INK)
    if strip:
        _draw_strip(canvas, (left + 5, bottom - strip, right - 5, bottom - 5), robot)


def draw(
    canvas: Canvas,
    box: Box,
    robot: RobotSnapshot,
    tasks: int,
    view: View,
    *,
    name: str | None = None,
) -> None:
    """Draw a robot large: shelf, cost curve with axes, gain, bid and how its tasks ended.

    Args:
      canvas: to draw on.
      box: where, pixels; the curve is beside the shelf where it is wide, else below.
      robot: what.
      tasks: of each robot.
      view: draws the shelf.
      name: of the robot; by default its number.
    """
    left, top, right, bottom = box
    words, color = state_words(robot)
    if tasks == 1 and robot.done:
        words += f": {robot.done[0].replace('_', ' ')}"
    canvas.rectangle(box, CARD, radius=6, outline=color, width=3)
    title = min(max(0.055 * (bottom - top), 28.0), 44.0)
    canvas.rectangle((left, top, right, top + title), color, radius=6)
    canvas.rectangle((left, top + title / 2, right, top + title), color)
    middle, pad = top + title / 2, 0.4 * title
    name = f"robot {robot.robot}" if name is None else name
    canvas.text((left + pad, middle), name, 0.55 * title, CARD, bold=True)
    from_left = left + 2 * pad + text_width(name, 0.55 * title, bold=True)
    dots = _draw_tasks(canvas, (right - pad, middle), 0.5 * title, robot, tasks, CARD)
    canvas.text((from_left, middle), words, 0.5 * title, CARD, room=dots - from_left - 4)

    inner = (left + 10, top + title + 10, right - 10, bottom - 12)
    width, height = inner[2] - inner[0], inner[3] - inner[1]
    if width / height > 1.25:
        split = inner[0] + min(height * ASPECT, 0.68 * width)
        _draw_shelf(canvas, (inner[0], inner[1], split, inner[3]), robot, view)
        facts = (split + 16, inner[1], inner[2] - 4, inner[3])
    else:
        split = inner[1] + min(width / ASPECT, 0.66 * height)
        _draw_shelf(canvas, (inner[0], inner[1], inner[2], split), robot, view)
        facts = (inner[0] + 2, split + 10, inner[2] - 4, inner[3])
    _draw_facts(canvas, facts, robot, tasks)


def _draw_facts(canvas: Canvas, box: Box, robot: RobotSnapshot, tasks: int) -> None:
    """Lines of what is known, then the curve."""
    left, top, right, bottom = box
    size = min(max((right - left) / 24, 11.0), 17.0)
    scene = f"{robot.scene}, task {robot.task + 1} of {tasks}" if tasks > 1 else robot.scene
    lines = [("shelf", scene, INK)]
    if robot.push is not None:
        push = robot.push
        where = f"{push.object + 1} to ({push.x:.2f}, {push.y:.2f}) m"
        lines.append(("push", where, INK))
    cost = robot.costs[-1] if robot.costs else math.nan
    lines.append(("cost", _number(cost), FEASIBLE if cost < 20 else INK))
    gain, bid = _signed(robot.gain), bid_words(robot.bid)
    lines.append(("predicted gain", gain + (f", bids {bid}" if bid else ""), INK))
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
    y += size
    # A very tall curve would say no more.
    chart = (left, y, right, min(bottom, y + 1.1 * (right - left)))
    draw_costs(canvas, chart, robot.costs, robot.inputs_at, size=max(0.75 * size, 9.0))


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


def _draw_shelf(canvas: Canvas, box: Box, robot: RobotSnapshot, view: View) -> None:
    left, top, right, bottom = (round(v) for v in box)
    if right - left >= 16 and bottom - top >= 16:
        canvas.paste(left, top, view.shelf(robot, right - left, bottom - top))
        canvas.rectangle((left - 1, top - 1, right + 1, bottom + 1), None, outline=RULE)


def _draw_tasks(
    canvas: Canvas, at: Point, size: float, robot: RobotSnapshot, tasks: int, ink: str
) -> float:
    """A sign for each task, or a count where they are many, written up to `at`; returns its left.

    In text, so that it can stand on a shelf's picture.
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
    return f"{value:.{0 if abs(value) >= 10 else 1 if abs(value) >= 1 else 2}f}"


def _signed(value: float) -> str:
    return f"{value:+.0f}" if math.isfinite(value) else "none"
