"""Files of scenes as this program writes them: JSON, with the goal of each scene."""

import json
from collections.abc import Sequence
from pathlib import Path

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import MIB, parse_json, read_file, write_atomically
from pgf_jax.scene.scene import Scene

_LARGEST = 64 * MIB  # a scene takes some kB
_EXPECTED = "a file of scenes (*.json)"


def save_scenes(path: Path | str, scenes: Sequence[Scene]) -> None:
    """Write scenes to a file, whole or not at all; `read_scenes` gives the same ones to the bit.

    Raises:
      BadInput: it cannot be written there.
    """
    content = [
        {"name": scene.name, "goal": scene.goal, "objects": scene.objects.tolist()}
        for scene in scenes
    ]
    write_atomically(path, (json.dumps({"scenes": content}) + "\n").encode())


def read_scenes(path: Path | str) -> list[Scene]:
    """Read a file that `save_scenes` wrote.

    Raises:
      BadInput: one line that names the file: missing, malformed, or with a scene that cannot be
        simulated.
    """
    data = read_file(path, _EXPECTED, _LARGEST)
    try:
        content = parse_json(data)
    except ValueError:
        raise BadInput(f"{path}: truncated or malformed, expected {_EXPECTED}") from None
    listed = content.get("scenes") if isinstance(content, dict) else None
    if not isinstance(listed, list) or not listed:
        raise BadInput(f"{path}: expected one or more scenes, got {short_repr(content)}")
    scenes = []
    for number, one in enumerate(listed):
        if not isinstance(one, dict) or not isinstance(one.get("name"), str):
            raise BadInput(f"{path}: scenes[{number}]: expected name, goal, objects")
        try:
            scenes.append(Scene(one["name"], one.get("objects"), one.get("goal")))  # pyright: ignore[reportArgumentType]
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
    return scenes
