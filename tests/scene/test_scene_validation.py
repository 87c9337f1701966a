import math

import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.scene import (
    Scene,
    corridor_count,
    corridor_mask,
    deeper_count,
    nearest_distances,
    scene_statistics,
)

R = 0.03


def refused(objects, goal=0, name="shelf_7") -> str:
    with pytest.raises(BadInput) as caught:
        Scene(name, objects, goal)
    message = str(caught.value)
    assert "\n" not in message
    assert "shelf_7" in message
    return message


def test_a_scene_keeps_its_own_read_only_copy():
    given = np.array([[0.4, 0.0, R], [0.4, 0.1, R]])
    scene = Scene("s", given, 1)
    given[0, 0] = 0.5
    assert scene.objects[0, 0] == 0.4
    np.testing.assert_array_equal(scene.positions, [[0.4, 0.0], [0.4, 0.1]])
    with pytest.raises(ValueError, match="read-only"):
        scene.objects[0, 0] = 0.5


def test_a_list_of_numbers_and_a_numpy_goal_are_accepted():
    scene = Scene("s", [[0.4, 0.0, R]], np.int64(0))  # pyright: ignore[reportArgumentType]
    assert scene.objects.dtype == np.float64
    assert type(scene.goal) is int


@pytest.mark.parametrize("objects", [[], [0.4, 0.0, R], [[0.4, 0.0]], np.zeros((0, 3))])
def test_wrong_shape(objects):
    message = refused(objects)
    assert "[N, 3]" in message
    assert str(np.shape(objects)) in message


@pytest.mark.parametrize(("objects", "value"), [("cup", "'cup'"), ([[0.4, 0.0, R], [1]], "[1]")])
def test_not_numbers(objects, value):
    assert value in refused(objects)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_not_finite(bad):
    message = refused([[0.4, 0.0, R], [0.4, bad, R]])
    assert "object_2" in message
    assert f"{bad:g}" in message


@pytest.mark.parametrize("goal", [-1, 2])
def test_goal_out_of_range(goal):
    message = refused([[0.4, 0.0, R], [0.4, 0.1, R]], goal)
    assert "0..1" in message
    assert f"got {goal}" in message


@pytest.mark.parametrize("goal", [1.0, "object_3", None])
def test_goal_not_an_index(goal):
    assert repr(goal) in refused([[0.4, 0.0, R], [0.4, 0.1, R]], goal)


def test_other_radius():
    message = refused([[0.4, 0.0, R], [0.4, 0.2, 0.06]])
    assert "object_2" in message
    assert "0.06" in message
    assert "0.015..0.05" in message
    assert "at most 0.035 m" in refused([[0.4, 0.0, 0.04], [0.4, 0.2, R]])
    scene = Scene("s", np.array([[0.4, 0.0, R], [0.4, 0.2, 0.04]]), 0)
    assert scene.shelf is not None and scene.shelf.radius.tolist() == [R, 0.04]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"heights": [0.1]}, r"heights must be \[2\], one of each object, got shape \(1,\)"),
        ({"heights": [0.1, 0.05]}, "object_2 has height 0.05 m; expected within 0.06..0.2 m"),
        ({"heights": [0.1, 0.13]}, "object_2 is 0.13 m high .* would tip; expected at most 0.12 m"),
        ({"masses": [-1.0, 1.0]}, "object_1 has mass -1 kg; expected within 0.05..5 kg"),
        ({"masses": [math.nan, 1.0]}, "object_1 has mass nan kg"),
        ({"masses": ["heavy", 1.0]}, r"masses must be numbers \[N\] mass, got"),
        ({"table_frictions": [0.5, 0.0]}, "object_2 has table friction 0; expected within 0.1..1"),
        ({"frictions": [0.5, 9.0]}, "object_2 has friction 9; expected within 0.05..1"),
        ({"width": 0.3}, "the shelf has width 0.3 m; expected within 0.4..1.6 m"),
        ({"depth": [0.3]}, r"depth must be a number, got \[0.3\]"),
        ({"depth": 0.2}, r"object_1 at \(0.4, 0\) is outside the shelf"),
    ],
)
def test_properties_that_are_not_simulated(changes, message):
    with pytest.raises(BadInput, match=message):
        Scene("s", np.array([[0.4, 0.0, R], [0.4, 0.2, R]]), 0, **changes)


def test_what_is_given_as_standard_is_standard():
    scene = Scene("s", np.array([[0.4, 0.0, R]]), 0, heights=[0.1], masses=[1], width=0.8)  # pyright: ignore[reportArgumentType]
    assert scene.shelf is None and (scene.back_x, scene.side_y) == (0.59, 0.4)
    deep = Scene("s", np.array([[0.6, 0.0, R]]), 0, depth=0.5)
    assert deep.shelf is not None and deep.shelf.back_x == deep.back_x == 0.7


@pytest.mark.parametrize(
    ("x", "y"), [(0.57, 0.0), (0.4, 0.38), (0.4, -0.38), (0.19, 0.0), (-0.4, 0.0)]
)
def test_outside_the_shelf(x, y):
    message = refused([[0.4, 0.1, R], [x, y, R]])
    assert "object_2" in message
    assert f"({x:g}, {y:g})" in message
    assert "0.2 <= x <= 0.56" in message
    assert "|y| <= 0.37" in message


def test_touching_the_walls_is_inside():
    Scene("s", [[0.56, 0.37, R], [0.56, -0.37, R], [0.20, 0.0, R]], 0)  # pyright: ignore[reportArgumentType]


def test_overlap_names_the_worst_pair():
    # 3-4-5 triangle: centres 0.050 m apart, 10 mm too close; objects 1 and 2 are 2 mm too close.
    message = refused([[0.30, 0.20, R], [0.358, 0.20, R], [0.40, 0.0, R], [0.43, 0.04, R]])
    assert "object_3 and object_4" in message
    assert "10.0 mm" in message
    assert "0.06" in message


def test_touching_objects_do_not_overlap():
    Scene("s", [[0.4, 0.0, R], [0.4, 0.06, R]], 0)  # pyright: ignore[reportArgumentType]


# Hand on the x axis at 0.2, goal at 0.5: the corridor is 0.2 < x < 0.49, |y| < 0.065.
@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [
        (0.35, 0.064, True),
        (0.35, -0.064, True),
        (0.35, 0.066, False),
        (0.489, 0.062, True),
        (0.491, 0.062, False),
        (0.201, 0.0, True),
        (0.2, 0.0, False),
    ],
)
def test_corridor_along_the_x_axis(x, y, inside):
    scene = Scene("s", np.array([[x, y, R], [0.5, 0.0, R]]), 1)
    assert corridor_mask(scene, (0.2, 0.0)).tolist() == [inside, False]


def test_corridor_is_turned_with_the_goal():
    # Towards (0.6, 0.8) over 0.4 m; an object 0.2 m along, 0.06 m across, and one 0.07 m across.
    hand, along, across = np.array([0.2, -0.1]), np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    goal = hand + 0.4 * along
    near, far = hand + 0.2 * along + 0.06 * across, hand + 0.2 * along - 0.07 * across
    scene = Scene("s", np.column_stack([[near, far, goal], [R, R, R]]), 2)
    assert corridor_mask(scene, (0.2, -0.1)).tolist() == [True, False, False]


def test_corridor_from_a_hand_at_the_goal_is_empty():
    scene = Scene("s", np.array([[0.4, 0.0, R], [0.3, 0.0, R]]), 0)
    assert not corridor_mask(scene, (0.4, 0.0)).any()


def test_statistics_of_two_scenes_by_hand():
    # Goal straight ahead of the start with one object before it, one behind it.
    first = Scene(
        "a", np.array([[0.3, -0.0088, R], [0.55, -0.0088, R], [0.45, -0.0088, R]]), goal=2
    )
    # The same goal, with its neighbours clear to the side and less deep.
    second = Scene("b", np.array([[0.3, 0.2, R], [0.3, 0.27, R], [0.45, -0.0088, R]]), goal=2)
    assert [corridor_count(s) for s in (first, second)] == [1, 0]
    assert [deeper_count(s) for s in (first, second)] == [1, 0]
    np.testing.assert_allclose(nearest_distances(first), [0.15, 0.10, 0.10])
    both = scene_statistics([first, second])
    assert both.scenes == 2
    assert both.x_range == (0.3, 0.55)
    assert both.y_range == (-0.0088, 0.27)
    assert both.goal_x == (0.45, 0.45, 0.45)
    assert both.corridor_mean == 0.5
    assert both.corridor_min == 0
    assert both.spacing_min == pytest.approx(0.07)
    assert both.near_pairs == 0.5


def test_statistics_need_a_scene():
    with pytest.raises(BadInput, match="at least one scene"):
        scene_statistics([])


def test_nearest_of_a_lone_object_is_infinite():
    assert nearest_distances(Scene("s", np.array([[0.4, 0.0, R]]), 0)).tolist() == [math.inf]
