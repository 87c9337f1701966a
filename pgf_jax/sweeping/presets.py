"""Sizes of sweeps by name: the presets of `sweep`."""

import dataclasses
from collections.abc import Callable

from pgf_jax.scene import SceneClass


@dataclasses.dataclass(frozen=True)
class Preset:
    """Sizes of a sweep.

    Attributes:
      robots: fleet sizes.
      policies: names of the policies.
      tasks: from R, tasks of each robot.
      scene_class: class of the sampled scenes.
      fixed: whether the configuration cannot have other sizes.
    """

    robots: tuple[int, ...]
    policies: tuple[str, ...]
    tasks: Callable[[int], int]
    scene_class: SceneClass = "tight"
    fixed: bool = False


DEFAULT = Preset((1, 10, 20, 30), ("or-hitl", "pgf", "gain-rate"), lambda robots: 10)
PRESETS = {
    # 2 policies * (1 robot * 4 tasks + 4 robots * 4 tasks) = 40 tasks.
    "quick": Preset((1, 4), ("pgf", "or-hitl"), lambda robots: 4, fixed=True),
    # The paper's figure 6: 100 tasks of one robot, 50 each of 10, 20 and 30.
    "paper": Preset((1, 10, 20, 30), ("pgf", "or-hitl"), lambda robots: 100 if robots == 1 else 50),
}
