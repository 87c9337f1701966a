"""Where every shelf is drawn: the page as a poster, and back from a click to a place on a shelf.

The poster has `WIDTH` x `HEIGHT` units; the camera looks at it from straight ahead. Each robot has
a cell: its shelf from above (x into the shelf points up, as the robot sees it), a caption over it,
its cost curve under it. While a robot is served, its shelf is drawn once more, large, with the wall
as a strip below.
"""

import dataclasses

import numpy as np

WIDTH, HEIGHT = 12.0, 10.0
STRIP = 3.1  # height of the wall while a shelf is shown large
# A cell, in metres of its shelf: captions and curve are as large as they would be on it.
CELL_WIDTH, CELL_HEIGHT = 0.90, 1.10
SHELF_V = 0.25  # of x = 0 over the cell's lower edge
CURVE_V = (0.02, 0.17)  # the curve's strip
LARGE_TOP = 0.89  # a large shelf's cell goes from over the curve to under the caption
LARGE_CURVE = (4.1, 2.6)  # width and height beside a large shelf, units
GAP = 0.15


@dataclasses.dataclass(frozen=True)
class Cell:
    """Where a shelf is drawn.

    Attributes:
      x, y: its lower left corner, units.
      scale: units a metre.
      large: drawn with numbers on the objects and its curve beside it.
    """

    x: float
    y: float
    scale: float
    large: bool = False

    def place(self, points: np.ndarray) -> np.ndarray:
        """[..., 2] (x, y) on the shelf, m -> the same on the poster, units."""
        points = np.asarray(points, float)
        u, v = CELL_WIDTH / 2 - points[..., 1], SHELF_V + points[..., 0]
        return np.stack([self.x + self.scale * u, self.y + self.scale * v], -1)

    def shelf(self, x: float, y: float) -> tuple[float, float]:
        """A place on the poster, units -> on the shelf, m."""
        u, v = (x - self.x) / self.scale, (y - self.y) / self.scale
        return v - SHELF_V, CELL_WIDTH / 2 - u

    def contains(self, x: float, y: float) -> bool:
        """Whether a place on the poster is in this cell."""
        inside_x = self.x <= x <= self.x + self.scale * CELL_WIDTH
        return inside_x and 0 <= (y - self.y) / self.scale <= CELL_HEIGHT


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where all shelves are drawn.

    Attributes:
      cells: of each robot; empty where only one is shown, large.
      large: of the robot that is served, or of the only one.
      served: that robot, or None.
    """

    cells: tuple[Cell, ...]
    large: Cell | None
    served: int | None

    @classmethod
    def of(cls, robots: int, served: int | None) -> "Layout":
        """The layout of a fleet of so many robots."""
        if robots == 1:
            return cls((), _large(0.0), 0)
        if served is None:
            return cls(_grid(robots, HEIGHT), None, None)
        return cls(_grid(robots, STRIP), _large(STRIP), served)

    def find(self, x: float, y: float) -> tuple[int | None, float, float]:
        """What is at a place on the poster: robot or None, and where on its shelf, m."""
        if self.large is not None and self.large.contains(x, y):
            return self.served, *self.large.shelf(x, y)
        for robot, cell in enumerate(self.cells):
            if cell.contains(x, y):
                return robot, *cell.shelf(x, y)
        return None, 0.0, 0.0


def _grid(robots: int, height: float) -> tuple[Cell, ...]:
    """As large as they can be, row by row from the top."""

    def scale(columns: int) -> float:
        rows = -(-robots // columns)
        return min(WIDTH / columns / CELL_WIDTH, height / rows / CELL_HEIGHT)

    columns = max(range(1, robots + 1), key=scale)
    size, rows = scale(columns), -(-robots // columns)
    step_x, step_y = WIDTH / columns, height / rows
    return tuple(
        Cell(
            (i % columns) * step_x + (step_x - size * CELL_WIDTH) / 2,
            height - (i // columns + 1) * step_y,
            0.97 * size,
        )
        for i in range(robots)
    )


def _large(below: float) -> Cell:
    room_x = WIDTH - LARGE_CURVE[0] - GAP
    scale = min(room_x / CELL_WIDTH, (HEIGHT - below - GAP) / (LARGE_TOP - CURVE_V[1]))
    height = scale * (LARGE_TOP - CURVE_V[1])
    bottom = below + (HEIGHT - below - height) / 2
    return Cell(0.0, bottom - scale * CURVE_V[1], scale, large=True)
