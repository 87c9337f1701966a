"""Draws a shelf from above: x (into the shelf) points up, y points left, as in `scene.draw`."""

import math
from typing import NamedTuple

import numpy as np

from pgf_jax.physics import hand
from pgf_jax.render.paint import Canvas, Point
from pgf_jax.scene.draw import CORRIDOR_OBJECT_COLOR, GOAL_COLOR, OBJECT_COLOR, ROBOT_COLOR
from pgf_jax.scene.shelf import BACK_WALL_X, FRONT_X, SIDE_WALL_Y
from pgf_jax.simulation.snapshot import RobotSnapshot

# m: the hand at its start is always in the picture, and what is behind and beside the walls.
LOW_X, _BEHIND, _BESIDE = -0.08, 0.025, 0.025

PUSH_COLOR = "#c8500a"
MOVED = 0.002  # m, smallest displacement that is drawn
_ORIGIN = "#5c6370"
_FLOOR, _BOARD, _WALL = "#dfe3e8", "#f6ecdc", "#7a5c3a"
_EDGE = "#4a4f57"
_ARM, _FINGER, _HAND_EDGE = "#7d8ba3", "#16396f", "#0f2547"
_PUSHED = CORRIDOR_OBJECT_COLOR
_WALL_M = 0.012
_NUMBERS_FROM_PX = 9  # smallest radius of an object that its number is written on


class Frame(NamedTuple):
    """A picture of a shelf: its size in pixels, and the walls that are in it, m."""

    width: int
    height: int
    back_x: float = BACK_WALL_X
    side_y: float = SIDE_WALL_Y

    @property
    def pixels_per_metre(self) -> float:
        """Scale of the picture."""
        half, high = self.side_y + _BESIDE, self.back_x + _BEHIND
        return min(self.width / (2 * half), self.height / (high - LOW_X))

    def project(self, x: float, y: float) -> Point:
        """Pixel of a point (m) of the plane: distance from the picture's left and from its top."""
        scale, middle = self.pixels_per_metre, (LOW_X + self.back_x + _BEHIND) / 2
        return self.width / 2 - y * scale, self.height / 2 - (x - middle) * scale


class TopView:
    """Draws shelves from above; a `ShelfView` that keeps the empty shelf of each size."""

    def __init__(self) -> None:
        self._empty: dict[Frame, Canvas] = {}

    def shelf(self, robot: RobotSnapshot, width: int, height: int) -> np.ndarray:
        """See `ShelfView.shelf`."""
        frame = Frame(width, height, robot.back_x, robot.side_y)
        if frame not in self._empty:
            self._empty[frame] = _empty_shelf(frame)
        picture = _Picture(Canvas(width, height, self._empty[frame]), frame)
        picture.push_target(robot)
        picture.origins(robot)
        picture.objects(robot)
        picture.hand(robot)
        picture.path(robot)
        picture.push_arrow(robot)
        return picture.canvas.finish()

    def close(self) -> None:
        """See `ShelfView.close`."""
        self._empty.clear()


def _empty_shelf(frame: Frame) -> Canvas:
    canvas = Canvas(frame.width, frame.height, _FLOOR)

    def box(low_x: float, high_x: float, right_y: float, left_y: float, color: str) -> None:
        left, top = frame.project(high_x, left_y)
        right, bottom = frame.project(low_x, right_y)
        canvas.rectangle((left, top, right, bottom), color)

    side, back, wall = frame.side_y, frame.back_x, _WALL_M
    box(FRONT_X, back, -side, side, _BOARD)
    box(back, back + wall, -side - wall, side + wall, _WALL)
    box(FRONT_X, back, side, side + wall, _WALL)
    box(FRONT_X, back, -side - wall, -side, _WALL)
    box(FRONT_X - 0.004, FRONT_X, -side - wall, side + wall, "#c9ad86")  # the board's front edge
    return canvas


class _Picture:
    """Draws the parts of a shelf on a canvas; positions are in metres."""

    def __init__(self, canvas: Canvas, frame: Frame) -> None:
        self.canvas, self._frame = canvas, frame
        self._scale = frame.pixels_per_metre
        # Lines get thicker with the picture, but stay visible in the smallest.
        self._line = max(0.004 * self._scale, 0.8)

    def _at(self, point) -> Point:
        return self._frame.project(float(point[0]), float(point[1]))

    def objects(self, robot: RobotSnapshot) -> None:
        """Draw the objects as discs, numbered from 1 where there is room."""
        pushed = None if robot.push is None else robot.push.object
        radii = robot.radii * self._scale
        for i, (centre, radius) in enumerate(zip(robot.objects, radii, strict=True)):
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
        radii = robot.radii * self._scale
        for origin, centre, radius in zip(robot.origins, robot.objects, radii, strict=False):
            if math.dist(origin, centre) > MOVED:
                at = self._at(origin)
                self.canvas.line([at, self._at(centre)], _ORIGIN, self._line)
                self.canvas.dashed_circle(at, radius, _ORIGIN, 0.8 * self._line)

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

    def push_target(self, robot: RobotSnapshot) -> None:
        """Draw the pushed object once more, transparent, at its target."""
        push = robot.push
        if push is None:
            return
        at, radius = self._at((push.x, push.y)), robot.radii[push.object] * self._scale
        self.canvas.disc(at, radius, _PUSHED + "60")
        self.canvas.dashed_circle(at, radius, PUSH_COLOR, self._line)

    def push_arrow(self, robot: RobotSnapshot) -> None:
        """Draw an arrow from the pushed object to its target."""
        if robot.push is not None:
            start, end = robot.objects[robot.push.object], (robot.push.x, robot.push.y)
            self.canvas.arrow(self._at(start), self._at(end), PUSH_COLOR, 1.3 * self._line)
