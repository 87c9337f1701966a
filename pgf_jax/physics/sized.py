"""Engines of one kind for any number of objects, each made when it is first needed."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Array, Engine, Rollout, World, make_engine

_SMALLEST, _STEP = 20, 8  # places are 20, 28, 36, 44, 52 ...
# A program is compiled for a number of objects, which takes seconds. So for objects that are not
# standard there are programs for a few numbers only, and the places that a scene leaves over stay
# empty (`planning/padding.py`). Standard ones have a program for each number, as they always had.
_COMPILED = ("planar",)


class SizedEngine:
    """An engine that rolls out scenes of any number of objects, one number in a call.

    Args:
      make: makes the engine for a number of objects.
      name, physics, lanes: as of `Engine`.
    """

    def __init__(
        self, make: Callable[[int], Engine], *, name: str, physics: Physics, lanes: int
    ) -> None:
        self.name, self.physics, self.lanes = name, physics, lanes
        self._make = make
        self._made: dict[int, Engine] = {}

    @classmethod
    def of_name(cls, name: str, physics: Physics, lanes: int) -> "SizedEngine":
        """The engines of a registered name; BadInput if there is none."""

        def make(n_objects: int) -> Engine:
            return make_engine(name, physics=physics, n_objects=n_objects, lanes=lanes)

        return cls(make, name=name, physics=physics, lanes=lanes)

    def of(self, n_objects: int) -> Engine:
        """The engine for so many objects."""
        if n_objects not in self._made:
            self._made[n_objects] = self._make(n_objects)
        return self._made[n_objects]

    def places(self, n_objects: int) -> int:
        """The number of objects of the program for a scene of so many: as many, or more."""
        if self.name not in _COMPILED:
            return n_objects
        return _SMALLEST + _STEP * max(0, -(-(n_objects - _SMALLEST) // _STEP))

    def rollout(
        self,
        start: World,
        controls: Array,
        gripper: Array,
        substeps: int,
        wanted: Array | None = None,
        **shelf: Any,
    ) -> Rollout:
        """See `Engine.rollout`."""
        engine = self.of(np.shape(start.objects)[1])
        return engine.rollout(start, controls, gripper, substeps, wanted, **shelf)

    def occupancy(self) -> tuple[int, int] | None:
        """Lanes used and computed, see `Engine`; None where an engine does not count them."""
        made = [*self._made.values()]
        if not all(hasattr(engine, "occupancy") for engine in made):
            return None
        counts: Any = [engine.occupancy() for engine in made]  # pyright: ignore[reportAttributeAccessIssue]
        return sum(used for used, _ in counts), sum(computed for _, computed in counts)
