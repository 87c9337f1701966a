"""The view of a shelf from above."""

import math

import numpy as np
import pytest
from render_cases import GOAL, OBJECTS, PATH, count, robot

from pgf_jax.planning.types import Push
from pgf_jax.render.top import Frame, TopView
from pgf_jax.scene.draw import CORRIDOR_OBJECT_COLOR, GOAL_COLOR, OBJECT_COLOR, ROBOT_COLOR
from pgf_jax.scene.shelf import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y, standard_shelf


def color_at(picture: np.ndarray, x: float, y: float) -> str:
    height, width = picture.shape[:2]
    px, py = Frame(width, height).project(x, y)
    return "#" + bytes(picture[int(py), int(px)]).hex()


@pytest.mark.parametrize("size", [(640, 480), (150, 130), (500, 900), (900, 300)])
def test_everything_lies_where_it_is(size):
    picture = TopView().shelf(robot(), *size)
    assert picture.shape == (size[1], size[0], 3) and picture.dtype == np.uint8
    for i, (x, y) in enumerate(OBJECTS):  # beside its number
        expected = GOAL_COLOR if i == GOAL else OBJECT_COLOR
        assert color_at(picture, x, y + 0.65 * RADIUS) == expected
        assert color_at(picture, x, y - 0.65 * RADIUS) == expected
    assert color_at(picture, 0.0, 0.0) == ROBOT_COLOR
    area = math.pi * (RADIUS * Frame(*size).pixels_per_metre) ** 2
    assert 0.6 * area < count(picture, GOAL_COLOR) < area


def test_objects_and_walls_of_other_sizes():
    n = len(OBJECTS)
    own = standard_shelf(n)._replace(radius=np.full(n, 0.02), back_x=0.8, side_y=0.6)
    picture = TopView().shelf(robot(shelf=own), 900, 700)
    frame = Frame(900, 700, 0.8, 0.6)
    px, py = frame.project(0.8 + 0.006, 0.3)
    assert "#" + bytes(picture[int(py), int(px)]).hex() == "#7a5c3a"  # the back wall
    area = math.pi * (0.02 * frame.pixels_per_metre) ** 2
    assert 0.6 * area < count(picture, GOAL_COLOR) < area


def test_left_is_left_and_deep_is_up():
    at = {
        name: Frame(400, 300).project(x, y)
        for name, x, y in [
            ("left", 0.4, SIDE_WALL_Y),
            ("right", 0.4, -SIDE_WALL_Y),
            ("front", FRONT_X, 0.0),
            ("back", BACK_WALL_X, 0.0),
        ]
    }
    assert 0 < at["left"][0] < 200 < at["right"][0] < 400
    assert 0 < at["back"][1] < at["front"][1] < 300


def test_a_push_marks_the_object_and_its_target():
    view, push = TopView(), Push(0, 0.30, 0.30)
    pushed = view.shelf(robot(push=push), 640, 480)
    assert color_at(pushed, 0.45, 0.20 - 0.65 * RADIUS) == CORRIDOR_OBJECT_COLOR
    plain = view.shelf(robot(), 640, 480)
    for x, y in [(0.30, 0.30), (0.375, 0.25)]:  # the target, the middle of the arrow
        assert color_at(pushed, x, y) != color_at(plain, x, y)
    there = view.shelf(robot(push=Push(0, *OBJECTS[0])), 640, 480)  # no arrow, and no failure
    assert there.shape == plain.shape


def test_the_path_leads_the_end_effector():
    view = TopView()
    with_path, without = view.shelf(robot(path=PATH), 640, 480), view.shelf(robot(), 640, 480)
    rows, columns = np.nonzero((with_path != without).any(-1))
    far = Frame(640, 480).project(PATH[-1, 0] + 0.19, PATH[-1, 1])
    assert rows.min() < far[1] + 60 and columns.max() > far[0] - 20
    single = view.shelf(robot(path=PATH[:1]), 640, 480)
    assert single.shape == without.shape


def test_pictures_do_not_leave_traces_in_later_ones():
    view = TopView()
    first = view.shelf(robot(), 320, 240)
    view.shelf(robot(hand=np.array([0.2, 0.1, 0.3]), path=PATH, gripper=255.0), 320, 240)
    np.testing.assert_array_equal(view.shelf(robot(), 320, 240), first)
