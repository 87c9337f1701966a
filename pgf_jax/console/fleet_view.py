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
from pgf_jax.scene.scene import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot

CAPTION_V = 1.09  # top of the caption in a cell, m on the scale of its shelf
DETAILED = 3.0  # smallest scale, units per metre, at which rims and fingers can be seen
_OUTLINE = np.array([0, 1, 2, 5, 7, 11, 13])  # base, wrist, palm, couplers, backs of the fingers
MOVED = 0.002  # m, smallest displacement of an object that is drawn
COSTS = (1.0, 10.0, 100.0, 1000.0)  # marked in a large curve
_COST_SPAN = math.log10(1 + 4000.0)  # of the curve's axis, log10(1 + cost)

BORDERS = {
    State.IDLE: (170, 170, 170),
    State.PLANNING: (150, 170, 205),
    State.IN_WINDOW: (245, 180, 0),
    State.IN_LINE: (245, 180, 0),
    State.SERVED: (230, 90, 20),
    State.EXECUTING: (40, 160, 80),
}
GOAL, OBJECT, PUSHED, CHOSEN = (46, 158, 79), (190, 190, 190), (240, 150, 60), (31, 119, 220)
RIM, HAND = (60, 60, 60), (31, 78, 156)


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
        colors.append(np.tile(np.array(BORDERS[robot.state], float), (4, 2, 1)))
    return np.concatenate(lines), np.concatenate(colors)


def walls(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Walls of the shelves, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    corners = np.array(
        [
            [FRONT_X, SIDE_WALL_Y],
            [BACK_WALL_X, SIDE_WALL_Y],
            [BACK_WALL_X, -SIDE_WALL_Y],
            [FRONT_X, -SIDE_WALL_Y],
        ]
    )
    parts += [_chain(cell.place(corners), 0.012) for cell, _ in pairs]
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
        radii.append(np.full(n, cell.scale * RADIUS))
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
    """Displacements of objects by the best trajectory so far, on a large shelf, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if cell.large and len(robot.ends):
            moved = np.hypot(*(robot.ends - robot.objects).T) > MOVED
            ends = cell.place(np.stack([robot.objects[moved], robot.ends[moved]], 1))  # [M, 2, 2]
            parts.append(np.concatenate([ends, np.full((len(ends), 2, 1), 0.035)], -1))
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


# Strokes on a grid of 2 x 4, (column, row from below). A label of viser would cover its object.
_DIGITS = (
    ((0, 0), (2, 0), (2, 4), (0, 4), (0, 0)),
    ((0, 3), (1, 4), (1, 0)),
    ((0, 4), (2, 4), (2, 2), (0, 2), (0, 0), (2, 0)),
    ((0, 4), (2, 4), (2, 2), (1, 2), (2, 2), (2, 0), (0, 0)),
    ((1.5, 0), (1.5, 4), (0, 1), (2, 1)),
    ((2, 4), (0, 4), (0, 2), (2, 2), (2, 0), (0, 0)),
    ((2, 4), (0, 4), (0, 0), (2, 0), (2, 2), (0, 2)),
    ((0, 4), (2, 4), (0.5, 0)),
    ((0, 2), (0, 0), (2, 0), (2, 4), (0, 4), (0, 2), (2, 2)),
    ((2, 2), (0, 2), (0, 4), (2, 4), (2, 0), (0, 0)),
)
_DIGIT_M = 0.0045  # step of the grid on the shelf, m


def numbers(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """Numbers of the objects on a large shelf, from 1, as strokes, [M, 2, 3]."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if not cell.large:
            continue
        step = cell.scale * _DIGIT_M
        for number, center in enumerate(cell.place(robot.objects), 1):
            digits = [int(digit) for digit in str(number)]
            left = center[0] - step * (1.5 * len(digits) - 0.5)
            for place, digit in enumerate(digits):
                corner = np.array([left + 3 * step * place, center[1] - 2 * step])
                parts.append(_chain(corner + step * np.array(_DIGITS[digit]), 0.05))
    return np.concatenate(parts)


def caption(robot: RobotSnapshot) -> str:
    """Two lines on a robot: what it does; its bid or predicted gain, and how its tasks ended."""
    text = f"{robot.robot} {robot.activity}"
    if robot.stuck and robot.state is State.PLANNING:
        text += ", stuck"
    failed = len(robot.done) - robot.solved
    ended = f"{robot.solved} solved" + (f", {failed} failed" if failed else "")
    return f"{text}\n{_worth(robot)}, {ended}"


def _worth(robot: RobotSnapshot) -> str:
    """The bid, or else the predicted gain."""
    if robot.bid_text:
        return f"bid {robot.bid_text}"
    return f"gain {robot.gain:.0f}" if math.isfinite(robot.gain) else "gain -"


def _at(points: np.ndarray, z: float) -> np.ndarray:
    return np.concatenate([points, np.full((len(points), 1), z)], 1)


def _chain(points: np.ndarray, z: float) -> np.ndarray:
    """Segments [M - 1, 2, 3] from each of M points [M, 2] to the next."""
    points = _at(points, z)
    return np.stack([points[:-1], points[1:]], 1)
