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

from pgf_jax.batching import places
from pgf_jax.batching.places import Place
from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.requests import Coroutine, Memoised, Step, robot_key_path
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.physics.worlds.world import State
from pgf_jax.planning.candidates import Candidates
from pgf_jax.planning.search import Search, start_world
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.task_worlds import TaskWorlds


class Node:
    """A task's search after everything that has happened in the task so far; never changed.

    Attributes:
      search: of the segment that is planned.
      state: of the world in which the robot acts, before the segment; None: there is no world.
      candidates: of the iteration that has just ended, while a check is to come; else None.
      imagined: what operators have imagined on the shelf as it stands; one for all nodes since the
        shelf last changed.
    """

    __slots__ = ("_cache", "_children", "candidates", "imagined", "search", "state")

    def __init__(
        self,
        search: Search,
        state: State | None = None,
        candidates: Candidates | None = None,
        imagined: dict[Hashable, Any] | None = None,
    ) -> None:
        self.search, self.state, self.candidates = search, state, candidates
        self.imagined: dict[Hashable, Any] = {} if imagined is None else imagined
        self._cache: dict[Hashable, Any] = {}
        self._children: dict[Hashable, Node] = {}

    def memoised(self, key: Hashable, make: Callable[[], Coroutine]) -> Memoised:
        """A memoised request for something that follows from this node alone."""
        return Memoised(self._cache, key, make)

    def child(
        self, key: Hashable, make: Callable[[], Search], state: State | None = None
    ) -> "Node":
        """The node after a change that is cheap to compute; made once for each key.

        Args:
          key: of the change.
          make: the search after it.
          state: of the world after it; None: it is the same.
        """
        if key not in self._children:
            self._children[key] = Node(make(), state or self.state, imagined=self.imagined)
        return self._children[key]


@dataclasses.dataclass(frozen=True, eq=False)
class CachedTask:
    """A task: its scene, the node at which its search begins, and the worlds it is in."""

    scene: Scene
    root: Node
    worlds: TaskWorlds | None


class SearchCache:
    """The memoised searches of the tasks of one seed.

    A task is kept until all fleets that retain it have released it.

    Args:
      planner_service: computes the requests of robots and operator.
      scenes: (robot, task) -> scene.
      operator: gives the inputs.
      seed: of the noise.
      worlds: (scene, robot, task) -> worlds of a task; None: its solutions are not checked.
    """

    def __init__(
        self,
        planner_service: PlannerService,
        *,
        scenes: Callable[[int, int], Scene],
        operator: AnyOperator,
        seed: int,
        worlds: Callable[[Scene, int, int], TaskWorlds] | None = None,
    ) -> None:
        self.worlds = worlds
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
          BadInput: its scene is not standard, and the engine simulates standard ones only.
        """
        key = (robot, task)
        if key not in self._tasks:
            scene = self._scenes(*key)
            worlds = None if self.worlds is None else self.worlds(scene, *key)
            world = start_world(scene.positions)
            search = self.planner_service.planner.begin_reach(world, scene.goal, scene.shelf)
            root = Node(search, None if worlds is None else worlds.start())
            self._tasks[key] = CachedTask(scene, root, worlds)
        return self._tasks[key]

    def iterated(self, node: Node, robot: int, task: int, iteration: int) -> Memoised:
        """A request for the node after the robot's iteration of that number."""
        before, state = node.search, node.state
        wanted = self.worlds is not None

        def iterate() -> Coroutine:
            path = robot_key_path(self.seed, robot, task, iteration)
            (result,) = yield [Step(before, path(0), candidates=wanted)]
            after, candidates = result if wanted else (result, None)
            return Node(after, state, candidates, node.imagined)

        return node.memoised("iteration", iterate)

    def checked(self, node: Node, place: Place) -> Memoised:
        """A request for the node after the next check of a node with candidates."""
        planner, candidates, state = self.planner_service.planner, node.candidates, node.state
        assert candidates is not None, "nothing to check"

        def check() -> Coroutine:
            after = yield from places.check(planner, place, candidates)
            more = after if after.next is not None else None
            return Node(after.search(planner), state, more, node.imagined)

        return node.memoised("check", check)

    def release(self, robot: int, task: int) -> None:
        """One fleet is done with a task, or will never begin it."""
        key = (robot, task)
        self._released[key] = self._released.get(key, 0) + 1
        if self._released[key] >= sum(r > robot and m > task for r, m in self._fleets):
            self._tasks.pop(key, None)

    def __len__(self) -> int:
        """Number of tasks kept."""
        return len(self._tasks)
