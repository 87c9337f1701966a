"""Scenes: shelves full of cylinders, and how they are sampled, imported and drawn.

Read `scene.py` first: the type `Scene` and its checks; `shelf.py` has the standard sizes and their
limits. `sampling.py` makes random scenes; `load.py` loads files, those of `file.py` (JSON) and the
authors' published ones (`mjcf.py`); `statistics.py` describes sets of scenes, and `draw.py` draws
the view from above.

Importing this room needs NumPy only: matplotlib is imported when a scene is drawn, JAX when a typed
key is given. It may import `parallel` and the layers below it.
"""

from pgf_jax.scene.draw import draw_scene, save_top_view
from pgf_jax.scene.file import save_scene
from pgf_jax.scene.load import load_scene, load_scenes
from pgf_jax.scene.sampling import PRESETS, PUBLISHED_CLASSES, SceneClass, Sizes, sample_scene
from pgf_jax.scene.scene import Scene, validate
from pgf_jax.scene.shelf import BACK_WALL_X, FRONT_X, HEIGHT, RADIUS, SIDE_WALL_Y
from pgf_jax.scene.statistics import (
    START_EE,
    SceneStatistics,
    corridor_count,
    corridor_mask,
    deeper_count,
    nearest_distances,
    scene_statistics,
)

__all__ = [
    "BACK_WALL_X",
    "FRONT_X",
    "HEIGHT",
    "PRESETS",
    "PUBLISHED_CLASSES",
    "RADIUS",
    "SIDE_WALL_Y",
    "START_EE",
    "Scene",
    "SceneClass",
    "SceneStatistics",
    "Sizes",
    "corridor_count",
    "corridor_mask",
    "deeper_count",
    "draw_scene",
    "load_scene",
    "load_scenes",
    "nearest_distances",
    "sample_scene",
    "save_scene",
    "save_top_view",
    "scene_statistics",
    "validate",
]
