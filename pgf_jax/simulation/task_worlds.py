"""The worlds of a task: in which its solutions are checked, and in which they are executed."""

import dataclasses
from collections.abc import Callable

from pgf_jax.batching.places import Place
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.world import State, World3D
from pgf_jax.scene.scene import Scene


@dataclasses.dataclass(frozen=True, eq=False)
class TaskWorlds:
    """The worlds of one task.

    Attributes:
      scene: of the task.
      acting: the world in which the robot acts, and in which it checks unless it is wrong about it.
      believed: makes a state of the world in which the robot checks from what the planner sees;
        None: it checks where it acts.
    """

    scene: Scene
    acting: World3D
    believed: Callable[[World], Place] | None = None

    def start(self) -> State:
        """The state before the task."""
        return self.acting.start(self.scene)

    def to_act(self, state: State) -> Place:
        """Where segments are executed."""
        return Place(self.acting, state)

    def to_check(self, state: State, seen: World) -> Place:
        """Where candidates are checked."""
        return self.to_act(state) if self.believed is None else self.believed(seen)
