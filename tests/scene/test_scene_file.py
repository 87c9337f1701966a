"""Scene files of this program: what is written is read, and what is wrong is said in one line."""

import copy
import json
import math

import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.scene import Scene, load_scene, load_scenes, sample_scene, save_scene
from pgf_jax.scene.file import read_scenes, save_scenes, scene_to_json

SCENE = sample_scene(3, "mixed")
CONTENT = scene_to_json(SCENE)


def assert_same(one: Scene, other: Scene) -> None:
    assert scene_to_json(one) == scene_to_json(other)
    for a, b in zip(one.shelf or (), other.shelf or (), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("scene", [SCENE, sample_scene(3, "tight")], ids=["mixed", "standard"])
def test_what_is_written_is_read(scene, tmp_path):
    path = tmp_path / "mine.json"
    save_scene(path, scene)
    assert_same(load_scene(path), scene)
    assert json.loads(path.read_text())["version"] == 1


def test_a_larger_shelf(tmp_path):
    scene = Scene("deep", np.array([[0.8, 0.5, 0.03]]), 0, width=1.2, depth=0.7)
    save_scene(tmp_path / "deep.json", scene)
    read = load_scene(tmp_path / "deep.json")
    assert (read.width, read.depth, read.back_x) == (1.2, 0.7, scene.back_x)


def test_several_in_one_file(tmp_path):
    scenes = [SCENE, sample_scene(4, "tight")]
    save_scenes(tmp_path / "scenes.json", scenes)
    for read, scene in zip(read_scenes(tmp_path / "scenes.json"), scenes, strict=True):
        assert_same(read, scene)


def test_a_folder_of_both_kinds(tmp_path):
    save_scene(tmp_path / "b_10.json", SCENE)
    save_scene(tmp_path / "b_2.json", sample_scene(4, "tight"))
    assert [scene.name for scene in load_scenes(tmp_path)] == ["tight_4", "mixed_3"]


def refused(tmp_path, content) -> str:
    path = tmp_path / "mine.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(BadInput) as caught:
        load_scene(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    assert "expected" in message or "must be within" in message
    return message.removeprefix(f"{path}: ")


PATHS = [
    *[(name,) for name in CONTENT],
    *[("shelf", name) for name in CONTENT["shelf"]],
    *[("objects", 1, name) for name in CONTENT["objects"][1]],
]


def changed(path, value=None, *, remove=False):
    content = copy.deepcopy(CONTENT)
    *first, last = path
    part = content
    for step in first:
        part = part[step]
    if remove:
        del part[last]
    else:
        part[last] = value
    return content


@pytest.mark.parametrize("path", PATHS, ids=str)
def test_a_field_that_is_missing(path, tmp_path):
    assert f"has no {path[-1]}" in refused(tmp_path, changed(path, remove=True))


@pytest.mark.parametrize("path", PATHS, ids=str)
@pytest.mark.parametrize("value", [None, True, {}, [], "1", math.nan, 10**400], ids=str)
def test_a_field_of_another_type_or_not_finite(path, value, tmp_path):
    if path == ("name",) and value == "1":
        return  # a name
    assert str(path[-1]) in refused(tmp_path, changed(path, value))


@pytest.mark.parametrize("path", [p for p in PATHS if p[-1] not in ("x", "y", "name", "objects")])
def test_a_field_that_is_negative(path, tmp_path):
    refused(tmp_path, changed(path, -1))


def test_a_field_that_is_not_known(tmp_path):
    assert "has 'colour'; expected only" in refused(tmp_path, CONTENT | {"colour": "red"})
    assert "has 'z'" in refused(tmp_path, changed(("objects", 0, "z"), 0.1))


def test_objects_that_cannot_stand_there(tmp_path):
    there = CONTENT["objects"][0]
    overlapping = changed(("objects", 1), there | {"x": there["x"] + 0.01})
    assert "overlap by" in refused(tmp_path, overlapping)
    assert "is outside the shelf" in refused(tmp_path, changed(("objects", 0, "x"), 3.0))
    count = len(CONTENT["objects"])
    assert f"within 0..{count - 1}" in refused(tmp_path, changed(("goal",), count))


def test_files_that_are_no_scene(tmp_path):
    for text in ("", "{", "[1]", "null", "[" * 10_000 + "]" * 10_000, json.dumps(CONTENT)[:-9]):
        refused(tmp_path, text)
    with pytest.raises(BadInput, match="no such file, expected a scene file"):
        load_scene(tmp_path / "none.json")
    with (tmp_path / "large.json").open("wb") as file:
        file.truncate(100 * 2**20)
    with pytest.raises(BadInput, match="expected a scene file"):
        load_scene(tmp_path / "large.json")
