"""The arrays that draw a fleet, at the places given by `layout.py`; uses NumPy only."""

import dataclasses
import math

import numpy as np

from pgf_jax.console.layout import (
    CELL_HEIGHT,
    CELL_WIDTH,
    CURVE_V,
    LARGE_CURVE,
    LARGE_TOP,
    SHELF_V,
    WIDTH,
    Cell,
    Layout,
)
from pgf_jax.fleet.records import State
from pgf_jax.physics import hand
from pgf_jax.scene.shelf import FRONT_X
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot, short_number

CAPTION_V = 1.14  # top of the caption in a cell, m on the scale of its shelf
DETAILED = 3.0  # smallest scale, units per metre, at which rims and fingers can be seen
ROOMY = 2.0  # smallest scale at which a caption has room for the robot's tasks
_OUTLINE = np.array([0, 1, 2, 5, 7, 11, 13])  # base, wrist, palm, couplers, backs of the fingers
_CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 17)) for f in (np.cos, np.sin)], -1)
MOVED = 0.01  # m, smallest displacement of an object that is drawn
COSTS = (1.0, 10.0, 100.0, 1000.0)  # marked in a large curve
_COST_SPAN = math.log10(1 + 4000.0)  # of the curve's axis, log10(1 + cost)

# Colour of a cell's border, and what the robot does, by its state.
STATES = {
    State.PLANNING: ((110, 150, 220), "planning"),
    State.IN_WINDOW: ((245, 180, 0), "waiting for help"),
    State.IN_LINE: ((245, 180, 0), "waiting for help"),
    State.SERVED: ((230, 90, 20), "being helped"),
    State.EXECUTING: ((40, 160, 80), "moving"),
    State.IDLE: ((190, 190, 190), "done"),
}
GOAL, OBJECT, PUSHED, CHOSEN = (46, 158, 79), (200, 200, 200), (240, 150, 60), (110, 175, 250)
RIM, HAND, PATH, DRAG, INPUT = (60, 60, 60), (31, 78, 156), (31, 78, 156), (180, 95, 40), PUSHED


@dataclasses.dataclass(frozen=True, eq=False)
class Squares:
    """Oriented rectangles: [M, 3] centres, [M] angles (rad), [M, 2] sizes, [M, 3] colours."""

    centers: np.ndarray
    angles: np.ndarray
    sizes: np.ndarray
    colors: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Disks:
    """Disks: [M, 3] centres, [M] radii, [M, 3] colours."""

    centers: np.ndarray
    radii: np.ndarray
    colors: np.ndarray


def visible_cells(fleet: FleetSnapshot, layout: Layout) -> list[tuple[Cell, RobotSnapshot]]:
    """The cells to draw, with their robots; the served robot has two."""
    pairs = list(zip(layout.cells, fleet.robots, strict=False))
    if layout.large is not None and layout.served is not None:
        pairs += [(layout.large, robot) for robot in fleet.robots if robot.robot == layout.served]
    return pairs


def borders(pairs: list[tuple[Cell, RobotSnapshot]]) -> tuple[np.ndarray, np.ndarray]:
    """Borders of the cells [M, 2, 3], and their colours [M, 2, 3], by the state of each robot."""
    lines, colors = [np.empty((0, 2, 3))], [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        low, high = (CURVE_V[1], LARGE_TOP) if cell.large else (0.0, CELL_HEIGHT)
        (x0, y0), (x1, y1) = np.array([[0.01, low + 0.01], [CELL_WIDTH - 0.01, high - 0.01]])
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        lines.append(_chain(cell.scale * corners + (cell.x, cell.y), 0.01))
        colors.append(np.tile(np.array(STATES[robot.state][0], float), (4, 2, 1)))
    return np.concatenate(lines), np.concatenate(colors)


def walls(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Walls of the shelves, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        back, side = robot.back_x, robot.side_y
        corners = np.array([[FRONT_X, side], [back, side], [back, -side], [FRONT_X, -side]])
        parts.append(_chain(cell.place(corners), 0.012))
    return np.concatenate(parts)


def objects(
    pairs: list[tuple[Cell, RobotSnapshot]], chosen: int | None
) -> tuple[Disks, Disks, Disks]:
    """Objects as disks; on the large shelf the object `chosen` is marked.

    Returns:
      The objects of cells that are large enough for rims; their rims; the objects of other cells.
    """
    centers, radii, colors, detailed = [], [], [], []
    for cell, robot in pairs:
        n = len(robot.objects)
        color = np.tile(np.array(OBJECT), (n, 1))
        color[robot.goal] = GOAL
        if robot.push is not None and robot.push.object < n:
            color[robot.push.object] = PUSHED
        if cell.large and chosen is not None:
            color[chosen] = CHOSEN
        centers.append(cell.place(robot.objects))
        radii.append(cell.scale * robot.radii)
        colors.append(color)
        detailed.append(np.full(n, cell.scale >= DETAILED))
    center = _at(np.concatenate([*centers, np.empty((0, 2))]), 0.03)
    radius = np.concatenate([*radii, np.empty(0)])
    color = np.concatenate([*colors, np.empty((0, 3))])
    large = np.concatenate([*detailed, np.empty(0, bool)])
    below = np.array([0, 0, -0.005])
    rims = np.tile(np.array(RIM), (int(large.sum()), 1))
    return (
        Disks(center[large], 0.88 * radius[large], color[large]),
        Disks(center[large] + below, radius[large], rims),
        Disks(center[~large], radius[~large], color[~large]),
    )


def hands(pairs: list[tuple[Cell, RobotSnapshot]]) -> Squares:
    """Hands, each capsule as a rectangle; in small cells only the largest capsules."""
    centers, angles, sizes = [], [], []
    for cell, robot in pairs:
        capsules = np.arange(hand.N_CAPSULES) if cell.scale >= DETAILED else _OUTLINE
        ends = cell.place(robot.hand_axes()[capsules])  # [C, 2, 2]
        along = ends[:, 1] - ends[:, 0]
        centers.append(ends.mean(1))
        angles.append(np.arctan2(along[:, 1], along[:, 0]))
        wide = 2 * cell.scale * hand.RADII[capsules]
        sizes.append(np.stack([np.hypot(*along.T) + wide, wide], -1))
    center = np.concatenate([*centers, np.empty((0, 2))])
    color = np.tile(np.array(HAND), (len(center), 1))
    return Squares(
        _at(center, 0.04),
        np.concatenate([*angles, np.empty(0)]),
        np.concatenate([*sizes, np.empty((0, 2))]),
        color,
    )


def paths(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Paths of the end-effector point on the best trajectories so far, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if len(robot.path) > 1:
            parts.append(_chain(cell.place(robot.end_effector_path()), 0.05))
    return np.concatenate(parts)


def drags(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Where the best trajectory so far takes the objects of a large shelf, as rings, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if cell.large and len(robot.ends):
            moved = np.hypot(*(robot.ends - robot.objects).T) > MOVED
            ends = cell.place(np.stack([robot.objects[moved], robot.ends[moved]], 1))  # [M, 2, 2]
            parts.append(np.concatenate([ends, np.full((len(ends), 2, 1), 0.02)], -1))
            for end, radius in zip(ends[:, 1], robot.radii[moved], strict=True):
                parts.append(_chain(end + cell.scale * radius * _CIRCLE, 0.035))
    return np.concatenate(parts)


def pushes(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Lines from each object that is being pushed to its target, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if robot.push is not None:
            ends = np.array([robot.objects[robot.push.object], [robot.push.x, robot.push.y]])
            parts.append(_chain(cell.place(ends), 0.05))
    return np.concatenate(parts)


def curves(pairs: list[tuple[Cell, RobotSnapshot]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cost curves, marks of the inputs, and frames of the curves, each [M, 2, 3]."""
    lines, inputs, frames = ([np.empty((0, 2, 3))] for _ in range(3))
    for cell, robot in pairs:
        low, high = curve_box(cell)
        width, height = high - low
        step = width / max(12, len(robot.costs) - 1)
        if len(robot.costs) > 1:
            cost = np.minimum(np.array(robot.costs), 10**_COST_SPAN)
            v = np.minimum(np.log10(1 + cost) / _COST_SPAN, 1.0)
            points = np.stack([low[0] + step * np.arange(len(v)), low[1] + height * v], -1)
            lines.append(_chain(points, 0.05))
        for at in robot.inputs_at:
            x = low[0] + step * max(0, at - 1)
            inputs.append(_chain(np.array([[x, low[1]], [x, high[1]]]), 0.045))
        frames.append(_chain(np.array([low, [high[0], low[1]]]), 0.045))
        if cell.large:
            for cost in COSTS:
                y = cost_height(cell, cost)
                frames.append(_chain(np.array([[low[0], y], [high[0], y]]), 0.045))
    return np.concatenate(lines), np.concatenate(inputs), np.concatenate(frames)


def curve_box(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of the curve of a cell, units."""
    if cell.large:
        low = np.array([WIDTH - LARGE_CURVE[0] + 0.45, cell.y + cell.scale * SHELF_V])
        return low, low + np.array([LARGE_CURVE[0] - 0.6, LARGE_CURVE[1]])
    s = cell.scale
    return (
        np.array([cell.x + 0.05 * s, cell.y + CURVE_V[0] * s]),
        np.array([cell.x + (CELL_WIDTH - 0.06) * s, cell.y + CURVE_V[1] * s]),
    )


def cost_height(cell: Cell, cost: float) -> float:
    """Height of a cost in the curve of a cell, units."""
    low, high = curve_box(cell)
    return float(low[1] + (high[1] - low[1]) * math.log10(1 + cost) / _COST_SPAN)


# Strokes on a grid of 20 x 40: column,row from below. A label of viser would cover its object.
_STROKES = (
    "6,40 14,40 20,33 20,7 14,0 6,0 0,7 0,33 6,40",
    "3,32 12,40 12,0",
    "0,34 5,40 15,40 20,34 20,27 0,0 20,0",
    "0,36 5,40 15,40 20,35 20,27 15,21 8,21 15,21 20,15 20,6 15,0 5,0 0,4",
    "15,0 15,40 0,12 21,12",
    "19,40 2,40 1,21 6,25 14,25 20,19 20,6 14,0 5,0 0,4",
    "18,38 14,40 7,40 0,32 0,6 6,0 14,0 20,6 20,18 14,24 6,24 0,18",
    "0,40 20,40 8,0",
    "6,22 1,27 1,35 6,40 14,40 19,35 19,27 14,22 6,22 0,16 0,6 6,0 14,0 20,6 20,16 14,22",
    "2,2 6,0 13,0 20,8 20,34 14,40 6,40 0,34 0,22 6,16 14,16 20,22",
)
_DIGITS = [np.array([point.split(",") for point in points.split()], float) for points in _STROKES]
_DIGIT_M = 0.0006  # step of the grid on the shelf, m


def numbers(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Numbers of the objects on a large shelf, from 1, as strokes, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if not cell.large:
            continue
        step = cell.scale * _DIGIT_M
        for number, center in enumerate(cell.place(robot.objects), 1):
            digits = [int(digit) for digit in str(number)]
            left = center[0] - step * (15 * len(digits) - 5)
            for place, digit in enumerate(digits):
                corner = np.array([left + 30 * step * place, center[1] - 20 * step])
                parts.append(_chain(corner + step * _DIGITS[digit], 0.06))
    return np.concatenate(parts)


def caption(robot: RobotSnapshot, tasks: int, *, roomy: bool) -> str:
    """Lines on a robot in a cell: its number, what it does, and its tasks if that is `roomy`."""
    if roomy:
        return f"Robot {robot.robot}: {_activity(robot)}\n{_progress(robot, tasks)}"
    return f"Robot {robot.robot}\n{'waiting' if robot.is_waiting else _activity(robot)}"


def title(robot: RobotSnapshot, tasks: int) -> str:
    """Lines on the robot of the large shelf, the last one on the curve below them."""
    lines = [f"Robot {robot.robot}: {_activity(robot)}", _progress(robot, tasks), _reason(robot)]
    cost = robot.costs[-1] if robot.costs else math.inf
    now = f": {short_number(cost)}" if math.isfinite(cost) else ""
    return "\n".join([*filter(None, lines), f"Cost of its best trajectory{now}"])


def iterations(robot: RobotSnapshot) -> str:
    """How many reach iterations of the task have ended, under the curve."""
    number = max(0, len(robot.costs) - 1)
    return f"after {number} iteration{'' if number == 1 else 's'}"


def _activity(robot: RobotSnapshot) -> str:
    """The robot's state in a few words."""
    if robot.push is not None and robot.state in (State.PLANNING, State.EXECUTING):
        return "pushing" if robot.state is State.EXECUTING else "plans a push"
    return f"{STATES[robot.state][1]}, plans on" if robot.plans_on else STATES[robot.state][1]


def _progress(robot: RobotSnapshot, tasks: int) -> str:
    """How many tasks the robot has done, and how many of them failed."""
    failed = len(robot.done) - robot.solved
    text = f"{len(robot.done)} of {tasks} task{'' if tasks == 1 else 's'} done"
    return f"{text}, {failed} failed" if failed else text


def _reason(robot: RobotSnapshot) -> str:
    """Why the robot asks, where it says so, else nothing.

    What some policies bid is no cost, so that only a bid that equals the predicted gain is named.
    """
    if robot.stuck:
        return "It is stuck"
    if robot.bid is not None and robot.bid == robot.gain:
        return f"Help is expected to save {short_number(robot.bid)} in cost"
    return ""


def _at(points: np.ndarray, z: float) -> np.ndarray:
    return np.concatenate([points, np.full((len(points), 1), z)], 1)


def _chain(points: np.ndarray, z: float) -> np.ndarray:
    """Segments [M - 1, 2, 3] from each of M points [M, 2] to the next."""
    points = _at(points, z)
    return np.stack([points[:-1], points[1:]], 1)
