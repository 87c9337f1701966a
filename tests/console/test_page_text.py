"""What the page says of a robot, and the legend of its colours."""

import math

import pytest
from render_cases import robot

from pgf_jax.console import legend
from pgf_jax.console.fleet_view import DRAG, GOAL, STATES, caption, iterations, title
from pgf_jax.fleet.records import State
from pgf_jax.planning.types import Push, Status

PUSH, MOVING = Push(0, 0.5, 0.3), State.EXECUTING
SOLVED, FAILED = Status.SOLVED, Status.TIMED_OUT


@pytest.mark.parametrize(
    ("changes", "activity", "progress"),
    [
        ({}, "planning", "0 of 2 tasks done"),
        ({"push": PUSH}, "plans a push", "0 of 2 tasks done"),
        ({"push": PUSH, "state": MOVING, "done": (SOLVED,)}, "pushing", "1 of 2 tasks done"),
        ({"state": State.IDLE, "done": (SOLVED, FAILED)}, "done", "2 of 2 tasks done, 1 failed"),
    ],
)
def test_captions(changes, activity, progress):
    shown = robot(3, **changes)
    assert caption(shown, 2, roomy=True) == f"Robot 3: {activity}\n{progress}"
    assert caption(shown, 2, roomy=False) == f"Robot 3\n{activity}"


def test_a_title_says_why_a_robot_asks_where_that_is_known():
    served = {"state": State.SERVED, "gain": 12.0}
    for changes, reason in (
        ({"bid": 12.0}, ["Help is expected to save 12 in cost"]),
        ({"bid": 1.0}, []),  # no cost
        ({"bid": math.inf, "stuck": True}, ["It is stuck"]),
        ({"bid": math.inf}, []),
    ):
        assert title(robot(3, **served, **changes), 1).split("\n") == [
            "Robot 3: being helped",
            "0 of 1 task done",
            *reason,
            "Cost of its best trajectory: 40",
        ]
    assert title(robot(costs=(math.inf,)), 1).endswith("\nCost of its best trajectory")
    assert iterations(robot()) == "after 2 iterations"
    assert iterations(robot(costs=(2.0, 1.0))) == "after 1 iteration"


def test_the_legend_has_a_swatch_for_each_state():
    html = legend.html(live=True)
    for color, text in ((GOAL, "object to grasp"), (DRAG, "where it would"), *STATES.values()):
        assert f"rgb{color}" in html and text in html
    assert "push one object out of its way" in html
    assert "push one object out of its way" not in legend.html(live=False)
