"""The command `pgf-jax scene`: checks scenes before they are used, and draws them."""

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.scene.config import SceneCommand
from pgf_jax.scene.draw import save_top_view
from pgf_jax.scene.file import save_scene
from pgf_jax.scene.load import load_scene
from pgf_jax.scene.sampling import sample_scene
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import standard_shelf
from pgf_jax.terminal import show_table

_HEAD = ("scene", "objects", "goal", "radius (mm)", "height (mm)", "mass (kg)", "shelf (m)")


def run(command: SceneCommand) -> None:
    """Check the scenes, draw them, and show a table.

    Raises:
      BadInput: a scene cannot be simulated, or nothing can be written there.
    """
    if command.scene_class is None:
        scenes = [load_scene(path) for path in command.scene]
    else:
        seeds = range(command.seed, command.seed + command.count)
        scenes = [sample_scene(seed, command.scene_class, sizes=command.sizes) for seed in seeds]
    names = [scene.name for scene in scenes]
    for name in names:
        if "/" in name or names.count(name) > 1:
            raise BadInput(f"scene: expected different names that files can have, got {name!r}")
    if command.out is not None:
        try:
            command.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(
                f"--out {command.out}: expected a folder to write to ({error.strerror})"
            ) from None
        for scene in scenes:
            save_top_view(scene, command.out / f"{scene.name}.png")
            if command.scene_class is not None:
                save_scene(command.out / f"{scene.name}.json", scene)
    show_table(_HEAD, [_row(scene) for scene in scenes])
    where = "" if command.out is None else f"; pictures in {command.out}"
    print(f"{len(scenes)} scenes can be simulated{where}")


def _row(scene: Scene) -> tuple[str, ...]:
    shelf = scene.shelf or standard_shelf(len(scene.objects))
    return (
        scene.name,
        str(len(scene.objects)),
        str(scene.goal + 1),
        _range(1e3 * shelf.radius),
        _range(1e3 * shelf.height),
        _range(shelf.mass),
        f"{scene.width:g} x {scene.depth:g}",
    )


def _range(values: np.ndarray) -> str:
    low, high = f"{values.min():.3g}", f"{values.max():.3g}"
    return low if low == high else f"{low}..{high}"
