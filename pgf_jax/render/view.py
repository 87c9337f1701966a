"""The interface of the two views that draw a shelf: from above, and in three dimensions."""

from typing import Protocol

import numpy as np

from pgf_jax.simulation.snapshot import RobotSnapshot


class ShelfView(Protocol):
    """Draws one robot and its shelf; one object draws all robots, in any size."""

    def shelf(self, robot: RobotSnapshot, width: int, height: int) -> np.ndarray:
        """Draw the robot, its objects, path and push: [height, width, 3] uint8."""
        ...

    def close(self) -> None:
        """Free all resources; the view must not draw afterwards."""
        ...


def make_view(name: str) -> ShelfView:
    """Make the view `top` or `3d`.

    Raises:
      BadInput: `3d`, on a computer without EGL.
    """
    if name == "top":
        from pgf_jax.render.top import TopView

        return TopView()
    from pgf_jax.render.shelf3d import View3d

    return View3d()
