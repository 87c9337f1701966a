"""Sweeps over scenes that are given as objects."""

import dataclasses
import json

import numpy as np
import pytest
from sweep_toys import ghost

from pgf_jax.errors import BadInput
from pgf_jax.inspection.config import VerifyConfig
from pgf_jax.inspection.verify import verify
from pgf_jax.scene import Scene, sample_scene
from pgf_jax.scene.file import read_scenes, save_scenes
from pgf_jax.sweeping.config import SCENES
from pgf_jax.sweeping.sweep import sweep


def scenes(count: int = 3) -> list[Scene]:
    return [sample_scene(seed, "tight") for seed in range(count)]


def test_scenes_given_as_objects_are_swept_and_saved(tmp_path):
    config = ghost(tmp_path / "a", scenes=scenes(), robots=(2,), tasks=3)
    result = sweep(config, quiet=True)
    for robot in (0, 1):
        own = result.tasks().filter(robot=robot, policy="autonomous")
        assert set(own["scene"]) == {"tight_0", "tight_1", "tight_2"}
    saved = read_scenes(config.out / SCENES)
    for ours, theirs in zip(scenes(), saved, strict=True):
        assert (ours.name, ours.goal) == (theirs.name, theirs.goal)
        np.testing.assert_array_equal(ours.objects, theirs.objects)
    # From the saved file it is the same sweep, to the name of its cells; and it can be verified.
    again = sweep(
        dataclasses.replace(config, scenes=config.out / SCENES, out=tmp_path / "b"), quiet=True
    )
    assert [p.name for p in again.files.values()] == [p.name for p in result.files.values()]
    assert sweep(dataclasses.replace(config, resume=True), quiet=True).computed == ()
    moved = config.out.rename(tmp_path / "moved")
    checked = verify(VerifyConfig(moved, cells=9), quiet=True)
    assert checked.ok and all(cell.same for cell in checked.recomputed)


def test_other_scenes_are_another_sweep(tmp_path):
    config = ghost(tmp_path, scenes=scenes(), robots=(1,))
    sweep(config, quiet=True)
    with pytest.raises(BadInput, match=r"^scenes [0-9a-f]+\.\.\., now [0-9a-f]+\.\.\.: "):
        sweep(dataclasses.replace(config, scenes=tuple(scenes()[::-1])), quiet=True)


def test_scenes_that_do_not_go_together(tmp_path):
    twice = [sample_scene(0, "tight"), sample_scene(0, "tight")]
    with pytest.raises(BadInput, match=r"^scenes: expected scenes of different names"):
        sweep(ghost(tmp_path, scenes=twice), quiet=True)
    small = Scene("small", np.array([[0.4, 0.0, 0.03]]), 0)
    with pytest.raises(BadInput, match=r"^scenes: small has 1 objects, expected 20 as in tight_0"):
        sweep(ghost(tmp_path, scenes=[*scenes(1), small]), quiet=True)
    assert not (tmp_path / SCENES).exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "truncated or malformed"),
        ("[]", "expected one or more scenes, got"),
        ('{"scenes": []}', "expected one or more scenes"),
        ('{"scenes": [{"goal": 0}]}', r"scenes\[0\]: expected name, goal, objects"),
        ('{"scenes": [{"name": "x", "goal": 0}]}', "objects must be"),
        ('{"scenes": [{"name": "x", "goal": 7, "objects": [[0.4, 0, 0.03]]}]}', "goal index"),
    ],
)
def test_files_that_hold_no_scenes(tmp_path, text, message):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(BadInput, match=f"^{path}: .*{message}"):
        read_scenes(path)
    with pytest.raises(BadInput, match="no such file, expected a file of scenes"):
        read_scenes(tmp_path / "none.json")


def test_a_scene_with_any_goal_comes_back(tmp_path):
    scene = Scene("x", np.array([[1 / 3, 0.1, 0.03], [0.45, -0.2, 0.03]]), 1)
    save_scenes(tmp_path / "x.json", [scene])
    (back,) = read_scenes(tmp_path / "x.json")
    assert back.goal == 1 and back.objects.tolist() == scene.objects.tolist()
    assert set(json.loads((tmp_path / "x.json").read_text())) == {"scenes"}
