"""Keeps what an engine has made for a shelf, such as its compiled model."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from pgf_jax.scene.shelf import Shelf

_KEPT = 16  # shelves: a task's iterations follow one another
T = TypeVar("T")


class KeptByShelf(Generic[T]):
    """What was made for the shelves that were used last.

    Args:
      make: makes it for a shelf, [N] each.
    """

    def __init__(self, make: Callable[[Shelf], T]) -> None:
        self._make = make
        self._kept: OrderedDict[bytes, T] = OrderedDict()

    def of(self, shelves: Shelf, i: int) -> T:
        """That of the i-th of several shelves, [B, N] each."""
        one = Shelf(*(np.asarray(x, np.float64)[i] for x in shelves))
        key = b"".join(x.tobytes() for x in one)
        if key not in self._kept:
            self._kept[key] = self._make(one)
        self._kept.move_to_end(key)
        if len(self._kept) > _KEPT:
            self._kept.popitem(last=False)
        return self._kept[key]
