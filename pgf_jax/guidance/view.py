"""The type `View`: what an operator sees of a robot, and the key of a decision."""

import dataclasses
from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from pgf_jax.planning import padding
from pgf_jax.scene.shelf import OnShelf, Shelf

if TYPE_CHECKING:  # the planner needs JAX, and the command line lists the operators
    from pgf_jax.batching.places import Place
    from pgf_jax.planning.search import Search

# Identifies one decision of an operator: seed, robot, task, iterations of the task that have ended.
DecisionKey = tuple[int, int, int, int]


@dataclasses.dataclass(frozen=True)
class View(OnShelf):
    """View of a robot: the shelf as it is, and the best trajectory so far.

    Attributes:
      objects: [N, 2] centres now, m.
      goal: index of the goal.
      hand: [3] hand pose now: base x, y (m), yaw (rad).
      gripper: 0 open .. 255 closed, now.
      path: [T, N, 2] centres at the knot ends of the best rollout, m; the present ones T times
        while nothing has been rolled out.
      hands: [T, 3] hand poses there.
      force: [T, C] contact forces there, N.
      bodies: [T, C, 2] the two bodies of each contact: 0..N-1 an object, N the hand, N+1 a wall.
      terms: [5] the best trajectory's c_d, c_f, c_b, c_e, c_s; inf before the first rollout.
      request: number of this input in its task, 0-based.
      dropped: pushes since the shelf last changed that the planner could not find.
      place: where trials can be checked, the world in which the robot stands; None: there is none.
      shelf: sizes of the objects, and walls; None: they are standard.
      imagined: where an operator may keep what follows from the shelf as it stands, whatever the
        best trajectory (a cache of `Memoised`); None: nothing is kept.
    """

    objects: np.ndarray
    goal: int
    hand: np.ndarray
    gripper: float
    path: np.ndarray
    hands: np.ndarray
    force: np.ndarray
    bodies: np.ndarray
    terms: np.ndarray
    request: int
    dropped: int
    place: "Place | None" = None
    shelf: Shelf | None = None
    imagined: dict[Hashable, Any] | None = dataclasses.field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        search: "Search",
        request: int = 0,
        dropped: int = 0,
        place: "Place | None" = None,
        imagined: dict[Hashable, Any] | None = None,
    ) -> "View":
        """Make the view of a robot from its search; the places that are empty are not in it."""
        n, places = search.objects, len(search.start.objects)
        bodies = np.asarray(search.best.bodies)
        return cls(
            objects=np.asarray(search.start.objects)[:n],
            goal=int(search.task.goal),
            hand=np.asarray(search.start.hand),
            gripper=float(search.start.gripper),
            path=np.asarray(search.best.objects)[:, :n],
            hands=np.asarray(search.best.hand),
            force=np.asarray(search.best.force),
            bodies=np.where(bodies >= places, bodies - (places - n), bodies),
            terms=np.asarray(search.value.terms),
            request=request,
            dropped=dropped,
            place=place,
            shelf=padding.without_empty(search.shelf),
            imagined=imagined,
        )
