"""The view in three dimensions; skipped on computers without EGL."""

import sys
from typing import Any

import numpy as np
import pytest
from render_cases import OBJECTS, PATH, fleet, robot

from pgf_jax.errors import BadInput
from pgf_jax.planning.types import Push
from pgf_jax.render import fleet_view
from pgf_jax.render.shelf3d import View3d


@pytest.fixture(scope="module")
def view():
    try:
        view = View3d()
    except BadInput as error:
        pytest.skip(str(error))
    yield view
    view.close()


def green(picture: np.ndarray) -> np.ndarray:
    """[n, 2] rows and columns of the pixels of the goal."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return np.argwhere((green > 1.5 * red) & (green > 1.5 * blue))


def test_the_goal_stands_on_its_side_of_the_shelf(view):
    for y in (0.3, -0.3):
        objects = OBJECTS.copy()
        objects[1] = (0.4, y)
        picture = view.shelf(robot(objects=objects), 320, 260)
        assert picture.shape == (260, 320, 3) and picture.dtype == np.uint8
        goal = green(picture)
        assert len(goal) > 100
        assert (goal[:, 1] < 160).all() if y > 0 else (goal[:, 1] >= 160).all()


def test_deeper_is_higher_up(view):
    rows = []
    for x in (0.25, 0.55):
        picture = view.shelf(robot(objects=np.array([[0.4, 0.3], [x, 0.0]])), 320, 260)
        rows.append(green(picture)[:, 0].mean())
    assert rows[0] > rows[1] + 40


def test_objects_lean_and_lie(view):
    objects = np.array([[0.4, 0.3], [0.4, 0.0]])

    def goal(z: float, *axis: float) -> np.ndarray:
        leaning = np.array([[0.05, 0, 0, 1], [z, *axis]])
        return green(view.shelf(robot(objects=objects, leaning=leaning), 320, 260))

    standing = goal(0.05, 0, 0, 1)
    assert np.array_equal(standing, green(view.shelf(robot(objects=objects), 320, 260)))
    lying, leaning = goal(0.03, 0, 1, 0), goal(0.05, 0, 0.5, np.sqrt(0.75))
    assert np.ptp(lying[:, 1]) > 1.4 * np.ptp(standing[:, 1])  # 0.10 m aside, 0.06 m across
    # It leans to positive y, which is to the left: its top is there.
    assert leaning[:10, 1].mean() < standing[:10, 1].mean() - 5
    # Upside down it looks the same.
    assert len(goal(0.05, 0, 0, -1)) == len(standing)


def test_push_path_and_hand_are_drawn(view):
    plain = view.shelf(robot(), 320, 260)
    changes_each: list[dict[str, Any]] = [
        {"push": Push(0, 0.3, 0.3)},
        {"push": Push(0, *OBJECTS[0])},
        {"path": PATH},
        {"hand": np.array([0.05, 0.0, 0.2])},
        {"gripper": 255.0},
    ]
    for changes in changes_each:
        changed = view.shelf(robot(**changes), 320, 260)
        assert (changed != plain).any(-1).sum() > 30
    np.testing.assert_array_equal(view.shelf(robot(), 320, 260), plain)


def test_one_view_draws_any_size_and_a_fleet(view):
    for width, height in [(700, 500), (60, 50), (300, 420)]:
        assert view.shelf(robot(), width, height).shape == (height, width, 3)
    assert fleet_view.draw(fleet(4, 1), (480, 300), view).shape == (300, 480, 3)


def test_any_number_of_objects_is_drawn(view):
    crowd = np.random.default_rng(0).uniform([0.23, -0.37], [0.55, 0.37], (60, 2))
    assert view.shelf(robot(objects=crowd), 200, 160).shape == (160, 200, 3)


def test_a_closed_view_draws_nothing_more(view):
    other = View3d()
    other.shelf(robot(), 64, 64)
    other.close()
    other.close()
    with pytest.raises(RuntimeError, match="closed"):
        other.shelf(robot(), 64, 64)
    assert view.shelf(robot(), 64, 64).shape == (64, 64, 3)  # this one goes on


def test_without_egl_there_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(BadInput, match=r"view 3d: needs EGL .*--view top") as caught:
        View3d()
    assert "\n" not in str(caught.value)
