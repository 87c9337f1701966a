"""The shelf and what stands on it: its standard sizes, their limits, and the type `Shelf`.

Metres, kg; x into the shelf, y left. The standard is that of the published scenes, as measured, and
the constants of the physics were fitted to it: to objects of its radius, mass and friction.
"""

from typing import Any, NamedTuple

import numpy as np

FRONT_X = 0.20  # the table's front edge: an object with its centre before it would fall
BACK_WALL_X = 0.59
SIDE_WALL_Y = 0.40
WIDTH, DEPTH = 2 * SIDE_WALL_Y, 0.39  # between the side walls; from the front to the back wall
RADIUS = 0.03
HEIGHT = 0.10
MASS = 1.0
TABLE_FRICTION = 0.5  # coefficient of an object on the table
FRICTION = 0.3  # of an object and other bodies

# What a scene may have, low and high.
RADII = (0.015, 0.05)
GOAL_RADIUS = 0.035  # at most: the open hand's gap is 77 mm
HEIGHTS = (0.06, 0.20)
SLENDER = 4.0  # at most so many radii high: a higher object tips, which no plane can show
MASSES = (0.05, 5.0)
TABLE_FRICTIONS = (0.1, 1.0)
FRICTIONS = (0.05, 1.0)
WIDTHS = (0.4, 1.6)
DEPTHS = (0.2, 0.8)


class Shelf(NamedTuple):
    """Objects and walls where they are not all standard: [N] each, but for the walls' places.

    Attributes:
      radius, height: of the objects, m.
      mass: kg.
      table_friction: coefficient of each object on the table.
      friction: of each object and the standard hand, wall or object; against others it is in
        proportion, and that of two objects is the larger one.
      back_x, side_y: [] faces of the walls, m.
    """

    radius: Any
    height: Any
    mass: Any
    table_friction: Any
    friction: Any
    back_x: Any
    side_y: Any


def standard_shelf(n_objects: int) -> Shelf:
    """The standard shelf with N standard objects."""
    values = (RADIUS, HEIGHT, MASS, TABLE_FRICTION, FRICTION)
    columns = [np.full(n_objects, value) for value in values]
    return Shelf._make([*columns, np.array(BACK_WALL_X), np.array(SIDE_WALL_Y)])


class OnShelf:
    """Sizes of objects that have a `Shelf`, or are standard; a mix-in of what is seen of a shelf.

    Attributes:
      objects: [N, ...].
      shelf: [N] each; None: standard.
    """

    objects: np.ndarray
    shelf: Shelf | None

    @property
    def radii(self) -> np.ndarray:
        """[N] m."""
        return self._of_objects("radius", RADIUS)

    @property
    def heights(self) -> np.ndarray:
        """[N] m."""
        return self._of_objects("height", HEIGHT)

    @property
    def larger(self) -> np.ndarray:
        """[N] how much larger the radii are than the standard one, m."""
        return self.radii - RADIUS

    @property
    def back_x(self) -> float:
        """Where the back wall is, m."""
        return BACK_WALL_X if self.shelf is None else float(self.shelf.back_x)

    @property
    def side_y(self) -> float:
        """Where the left wall is, m; the right one is at minus that."""
        return SIDE_WALL_Y if self.shelf is None else float(self.shelf.side_y)

    def _of_objects(self, field: str, usual: float) -> np.ndarray:
        if self.shelf is None:
            return np.full(len(self.objects), usual)
        return np.asarray(getattr(self.shelf, field), float)
