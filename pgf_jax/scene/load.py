"""Loads scenes from files of either kind: this program's (JSON), or the published ones (MJCF)."""

import re
from pathlib import Path

from pgf_jax.errors import BadInput
from pgf_jax.files import is_folder
from pgf_jax.scene.file import read_scene
from pgf_jax.scene.mjcf import read_mjcf
from pgf_jax.scene.scene import Scene
from pgf_jax.settings import check_path

_SUFFIXES = (".xml", ".json")


def load_scene(path: str | Path) -> Scene:
    """Read one scene file.

    Args:
      path: a file that `save_scene` wrote or one like it (`*.json`); or an MJCF file in the form
        of the published scenes, whose stem is the scene's name and `object_3` the goal.

    Returns:
      The scene, its objects in the order of the file, or of their numbers.

    Raises:
      BadInput: the file is missing or malformed, or holds what is not simulated: anything but
        upright cylinders within the limits of `pgf_jax/scene/shelf.py`, clear of each other and on
        the shelf. The message is one line with the file, the value and what was expected.

    Source: of the MJCF files https://github.com/rpapallas/PGF, models/warehouse_N.xml.
    """
    path = check_path("path", path)
    return read_scene(path) if path.suffix == ".json" else read_mjcf(path)


def load_scenes(directory: str | Path) -> list[Scene]:
    """Read every scene file directly in a directory, in natural order (scene_2 before scene_10).

    Raises:
      BadInput: no such directory, no scene file in it, or a file that `load_scene` refuses.
    """
    directory = Path(directory)
    expected = " or ".join(f"*{suffix}" for suffix in _SUFFIXES)
    if not is_folder(directory):
        raise BadInput(f"{directory}: expected a directory of scene files ({expected}), found none")
    found = (p for p in directory.iterdir() if p.suffix in _SUFFIXES and p.is_file())
    paths = sorted(found, key=_natural)
    if not paths:
        raise BadInput(f"{directory}: holds no scene file; expected one or more {expected}")
    return [load_scene(path) for path in paths]


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key that reads the digits in a name as numbers."""
    parts = re.split(r"([0-9]+)", path.name)  # every other one is a number
    return [(int(part), "") if i % 2 else (-1, part) for i, part in enumerate(parts)]
