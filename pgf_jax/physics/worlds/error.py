"""Draws how the world in which a robot acts differs from the one in which it checks."""

from typing import NamedTuple

import numpy as np

from pgf_jax.physics.worlds.config import WorldError
from pgf_jax.scene.scene import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y
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


def draw(error: WorldError, positions: np.ndarray, seed: int, *key: int) -> Drawn:
    """Draw the world that a robot acts in.

    Args:
      error: the spreads.
      positions: [N, 2] where the robot sees the objects, m.
      seed, key: of the draw: of the fleet, and the robot's number and its task's.
    """
    draws, n = stream(seed, "world-error", *key), len(positions)
    mass = 1 + error.mass * draws.uniform(-1, 1, n)
    friction = 1 + error.friction * draws.uniform(-1, 1, n + 1)
    moved = positions + error.position * draws.standard_normal((n, 2))
    return Drawn(mass, friction[:n], float(friction[n]), moved_apart(moved))


def moved_apart(positions: np.ndarray) -> np.ndarray:
    """Move objects apart that overlap, each by half, and onto the shelf; [N, 2] -> [N, 2], m."""
    positions = np.array(positions, np.float64)
    first, second = np.triu_indices(len(positions), 1)
    low = np.array([FRONT_X, RADIUS - SIDE_WALL_Y])
    high = np.array([BACK_WALL_X - RADIUS, SIDE_WALL_Y - RADIUS])
    for _ in range(_ROUNDS):
        positions = np.clip(positions, low, high)
        apart = positions[second] - positions[first]
        distance = np.linalg.norm(apart, axis=1)
        overlap = 2 * RADIUS - distance
        if overlap.max(initial=0.0) <= 1e-6:
            break
        along = np.where(distance[:, None] > 0, apart, [1.0, 0.0])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        step = 0.5 * np.maximum(overlap, 0.0)[:, None] * along
        np.add.at(positions, first, -step)
        np.add.at(positions, second, step)
    return positions
