"""The heuristic operator on shelves laid out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.guidance.geometry import culprits
from pgf_jax.guidance.operators.base import NoOperator
from pgf_jax.guidance.operators.heuristic import HeuristicOperator
from pgf_jax.guidance.operators.registry import make_operator, operator_names, register_operator
from pgf_jax.guidance.view import View
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene

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
    """What it would try first, by geometry alone."""
    (push,) = HeuristicOperator().ranked(view, 1)
    return push


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


def test_there_may_be_nothing_to_push():
    assert HeuristicOperator().ranked(shelf([(0.50, -0.01)]), 5) == []


def test_no_two_choices_are_alike():
    """A push that could not be planned says that its like cannot either."""
    view = shelf([(0.50, -0.01), (0.36, -0.01), (0.50, 0.25), (0.44, 0.05)])
    offers = HeuristicOperator().ranked(view, 12)
    assert len(offers) == 12 and {push.object for push in offers} == {1, 3}
    for i, one in enumerate(offers):
        for other in offers[:i]:
            far = np.hypot(one.x - other.x, one.y - other.y) >= 0.08
            assert one.object != other.object or far


def test_the_best_few_are_the_first_of_more():
    view = shelf([(0.50, -0.01), (0.36, -0.01), (0.50, 0.25), (0.44, 0.05)])
    ranked = HeuristicOperator().ranked
    assert ranked(view, 3) == ranked(view, 12)[:3]
    most = ranked(view, 10**6)
    assert 12 < len(most) < 3 * 16 * 4


def test_culprits_are_in_the_hand_or_pressed_or_jammed():
    # ee is at (0.182, -0.009): object 1 sits in the hand, 2 is pressed ahead, 3 slides along the
    # side, 4 is jammed against a wall, 5 touches a wall lightly, 0 is the goal.
    objects = [(0.50, 0.0), (0.22, 0.0), (0.30, 0.0), (0.10, 0.09), (0.4, 0.37), (0.3, -0.37)]
    hand, wall = len(objects), len(objects) + 1
    force = [(20, 2, hand), (20, hand, 3), (30, wall, 4), (3, wall, 5)]
    assert culprits(shelf(objects, force=force)).tolist() == [0, 1, 1, 0, 1, 0]


def test_nothing_is_a_culprit_before_the_first_rollout():
    view = shelf([(0.5, 0.0), (0.22, 0.0)], rolled_out=False)
    assert not culprits(view).any()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), preset=st.sampled_from(["tight", "medium", "wide"]))
def test_any_push_stays_on_the_shelf_and_leaves_the_goal_alone(seed, preset):
    scene = sample_scene(seed, preset)
    view = shelf(scene.positions, scene.goal)
    push = decide(view)
    assert push == decide(view)
    assert push.object != scene.goal
    assert 0.28 < push.x < 0.59 - 0.03
    assert abs(push.y) < 0.40 - 0.03


def test_registry():
    assert {"none", "heuristic", "oracle", "clairvoyant"} <= set(operator_names())
    for name in ("none", "heuristic", "oracle", "clairvoyant"):
        assert make_operator(name).name == name
    assert NoOperator().decide(shelf([(0.5, 0.0), (0.36, 0.0)])) is None
    with pytest.raises(BadInput, match=r"operator: expected one of .*heuristic.*, got 'nobody'"):
        make_operator("nobody")
    register_operator("always-first", _First)
    assert isinstance(make_operator("always-first"), _First)


class _First:
    name = "always-first"

    def decide(self, view: View) -> Push | None:
        return Push(0, 0.4, 0.0)
