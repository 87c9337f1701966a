"""Draws how the world in which a robot acts differs from the one in which it checks."""

from typing import NamedTuple

import numpy as np

from pgf_jax.physics.worlds.config import WorldError
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import FRONT_X
from pgf_jax.streams import stream

_ROUNDS = 1000  # of moving overlaps apart; a few are enough unless the shelf is full


class Drawn(NamedTuple):
    """One draw of a world's error.

    Attributes:
      mass: [N] factors of the objects' masses.
      friction: [N] factors of the objects' friction, with the table and with each other.
      hand_friction: factor of the hand's.
      positions: [N, 2] where the objects stand, m.
    """

    mass: np.ndarray
    friction: np.ndarray
    hand_friction: float
    positions: np.ndarray


def draw(error: WorldError, scene: Scene, seed: int, *key: int) -> Drawn:
    """Draw the world that a robot acts in.

    Args:
      error: the spreads.
      scene: with the objects where the robot sees them.
      seed, key: of the draw: of the fleet, and the robot's number and its task's.
    """
    draws, n = stream(seed, "world-error", *key), len(scene.objects)
    mass = 1 + error.mass * draws.uniform(-1, 1, n)
    friction = 1 + error.friction * draws.uniform(-1, 1, n + 1)
    moved = scene.positions + error.position * draws.standard_normal((n, 2))
    return Drawn(mass, friction[:n], float(friction[n]), moved_apart(moved, scene))


def moved_apart(positions: np.ndarray, scene: Scene) -> np.ndarray:
    """Move objects apart that overlap, each by half, and onto the shelf.

    Args:
      positions: [N, 2] m.
      scene: with their radii, and the shelf.

    Returns:
      [N, 2] m.
    """
    positions, radii = np.array(positions, np.float64), scene.radii
    first, second = np.triu_indices(len(positions), 1)
    touching = radii[first] + radii[second]
    low = np.stack([np.full(len(radii), FRONT_X), radii - scene.side_y], axis=1)
    high = np.stack([scene.back_x - radii, scene.side_y - radii], axis=1)
    for _ in range(_ROUNDS):
        positions = np.clip(positions, low, high)
        apart = positions[second] - positions[first]
        distance = np.linalg.norm(apart, axis=1)
        overlap = touching - distance
        if overlap.max(initial=0.0) <= 1e-6:
            break
        along = np.where(distance[:, None] > 0, apart, [1.0, 0.0])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        step = 0.5 * np.maximum(overlap, 0.0)[:, None] * along
        np.add.at(positions, first, -step)
        np.add.at(positions, second, step)
    return positions
