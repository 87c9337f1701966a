"""Statistics of scenes: where the goal stands, and how much stands around it."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import RADIUS

START_EE = (0.1821, -0.0088)  # end-effector point of the robot at its start (0, 0, yaw 0), m
CORRIDOR_HALF_WIDTH = 0.065  # m
CORRIDOR_END_GAP = 0.01  # the corridor ends this far before the goal's centre, m


def corridor_mask(scene: Scene, ee: tuple[float, float] = START_EE) -> np.ndarray:
    """Mark the objects whose centre is in the straight corridor from the hand to the goal.

    The corridor runs from `ee` to 0.01 m before the goal's centre, 0.065 m to either side; the edge
    of an object counts, so that a larger one is in it from further aside.

    Args:
      scene: the shelf.
      ee: (x, y) of the end-effector point, metres; by default where the robot starts.

    Returns:
      [N] bool; never true for the goal itself.
    """
    dx, dy = scene.positions[:, 0] - ee[0], scene.positions[:, 1] - ee[1]  # [N] each
    length = np.sqrt(dx[scene.goal] ** 2 + dy[scene.goal] ** 2)
    if length == 0.0:
        return np.zeros(len(dx), dtype=bool)
    ux, uy = dx[scene.goal] / length, dy[scene.goal] / length
    along, across = dx * ux + dy * uy, dx * uy - dy * ux
    inside = (along > 0) & (along < length - CORRIDOR_END_GAP)
    inside &= np.abs(across) < CORRIDOR_HALF_WIDTH + (scene.radii - RADIUS)
    inside[scene.goal] = False
    return inside


def corridor_count(scene: Scene) -> int:
    """Number of objects in the straight corridor from the robot's start to the goal."""
    return int(np.count_nonzero(corridor_mask(scene)))


def deeper_count(scene: Scene) -> int:
    """Number of objects that stand deeper in the shelf (larger x) than the goal."""
    x = scene.positions[:, 0]
    return int(np.count_nonzero(x > x[scene.goal]))


def nearest_distances(scene: Scene) -> np.ndarray:
    """[N] distance in metres from each object's centre to the nearest other; inf for N = 1."""
    apart = scene.positions[:, None] - scene.positions[None]  # [N, N, 2]
    distance = np.sqrt((apart**2).sum(axis=-1))
    np.fill_diagonal(distance, np.inf)
    return distance.min(axis=1)


@dataclasses.dataclass(frozen=True)
class SceneStatistics:
    """Statistics of a set of scenes; lengths in metres, quantiles as (5, 50, 95 %).

    Attributes:
      scenes: how many scenes.
      x_range: smallest and largest x of any object's centre.
      y_range: the same for y.
      goal_x: quantiles of the goal's x.
      deeper: quantiles of the number of objects deeper than the goal.
      corridor_mean: mean number of objects in the straight corridor.
      corridor_min: the smallest such number.
      spacing_min: the smallest distance between two centres.
      nearest: quantiles of the distance from an object to its nearest neighbour.
      near_pairs: mean number of pairs a scene with centres less than 0.08 m apart.
    """

    scenes: int
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    goal_x: tuple[float, float, float]
    deeper: tuple[float, float, float]
    corridor_mean: float
    corridor_min: int
    spacing_min: float
    nearest: tuple[float, float, float]
    near_pairs: float


def scene_statistics(scenes: Sequence[Scene]) -> SceneStatistics:
    """Compute the statistics of a set of scenes; BadInput if it is empty."""
    if not scenes:
        raise BadInput("scene statistics: expected at least one scene, got none")
    x = np.concatenate([s.positions[:, 0] for s in scenes])
    y = np.concatenate([s.positions[:, 1] for s in scenes])
    nearest = np.concatenate([nearest_distances(s) for s in scenes])
    corridor = [corridor_count(s) for s in scenes]
    return SceneStatistics(
        scenes=len(scenes),
        x_range=(float(x.min()), float(x.max())),
        y_range=(float(y.min()), float(y.max())),
        goal_x=_quantiles([s.positions[s.goal, 0] for s in scenes]),
        deeper=_quantiles([deeper_count(s) for s in scenes]),
        corridor_mean=float(np.mean(corridor)),
        corridor_min=min(corridor),
        spacing_min=float(nearest.min()),
        nearest=_quantiles(nearest),
        near_pairs=float(np.mean([_near_pairs(s) for s in scenes])),
    )


def _near_pairs(scene: Scene, limit: float = 0.08) -> int:
    apart = scene.positions[:, None] - scene.positions[None]
    i, j = np.triu_indices(len(apart), 1)
    return int(np.count_nonzero((apart[i, j] ** 2).sum(axis=-1) < limit**2))


def _quantiles(values) -> tuple[float, float, float]:
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    return float(low), float(middle), float(high)
