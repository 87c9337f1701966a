"""Random scenes that look like the published ones, in their three classes.

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
"""

import bisect
import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Literal, Union, get_args

import numpy as np

from pgf_jax.errors import BadInput, kind_of
from pgf_jax.scene.scene import RADIUS, Scene
from pgf_jax.scene.statistics import corridor_count
from pgf_jax.settings import check_choice

if TYPE_CHECKING:
    import jax

SceneClass = Literal["tight", "medium", "wide"]
PRESETS: tuple[SceneClass, ...] = get_args(SceneClass)  # the order decides the draws: append only
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

Uniforms = Iterator[float]
Point = tuple[float, float]


def sample_scene(
    key: Union[int, np.ndarray, "jax.Array"], preset: str = "tight", *, name: str | None = None
) -> Scene:
    """Draw a scene of 20 cylinders of radius 0.03 m, the goal being `object_3` (index 2).

    The same key and preset give the same scene to the last bit on every platform: the draws are
    raw PCG64 output (which NumPy guarantees) and the arithmetic is IEEE's four operations.

    Args:
      key: a JAX key, typed or raw uint32 words, or a seed in 0..2**64-1; seed `s` is the key
        `jax.random.key(s)`. The key is consumed. Not to be traced: this runs on the host.
      preset: `tight`, `medium` or `wide`.
      name: the scene's name; by default the preset and the key as a number, `tight_7`.

    Returns:
      A valid Scene; centres are never less than 0.060 m apart.

    Raises:
      BadInput: an unknown preset, or not a key or seed.

    Source: the classes of the published scenes (Papallas & Dogar 2022), as measured.
    """
    check_choice("preset", preset, PRESETS)
    words = _key_words(key)
    if name is None:
        name = f"{preset}_{sum(w << 32 * i for i, w in enumerate(reversed(words)))}"
    uniforms = _uniforms(words, stream=PRESETS.index(preset))
    tight = preset == "tight" or (preset == "medium" and next(uniforms) < _TIGHT_SHARE)
    while True:
        if tight:
            centres = _pack(_goal_in_back_row, _TIGHT_X, _TIGHT_Y, uniforms)
        else:
            centres = _pack(_goal_anywhere, _WIDE_X, _WIDE_Y, uniforms)
        scene = Scene(name, np.array([(x, y, RADIUS) for x, y in centres]), GOAL)
        if not tight or corridor_count(scene) > 0:
            return scene


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
