"""Scenes: the type and its checks, sampling, import of the authors' files, top-view drawing.

Importing this needs NumPy only: matplotlib is imported when something is drawn, JAX when a typed
key is given.
"""

from pgf_jax.scene.draw import draw_scene, save_top_view
from pgf_jax.scene.mjcf import load_scene, load_scenes
from pgf_jax.scene.sampling import PRESETS, sample_scene
from pgf_jax.scene.scene import BACK_WALL_X, FRONT_X, HEIGHT, RADIUS, SIDE_WALL_Y, Scene, validate
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
    "RADIUS",
    "SIDE_WALL_Y",
    "START_EE",
    "Scene",
    "SceneStatistics",
    "corridor_count",
    "corridor_mask",
    "deeper_count",
    "draw_scene",
    "load_scene",
    "load_scenes",
    "nearest_distances",
    "sample_scene",
    "save_top_view",
    "scene_statistics",
    "validate",
]
