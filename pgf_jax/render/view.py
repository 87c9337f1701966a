"""What draws a shelf: from above, or in three dimensions."""

from typing import Protocol

import numpy as np

from pgf_jax.simulation.snapshot import RobotSnapshot

ASPECT = 1.2  # width to height at which the views fill their pictures best


class View(Protocol):
    """Draws one robot and its shelf; what it sets up serves for all robots and sizes."""

    def shelf(self, robot: RobotSnapshot, width: int, height: int) -> np.ndarray:
        """[height, width, 3] uint8: the robot, its objects, path and push."""
        ...

    def close(self) -> None:
        """Free what it holds; it draws nothing afterwards."""
        ...


def make_view(name: str) -> View:
    """The view `top` or `3d`.

    Raises:
      BadInput: `3d`, where nothing can be drawn in three dimensions.
    """
    if name == "top":
        from pgf_jax.render.top import TopView

        return TopView()
    from pgf_jax.render.shelf3d import ShelfView

    return ShelfView()
