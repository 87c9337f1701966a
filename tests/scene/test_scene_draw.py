import io
import subprocess
import sys

import matplotlib.colors
import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from pgf_jax.errors import BadInput
from pgf_jax.scene import START_EE, Scene, draw_scene, sample_scene, save_top_view
from pgf_jax.scene.draw import (
    CORRIDOR_COLOR,
    CORRIDOR_OBJECT_COLOR,
    GOAL_COLOR,
    OBJECT_COLOR,
    ROBOT_COLOR,
)

R = 0.03
# The goal straight ahead, one object in the way, one far to the left, one far to the right.
SCENE = Scene(
    "four",
    np.array(
        [[0.3, -0.0088, R], [0.4, 0.3, R], [0.5, -0.0088, R], [0.4, -0.3, R]],
    ),
    goal=2,
)


def drawn(scene, **options):
    """The picture as [H, W, 3], and a function from (x, y) in metres to the pixel's colour."""
    figure = Figure(figsize=(7, 5.6), dpi=100)
    ax = draw_scene(scene, figure.add_subplot(), numbers=False, **options)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=100)
    file.seek(0)
    picture = matplotlib.image.imread(file)[..., :3]

    def color(x, y):
        column, row = ax.transData.transform((y, x))
        return picture[picture.shape[0] - 1 - int(row), int(column)]

    return picture, color


def same(pixel, color):
    return np.abs(pixel - matplotlib.colors.to_rgb(color)).max() < 0.02


def test_disks_stand_where_they_should_in_their_colours():
    _, color = drawn(SCENE)
    assert same(color(0.5, -0.0088), GOAL_COLOR)
    assert same(color(0.3, -0.0088), CORRIDOR_OBJECT_COLOR)
    assert same(color(0.4, 0.3), OBJECT_COLOR)
    assert same(color(0.4, -0.3), OBJECT_COLOR)
    assert same(color(0.4, -0.0088), CORRIDOR_COLOR)
    assert same(color(*START_EE), ROBOT_COLOR)
    assert same(color(0.5, 0.2), "white")
    # 0.025 m from the goal's centre is still in the disk, 0.035 m is not.
    assert same(color(0.525, -0.0088), GOAL_COLOR)
    assert not same(color(0.535, -0.0088), GOAL_COLOR)


def test_x_points_up_and_y_to_the_left():
    picture, _ = drawn(Scene("corner", np.array([[0.55, 0.35, R]]), 0), corridor=False)
    row, column = np.argwhere(
        np.abs(picture - matplotlib.colors.to_rgb(GOAL_COLOR)).max(axis=-1) < 0.02
    ).mean(axis=0)
    assert row < picture.shape[0] / 3
    assert column < picture.shape[1] / 3


def test_without_the_corridor_nothing_is_marked():
    _, color = drawn(SCENE, corridor=False)
    assert same(color(0.3, -0.0088), OBJECT_COLOR)
    assert same(color(0.4, -0.0088), "white")


def test_numbers_start_at_one():
    ax = draw_scene(SCENE)
    assert {text.get_text(): text.get_position() for text in ax.texts} == {
        str(i + 1): (y, x) for i, (x, y) in enumerate(SCENE.positions.tolist())
    }


def test_paths_and_moved_objects():
    ends = SCENE.positions.copy()
    ends[1] += (0.05, -0.02)
    path = np.array([[0.2, 0.1], [0.3, 0.2], [0.45, 0.25]])
    _, color = drawn(SCENE, ee_paths=path)
    assert same(color(0.3, 0.2), ROBOT_COLOR)
    plain, moved = draw_scene(SCENE), draw_scene(SCENE, ee_paths=[path, path], end_positions=ends)
    assert len(moved.lines) == len(plain.lines) + 2
    assert len(moved.patches) == len(plain.patches) + 1  # three objects stayed
    outline = moved.patches[-1]
    np.testing.assert_allclose(outline.get_center(), (0.28, 0.45))  # pyright: ignore[reportAttributeAccessIssue]


def test_title():
    assert draw_scene(SCENE).get_title() == "four"
    assert draw_scene(SCENE, title="before").get_title() == "before"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ee_paths": np.zeros((5, 3))}, r"ee_paths: expected paths \[M, 2\].*\(5, 3\)"),
        ({"ee_paths": [np.zeros(4)]}, r"ee_paths: expected paths \[M, 2\].*\(4,\)"),
        ({"end_positions": np.zeros((3, 2))}, r"end_positions: expected shape \(4, 2\).*\(3, 2\)"),
    ],
)
def test_arrays_of_another_shape(options, message):
    with pytest.raises(BadInput, match=message):
        draw_scene(SCENE, **options)


def test_saved_picture(tmp_path):
    path = save_top_view(sample_scene(0, "wide"), str(tmp_path / "wide.png"), dpi=80)
    picture = matplotlib.image.imread(path)[..., :3]
    assert picture.shape == (448, 560, 3)  # 7 x 5.6 inches at 80 dots an inch
    goal = np.abs(picture - matplotlib.colors.to_rgb(GOAL_COLOR)).max(axis=-1) < 0.02
    # The disk's share of the axes' area, were it not for its edge and its number.
    axes = np.prod(picture.shape[:2]) * 0.75
    share = np.pi * R**2 / (0.86 * 0.65)
    assert 0.4 * share < goal.sum() / axes < 1.2 * share


def test_saved_formats(tmp_path):
    assert save_top_view(SCENE, tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert b"<svg" in save_top_view(SCENE, tmp_path / "a.SVG").read_bytes()


@pytest.mark.parametrize("name", ["a.xml", "a"])
def test_unknown_format(tmp_path, name):
    with pytest.raises(BadInput, match=r"picture format .* expected one of .*png"):
        save_top_view(SCENE, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_path_that_cannot_be_written(tmp_path):
    with pytest.raises(BadInput, match=r"a\.png: cannot be written"):
        save_top_view(SCENE, tmp_path / "nowhere" / "a.png")


def test_drawing_leaves_pyplot_alone(tmp_path):
    code = (
        "import sys; from pgf_jax.scene import sample_scene, save_top_view; "
        f"save_top_view(sample_scene(0), {str(tmp_path / 'a.png')!r}); "
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
