"""The wall: the arrays that draw the fleet where `layout.py` says. NumPy only."""

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
from pgf_jax.planning.types import Status
from pgf_jax.scene.scene import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot

CAPTION_V = 1.09  # top of the caption, in a cell
DETAILED = 3.0  # scale from which on rims and fingers can be told apart
_OUTLINE = np.array([0, 1, 2, 5, 7, 11, 13])  # base, wrist, palm, couplers, fingers' backs
MOVED = 0.002  # m, from which on an object is seen to move
COSTS = (1.0, 10.0, 100.0, 1000.0)  # marked in a large curve
_COST_SPAN = math.log10(1 + 4000.0)

WORDS = {
    State.IDLE: "done",
    State.PLANNING: "plans",
    State.IN_WINDOW: "bids",
    State.IN_LINE: "in line",
    State.SERVED: "asks",
    State.EXECUTING: "reaches",
}
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


def shown(fleet: FleetSnapshot, layout: Layout) -> list[tuple[Cell, RobotSnapshot]]:
    """The cells to draw; the served robot has two."""
    pairs = list(zip(layout.cells, fleet.robots, strict=False))
    if layout.large is not None and layout.served is not None:
        pairs += [(layout.large, robot) for robot in fleet.robots if robot.robot == layout.served]
    return pairs


def borders(pairs: list[tuple[Cell, RobotSnapshot]]) -> tuple[np.ndarray, np.ndarray]:
    """[M, 2, 3] the cells' borders, and [M, 2, 3] their colours: what each robot does."""
    lines, colors = [np.empty((0, 2, 3))], [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        low, high = (CURVE_V[1], LARGE_TOP) if cell.large else (0.0, CELL_HEIGHT)
        (x0, y0), (x1, y1) = np.array([[0.01, low + 0.01], [CELL_WIDTH - 0.01, high - 0.01]])
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        lines.append(_chain(cell.scale * corners + (cell.x, cell.y), 0.01))
        colors.append(np.tile(np.array(BORDERS[robot.state], float), (4, 2, 1)))
    return np.concatenate(lines), np.concatenate(colors)


def walls(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """[M, 2, 3] the shelves' walls."""
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
    """The objects of shelves that are large enough for rims, these rims, and the other objects.

    `chosen` is marked on the large shelf.
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
    """The hands: each capsule as a rectangle of its width; the largest ones on small shelves."""
    centers, angles, sizes = [], [], []
    for cell, robot in pairs:
        capsules = np.arange(hand.N_CAPSULES) if cell.scale >= DETAILED else _OUTLINE
        # [C, 2, 2] in the hand's frame
        ends = hand.capsule_segments(np.float64(robot.gripper))[capsules]
        c, s = np.cos(robot.hand[2]), np.sin(robot.hand[2])
        ends = cell.place(ends @ np.array([[c, s], [-s, c]]) + robot.hand[:2])
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
    """[M, 2, 3] where the end-effector goes on the best trajectories so far."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if len(robot.path) > 1:
            c, s = np.cos(robot.path[:, 2]), np.sin(robot.path[:, 2])
            turned = np.stack(
                [
                    c * hand.EE_POINT[0] - s * hand.EE_POINT[1],
                    s * hand.EE_POINT[0] + c * hand.EE_POINT[1],
                ],
                -1,
            )
            parts.append(_chain(cell.place(robot.path[:, :2] + turned), 0.05))
    return np.concatenate(parts)


def drags(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """[M, 2, 3] on a large shelf: where the best trajectory so far would take the objects."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if cell.large and len(robot.ends):
            moved = np.hypot(*(robot.ends - robot.objects).T) > MOVED
            ends = cell.place(np.stack([robot.objects[moved], robot.ends[moved]], 1))  # [M, 2, 2]
            parts.append(np.concatenate([ends, np.full((len(ends), 2, 1), 0.035)], -1))
    return np.concatenate(parts)


def pushes(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """[M, 2, 3] from each object that is to be pushed to where it is to come."""
    parts = [np.empty((0, 2, 3))]
    for cell, robot in pairs:
        if robot.push is not None:
            ends = np.array([robot.objects[robot.push.object], [robot.push.x, robot.push.y]])
            parts.append(_chain(cell.place(ends), 0.05))
    return np.concatenate(parts)


def curves(pairs: list[tuple[Cell, RobotSnapshot]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[M, 2, 3] each: the cost curves, when inputs were given, and the curves' frames."""
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
    """Lower left and upper right corner of a cell's curve, units."""
    if cell.large:
        low = np.array([WIDTH - LARGE_CURVE[0] + 0.45, cell.y + cell.scale * SHELF_V])
        return low, low + np.array([LARGE_CURVE[0] - 0.6, LARGE_CURVE[1]])
    s = cell.scale
    return (
        np.array([cell.x + 0.05 * s, cell.y + CURVE_V[0] * s]),
        np.array([cell.x + (CELL_WIDTH - 0.06) * s, cell.y + CURVE_V[1] * s]),
    )


def cost_height(cell: Cell, cost: float) -> float:
    """Where a cost is in a curve, units."""
    low, high = curve_box(cell)
    return float(low[1] + (high[1] - low[1]) * math.log10(1 + cost) / _COST_SPAN)


# Strokes on a grid of 2 x 4, (column, row from below); a label of viser's would cover its object.
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
_DIGIT_M = 0.0045  # of the grid's step, on the shelf


def numbers(pairs: list[tuple[Cell, RobotSnapshot]]) -> np.ndarray:
    """[M, 2, 3] the numbers of the objects on a large shelf, from 1, as strokes."""
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
    """What a robot does, and what it would gain from help."""
    word = WORDS[robot.state]
    if robot.push is not None and robot.state in (State.PLANNING, State.EXECUTING):
        word = "plans push" if robot.state is State.PLANNING else "pushes"
    solved = sum(status is Status.SOLVED for status in robot.done)
    failed = len(robot.done) - solved
    text = f"{robot.robot} {word}"
    if robot.stuck and robot.state is State.PLANNING:
        text += ", stuck"
    ended = f"{solved} solved" + (f", {failed} failed" if failed else "")
    return f"{text}\n{bid_words(robot)}, {ended}"


def bid_words(robot: RobotSnapshot) -> str:
    """The bid, or the predicted gain."""
    if robot.bid is not None:
        return "bid stuck" if math.isinf(robot.bid) else f"bid {robot.bid:.0f}"
    return "gain -" if math.isnan(robot.gain) else f"gain {robot.gain:.0f}"


def _at(points: np.ndarray, z: float) -> np.ndarray:
    return np.concatenate([points, np.full((len(points), 1), z)], 1)


def _chain(points: np.ndarray, z: float) -> np.ndarray:
    """[M, 2] points -> [M - 1, 2, 3] segments."""
    points = _at(points, z)
    return np.stack([points[:-1], points[1:]], 1)
