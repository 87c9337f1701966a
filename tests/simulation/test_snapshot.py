"""What the console and `render` both say of a robot and a fleet."""

import math

import numpy as np
import pytest
from render_cases import PATH, fleet, robot

from pgf_jax.fleet.records import State
from pgf_jax.guidance.geometry import end_effector
from pgf_jax.physics import hand
from pgf_jax.planning.types import Push, Status


@pytest.mark.parametrize(
    ("state", "alone", "with_push"),
    [
        (State.IDLE, "done", "done"),
        (State.PLANNING, "planning", "planning push"),
        (State.IN_WINDOW, "bids", "bids"),
        (State.IN_LINE, "waiting", "waiting"),
        (State.SERVED, "served", "served"),
        (State.EXECUTING, "executing", "pushing"),
    ],
)
def test_every_state_has_its_activity(state, alone, with_push):
    assert robot(state=state).activity == alone
    assert robot(state=state, push=Push(0, 0.5, 0.3)).activity == with_push
    assert robot(state=state).is_waiting == (alone in ("bids", "waiting"))


@pytest.mark.parametrize(
    ("bid", "text"),
    [(None, ""), (math.nan, ""), (math.inf, "stuck"), (23.4, "23"), (2.34, "2.3"), (0.234, "0.23")],
)
def test_a_bid_as_text(bid, text):
    assert robot(bid=bid).bid_text == text


def test_progress_counts_ended_and_solved_tasks():
    assert robot(done=(Status.SOLVED, Status.STUCK, Status.SOLVED)).solved == 2
    assert fleet(9).progress == "2 of 18 tasks done, 1 solved"


def test_the_hand_and_its_path_lie_where_its_poses_say():
    snapshot = robot(path=PATH, hand=np.array([0.1, -0.2, 0.3]), gripper=100.0)
    expected = [end_effector(pose) for pose in PATH]
    np.testing.assert_allclose(snapshot.end_effector_path(), expected, atol=1e-12)
    assert robot().end_effector_path().shape == (0, 2)
    turn = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
    for axis, own in zip(snapshot.hand_axes(), hand.capsule_segments(100.0), strict=True):
        for point, of_hand in zip(axis, own, strict=True):
            np.testing.assert_allclose(point, turn @ of_hand + [0.1, -0.2], atol=1e-12)
