"""The command `scene`: checks, draws and samples scenes."""

import pytest

from pgf_jax import cli
from pgf_jax.scene import load_scene, sample_scene, save_scene
from pgf_jax.scene.sampling import Sizes


def run(arguments, capsys) -> tuple[int, str, str]:
    code = cli.main(list(map(str, arguments)))
    out, err = capsys.readouterr()
    return code, out, err


def test_sampled_scenes_are_drawn_and_written(tmp_path, capsys):
    sizes = ("--objects", 22, 24, "--radius", 0.02, 0.03, "--width", 1.0)
    arguments = ["scene", "--scene-class", "mixed", "--seed", 3, "--count", 2, *sizes]
    code, out, _ = run([*arguments, "--out", tmp_path], capsys)
    assert code == 0 and "2 scenes can be simulated; pictures in" in out
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["mixed_3.json", "mixed_3.png", "mixed_4.json", "mixed_4.png"]
    scene = load_scene(tmp_path / "mixed_3.json")
    assert 22 <= len(scene.objects) <= 24 and scene.width == 1.0
    assert scene.radii.min() >= 0.02 and scene.radii.max() <= 0.03
    again = sample_scene(
        3,
        "mixed",
        sizes=Sizes(
            objects=(22, 24), radius=(0.02, 0.03), height=(0.06, 0.16), mass=(0.3, 3.0), width=1.0
        ),
    )
    assert again.objects.tolist() == scene.objects.tolist()


def test_files_are_checked(tmp_path, capsys):
    path = tmp_path / "mine.json"
    save_scene(path, sample_scene(3, "mixed"))
    code, out, _ = run(["scene", "--scene", path], capsys)
    assert code == 0 and "mixed_3" in out and "0.8 x 0.39" in out
    path.write_text(path.read_text().replace('"goal": 2', '"goal": 99'))
    code, out, err = run(["scene", "--scene", path], capsys)
    assert (code, out) == (2, "") and err.count("\n") == 1 and "goal index" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--scene, --scene-class: expected one of the two, got neither"),
        (["--scene-class", "tight", "--objects", 30, 30], "sizes: expected with crowded, packed"),
        (["--scene-class", "packed", "--objects", 200, 300], "objects: expected low and high"),
        (["--scene-class", "packed", "--radius", 0.04, 0.05], "that of the goal, got 0.04"),
        (["--scene-class", "packed", "--objects", 110, 110], "find no room; expected fewer"),
        (["--scene-class", "mixed", "--width", 9], "the shelf has width 9 m"),
        (["--scene", "x.json", "--mass", 1, 2], "mass: goes with scene_class only"),
    ],
)
def test_what_cannot_be_sampled(arguments, message, capsys):
    code, out, err = run(["scene", *arguments], capsys)
    assert (code, out) == (2, "") and err.count("\n") == 1 and message in err
