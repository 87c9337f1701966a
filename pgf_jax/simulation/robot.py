"""The state of one robot that really plans."""

import dataclasses

import numpy as np

from pgf_jax.batching.places import Place
from pgf_jax.planning.search import Search
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.search_cache import Node
from pgf_jax.simulation.task_worlds import TaskWorlds
from pgf_jax.tables.run_log import RunLog


@dataclasses.dataclass(frozen=True)
class Segment:
    """A part of a plan that was, or can be, executed."""

    kind: str  # "push" or "reach"
    duration_s: float
    controls: np.ndarray  # [T, 3] m/s, m/s, rad/s along the world axes
    gripper: np.ndarray  # [T] 0 open .. 255 closed


@dataclasses.dataclass
class Robot:
    """The state of one robot's task; only `PlannedRobots` changes it."""

    task: int
    scene: Scene
    node: Node
    executed: list[Segment]
    log: RunLog
    inputs: int = 0  # services that have ended, those without an answer included
    dropped: int = 0  # pushes given since the shelf last changed that could not be planned
    reach_node: Node | None = None  # while pushing: the reach for which help was asked
    worlds: TaskWorlds | None = None  # None: nothing is checked

    @property
    def search(self) -> Search:
        """The segment being planned."""
        return self.node.search

    @property
    def reach(self) -> Search:
        """The reach being planned, or the one that was planned before the push under way."""
        return (self.reach_node or self.node).search

    def checked_at(self, node: Node) -> Place | None:
        """Where candidates of a node's segment are checked."""
        if self.worlds is None:
            return None
        assert node.state is not None
        return self.worlds.to_check(node.state, node.search.start)

    def acts_at(self, node: Node) -> Place:
        """Where a node's segment is executed."""
        assert self.worlds is not None and node.state is not None, "there is no world"
        return self.worlds.to_act(node.state)
