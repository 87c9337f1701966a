"""Draws a scene from above: x (into the shelf) points up, y to the left, as the robot sees it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import FRONT_X
from pgf_jax.scene.statistics import (
    CORRIDOR_END_GAP,
    CORRIDOR_HALF_WIDTH,
    START_EE,
    corridor_mask,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOAL_COLOR = "#2e9e4f"
OBJECT_COLOR = "#c9c9c9"
CORRIDOR_OBJECT_COLOR = "#f0b27a"  # objects whose centre is in the straight corridor
CORRIDOR_COLOR = "#fdf1e3"
ROBOT_COLOR = "#1f4e9c"
_WALL_COLOR = "#7a5c3a"
_MOVED = 1e-3  # m; smaller displacements are not drawn


def draw_scene(
    scene: Scene,
    ax: Axes | None = None,
    *,
    ee_paths: np.ndarray | Sequence[np.ndarray] = (),
    end_positions: np.ndarray | None = None,
    corridor: bool = True,
    numbers: bool = True,
    title: str | None = None,
    legend: bool = False,
) -> Axes:
    """Draw a scene into matplotlib axes; horizontal is y, growing to the left, vertical is x.

    Args:
      scene: what to draw: the goal in `GOAL_COLOR`, objects in the straight corridor marked.
      ax: axes to draw into; by default those of a new figure (`ax.figure`), free of pyplot's state.
      ee_paths: paths of the end-effector point, metres: one [M, 2] or a sequence of them.
      end_positions: [N, 2] where the objects end, metres; moved ones are outlined, with an arrow.
      corridor: draw the straight corridor from the robot's start to the goal.
      numbers: write each object's number (from 1, as in its name object_N).
      title: by default the scene's name.
      legend: say below the axes what is what.

    Returns:
      The axes.

    Raises:
      BadInput: an array that does not have the shape above.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    paths = _paths(ee_paths)
    ends = _ends(end_positions, scene)
    if ax is None:
        ax = Figure(figsize=(7, 5.6), layout="constrained").add_subplot()

    _draw_shelf(ax, scene)
    if corridor:
        ax.add_patch(Polygon(_corridor_corners(scene)[:, ::-1], color=CORRIDOR_COLOR, zorder=1))
    blocking = corridor_mask(scene) if corridor else np.zeros(len(scene.objects), dtype=bool)
    for i, (x, y, radius) in enumerate(scene.objects):
        color = CORRIDOR_OBJECT_COLOR if blocking[i] else OBJECT_COLOR
        color = GOAL_COLOR if i == scene.goal else color
        ax.add_patch(Circle((y, x), radius, facecolor=color, edgecolor="black", zorder=2))
        if numbers:
            ax.text(y, x, str(i + 1), ha="center", va="center", fontsize=8, zorder=5)
    if ends is not None:
        for (x, y, radius), (end_x, end_y) in zip(scene.objects, ends, strict=True):
            if np.hypot(end_x - x, end_y - y) < _MOVED:
                continue
            outline = Circle((end_y, end_x), radius, fill=False, linestyle="--", zorder=4)
            ax.add_patch(outline)
            ax.annotate("", (end_y, end_x), (y, x), arrowprops={"arrowstyle": "->"}, zorder=4)
    for path in paths:
        ax.plot(path[:, 1], path[:, 0], color=ROBOT_COLOR, linewidth=1.2, zorder=4)
    ax.plot([0.0, START_EE[1]], [0.0, START_EE[0]], color=ROBOT_COLOR, linewidth=4, zorder=3)
    ax.plot(START_EE[1], START_EE[0], "o", color=ROBOT_COLOR, markersize=7, zorder=3)

    ax.set_aspect("equal")
    ax.set_xlim(scene.side_y + 0.03, -scene.side_y - 0.03)  # y grows to the left
    ax.set_ylim(-0.03, scene.back_x + 0.03)
    ax.set_xlabel("y (m)")
    ax.set_ylabel("x (m), into the shelf")
    ax.set_title(scene.name if title is None else title)
    if legend:
        _legend(ax, corridor=corridor, paths=bool(paths), moved=ends is not None)
    return ax


def save_top_view(
    scene: Scene,
    path: str | Path,
    *,
    dpi: int = 150,
    ee_paths: np.ndarray | Sequence[np.ndarray] = (),
    end_positions: np.ndarray | None = None,
    corridor: bool = True,
    numbers: bool = True,
    title: str | None = None,
) -> Path:
    """Write the picture of `draw_scene` to a file whose suffix is its format (`.png`, `.pdf`, ...).

    Returns:
      The path written.

    Raises:
      BadInput: arrays of the wrong shape, a format that matplotlib does not write, or a path that
        cannot be written; then no file is left behind.
    """
    from matplotlib.figure import Figure

    path = Path(path)
    figure = Figure(figsize=(7, 5.6), dpi=dpi, layout="constrained")
    formats = figure.canvas.get_supported_filetypes()
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in formats:
        raise BadInput(f"{path}: picture format {suffix!r}; expected one of {', '.join(formats)}")
    draw_scene(
        scene,
        figure.add_subplot(),
        ee_paths=ee_paths,
        end_positions=end_positions,
        corridor=corridor,
        numbers=numbers,
        title=title,
    )
    picture = io.BytesIO()  # drawn in full before the file is opened: nothing half-written
    figure.savefig(picture, format=suffix, dpi=dpi)
    try:
        path.write_bytes(picture.getvalue())
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be written ({error.strerror}); expected a path in an existing folder"
        ) from None
    return path


def _legend(ax: Axes, *, corridor: bool, paths: bool, moved: bool) -> None:
    """Say below the axes what is what; nothing of the drawing is covered."""
    from matplotlib.lines import Line2D

    def disk(color: str, label: str, edge: str = "black") -> Line2D:
        style = {"marker": "o", "markersize": 9, "linestyle": "none"}
        return Line2D([], [], markerfacecolor=color, markeredgecolor=edge, label=label, **style)

    handles = [disk(GOAL_COLOR, "goal"), disk(OBJECT_COLOR, "object")]
    if corridor:
        handles.append(disk(CORRIDOR_OBJECT_COLOR, "object in the straight corridor"))
    if moved:
        handles.append(
            Line2D([], [], color="black", linestyle="--", linewidth=1, label="where it ends")
        )
    hand = "hand at first, and the paths of its fingertips' middle" if paths else "hand at first"
    handles.append(Line2D([], [], color=ROBOT_COLOR, label=hand))
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.13),
        ncols=3,
        fontsize="small",
        frameon=False,
    )


def _draw_shelf(ax: Axes, scene: Scene) -> None:
    back, side = scene.back_x, scene.side_y
    ax.plot(
        [side, side, -side, -side],
        [FRONT_X, back, back, FRONT_X],
        color=_WALL_COLOR,
        linewidth=3,
        zorder=1,
    )
    ax.plot(
        [side, -side],
        [FRONT_X, FRONT_X],
        color=_WALL_COLOR,
        linewidth=1,
        linestyle=":",
        zorder=1,
    )


def _corridor_corners(scene: Scene) -> np.ndarray:
    """[4, 2] corners (x, y) of the straight corridor, metres."""
    start = np.array(START_EE)
    line = scene.positions[scene.goal] - start
    length = np.linalg.norm(line)
    along = line / length
    end = start + along * max(length - CORRIDOR_END_GAP, 0.0)
    side = CORRIDOR_HALF_WIDTH * np.array([-along[1], along[0]])
    return np.array([start + side, end + side, end - side, start - side])


def _paths(ee_paths: np.ndarray | Sequence[np.ndarray]) -> list[np.ndarray]:
    if isinstance(ee_paths, np.ndarray) and ee_paths.ndim == 2:
        ee_paths = [ee_paths]
    paths = [np.asarray(path, dtype=float) for path in ee_paths]
    for path in paths:
        if path.ndim != 2 or path.shape[1] != 2:
            raise BadInput(f"ee_paths: expected paths [M, 2] (x, y), got shape {path.shape}")
    return paths


def _ends(end_positions: np.ndarray | None, scene: Scene) -> np.ndarray | None:
    if end_positions is None:
        return None
    ends = np.asarray(end_positions, dtype=float)
    if ends.shape != scene.positions.shape:
        raise BadInput(
            f"end_positions: expected shape {scene.positions.shape} (x, y) of each object "
            f"of scene {scene.name}, got {ends.shape}"
        )
    return ends
