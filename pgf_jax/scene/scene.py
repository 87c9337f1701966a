"""The type `Scene`: upright cylinders on a shelf, one of them the goal, and its checks."""

import dataclasses
import operator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgf_jax.errors import BadInput, short_repr

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The shelf and its objects, as measured on the published scenes. Metres; x into the shelf, y left.
FRONT_X = 0.20  # the table's front edge: an object with its centre before it would fall
BACK_WALL_X = 0.59
SIDE_WALL_Y = 0.40
RADIUS = 0.03
HEIGHT = 0.10
# The published scenes hold pairs whose centres are 0.060 m apart to within rounding.
OVERLAP_TOLERANCE = 5e-4
MOST_OBJECTS = 120  # hexagonal packing has room for 108


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A shelf before the robot moves; objects are seen as disks on a plane.

    Attributes:
      name: the file's stem, or the preset and seed; names the plan file.
      objects: [N, 3] float64, read-only, (x, y, radius) in metres of each movable object.
      goal: index in `objects` of the object to reach.
      source: the scene file that it was read from; None: it was not.

    Raises:
      BadInput: the scene cannot be simulated; the message names it, the value and what is expected.
    """

    name: str
    objects: np.ndarray  # [N, 3]
    goal: int
    source: Path | None = None

    def __post_init__(self) -> None:
        try:
            objects = np.array(self.objects, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):  # an int of hundreds of digits overflows
            raise BadInput(
                f"scene {self.name}: objects must be numbers [N, 3] (x, y, radius), "
                f"got {short_repr(self.objects)}"
            ) from None
        try:
            goal = operator.index(self.goal)
        except TypeError:
            raise BadInput(
                f"scene {self.name}: goal index must be a whole number, got {short_repr(self.goal)}"
            ) from None
        objects.setflags(write=False)
        object.__setattr__(self, "goal", goal)
        object.__setattr__(self, "objects", objects)
        validate(self)

    @property
    def positions(self) -> np.ndarray:
        """[N, 2] centres in metres."""
        return self.objects[:, :2]

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the shelf from above.

        Args:
          ax: matplotlib axes to draw into; None: those of a new figure (`ax.figure`).
        """
        from pgf_jax.scene.draw import draw_scene

        return draw_scene(self, ax, legend=True)


def validate(scene: Scene) -> None:
    """Raise BadInput, naming the scene and the value, unless the scene can be simulated."""
    objects, name = scene.objects, scene.name
    if objects.ndim != 2 or objects.shape[1:] != (3,) or len(objects) == 0:
        raise BadInput(
            f"scene {name}: objects must be [N, 3] (x, y, radius), got shape {objects.shape}"
        )
    if len(objects) > MOST_OBJECTS:
        raise BadInput(
            f"scene {name}: has {len(objects)} objects; expected at most {MOST_OBJECTS}, "
            f"more find no room on the shelf"
        )
    bad = np.flatnonzero(~np.isfinite(objects).all(axis=1))
    if len(bad):
        raise BadInput(
            f"scene {name}: object_{bad[0] + 1} has (x, y, radius) = "
            f"({', '.join(f'{v:g}' for v in objects[bad[0]])}); expected finite numbers"
        )
    if not 0 <= scene.goal < len(objects):
        raise BadInput(
            f"scene {name}: goal index must be within 0..{len(objects) - 1}, got {scene.goal}"
        )
    odd = np.flatnonzero(np.abs(objects[:, 2] - RADIUS) > 1e-6)
    if len(odd):
        raise BadInput(
            f"scene {name}: object_{odd[0] + 1} has radius {objects[odd[0], 2]:g} m; "
            f"only cylinders of radius {RADIUS} m are supported"
        )
    x, y, r = objects.T
    outside = np.flatnonzero(
        (x < FRONT_X)
        | (x + r > BACK_WALL_X + OVERLAP_TOLERANCE)
        | (np.abs(y) + r > SIDE_WALL_Y + OVERLAP_TOLERANCE)
    )
    if len(outside):
        i = outside[0]
        raise BadInput(
            f"scene {name}: object_{i + 1} at ({x[i]:g}, {y[i]:g}) is outside the shelf; "
            f"expected {FRONT_X:g} <= x <= {BACK_WALL_X - RADIUS:g}, "
            f"|y| <= {SIDE_WALL_Y - RADIUS:g}"
        )
    gap = np.linalg.norm(objects[:, None, :2] - objects[None, :, :2], axis=-1) - (r[:, None] + r)
    gap[np.tril_indices(len(objects))] = np.inf
    i, j = np.unravel_index(np.argmin(gap), gap.shape)
    if gap[i, j] < -OVERLAP_TOLERANCE:
        raise BadInput(
            f"scene {name}: object_{i + 1} and object_{j + 1} overlap by "
            f"{-1e3 * gap[i, j]:.1f} mm; expected centres at least {r[i] + r[j]:g} m apart"
        )


def class_of(scene: Scene) -> str:
    """Class of a sampled scene, which its name begins with; `file` for other scenes."""
    head = scene.name.split("_")[0]
    return head if head in ("tight", "medium", "wide") else "file"
