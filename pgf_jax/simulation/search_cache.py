"""What becomes of a task, as a tree that fleets share: no branch of it is computed twice.

A task's search is a function of its scene, the seed, the operator, and what has happened in it:
iterations, inputs, pushes dropped. Fleets of other sizes, other policies, other operator latencies
go the same way until somebody is served at another moment, often to the end. So the fleets of a
process walk one tree for each (robot, task); who comes first has a branch computed. Common random
numbers are what makes this exact: a result is the same whoever asks for it (D8).
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
    """A task's search after all that has happened to it so far; never changed."""

    __slots__ = ("_cache", "_children", "search")

    def __init__(self, search: Search) -> None:
        self.search = search
        self._cache: dict[Hashable, Any] = {}
        self._children: dict[Hashable, Node] = {}

    def memoised(self, label: Hashable, make: Callable[[], Coroutine]) -> Memoised:
        """A request for something that follows from this node alone, and takes the computer."""
        return Memoised(self._cache, label, make)

    def child(self, label: Hashable, make: Callable[[], Search]) -> "Node":
        """The node after something that takes no computing to speak of."""
        if label not in self._children:
            self._children[label] = Node(make())
        return self._children[label]


@dataclasses.dataclass(frozen=True, eq=False)
class CachedTask:
    """One task: its scene, and where its search begins."""

    scene: Scene
    root: Node


class SearchCache:
    """The trees of the tasks of one seed.

    A tree is kept until all fleets that have joined are done with its task.

    Args:
      computer: computes what robots and operator ask for.
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
        self._trees: dict[tuple[int, int], CachedTask] = {}
        self._left: dict[tuple[int, int], int] = {}

    def retain(self, robots: int, tasks: int) -> None:
        """A fleet of so many robots with so many tasks each; all join before the first begins."""
        self._fleets.append((robots, tasks))

    def task(self, robot: int, task: int) -> CachedTask:
        """The tree of a task.

        Raises:
          BadInput: its scene has another number of objects than the engine.
        """
        key = (robot, task)
        if key not in self._trees:
            scene, n = self._scenes(*key), self.planner_service.engine.n_objects
            if len(scene.objects) != n:
                raise BadInput(
                    f"scene {scene.name}: has {len(scene.objects)} objects, the engine simulates "
                    f"{n}"
                )
            world = start_world(scene.positions)
            root = Node(self.planner_service.planner.begin_reach(world, scene.goal))
            self._trees[key] = CachedTask(scene, root)
        return self._trees[key]

    def release(self, robot: int, task: int) -> None:
        """A fleet is done with a task, or will never begin it."""
        key = (robot, task)
        self._left[key] = self._left.get(key, 0) + 1
        if self._left[key] >= sum(r > robot and m > task for r, m in self._fleets):
            self._trees.pop(key, None)

    def __len__(self) -> int:
        """Trees kept."""
        return len(self._trees)
