"""The heuristic operator on shelves laid out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.guidance.heuristic import WALL_PATIENCE, WALL_ROOM, HeuristicOperator, _culprits
from pgf_jax.guidance.operators import View, make_operator, operator_names, register_operator
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene
from pgf_jax.scene.scene import SIDE_WALL_Y

KNOTS, SLOTS = 8, 4


def shelf(objects, goal=0, *, dropped=0, request=0, force=(), rolled_out=True) -> View:
    """A view of objects at rest, the hand at the origin; `force` are (N, body, body) at the end."""
    objects = np.array(objects, float)
    forces, bodies = np.zeros((KNOTS, SLOTS)), np.zeros((KNOTS, SLOTS, 2), int)
    for slot, (newton, a, b) in enumerate(force):
        forces[-1, slot], bodies[-1, slot] = newton, (a, b)
    return View(
        objects=objects,
        goal=goal,
        hand=np.zeros(3),
        gripper=0.0,
        path=np.broadcast_to(objects, (KNOTS, *objects.shape)),
        hands=np.zeros((KNOTS, 3)),
        force=forces,
        bodies=bodies,
        terms=np.full(5, 0.0 if rolled_out else np.inf),
        request=request,
        dropped=dropped,
    )


def decide(view: View) -> Push:
    push = HeuristicOperator().decide(view)
    assert push is not None
    return push


def request_answered(scene) -> int:
    """The first request that is answered with a push."""
    room = SIDE_WALL_Y - abs(scene.positions[scene.goal, 1])
    return WALL_PATIENCE if room < WALL_ROOM else 0


def test_the_blocker_at_the_front_is_pushed_into_the_shelf():
    goal, front, deep = (0.50, -0.01), (0.34, -0.01), (0.50, 0.12)
    push = decide(shelf([goal, front, deep]))
    assert push.object == 1
    assert push.x > front[0]
    # Not into the goal: its disk stays clear of where the pushed one goes.
    assert np.hypot(push.x - goal[0], push.y - goal[1]) > 0.06


def test_an_object_behind_another_is_left_to_the_one_in_front():
    row = [(0.50, 0.20), (0.32, -0.01), (0.40, -0.01), (0.48, -0.01)]
    assert decide(shelf(row)).object == 1


def test_every_second_time_the_robot_tries_for_itself():
    objects = [(0.50, -0.01), (0.34, -0.01)]
    given = [HeuristicOperator().decide(shelf(objects, request=n)) for n in range(4)]
    assert [push is None for push in given] == [False, True, False, True]


def test_at_a_side_wall_the_robot_tries_for_longer():
    """Going on solves as many of these as a push does; only then is one tried."""
    near, clear = SIDE_WALL_Y - WALL_ROOM + 0.01, SIDE_WALL_Y - WALL_ROOM - 0.01
    given = [
        [
            HeuristicOperator().decide(shelf([(0.50, side * y), (0.34, side * y)], request=n))
            for n in range(WALL_PATIENCE + 3)
        ]
        for y in (near, clear)
        for side in (1, -1)
    ]
    pushes = [[push is not None for push in of_goal] for of_goal in given]
    at_wall = [False] * WALL_PATIENCE + [True, False, True]
    assert pushes == [at_wall] * 2 + [[True, False] * 3] * 2


def test_there_may_be_nothing_to_push():
    assert HeuristicOperator().decide(shelf([(0.50, -0.01)])) is None


def test_a_dropped_push_is_not_offered_again():
    objects = [(0.50, -0.01), (0.36, -0.01), (0.50, 0.25), (0.44, 0.05)]
    offers = [decide(shelf(objects, dropped=n)) for n in range(4)]
    for i, one in enumerate(offers):
        for other in offers[:i]:
            far = np.hypot(one.x - other.x, one.y - other.y) >= 0.08
            assert one.object != other.object or far


def test_culprits_are_in_the_hand_or_pressed_or_jammed():
    # ee is at (0.182, -0.009): object 1 sits in the hand, 2 is pressed ahead, 3 slides along the
    # side, 4 is jammed against a wall, 5 touches a wall lightly, 0 is the goal.
    objects = [(0.50, 0.0), (0.22, 0.0), (0.30, 0.0), (0.10, 0.09), (0.4, 0.37), (0.3, -0.37)]
    hand, wall = len(objects), len(objects) + 1
    force = [(20, 2, hand), (20, hand, 3), (30, wall, 4), (3, wall, 5)]
    assert _culprits(shelf(objects, force=force)).tolist() == [0, 1, 1, 0, 1, 0]


def test_nothing_is_a_culprit_before_the_first_rollout():
    view = shelf([(0.5, 0.0), (0.22, 0.0)], rolled_out=False)
    assert not _culprits(view).any()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), preset=st.sampled_from(["tight", "medium", "wide"]))
def test_any_push_stays_on_the_shelf_and_leaves_the_goal_alone(seed, preset):
    scene = sample_scene(seed, preset)
    view = shelf(scene.positions, scene.goal, request=request_answered(scene))
    push = decide(view)
    assert push == decide(view)
    assert push.object != scene.goal
    assert 0.28 < push.x < 0.59 - 0.03
    assert abs(push.y) < 0.40 - 0.03


def test_registry():
    assert {"none", "heuristic"} <= set(operator_names())
    assert make_operator("none").decide(shelf([(0.5, 0.0), (0.36, 0.0)])) is None
    with pytest.raises(BadInput, match=r"unknown operator 'nobody': expected one of .*heuristic"):
        make_operator("nobody")
    register_operator("always-first", lambda: _First())
    assert make_operator("always-first").decide(shelf([(0.5, 0.0)])) == Push(0, 0.4, 0.0)


class _First:
    name = "always-first"

    def decide(self, view: View) -> Push | None:
        return Push(0, 0.4, 0.0)
