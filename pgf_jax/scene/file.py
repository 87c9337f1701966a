"""Files of scenes as this program writes them: JSON.

A scene is an object with these fields, all of which have to be there, and no others:

    version   1
    name      text; names the plan file
    goal      index in `objects` of the one to reach, from 0
    shelf     {"width": m, "depth": m}: between the side walls; from the front at x 0.20 m back
    objects   [{"x": m, "y": m, "radius": m, "height": m, "mass": kg,
                "table_friction": coefficient on the table,
                "friction": coefficient with other bodies}, ...]
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import MIB, parse_json, read_file, write_atomically
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import standard_shelf
from pgf_jax.settings import check_path

VERSION = 1
_LARGEST = 64 * MIB  # a scene takes some kB
_EXPECTED = "a file of scenes (*.json)"
_EXPECTED_ONE = "a scene file (*.json)"
_FIELDS = ("version", "name", "goal", "shelf", "objects")
_SHELF = ("width", "depth")
_OBJECT = ("x", "y", "radius", "height", "mass", "table_friction", "friction")


def save_scene(path: Path | str, scene: Scene) -> None:
    """Write a scene to a file, whole or not at all; `load_scene` gives the same one to the bit.

    Args:
      path: of the file, which should end in `.json`.
      scene: the scene.

    Raises:
      BadInput: it cannot be written there.
    """
    path = check_path("path", path)
    write_atomically(path, (json.dumps(scene_to_json(scene), indent=2) + "\n").encode())


def read_scene(path: Path) -> Scene:
    """Read a file that `save_scene` wrote, or one like it.

    Raises:
      BadInput: one line that names the file, the field and what was expected.
    """
    content = _parse(path, _EXPECTED_ONE)
    try:
        return scene_from_json(content)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def save_scenes(path: Path | str, scenes: Sequence[Scene]) -> None:
    """Write scenes to a file, whole or not at all; `read_scenes` gives the same ones to the bit.

    Raises:
      BadInput: it cannot be written there.
    """
    content = [
        # Standard ones as ever, so that files of the same scenes stay the same.
        {"name": scene.name, "goal": scene.goal, "objects": scene.objects.tolist()}
        if scene.shelf is None
        else scene_to_json(scene)
        for scene in scenes
    ]
    write_atomically(path, (json.dumps({"scenes": content}) + "\n").encode())


def read_scenes(path: Path | str) -> list[Scene]:
    """Read a file that `save_scenes` wrote.

    Raises:
      BadInput: one line that names the file: missing, malformed, or with a scene that cannot be
        simulated.
    """
    content = _parse(path, _EXPECTED)
    listed = content.get("scenes") if isinstance(content, dict) else None
    if not isinstance(listed, list) or not listed:
        raise BadInput(f"{path}: expected one or more scenes, got {short_repr(content)}")
    scenes = []
    for number, one in enumerate(listed):
        if not isinstance(one, dict) or not isinstance(one.get("name"), str):
            raise BadInput(f"{path}: scenes[{number}]: expected name, goal, objects")
        try:
            if "version" in one:
                scenes.append(scene_from_json(one))
            else:
                scenes.append(Scene(one["name"], one.get("objects"), one.get("goal")))  # pyright: ignore[reportArgumentType]
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
    return scenes


def scene_to_json(scene: Scene) -> dict[str, Any]:
    """The content of a scene's file."""
    shelf = scene.shelf or standard_shelf(len(scene.objects))
    own = (shelf.height, shelf.mass, shelf.table_friction, shelf.friction)
    columns = [*scene.objects.T, *own]
    return {
        "version": VERSION,
        "name": scene.name,
        "goal": scene.goal,
        "shelf": {"width": scene.width, "depth": scene.depth},
        "objects": [
            dict(zip(_OBJECT, row, strict=True)) for row in np.stack(columns, axis=1).tolist()
        ],
    }


def scene_from_json(content: Any) -> Scene:
    """The scene of a file's content.

    Raises:
      BadInput: one line with the field, its value and what was expected.
    """
    top = _fields("scene", content, _FIELDS)
    if type(top["version"]) is not int or top["version"] != VERSION:
        raise BadInput(f"version: expected {VERSION}, got {short_repr(top['version'])}")
    if not isinstance(top["name"], str) or not top["name"]:
        raise BadInput(f"name: expected text, got {short_repr(top['name'])}")
    if type(top["goal"]) is not int:
        raise BadInput(f"goal: expected a whole number, got {short_repr(top['goal'])}")
    sizes = _numbers("shelf", top["shelf"], _SHELF)
    if not isinstance(top["objects"], list) or not top["objects"]:
        raise BadInput(f"objects: expected a list of objects, got {short_repr(top['objects'])}")
    rows = [_numbers(f"objects[{i}]", one, _OBJECT) for i, one in enumerate(top["objects"])]
    table = np.array([list(row.values()) for row in rows])
    return Scene(
        top["name"],
        table[:, :3],
        top["goal"],
        heights=table[:, 3],
        masses=table[:, 4],
        table_frictions=table[:, 5],
        frictions=table[:, 6],
        width=sizes["width"],
        depth=sizes["depth"],
    )


def _parse(path: Path | str, expected: str) -> Any:
    data = read_file(path, expected, _LARGEST)
    try:
        return parse_json(data)
    except ValueError:
        raise BadInput(f"{path}: truncated or malformed, expected {expected}") from None


def _fields(where: str, content: Any, names: Sequence[str]) -> Mapping[str, Any]:
    """An object that has these fields and no others."""
    if not isinstance(content, dict):
        raise BadInput(f"{where}: expected {', '.join(names)}, got {short_repr(content)}")
    for name in names:
        if name not in content:
            raise BadInput(f"{where}: has no {name}; expected {', '.join(names)}")
    for name in content:
        if name not in names:
            raise BadInput(f"{where}: has {short_repr(name)}; expected only {', '.join(names)}")
    return content


def _numbers(where: str, content: Any, names: Sequence[str]) -> dict[str, float]:
    """An object of finite numbers, by name in their order."""
    fields = _fields(where, content, names)
    numbers = {}
    for name in names:
        value = fields[name]
        try:
            number = float(value) if type(value) in (int, float) else float("nan")
        except OverflowError:  # a whole number of hundreds of digits
            number = float("inf")
        if not np.isfinite(number):
            raise BadInput(f"{where}.{name}: expected a finite number, got {short_repr(value)}")
        numbers[name] = number
    return numbers
