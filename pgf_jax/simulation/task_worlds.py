"""The worlds of a task: in which its solutions are checked, and in which they are executed."""

import dataclasses
import functools
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from pgf_jax.batching.places import Place
from pgf_jax.errors import BadInput
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.config import WorldError
from pgf_jax.physics.worlds.error import draw
from pgf_jax.physics.worlds.scene import SceneModel, SceneWorld, read_scene_model
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.physics.worlds.solid_model import Solid
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


@dataclasses.dataclass(frozen=True)
class WorldSpec:
    """The world that a fleet's tasks are checked and executed in; can be sent to another process.

    Attributes:
      name: solid or scene.
      models: scene: of each scene file, by the scene's name.
      error: in which the world where robots act differs from the one where they check.
      seed: of its draws.
    """

    name: str
    models: tuple[tuple[str, SceneModel], ...] = ()
    error: WorldError | None = None
    seed: int = 0

    @classmethod
    def of(cls, name: str, scenes: Sequence[Scene] | None) -> "WorldSpec | None":
        """The world of a name, and what it needs of the scenes; None: there is none.

        Args:
          name: solid, scene or none.
          scenes: of all tasks; None: they are sampled.

        Raises:
          BadInput: a scene's file holds no world.
        """
        if name == "none":
            return None
        if name == "solid":
            return cls(name)
        models = []
        for scene in scenes or ():
            if scene.source is None:
                raise BadInput(
                    f"world scene: scene {scene.name} is of no scene file, expected *.xml"
                )
            models.append((scene.name, read_scene_model(scene.source)))
        if not models:
            raise BadInput("world scene: expected scene files (*.xml), got sampled scenes")
        return cls(name, tuple(models))

    def worlds(self, scene: Scene, robot: int = 0, task: int = 0) -> TaskWorlds:
        """The worlds of a task."""
        if self.name == "scene":
            return TaskWorlds(scene, _scene(dict(self.models)[scene.name]))
        n, shelf = len(scene.objects), scene.shelf
        solid = _solid(n) if shelf is None else SolidWorld(n, shelf=shelf)
        if self.error is None:
            return TaskWorlds(scene, solid)
        drawn = draw(self.error, scene, self.seed, robot, task)
        acting = SolidWorld(n, drawn=drawn, shelf=shelf)
        return TaskWorlds(scene, acting, lambda seen: Place(solid, solid.state_of(seen)))

    @property
    def key(self) -> Hashable:
        """What the results in it depend on."""
        models = tuple((name, model.digest) for name, model in self.models)
        return self.name, models, self.error, self.seed

    @property
    def identity(self) -> dict[str, Any]:
        """The same, as JSON."""
        if self.name == "solid":
            error = {} if self.error is None else {"error": dataclasses.asdict(self.error)}
            return {"name": self.name, **dataclasses.asdict(Solid()), **error}
        return {"name": self.name, "models": {name: model.digest for name, model in self.models}}


@functools.lru_cache(maxsize=8)
def _solid(n_objects: int) -> SolidWorld:
    return SolidWorld(n_objects)


@functools.lru_cache(maxsize=128)
def _scene(model: SceneModel) -> SceneWorld:
    return SceneWorld(model)
