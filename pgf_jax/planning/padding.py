"""Pads shelves to the places of a program, of which few are compiled (`physics/sized.py`).

A place of a padded shelf that is empty has a radius so far below zero that nothing meets it: it
touches nothing, costs nothing, and stays where it is.
"""

import numpy as np

from pgf_jax.physics.engine import Rollout, World, contact_slots
from pgf_jax.scene import shelf as standard
from pgf_jax.scene.shelf import Shelf

EMPTY_RADIUS = -10.0  # m
_EMPTY_X = 0.4  # m, on every shelf, so that no edge is crossed


def count(shelf: Shelf | None, places: int) -> int:
    """How many of the places hold an object."""
    return places if shelf is None else int((np.asarray(shelf.radius) > 0).sum())


def pad(world: World, shelf: Shelf | None, places: int) -> tuple[World, Shelf | None]:
    """Give a world ([N] objects, unbatched) more places, which are empty.

    Args:
      world: may have them already.
      shelf: [N] or [M]; None: all objects are standard.
      places: M; N or more.
    """
    n = len(world.objects)
    if shelf is None:
        if n == places:
            return world, None
        shelf = standard.standard_shelf(n)
    more = places - len(np.asarray(shelf.radius))
    if more:
        empty = (EMPTY_RADIUS, standard.HEIGHT, standard.MASS)
        empty += (standard.TABLE_FRICTION, standard.FRICTION)
        columns = [
            np.append(np.asarray(column, np.float32), np.full(more, value, np.float32))
            for column, value in zip(shelf[: len(empty)], empty, strict=True)
        ]
        shelf = Shelf._make([*columns, shelf.back_x, shelf.side_y])
    return _with_places(world, places), shelf


def without_empty(shelf: Shelf | None) -> Shelf | None:
    """The shelf of the objects that are there."""
    if shelf is None:
        return None
    n = count(shelf, 0)
    columns = [np.asarray(column)[:n] for column in shelf[:-2]]
    return Shelf._make([*columns, shelf.back_x, shelf.side_y])


def pad_rollout(rollout: Rollout, places: int) -> Rollout:
    """Give a rollout ([T, N, 2] and so on) more places; hand and walls are numbered after them."""
    n = rollout.objects.shape[-2]
    if n == places:
        return rollout
    bodies = np.asarray(rollout.bodies)
    bodies = np.where(bodies >= n, bodies + (places - n), bodies).astype(bodies.dtype)
    slots = (0, contact_slots(places) - contact_slots(n))
    return rollout._replace(
        objects=_more(rollout.objects, places),
        velocities=_more(rollout.velocities, places, 0.0),
        force=np.pad(rollout.force, ((0, 0), slots)),
        bodies=np.pad(bodies, ((0, 0), slots, (0, 0))),
    )


def _with_places(world: World, places: int) -> World:
    return world._replace(
        objects=_more(world.objects, places), velocities=_more(world.velocities, places, 0.0)
    )


def _more(rows: np.ndarray, places: int, x: float = _EMPTY_X) -> np.ndarray:
    """[..., N, 2] -> [..., M, 2]: (x, 0) where a place is empty."""
    rows = np.asarray(rows)
    shape = (*rows.shape[:-2], places - rows.shape[-2], 2)
    empty = np.broadcast_to(np.array([x, 0.0], rows.dtype), shape)
    return np.concatenate([rows, empty], axis=-2)
