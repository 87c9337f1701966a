"""The type `Scene`: upright cylinders on a shelf, one of them the goal, and its checks."""

import dataclasses
import operator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.scene import shelf
from pgf_jax.scene.shelf import FRONT_X, Shelf

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The published scenes hold pairs whose centres are 0.060 m apart to within rounding.
OVERLAP_TOLERANCE = 5e-4
MOST_OBJECTS = 120  # hexagonal packing has room for 108 standard ones on the standard shelf
_SAME = 1e-6  # m: a radius that is standard to within rounding

# Of an object, beside its place and radius: field of `Scene`, in words, standard, limits, unit.
_PROPERTIES = (
    ("heights", "height", shelf.HEIGHT, shelf.HEIGHTS, " m"),
    ("masses", "mass", shelf.MASS, shelf.MASSES, " kg"),
    ("table_frictions", "table friction", shelf.TABLE_FRICTION, shelf.TABLE_FRICTIONS, ""),
    ("frictions", "friction", shelf.FRICTION, shelf.FRICTIONS, ""),
)


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A shelf before the robot moves; objects are seen as disks on a plane.

    Arrays are float64 and read-only. Limits and standard values stand in `shelf.py`.

    Attributes:
      name: the file's stem, or the preset and seed; names the plan file.
      objects: [N, 3] (x, y, radius) in metres of each movable object.
      goal: index in `objects` of the object to reach.
      source: the MJCF file that it was read from; None: it was not.
      heights: [N] of the objects, m; None: all standard, as the three below.
      masses: [N] kg.
      table_frictions: [N] coefficients of the objects on the table.
      frictions: [N] coefficients of the objects and other bodies, see `Shelf`.
      width: of the shelf between its side walls, m.
      depth: from the shelf's front, which is always at x 0.20 m, to its back wall, m.

    Raises:
      BadInput: the scene cannot be simulated; the message names it, the value and what is expected.
    """

    name: str
    objects: np.ndarray  # [N, 3]
    goal: int
    source: Path | None = None
    heights: np.ndarray | None = None
    masses: np.ndarray | None = None
    table_frictions: np.ndarray | None = None
    frictions: np.ndarray | None = None
    width: float = shelf.WIDTH
    depth: float = shelf.DEPTH

    def __post_init__(self) -> None:
        objects = self._numbers("objects", self.objects, "[N, 3] (x, y, radius)")
        try:
            goal = operator.index(self.goal)
        except TypeError:
            raise BadInput(
                f"scene {self.name}: goal index must be a whole number, got {short_repr(self.goal)}"
            ) from None
        object.__setattr__(self, "goal", goal)
        object.__setattr__(self, "objects", objects)
        for field, words, *_ in _PROPERTIES:
            values = getattr(self, field)
            if values is not None:
                object.__setattr__(self, field, self._numbers(field, values, f"[N] {words}"))
        for field in ("width", "depth"):
            object.__setattr__(self, field, float(self._numbers(field, getattr(self, field), "[]")))
        validate(self)

    def _numbers(self, field: str, values: Any, expected: str) -> np.ndarray:
        try:
            array = np.array(values, dtype=np.float64)
            if expected == "[]" and array.ndim:
                raise ValueError
        except (TypeError, ValueError, OverflowError):  # an int of hundreds of digits overflows
            what = "a number" if expected == "[]" else f"numbers {expected}"
            raise BadInput(
                f"scene {self.name}: {field} must be {what}, got {short_repr(values)}"
            ) from None
        array.setflags(write=False)
        return array

    @property
    def positions(self) -> np.ndarray:
        """[N, 2] centres in metres."""
        return self.objects[:, :2]

    @property
    def radii(self) -> np.ndarray:
        """[N] m."""
        return self.objects[:, 2]

    @property
    def back_x(self) -> float:
        """Where the back wall is, m."""
        return shelf.BACK_WALL_X if self.depth == shelf.DEPTH else FRONT_X + self.depth

    @property
    def side_y(self) -> float:
        """Where the left wall is, m; the right one is at minus that."""
        return self.width / 2

    @property
    def shelf(self) -> Shelf | None:
        """The shelf with its objects' sizes, masses and frictions; None: all are standard."""
        given = {
            field: np.full(len(self.objects), usual) if values is None else values
            for field, _, usual, *_ in _PROPERTIES
            for values in [getattr(self, field)]
        }
        standard = (
            np.allclose(self.radii, shelf.RADIUS, rtol=0, atol=_SAME)
            and all((given[field] == usual).all() for field, _, usual, *_ in _PROPERTIES)
            and (self.width, self.depth) == (shelf.WIDTH, shelf.DEPTH)
        )
        if standard:
            return None
        walls = (np.array(self.back_x), np.array(self.side_y))
        return Shelf._make([self.radii, *given.values(), *walls])

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
    for field, limits in (("width", shelf.WIDTHS), ("depth", shelf.DEPTHS)):
        _check_limits(f"scene {name}: the shelf", field, getattr(scene, field), limits, " m")
    _check_properties(scene)
    _check_places(scene)


def _check_limits(
    owner: str, what: str, value: float, limits: tuple[float, float], unit: str
) -> None:
    low, high = limits
    if not low - 1e-9 <= value <= high + 1e-9:  # not where it is not a number
        raise BadInput(
            f"{owner} has {what} {value:g}{unit}; expected within {low:g}..{high:g}{unit}"
        )


def _check_properties(scene: Scene) -> None:
    """Check radius, height, mass and friction of each object."""
    name, count = scene.name, len(scene.objects)
    for i, radius in enumerate(scene.radii):
        _check_limits(f"scene {name}: object_{i + 1}", "radius", radius, shelf.RADII, " m")
    goal_radius = scene.radii[scene.goal]
    if goal_radius > shelf.GOAL_RADIUS + _SAME:
        raise BadInput(
            f"scene {name}: the goal, object_{scene.goal + 1}, has radius {goal_radius:g} m; "
            f"expected at most {shelf.GOAL_RADIUS:g} m, so that it fits into the open hand"
        )
    for field, words, _, limits, unit in _PROPERTIES:
        values = getattr(scene, field)
        if values is None:
            continue
        if values.shape != (count,):
            raise BadInput(
                f"scene {name}: {field} must be [{count}], one of each object, "
                f"got shape {values.shape}"
            )
        for i, value in enumerate(values):
            _check_limits(f"scene {name}: object_{i + 1}", words, value, limits, unit)
    heights = np.full(count, shelf.HEIGHT) if scene.heights is None else scene.heights
    most = shelf.SLENDER * scene.radii
    high = np.flatnonzero(heights > most + _SAME)
    if len(high):
        i = high[0]
        raise BadInput(
            f"scene {name}: object_{i + 1} is {heights[i]:g} m high at a radius of "
            f"{scene.radii[i]:g} m, and would tip; expected at most {most[i]:g} m, "
            f"{shelf.SLENDER:g} radii"
        )


def _check_places(scene: Scene) -> None:
    """Check that objects are on the shelf, and clear of each other."""
    objects, name = scene.objects, scene.name
    x, y, r = objects.T
    back, side = scene.back_x, scene.side_y
    outside = np.flatnonzero(
        (x < FRONT_X)
        | (x + r > back + OVERLAP_TOLERANCE)
        | (np.abs(y) + r > side + OVERLAP_TOLERANCE)
    )
    if len(outside):
        i = outside[0]
        raise BadInput(
            f"scene {name}: object_{i + 1} at ({x[i]:g}, {y[i]:g}) is outside the shelf; "
            f"expected {FRONT_X:g} <= x <= {back - r[i]:g}, |y| <= {side - r[i]:g}"
        )
    gap = np.linalg.norm(objects[:, None, :2] - objects[None, :, :2], axis=-1) - (r[:, None] + r)
    gap[np.tril_indices(len(objects))] = np.inf
    i, j = np.unravel_index(np.argmin(gap), gap.shape)
    if gap[i, j] < -OVERLAP_TOLERANCE:
        raise BadInput(
            f"scene {name}: object_{i + 1} and object_{j + 1} overlap by "
            f"{-1e3 * gap[i, j]:.1f} mm; expected centres at least {r[i] + r[j]:g} m apart"
        )
