"""Sweeps over scenes that are given as objects."""

import dataclasses
import json

import numpy as np
import pytest
from sweep_toys import ghost

from pgf_jax.errors import BadInput
from pgf_jax.inspection.config import VerifyConfig
from pgf_jax.inspection.verify import verify
from pgf_jax.scene import PRESETS, Scene, sample_scene
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
    assert not (tmp_path / SCENES).exists()


def test_scenes_of_different_sizes_share_a_sweep(tmp_path):
    """Each is as in a sweep without the others."""
    several = [*scenes(1), sample_scene(0, "crowded"), sample_scene(1, "mixed")]
    config = ghost(tmp_path / "all", scenes=several, robots=(1,), tasks=3, policies=("autonomous",))
    together = sweep(config, quiet=True)
    saved = read_scenes(config.out / SCENES)
    assert [len(s.objects) for s in saved] == [len(s.objects) for s in several]
    own = ("scene", "status", "planning_time_s", "iterations", "cost", "c_d", "c_f", "c_b")
    for scene in several:
        alone = sweep(
            dataclasses.replace(config, scenes=(scene,), out=tmp_path / scene.name), quiet=True
        )
        row = together.tasks().filter(scene=scene.name)
        assert len(row) == 1
        # The same place among the robot's tasks, so that the noise is the same.
        assert row.select(own).equals(alone.tasks().filter(task=row["task"][0]).select(own))


def test_a_sweep_of_every_class(tmp_path):
    config = ghost(
        tmp_path / "every",
        scene_class="every",
        robots=(6,),
        tasks=1,
        policies=("autonomous",),
    )
    every = sweep(config, quiet=True).tasks()
    assert [name.split("_")[0] for name in every.sort("robot")["scene"]] == [*PRESETS]
    for robot in (2, 3, 5):
        one = dataclasses.replace(config, scene_class=PRESETS[robot], out=tmp_path / f"{robot}")
        alone = sweep(one, quiet=True).tasks().filter(robot=robot)
        settings = ("scene_class", "cell", "sha256")
        columns = [name for name in every.columns if name not in settings]
        assert every.filter(robot=robot).select(columns).equals(alone.select(columns))


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
