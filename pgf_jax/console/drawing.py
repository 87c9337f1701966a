"""Draws the fleet in viser with a few batched handles; only arrays that changed are sent again."""

from typing import Any

import numpy as np
import viser

from pgf_jax.console import fleet_view
from pgf_jax.console.fleet_view import Disks, Squares
from pgf_jax.console.layout import Layout
from pgf_jax.console.session import Frame
from pgf_jax.physics import hand

_SMALL, _LARGE = 8, 24  # sides of a disk: there are many small ones
_SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
_HALVES = np.array([[0, 1, 2], [0, 2, 3]])
_PAD = 32  # lines are sent in multiples of it, so that their buffers are seldom made again
CAPTION_HEIGHT, SMALLEST = 0.068, 0.14  # of text: m on the scale of a shelf; at least, units
_AWAY = -100.0  # coordinate, in all three directions, of what is out of sight
_PICKED, _REFUSED = (31, 119, 220), (214, 39, 40)


class Drawing:
    """Draws frames in the scene that all clients see.

    Args:
      scene: of viser.
      robots, n_objects: R and N.
    """

    def __init__(self, scene: viser.SceneApi, robots: int, n_objects: int) -> None:
        self._scene = scene
        scene.configure_default_lights(enabled=False)
        scene.add_light_ambient("/light", intensity=np.pi)  # shows colours as given
        self._sent: dict[tuple[str, str], np.ndarray] = {}
        cells = robots + 1
        self._meshes = {
            "rims": self._mesh("rims", *_disk(_LARGE), n_objects * cells),
            "objects": self._mesh("objects", *_disk(_LARGE), n_objects * cells),
            "small_objects": self._mesh("small_objects", *_disk(_SMALL), n_objects * cells),
            "hands": self._mesh("hands", _SQUARE, _HALVES, hand.N_CAPSULES * cells),
        }
        self._lines = {
            name: self._segments(name, color, width)
            for name, color, width in (
                ("borders", (150, 150, 150), 4),
                ("walls", (122, 92, 58), 4),
                ("frames", (190, 190, 190), 1),
                ("curves", (40, 60, 110), 2),
                ("inputs", fleet_view.INPUT, 2),
                ("paths", fleet_view.PATH, 2),
                ("drags", fleet_view.DRAG, 2),
                ("pushes", fleet_view.PUSHED, 3),
                ("arrow", _PICKED, 3),
                ("numbers", (0, 0, 0), 2.7),
            )
        }
        self._picked = self._mesh("picked", *_disk(_LARGE), 1, opacity=0.55)
        self._captions = [self._label(f"caption/{i}", "top-left") for i in range(robots)]
        self._title = self._label("title", "bottom-left")
        self._axis = self._label("axis", "center-right")
        self._iterations = self._label("iterations", "top-right")
        self._costs = [
            self._label(f"cost/{i}", "center-right") for i in range(len(fleet_view.COSTS))
        ]

    def show(self, frame: Frame, layout: Layout) -> None:
        """Draw a frame; call it within the server's `atomic`."""
        pairs = fleet_view.visible_cells(frame.fleet, layout)
        picked = frame.picked
        parts = fleet_view.objects(pairs, None if picked is None else picked.object)
        for name, disks in zip(("objects", "rims", "small_objects"), parts, strict=True):
            self._disks(name, disks)
        self._squares("hands", fleet_view.hands(pairs))
        curves, inputs, frames = fleet_view.curves(pairs)
        lines = {"curves": curves, "inputs": inputs, "frames": frames}
        lines["walls"] = fleet_view.walls(pairs)
        borders, colors = fleet_view.borders(pairs)
        self._put_lines("borders", borders, colors)
        lines |= {"paths": fleet_view.paths(pairs), "pushes": fleet_view.pushes(pairs)}
        lines |= {"drags": fleet_view.drags(pairs), "numbers": fleet_view.numbers(pairs)}
        lines["arrow"] = self._show_picked(frame, layout)
        for name, points in lines.items():
            self._put_lines(name, points)
        self._show_captions(frame, layout)
        self._show_large(frame, layout)

    # -- parts ----------------------------------------------------------------------------------

    def _show_picked(self, frame: Frame, layout: Layout) -> np.ndarray:
        """Draw the picked object transparent at its target; returns its arrow, [M, 2, 3]."""
        picked, cell = frame.picked, layout.large
        centers, radii = np.full((1, 3), _AWAY), np.ones(1)
        color = np.array([_REFUSED if picked is not None and picked.problem else _PICKED])
        arrow = np.empty((0, 2, 3))
        if picked is not None and cell is not None and picked.object is not None and picked.target:
            robot = frame.fleet.robots[picked.robot]
            ends = cell.place(np.array([robot.objects[picked.object], picked.target]))
            centers = np.array([[*ends[1], 0.06]])
            radii = np.array([cell.scale * robot.radii[picked.object]])
            arrow = np.concatenate([ends, [[0.065], [0.065]]], 1)[None]
        self._put(self._picked, "picked", centers, np.tile(radii[:, None], (1, 3)), color)
        return arrow

    def _show_captions(self, frame: Frame, layout: Layout) -> None:
        for index, handle in enumerate(self._captions):
            if index < len(layout.cells) and index < len(frame.fleet.robots):
                cell = layout.cells[index]
                place = (cell.x + 0.03 * cell.scale, cell.y + fleet_view.CAPTION_V * cell.scale)
                roomy = cell.scale >= fleet_view.ROOMY
                robot, tasks = frame.fleet.robots[index], frame.fleet.tasks
                text = fleet_view.caption(robot, tasks, roomy=roomy)
                self._write(handle, text, place, max(CAPTION_HEIGHT * cell.scale, SMALLEST))
            else:
                self._write(handle, "", (0.0, 0.0), SMALLEST)

    def _show_large(self, frame: Frame, layout: Layout) -> None:
        cell, served = layout.large, layout.served
        if cell is None or served is None or served >= len(frame.fleet.robots):
            for handle in (*self._costs, self._axis, self._title, self._iterations):
                self._write(handle, "", (0.0, 0.0), SMALLEST)
            return
        robot = frame.fleet.robots[served]
        low, high = fleet_view.curve_box(cell)
        self._write(self._axis, "cost", (low[0] - 0.06, high[1]), 0.18)
        for handle, cost in zip(self._costs, fleet_view.COSTS, strict=True):
            place = (low[0] - 0.06, fleet_view.cost_height(cell, cost))
            self._write(handle, f"{cost:.0f}", place, 0.18)
        text = fleet_view.title(robot, frame.fleet.tasks)
        self._write(self._title, text, (low[0] - 0.4, high[1] + 0.25), 0.2)
        self._write(self._iterations, fleet_view.iterations(robot), (high[0], low[1] - 0.05), 0.18)

    # -- handles, sent again when they change ---------------------------------------------------

    def _mesh(
        self,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        count: int,
        opacity: float | None = None,
    ) -> Any:
        return self._scene.add_batched_meshes_simple(
            f"/{name}",
            vertices.astype(np.float32),
            faces.astype(np.uint32),
            np.tile(np.array([1.0, 0, 0, 0], np.float32), (count, 1)),
            np.full((count, 3), _AWAY, np.float32),
            batched_scales=np.ones((count, 3), np.float32),
            batched_colors=np.zeros((count, 3), np.uint8),
            lod="off",
            material="toon3",
            opacity=opacity,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _segments(self, name: str, color: tuple[int, int, int], width: float) -> Any:
        points = np.full((_PAD, 2, 3), _AWAY, np.float32)
        return self._scene.add_line_segments(
            f"/{name}", points, color, thickness=width, thickness_units="screen"
        )

    def _label(self, name: str, anchor: Any) -> Any:
        return self._scene.add_label(
            f"/{name}",
            "",
            font_size_mode="scene",
            font_scene_height=SMALLEST,
            anchor=anchor,
            visible=False,
        )

    def _squares(self, name: str, squares: Squares) -> None:
        scales = np.concatenate([squares.sizes, np.ones((len(squares.sizes), 1))], 1)
        half = squares.angles / 2
        turns = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], -1)
        self._put(self._meshes[name], name, squares.centers, scales, squares.colors, turns)

    def _disks(self, name: str, disks: Disks) -> None:
        scales = np.tile(disks.radii[:, None], (1, 3))
        self._put(self._meshes[name], name, disks.centers, scales, disks.colors)

    def _put(
        self,
        handle: Any,
        name: str,
        centers: np.ndarray,
        scales: np.ndarray,
        colors: np.ndarray,
        turns: np.ndarray | None = None,
    ) -> None:
        count = len(handle.batched_positions)
        self._set(handle, name, "batched_positions", _padded(centers, count, _AWAY))
        self._set(handle, name, "batched_scales", _padded(scales, count, 1e-6))
        self._set(handle, name, "batched_colors", _padded(_linear(colors), count, 0))
        if turns is not None:
            self._set(handle, name, "batched_wxyzs", _padded(turns, count, 0.5))

    def _put_lines(self, name: str, points: np.ndarray, colors: np.ndarray | None = None) -> None:
        count = _PAD * max(1, -(-len(points) // _PAD))
        self._set(self._lines[name], name, "points", _padded(points, count, _AWAY))
        if colors is not None:
            colors = _linear(colors)
            self._set(self._lines[name], name, "colors", _padded(colors, count, 0))

    def _set(self, handle: Any, name: str, attribute: str, value: np.ndarray) -> None:
        value = value.astype(np.uint8 if attribute.endswith("colors") else np.float32)
        before = self._sent.get((name, attribute))
        if before is None or before.shape != value.shape or (before != value).any():
            self._sent[name, attribute] = value
            setattr(handle, attribute, value)

    @staticmethod
    def _write(handle: Any, text: str, place: tuple[float, float], height: float) -> None:
        if handle.visible != bool(text):
            handle.visible = bool(text)
        if not text:
            return
        if handle.text != text:
            handle.text = text
        if handle.font_scene_height != height:
            handle.font_scene_height = height
        position = np.array([*place, 0.1])
        if (handle.position != position).any():
            handle.position = position


def _disk(sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a disk with radius 1."""
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    corners = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    fan = np.array([[0, 1 + i, 1 + (i + 1) % sides] for i in range(sides)])
    return np.concatenate([np.zeros((1, 3)), corners]), fan


def _linear(colors: np.ndarray) -> np.ndarray:
    """Convert [..., 3] sRGB colours (0..255) to linear ones, which viser wants for instances."""
    return np.round(255 * (np.asarray(colors) / 255) ** 2.2)


def _padded(rows: np.ndarray, count: int, value: float) -> np.ndarray:
    """Pad [M, ...] with `value` to [count, ...]."""
    assert len(rows) <= count, f"{len(rows)} rows, but room for {count}"
    rest = np.full((count - len(rows), *rows.shape[1:]), value)
    return np.concatenate([np.asarray(rows, float), rest])
