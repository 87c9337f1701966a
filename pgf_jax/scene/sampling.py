"""Random scenes: three classes that look like the published ones, and three that are hard.

Twenty cylinders are packed one after another: a place is drawn uniformly in the class's rectangle
and kept if it is 0.060 m or more from every centre before it (random sequential packing). This
alone reproduces the spacing of the published scenes. Classes differ in their rectangle and in where
the goal stands, so the goal is drawn first and the others around it. The classes:

* `tight` (published warehouse_1..1000): a dense rectangle, 0.25 m by 0.40 m, with the goal in its
  back row and at least one object in the straight corridor to it (a scene without one would be
  drawn again; in 60,000 scenes there was none).
* `wide` (2001..3000): the rectangle is the shelf, and the goal may stand anywhere in it.
* `medium` (1001..2000): tight or wide, about half each. The published files are such a
  mixture: 1001..1020 and 1250 lie in the tight rectangle, 1600 and 1900 in the wide one, and the
  quantiles of the whole thousand are those of half and half.

Statistics of 1,000 sampled scenes a class (seeds 0..999; `experiments/scene_statistics.py`) and of
the 1,000 published ones; nearest neighbours of 20 published scenes a class, of which the medium
20 are all of the tight half. Over 4,000 other seeds `medium` gives 0.280, 0.473, 0.523 and 2.9:
its 5 % quantile varies much between samples, since few goals stand that near the front.

                       goal x (m)           deeper    corridor   nearest neighbour (mm)
                       5, 50, 95 %          5, 95 %   mean       5, 50, 95 %
    tight   sampled    0.455, 0.486, 0.517  3, 8      4.1, >= 1  60.4, 65.2, 81.8
            published  0.455, 0.485, 0.518  3, 8      4.0, >= 1  60.6, 65.0, 78.5
    medium  sampled    0.289, 0.472, 0.531  2, 18     3.0        60.6, 69.0, 104.3
            published  0.281, 0.475, 0.526  2, 18     2.9
    wide    sampled    0.277, 0.413, 0.548  1, 19     1.9        61.2, 75.6, 114.3
            published  0.276, 0.413, 0.547  1, 19     1.9        61.3, 74.4, 115.0

The hard classes are packed in the same way on a shelf from wall to wall (centres in 0.27..0.56 by
+-0.36 m), with the goal in the back row (x 0.47..0.53, |y| <= 0.25 m): `crowded` has 36 standard
objects, `packed` 44, and `mixed` 20 to 36 of 20 to 40 mm radius (the goal at most 35), 60 to 160 mm
height (at most four radii) and 0.3 to 3 kg. Other numbers and sizes are options (`Sizes`).

Of 1,000 sampled scenes (seeds 0..999):

    class     goal x (m)             deeper   corridor    nearest neighbour (mm)
              5, 50, 95 %            5, 95 %  mean, least 5, 50, 95 %
    crowded   0.473, 0.499, 0.528    4, 12    4.7, 2      60.5, 66.2, 84.4
    packed    0.473, 0.500, 0.527    6, 14    5.7, 3      60.3, 63.6, 76.4
    mixed     0.474, 0.499, 0.527    2, 10    3.6, 1      53.1, 69.7, 99.8
"""

import bisect
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Literal, Union, get_args

import numpy as np

from pgf_jax.errors import BadInput, kind_of
from pgf_jax.scene import shelf
from pgf_jax.scene.scene import MOST_OBJECTS, Scene
from pgf_jax.scene.shelf import DEPTH, FRICTION, HEIGHT, MASS, RADIUS, TABLE_FRICTION, WIDTH
from pgf_jax.scene.statistics import corridor_count
from pgf_jax.settings import check_choice

if TYPE_CHECKING:
    import jax

SceneClass = Literal["tight", "medium", "wide", "crowded", "packed", "mixed"]
PRESETS: tuple[SceneClass, ...] = get_args(SceneClass)  # the order decides the draws: append only
PUBLISHED_CLASSES: tuple[SceneClass, ...] = PRESETS[:3]  # those of the published scenes
OBJECTS = 20
GOAL = 2  # object_3, as in the published scenes
MIN_SPACING = 2 * RADIUS

_TIGHT_X, _TIGHT_Y = (0.30, 0.55), (-0.20, 0.20)  # ranges of the centres, m
_WIDE_X, _WIDE_Y = (0.27, 0.56), (-0.35, 0.35)
# Of the medium scenes; with it the mean number of objects in the corridor is the published 2.9.
_TIGHT_SHARE = 0.475

# Tight goals: (share, x range, y range). On the 41 published scenes looked at the goal stands in
# one of these four patches of the back row, never straight ahead of the hand.
_BACK_ROW = (
    (0.27, (0.465, 0.492), (-0.200, -0.170)),
    (0.15, (0.483, 0.505), (-0.145, -0.120)),
    (0.48, (0.449, 0.515), (0.042, 0.115)),
    (0.10, (0.513, 0.523), (0.178, 0.200)),
)
_BACK_ROW_SHARES = tuple(itertools.accumulate(patch[0] for patch in _BACK_ROW))
# Wide goals: quantile functions of x and y as (probability, value) knots. Goals crowd the front
# edge (5 % before 0.276) and, so that the corridor holds 1.9 objects, a little the sides.
_ANYWHERE_X = (
    (0.00, 0.270),
    (0.05, 0.276),
    (0.12, 0.283),
    (0.50, 0.413),
    (0.90, 0.526),
    (0.95, 0.547),
    (1.00, 0.560),
)
_ANYWHERE_Y = ((0.00, -0.35), (0.25, -0.22), (0.75, 0.22), (1.00, 0.35))

_MAX_TRIES = 4000  # places tried before a packing is given up; a tight one takes some 250
_MAX_PACKINGS = 300  # of a crowded shelf; 50 standard objects take some 30, and 76 at most of 12

_CROWDED_X, _CROWDED_Y = (0.27, 0.56), (-0.36, 0.36)  # on the standard shelf
_DEEP_X, _DEEP_Y = (0.47, 0.53), (-0.25, 0.25)  # of the goal, there

Uniforms = Iterator[float]
Point = tuple[float, float]
Range = tuple[float, float]  # low and high; equal ones are a value


@dataclasses.dataclass(frozen=True)
class Sizes:
    """What a crowded shelf holds: each value is drawn evenly from a range.

    Attributes:
      objects: how many.
      radius: m; the goal's is at most 35 mm, since it has to fit into the open hand.
      height: m; at most four radii.
      mass: kg.
      table_friction, friction: coefficients, see `Scene`.
      width, depth: of the shelf, m.
    """

    objects: tuple[int, int] = (36, 36)
    radius: Range = (RADIUS, RADIUS)
    height: Range = (HEIGHT, HEIGHT)
    mass: Range = (MASS, MASS)
    table_friction: Range = (TABLE_FRICTION, TABLE_FRICTION)
    friction: Range = (FRICTION, FRICTION)
    width: float = WIDTH
    depth: float = DEPTH

    def __post_init__(self) -> None:
        limits = {
            "objects": (GOAL + 1, MOST_OBJECTS),
            "radius": shelf.RADII,
            "height": shelf.HEIGHTS,
            "mass": shelf.MASSES,
            "table_friction": shelf.TABLE_FRICTIONS,
            "friction": shelf.FRICTIONS,
        }
        for name, (least, most) in limits.items():
            low, high = getattr(self, name)
            if not least <= low <= high <= most:
                raise BadInput(
                    f"{name}: expected low and high within {least:g}..{most:g}, got {low}, {high}"
                )
        if self.radius[0] > shelf.GOAL_RADIUS:
            raise BadInput(
                f"radius: expected a low one of at most {shelf.GOAL_RADIUS:g} m, that of the goal, "
                f"got {self.radius[0]:g}"
            )


_SIZES = {
    "crowded": Sizes(),
    "packed": Sizes(objects=(44, 44)),
    "mixed": Sizes(objects=(20, 36), radius=(0.02, 0.04), height=(0.06, 0.16), mass=(0.3, 3.0)),
}


def sample_scene(
    key: Union[int, np.ndarray, "jax.Array"],
    preset: str = "tight",
    *,
    name: str | None = None,
    sizes: Sizes | None = None,
) -> Scene:
    """Draw a scene of a class, the goal being `object_3` (index 2).

    The same key and preset give the same scene to the last bit on every platform: the draws are
    raw PCG64 output (which NumPy guarantees) and the arithmetic is IEEE's four operations.

    Args:
      key: a JAX key, typed or raw uint32 words, or a seed in 0..2**64-1; seed `s` is the key
        `jax.random.key(s)`. The key is consumed. Not to be traced: this runs on the host.
      preset: `tight`, `medium`, `wide`, `crowded`, `packed` or `mixed`.
      name: the scene's name; by default the preset and the key as a number, `tight_7`.
      sizes: of the objects, in place of the class's own; with `crowded`, `packed` and `mixed` only.

    Returns:
      A valid Scene; its objects are clear of each other.

    Raises:
      BadInput: an unknown preset, not a key or seed, or more objects than find room.

    Source: the classes of the published scenes (Papallas & Dogar 2022), as measured.
    """
    check_choice("preset", preset, PRESETS)
    words = _key_words(key)
    if name is None:
        name = f"{preset}_{sum(w << 32 * i for i, w in enumerate(reversed(words)))}"
    uniforms = _uniforms(words, stream=PRESETS.index(preset))
    if preset in _SIZES or sizes is not None:
        own = sizes_of(preset)  # pyright: ignore[reportArgumentType]
        return _crowded(name, sizes or own, uniforms)
    tight = preset == "tight" or (preset == "medium" and next(uniforms) < _TIGHT_SHARE)
    while True:
        if tight:
            centres = _pack(_goal_in_back_row, _TIGHT_X, _TIGHT_Y, uniforms)
        else:
            centres = _pack(_goal_anywhere, _WIDE_X, _WIDE_Y, uniforms)
        scene = Scene(name, np.array([(x, y, RADIUS) for x, y in centres]), GOAL)
        if not tight or corridor_count(scene) > 0:
            return scene


def class_of(scene: Scene) -> str:
    """Class of a sampled scene, which its name begins with; `file` for other scenes."""
    head = scene.name.split("_")[0]
    return head if head in PRESETS else "file"


def sizes_of(scene_class: SceneClass) -> Sizes:
    """The sizes of a crowded class; BadInput for one of the published scenes'."""
    if scene_class not in _SIZES:
        raise BadInput(f"sizes: expected with {', '.join(_SIZES)}, got {scene_class}")
    return _SIZES[scene_class]


def most_objects(scene_class: SceneClass) -> int:
    """The largest number of objects in scenes of a class."""
    return _SIZES[scene_class].objects[1] if scene_class in _SIZES else OBJECTS


def _key_words(key) -> list[int]:
    """The key's 32-bit words, most significant first."""
    dtype = getattr(key, "dtype", None)
    plain = isinstance(dtype, np.dtype)
    if isinstance(key, int) or (plain and key.ndim == 0 and dtype.kind in "iu"):
        seed = int(key)
        if not 0 <= seed < 2**64:
            raise BadInput(f"seed {seed}: expected a whole number in 0..2**64-1")
        return [seed >> 32, seed & 0xFFFFFFFF]
    words = key
    if dtype is not None and not plain and str(dtype).startswith("key<"):
        import jax  # only a typed JAX key brings us here, so jax is imported already

        words = jax.random.key_data(key)
    if dtype is None or words.dtype != np.uint32 or words.ndim != 1 or words.size == 0:
        got = kind_of(key) if dtype is None else f"{dtype} of shape {key.shape}"
        raise BadInput(f"key: expected one JAX key (uint32 words) or a whole number, got {got}")
    return np.asarray(words).tolist()


def _uniforms(words: list[int], *, stream: int) -> Uniforms:
    """Endless uniforms in [0, 1) from the key."""
    # Raw bits, because NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
    bits = np.random.PCG64(np.random.SeedSequence(words, spawn_key=(stream,)))
    while True:
        for raw in bits.random_raw(512).tolist():
            yield (raw >> 11) * 2.0**-53


def _pack(
    draw_goal: Callable[[Uniforms], Point], x_range: Point, y_range: Point, uniforms: Uniforms
) -> list[Point]:
    """Centres by random sequential packing around a goal, in the scene's order."""
    while True:
        goal = draw_goal(uniforms)
        centres = [goal]
        for _ in range(_MAX_TRIES):
            x, y = _within(x_range, next(uniforms)), _within(y_range, next(uniforms))
            # Squares as products: a power goes through the platform's C library.
            if all((x - a) * (x - a) + (y - b) * (y - b) >= MIN_SPACING**2 for a, b in centres):
                centres.append((x, y))
                if len(centres) == OBJECTS:
                    others = centres[1:]
                    return [*others[:GOAL], goal, *others[GOAL:]]


def _crowded(name: str, sizes: Sizes, uniforms: Uniforms) -> Scene:
    """A crowded shelf: places are drawn until all objects have found room, the largest first."""
    for _ in range(_MAX_PACKINGS):
        scene = _try_crowded(name, sizes, uniforms)
        if scene is not None:
            return scene
    raise BadInput(
        f"sizes: {sizes.objects[1]} objects of up to {sizes.radius[1]:g} m radius find no room; "
        "expected fewer or smaller ones, or a larger shelf"
    )


def _try_crowded(name: str, sizes: Sizes, uniforms: Uniforms) -> Scene | None:
    low, high = sizes.objects
    count = min(low + int((high - low + 1) * next(uniforms)), high)
    radii = [_within(sizes.radius, next(uniforms)) for _ in range(count)]
    goal_radius = (sizes.radius[0], min(sizes.radius[1], shelf.GOAL_RADIUS))
    radii[GOAL] = _within(goal_radius, next(uniforms))
    heights = [
        _within((sizes.height[0], min(sizes.height[1], shelf.SLENDER * r)), next(uniforms))
        for r in radii
    ]
    others = [
        [_within(bounds, next(uniforms)) for _ in range(count)]
        for bounds in (sizes.mass, sizes.table_friction, sizes.friction)
    ]
    # Places are on a shelf of another size as near to its walls as on the standard one.
    deeper, wider = sizes.depth - DEPTH, sizes.width / WIDTH
    goal_x = _within(_DEEP_X, next(uniforms)) + deeper
    goal_y = _within(_DEEP_Y, next(uniforms)) * wider
    by_size = sorted((i for i in range(count) if i != GOAL), key=lambda i: -radii[i])
    placed = {GOAL: (goal_x, goal_y, radii[GOAL])}
    for i in by_size:
        more = radii[i] - RADIUS
        x_range = (_CROWDED_X[0], _CROWDED_X[1] + deeper - more)
        side = _CROWDED_Y[1] + (sizes.width - WIDTH) / 2 - more
        for _ in range(_MAX_TRIES):
            x, y = _within(x_range, next(uniforms)), _within((-side, side), next(uniforms))
            if all(
                (x - a) * (x - a) + (y - b) * (y - b) >= (radii[i] + r) * (radii[i] + r)
                for a, b, r in placed.values()
            ):
                placed[i] = (x, y, radii[i])
                break
        else:
            return None
    masses, table_frictions, frictions = (np.array(values) for values in others)
    return Scene(
        name,
        np.array([placed[i] for i in range(count)]),
        GOAL,
        heights=np.array(heights),
        masses=masses,
        table_frictions=table_frictions,
        frictions=frictions,
        width=sizes.width,
        depth=sizes.depth,
    )


def _goal_in_back_row(uniforms: Uniforms) -> Point:
    patch = bisect.bisect_right(_BACK_ROW_SHARES, next(uniforms))
    _, x_range, y_range = _BACK_ROW[min(patch, len(_BACK_ROW) - 1)]
    return _within(x_range, next(uniforms)), _within(y_range, next(uniforms))


def _goal_anywhere(uniforms: Uniforms) -> Point:
    return _quantile(_ANYWHERE_X, next(uniforms)), _quantile(_ANYWHERE_Y, next(uniforms))


def _within(bounds: Point, u: float) -> float:
    low, high = bounds
    return low + (high - low) * u


def _quantile(knots: tuple[Point, ...], u: float) -> float:
    """Value at probability u of a distribution given by (probability, value) knots."""
    for (p0, v0), (p1, v1) in itertools.pairwise(knots):
        if u < p1:
            return v0 + (v1 - v0) * (u - p0) / (p1 - p0)
    return knots[-1][1]
