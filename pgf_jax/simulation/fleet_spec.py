"""All that the simulation of one fleet is made from."""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Hashable
from typing import cast

import numpy as np

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.fleet import Fleet, FleetConfig
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.guidance.operators.registry import make_operator
from pgf_jax.physics.config import Physics
from pgf_jax.planning.config import Planner
from pgf_jax.scene import Scene, sample_scene
from pgf_jax.scene.sampling import PRESETS, PUBLISHED_CLASSES, SceneClass, most_objects
from pgf_jax.simulation.planned_robots import AnyPredictor, PlannedRobots
from pgf_jax.simulation.recorded_operator import Recording
from pgf_jax.simulation.robot import Robot
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.simulation.task_worlds import WorldSpec
from pgf_jax.streams import stream


@dataclasses.dataclass(frozen=True)
class TaskScenes:
    """The scenes of a fleet's tasks, drawn by (seed, robot, task).

    Sampled scenes have the key [seed, robot, task]. Of scene files, each robot takes a permutation
    of all of them, then another one, and so on.

    Attributes:
      seed: of the draws.
      scene_class: of sampled scenes; `all`: the three classes of the published scenes in turn;
        `every`: all six; None with files.
      files: scenes to draw from; None: sample.
    """

    seed: int
    scene_class: str | None = "tight"
    files: tuple[Scene, ...] | None = None

    def scene(self, robot: int, task: int) -> Scene:
        """The scene of a robot's task (both 0-based)."""
        if self.files is None:
            key = np.array([self.seed, robot, task], np.uint32)
            name = self._sampled_name(robot, task)
            return sample_scene(key, self._class_of_task(robot, task), name=name)
        turn, place = divmod(task, len(self.files))
        # Raw bits: NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
        draws = stream(self.seed, "scenes", robot, turn)
        bits = draws.bit_generator.random_raw(len(self.files))
        return self.files[int(np.argsort(bits, kind="stable")[place])]

    def name(self, robot: int, task: int) -> str:
        """The name of a task's scene, without sampling it."""
        if self.files is not None:
            return self.scene(robot, task).name
        return self._sampled_name(robot, task)

    @property
    def n_objects(self) -> int:
        """N, the largest of any scene."""
        if self.files is None:
            return max(most_objects(one) for one in self._classes)
        return max(len(scene.objects) for scene in self.files)

    @functools.cached_property
    def digest(self) -> str | None:
        """Digest of the scene files, their names and their order; None without files."""
        if self.files is None:
            return None
        digest = hashlib.sha256()
        for scene in self.files:
            digest.update(f"{scene.name}\0{scene.goal}\0{len(scene.objects)}\0".encode())
            digest.update(np.ascontiguousarray(scene.objects, "<f8").tobytes())
            for values in scene.shelf or ():
                digest.update(np.ascontiguousarray(values, "<f8").tobytes())
        return digest.hexdigest()

    def _class_of_task(self, robot: int, task: int) -> str:
        # In turn, and shifted from robot to robot: classes are mixed over the fleet at all times.
        return self._classes[(robot + task) % len(self._classes)]

    @property
    def _classes(self) -> tuple[SceneClass, ...]:
        assert self.scene_class is not None
        several = {"all": PUBLISHED_CLASSES, "every": PRESETS}
        return several.get(self.scene_class) or (cast(SceneClass, self.scene_class),)

    def _sampled_name(self, robot: int, task: int) -> str:
        return f"{self._class_of_task(robot, task)}_{self.seed}_{robot}_{task}"


@dataclasses.dataclass(frozen=True)
class FleetSpec:
    """One fleet with its planner, scenes, operator and predictor; can be sent to another process.

    Attributes:
      config: sizes, policy, operators and times.
      engine: name of the physics engine.
      physics: its constants.
      planner: settings of the planner.
      lanes: L.
      scenes: of its tasks.
      operator: name of who gives the input.
      predictor: of what its robots may bid, or are ranked by; None: there is none.
      recording: the operator of a recorded session, in place of the one named.
      world: in which solutions are checked and executed; None: the engine is believed.
    """

    config: FleetConfig
    engine: str
    physics: Physics
    planner: Planner
    lanes: int
    scenes: TaskScenes
    operator: str
    predictor: AnyPredictor | None = None
    recording: Recording | None = None
    world: WorldSpec | None = None

    @functools.cached_property
    def compile_key(self) -> tuple[str, Physics, Planner, int]:
        """What its programs depend on beside the scenes: engine, physics, planner, lanes."""
        return self.engine, self.physics, self.planner, self.lanes

    @functools.cached_property
    def cache_key(self) -> Hashable:
        """What its searches depend on; fleets with equal keys share a `SearchCache`."""
        scenes = self.scenes.digest or self.scenes.scene_class
        recording = None if self.recording is None else self.recording.sha256
        world = None if self.world is None else self.world.key
        return self.compile_key, self.config.seed, scenes, self.operator, recording, world

    @property
    def misses(self) -> bool:
        """Whether a reach may miss when it is executed."""
        return self.world is not None and self.world.error is not None

    def search_cache(
        self, planner_service: PlannerService, operator: AnyOperator | None = None
    ) -> SearchCache:
        """A new cache of its searches; `operator` in place of its own."""
        return SearchCache(
            planner_service,
            scenes=self.scenes.scene,
            operator=operator or self.recording or make_operator(self.operator),
            seed=self.config.seed,
            worlds=None if self.world is None else self.world.worlds,
        )

    def planned_robots(
        self, cache: SearchCache, on_task_end: Callable[[int, Robot], None] | None = None
    ) -> PlannedRobots:
        """Its robots; for `on_task_end` see `PlannedRobots`."""
        return PlannedRobots(
            cache,
            robots=self.config.robots,
            tasks=self.config.tasks,
            predictor=self.predictor,
            on_task_end=on_task_end,
            misses=self.misses,
        )

    def new_fleet(self, robots: PlannedRobots) -> Fleet:
        """The fleet, before its first event."""
        if self.recording is None:
            return Fleet(self.config, robots)
        return Fleet(
            self.config, robots, service=self.recording, attendance=self.recording.attendance
        )
