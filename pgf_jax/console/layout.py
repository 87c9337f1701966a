"""The layout of the page: maps places on shelves to places on the drawing, and clicks back.

The drawing is a plane of `WIDTH` x `HEIGHT` units; the camera looks at it from straight ahead. Each
robot has a cell: its shelf from above (x into the shelf points up, as the robot sees it), a caption
above and its cost curve below. While a robot is served, its shelf is drawn once more, large, above
the cells.
"""

import dataclasses

import numpy as np

WIDTH, HEIGHT = 12.0, 10.0
STRIP = 3.1  # height of the grid of cells while a shelf is drawn large
# The parts of a cell, in metres on the scale of its shelf.
CELL_WIDTH, CELL_HEIGHT = 0.90, 1.16
SHELF_V = 0.25  # height of x = 0 above the cell's lower edge
CURVE_V = (0.02, 0.17)  # lower and upper edge of the curve
LARGE_TOP = 0.89  # upper edge of a large cell, which has neither curve nor caption in it
LARGE_CURVE = (4.1, 2.6)  # width and height beside a large shelf, units
GAP = 0.15


@dataclasses.dataclass(frozen=True)
class Cell:
    """The place where one shelf is drawn.

    Attributes:
      x, y: its lower left corner, units.
      scale: units per metre.
      large: whether objects have numbers, and the curve is beside the shelf.
    """

    x: float
    y: float
    scale: float
    large: bool = False

    def place(self, points: np.ndarray) -> np.ndarray:
        """Map places on the shelf to the drawing: [..., 2] m -> [..., 2] units."""
        points = np.asarray(points, float)
        u, v = CELL_WIDTH / 2 - points[..., 1], SHELF_V + points[..., 0]
        return np.stack([self.x + self.scale * u, self.y + self.scale * v], -1)

    def shelf(self, x: float, y: float) -> tuple[float, float]:
        """Map a place on the drawing (units) to the shelf: (x, y), m."""
        u, v = (x - self.x) / self.scale, (y - self.y) / self.scale
        return v - SHELF_V, CELL_WIDTH / 2 - u

    def contains(self, x: float, y: float) -> bool:
        """Whether a place on the drawing (units) is in this cell."""
        inside_x = self.x <= x <= self.x + self.scale * CELL_WIDTH
        return inside_x and 0 <= (y - self.y) / self.scale <= CELL_HEIGHT


@dataclasses.dataclass(frozen=True)
class Layout:
    """The places where all shelves are drawn.

    Attributes:
      cells: of each robot; empty for a single robot, which is drawn large only.
      large: cell of the robot that is served, or of the single robot.
      served: index of that robot, or None.
    """

    cells: tuple[Cell, ...]
    large: Cell | None
    served: int | None

    @classmethod
    def of(cls, robots: int, served: int | None) -> "Layout":
        """The layout of `robots` shelves, one of them large while it is served."""
        if robots == 1:
            return cls((), _large(0.0), 0)
        if served is None:
            return cls(_grid(robots, HEIGHT), None, None)
        return cls(_grid(robots, STRIP), _large(STRIP), served)

    def find(self, x: float, y: float) -> tuple[int | None, float, float]:
        """Find the shelf at a place on the drawing: robot or None, and (x, y) on its shelf, m."""
        if self.large is not None and self.large.contains(x, y):
            return self.served, *self.large.shelf(x, y)
        for robot, cell in enumerate(self.cells):
            if cell.contains(x, y):
                return robot, *cell.shelf(x, y)
        return None, 0.0, 0.0


def _grid(robots: int, height: float) -> tuple[Cell, ...]:
    """Cells in a grid, as large as possible, row by row from the top."""

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
