"""The heuristic operator on shelves laid out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.guidance.heuristic import HeuristicOperator, _culprits
from pgf_jax.guidance.operators import View, make_operator, operator_names, register_operator
from pgf_jax.planning.types import Push
from pgf_jax.scene import corridor_count, sample_scene

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


def test_the_only_blocker_is_pushed_out_of_the_corridor():
    goal, blocker, bystander = (0.50, -0.01), (0.36, -0.01), (0.50, 0.25)
    push = decide(shelf([goal, blocker, bystander]))
    assert push.object == 1
    # The corridor runs along y = -0.009; an object of radius 0.03 leaves it at 0.065 and more.
    assert abs(push.y + 0.009) > 0.065


def test_it_frees_the_reach_of_a_sampled_scene():
    """Seen from the start, pushing never adds a blocker, and over many scenes it removes some."""
    before = after = 0
    for seed in range(30):
        scene = sample_scene(seed, "tight")
        push = decide(shelf(scene.positions, scene.goal, rolled_out=False))
        moved = np.array(scene.objects)
        moved[push.object, :2] = push.x, push.y
        before += corridor_count(scene)
        after += int(_blockers(moved[:, :2], scene.goal))
    assert after < 0.9 * before


def _blockers(objects: np.ndarray, goal: int) -> int:
    """Counted anew: centres within 0.065 m of the line from ee to 0.01 m before the goal."""
    ee = np.array([0.1821, -0.0088])
    line = objects[goal] - ee
    length = np.linalg.norm(line)
    forward = (objects - ee) @ line / length
    aside = np.abs((objects - ee) @ np.array([-line[1], line[0]]) / length)
    inside = (forward > 0) & (forward < length - 0.01) & (aside < 0.065)
    inside[goal] = False
    return inside.sum()


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


def test_it_goes_on_where_the_way_is_free_and_input_was_given_before():
    free = [(0.50, -0.01), (0.50, 0.25)]
    assert HeuristicOperator().decide(shelf(free, request=1)) is None
    assert HeuristicOperator().decide(shelf([(0.50, -0.01)])) is None  # nothing to push


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
