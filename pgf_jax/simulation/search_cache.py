"""Memoised task searches, shared between fleets.

A task's search is a function of its scene, the seed, the operator, and what has happened in it:
iterations, inputs, pushes dropped. Fleets of other sizes, other policies or other operator
latencies go the same way until a robot is served at another moment, often to the end. So each
(robot, task) has one tree of searches, and a branch is computed for the first fleet that needs it.
This is exact because of common random numbers: a result is the same for whoever asks for it.
"""

import dataclasses
from collections.abc import Callable, Hashable
from typing import Any

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.requests import Coroutine, Memoised
from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.planning.planner import Search, start_world
from pgf_jax.scene.scene import Scene


class Node:
    """A task's search after everything that has happened in the task so far; never changed."""

    __slots__ = ("_cache", "_children", "search")

    def __init__(self, search: Search) -> None:
        self.search = search
        self._cache: dict[Hashable, Any] = {}
        self._children: dict[Hashable, Node] = {}

    def memoised(self, key: Hashable, make: Callable[[], Coroutine]) -> Memoised:
        """A memoised request for something that follows from this node alone."""
        return Memoised(self._cache, key, make)

    def child(self, key: Hashable, make: Callable[[], Search]) -> "Node":
        """The node after a change that is cheap to compute; made once for each key."""
        if key not in self._children:
            self._children[key] = Node(make())
        return self._children[key]


@dataclasses.dataclass(frozen=True, eq=False)
class CachedTask:
    """A task: its scene, and the node at which its search begins."""

    scene: Scene
    root: Node


class SearchCache:
    """The memoised searches of the tasks of one seed.

    A task is kept until all fleets that retain it have released it.

    Args:
      planner_service: computes the requests of robots and operator.
      scenes: (robot, task) -> scene.
      operator: gives the inputs.
      seed: of the noise.
    """

    def __init__(
        self,
        planner_service: PlannerService,
        *,
        scenes: Callable[[int, int], Scene],
        operator: AnyOperator,
        seed: int,
    ) -> None:
        self.planner_service, self.operator, self.seed = planner_service, operator, seed
        self._scenes = scenes
        self._fleets: list[tuple[int, int]] = []
        self._tasks: dict[tuple[int, int], CachedTask] = {}
        self._released: dict[tuple[int, int], int] = {}

    def retain(self, robots: int, tasks: int) -> None:
        """Keep the tasks of a fleet; to be called for all fleets before the first one begins."""
        self._fleets.append((robots, tasks))

    def task(self, robot: int, task: int) -> CachedTask:
        """The task number `task` of a robot (both 0-based).

        Raises:
          BadInput: its scene has another number of objects than the engine.
        """
        key = (robot, task)
        if key not in self._tasks:
            scene, n = self._scenes(*key), self.planner_service.engine.n_objects
            if len(scene.objects) != n:
                raise BadInput(
                    f"scene {scene.name}: has {len(scene.objects)} objects, the engine simulates "
                    f"{n}"
                )
            world = start_world(scene.positions)
            root = Node(self.planner_service.planner.begin_reach(world, scene.goal))
            self._tasks[key] = CachedTask(scene, root)
        return self._tasks[key]

    def release(self, robot: int, task: int) -> None:
        """One fleet is done with a task, or will never begin it."""
        key = (robot, task)
        self._released[key] = self._released.get(key, 0) + 1
        if self._released[key] >= sum(r > robot and m > task for r, m in self._fleets):
            self._tasks.pop(key, None)

    def __len__(self) -> int:
        """Number of tasks kept."""
        return len(self._tasks)
