"""Draws a shelf from above: x (into the shelf) points up, y points left, as in `scene.draw`."""

import math

import numpy as np

from pgf_jax.physics import hand
from pgf_jax.planning.types import Push
from pgf_jax.render.paint import Canvas, Point
from pgf_jax.scene.draw import CORRIDOR_OBJECT_COLOR, GOAL_COLOR, OBJECT_COLOR, ROBOT_COLOR
from pgf_jax.scene.scene import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y
from pgf_jax.simulation.snapshot import RobotSnapshot

# Part of the plane that is always in the picture, m: the shelf, and the hand at its start.
LOW_X, HIGH_X, HALF_WIDTH = -0.08, 0.615, 0.425

PUSH_COLOR = "#c8500a"
MOVED = 0.002  # m, smallest displacement that is drawn
_ORIGIN = "#5c6370"
_FLOOR, _BOARD, _WALL = "#dfe3e8", "#f6ecdc", "#7a5c3a"
_EDGE = "#4a4f57"
_ARM, _FINGER, _HAND_EDGE = "#7d8ba3", "#16396f", "#0f2547"
_PUSHED = CORRIDOR_OBJECT_COLOR
_WALL_M = 0.012
_NUMBERS_FROM_PX = 9  # smallest radius of an object that its number is written on


def pixels_per_metre(width: int, height: int) -> float:
    """Scale of a picture of `width` x `height` pixels."""
    return min(width / (2 * HALF_WIDTH), height / (HIGH_X - LOW_X))


def project(x: float, y: float, width: int, height: int) -> Point:
    """Pixel of a point (m) of the plane: distance from the left and from the top of the picture."""
    scale = pixels_per_metre(width, height)
    return width / 2 - y * scale, height / 2 - (x - (LOW_X + HIGH_X) / 2) * scale


class TopView:
    """Draws shelves from above; a `ShelfView` that keeps the empty shelf of each size."""

    def __init__(self) -> None:
        self._empty: dict[tuple[int, int], Canvas] = {}

    def shelf(self, robot: RobotSnapshot, width: int, height: int) -> np.ndarray:
        """See `ShelfView.shelf`."""
        size = (width, height)
        if size not in self._empty:
            self._empty[size] = _empty_shelf(width, height)
        picture = _Picture(Canvas(width, height, self._empty[size]))
        picture.push_target(robot.push)
        picture.origins(robot)
        picture.objects(robot)
        picture.hand(robot)
        picture.path(robot)
        picture.push_arrow(robot)
        return picture.canvas.finish()

    def close(self) -> None:
        """See `ShelfView.close`."""
        self._empty.clear()


def _empty_shelf(width: int, height: int) -> Canvas:
    canvas = Canvas(width, height, _FLOOR)

    def box(low_x: float, high_x: float, right_y: float, left_y: float, color: str) -> None:
        left, top = project(high_x, left_y, width, height)
        right, bottom = project(low_x, right_y, width, height)
        canvas.rectangle((left, top, right, bottom), color)

    side, back, wall = SIDE_WALL_Y, BACK_WALL_X, _WALL_M
    box(FRONT_X, back, -side, side, _BOARD)
    box(back, back + wall, -side - wall, side + wall, _WALL)
    box(FRONT_X, back, side, side + wall, _WALL)
    box(FRONT_X, back, -side - wall, -side, _WALL)
    box(FRONT_X - 0.004, FRONT_X, -side - wall, side + wall, "#c9ad86")  # the board's front edge
    return canvas


class _Picture:
    """Draws the parts of a shelf on a canvas; positions are in metres."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self._scale = pixels_per_metre(canvas.width, canvas.height)
        # Lines get thicker with the picture, but stay visible in the smallest.
        self._line = max(0.004 * self._scale, 0.8)

    def _at(self, point) -> Point:
        return project(float(point[0]), float(point[1]), self.canvas.width, self.canvas.height)

    def objects(self, robot: RobotSnapshot) -> None:
        """Draw the objects as discs, numbered from 1 where there is room."""
        radius = RADIUS * self._scale
        pushed = None if robot.push is None else robot.push.object
        for i, centre in enumerate(robot.objects):
            fill, edge, ink = OBJECT_COLOR, _EDGE, "#3c4148"
            if i == pushed:
                fill, edge, ink = _PUSHED, PUSH_COLOR, "#5b2505"
            if i == robot.goal:
                fill, edge, ink = GOAL_COLOR, "#175a2c", "#ffffff"
            at = self._at(centre)
            self.canvas.disc(at, radius, fill, outline=edge, width=max(0.0022 * self._scale, 0.6))
            if radius >= _NUMBERS_FROM_PX:
                bold = i == robot.goal
                self.canvas.text(at, str(i + 1), 0.85 * radius, ink, anchor="mm", bold=bold)

    def origins(self, robot: RobotSnapshot) -> None:
        """Draw a faint ring where each object that has moved stood at first, and a line from it."""
        for origin, centre in zip(robot.origins, robot.objects, strict=False):
            if math.dist(origin, centre) > MOVED:
                at = self._at(origin)
                self.canvas.line([at, self._at(centre)], _ORIGIN, self._line)
                self.canvas.dashed_circle(at, RADIUS * self._scale, _ORIGIN, 0.8 * self._line)

    def hand(self, robot: RobotSnapshot) -> None:
        """Draw the hand's capsules, and a forearm that leaves the picture."""
        x, y, yaw = (float(v) for v in robot.hand)
        back = (x - 0.6 * math.cos(yaw), y - 0.6 * math.sin(yaw))
        scale, edge = self._scale, max(0.0025 * self._scale, 0.7)
        self.canvas.capsule(self._at((x, y)), self._at(back), 0.040 * scale + edge, _HAND_EDGE)
        self.canvas.capsule(self._at((x, y)), self._at(back), 0.040 * scale, _ARM)
        ends = [(self._at(a), self._at(b)) for a, b in robot.hand_axes()]
        # All edges first: what is not covered afterwards is the outline of the whole hand.
        for (a, b), radius in zip(ends, hand.RADII, strict=True):
            self.canvas.capsule(a, b, radius * scale + edge, _HAND_EDGE)
        for (a, b), radius, body in zip(ends, hand.RADII, hand.CAPSULE_BODY, strict=True):
            color = ROBOT_COLOR if hand.BODIES[body] == "palm" else _FINGER
            self.canvas.capsule(a, b, radius * scale, color)

    def path(self, robot: RobotSnapshot) -> None:
        """Draw the path of the end-effector point, with a dot at each knot end."""
        points = [self._at(point) for point in robot.end_effector_path()]
        color = "#f2b705"
        if len(points) > 1:
            self.canvas.line(points, "#00000055", 2.0 * self._line)
            self.canvas.line(points, color, 1.2 * self._line)
        for at in points:
            self.canvas.disc(at, 1.6 * self._line, color, outline="#00000088", width=0.7)

    def push_target(self, push: Push | None) -> None:
        """Draw the pushed object once more, transparent, at its target."""
        if push is None:
            return
        at, radius = self._at((push.x, push.y)), RADIUS * self._scale
        self.canvas.disc(at, radius, _PUSHED + "60")
        self.canvas.dashed_circle(at, radius, PUSH_COLOR, self._line)

    def push_arrow(self, robot: RobotSnapshot) -> None:
        """Draw an arrow from the pushed object to its target."""
        if robot.push is not None:
            start, end = robot.objects[robot.push.object], (robot.push.x, robot.push.y)
            self.canvas.arrow(self._at(start), self._at(end), PUSH_COLOR, 1.3 * self._line)
