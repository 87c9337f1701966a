"""The motion of a plan: what its engine simulates, and the retreat after each push."""

import dataclasses
import math

import numpy as np
import pytest
from render_plans import PUSH, REACH, plan

from pgf_jax.errors import BadInput
from pgf_jax.fleet.records import State
from pgf_jax.physics import hand
from pgf_jax.physics.config import PHYSICS, Physics
from pgf_jax.physics.engine import World, make_engine
from pgf_jax.planning.types import Status
from pgf_jax.plans.motion import Motion


@pytest.fixture(scope="module")
def motion() -> Motion:
    return Motion(plan())


def roll(world: World, controls, gripper, substeps: int) -> World:
    """The world after a rollout of 8 knots in one call, as in planning."""
    engine = make_engine("native", n_objects=3, threads=1)
    start = World(*(np.asarray(value)[None] for value in world))
    out = engine.rollout(start, controls[None], np.asarray(gripper)[None], substeps)
    return World(out.objects[0, -1], out.velocities[0], out.hand[0, -1], gripper[-1])


def test_it_ends_where_the_plans_engine_says(motion):
    world = World(plan().scene.positions, np.zeros((3, 2)), np.zeros(3), 0.0)
    pushed = roll(world, PUSH.controls, PUSH.gripper, 36)
    yaw = pushed.hand[2] + hand.POINTING_YAW
    back = np.tile([-0.07 * math.cos(yaw), -0.07 * math.sin(yaw), 0.0], (8, 1))
    retreated = roll(pushed, back, np.full(8, PUSH.gripper[-1]), 12)
    reached = roll(retreated, REACH.controls, REACH.gripper, 36)
    assert np.abs(pushed.objects[2] - plan().scene.positions[2]).max() > 0.02  # the goal moved
    for time_s, expected in [(3.0, pushed), (4.0, retreated), (7.0, reached)]:
        now = motion.at(time_s)
        np.testing.assert_allclose(now.objects, expected.objects, atol=5e-5)
        np.testing.assert_allclose(now.hand, expected.hand, atol=1e-5)
        assert now.gripper == pytest.approx(expected.gripper, abs=1e-4)
    assert motion.duration_s == pytest.approx(7.0)


def test_between_knots_hand_and_gripper_go_evenly(motion):
    knot_s = 0.375
    for time_s in (0.1, 1.3, 2.9):
        np.testing.assert_allclose(motion.at(time_s).hand, PUSH.controls[0] * time_s, atol=1e-5)
    assert motion.at(knot_s / 4).gripper == pytest.approx(PUSH.gripper[0] / 4, abs=1e-3)
    # Objects move once they are touched, and not from the knot's beginning on.
    touched = np.flatnonzero(np.abs(np.diff(motion.objects[:, 0, 0])) > 1e-5)[0]
    assert motion.times[touched] % knot_s > 1e-6


def test_its_snapshots_say_what_is_done(motion):
    push, retreat, reach, end = (motion.at(t) for t in (1.0, 3.5, 5.0, 7.0))
    assert push.state is retreat.state is reach.state is State.EXECUTING
    assert push.push is not None and push.push.object in (0, 2) and retreat.push == push.push
    assert reach.push is None and reach.waited_s == pytest.approx(1.0)
    assert (end.state, end.done) == (State.IDLE, (Status.TIMED_OUT,))
    assert push.costs == (123.0, 50.0, math.inf) and push.inputs_at == (2,)
    assert push.path.shape == reach.path.shape == (9, 3)
    np.testing.assert_allclose(push.path[4], PUSH.controls[0] * 1.5, atol=1e-5)
    np.testing.assert_allclose(reach.path[-1], end.hand, atol=1e-9)
    np.testing.assert_array_equal(motion.at(99.0).objects, end.objects)


@pytest.mark.parametrize(
    ("times", "frames", "last"),
    [
        ((0.5,), 15, 7.0),
        ((2.0,), 5, 7.0),  # 0, 2, 4, 6, and the end
        ((0.1, 6.95), 2, 7.0),
        ((0.5, 1.0, 3.0), 5, 3.0),
        ((0.5, 7.5), 0, None),
    ],
)
def test_a_film_goes_to_its_end(motion, times, frames, last):
    film = list(motion.film(*times))
    assert len(film) == motion.frames(*times) == frames
    if film:
        np.testing.assert_allclose(film[-1].objects, motion.at(last).objects)
        assert (film[-1].state is State.IDLE) == (last == 7.0)


def test_substeps_that_do_not_divide_go_whole(monkeypatch):
    monkeypatch.setitem(PHYSICS, "odd", Physics(substeps=37))
    assert Motion(plan(physics="odd", segments=(REACH,), pushes=0)).duration_s == pytest.approx(3.0)


def test_what_cannot_be_carried_out_is_one_line(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes what it warns of to a file where it runs
    with pytest.raises(BadInput, match=r"engine: expected one of .*, got 'bull'"):
        Motion(plan(engine="bull"))
    with pytest.raises(
        BadInput, match=r"physics: expected one of default, authors, paper, got .soft."
    ):
        Motion(plan(physics="soft"))
    wild = dataclasses.replace(REACH, controls=np.full((8, 3), 1e30))
    with pytest.raises(BadInput, match="plan short: does not stay finite in engine native"):
        Motion(plan(segments=(wild,), pushes=0))


def test_a_plan_gives_its_motion_and_draws_it():
    made = plan()
    motion = made.motion()
    count = len(motion.times)
    assert motion.times[0] == 0 and (np.diff(motion.times) > 0).all()
    assert motion.objects.shape == (count, len(made.scene.objects), 2)
    assert motion.hand.shape == (count, 3) and motion.gripper.shape == (count,)
    axes = made.plot()
    assert axes.get_title().startswith(made.scene.name)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("y (m)", "x (m), into the shelf")
    paths = [line.get_xydata() for line in axes.get_lines() if len(line.get_xydata()) > 4]  # pyright: ignore
    assert len(paths) >= len(made.segments)
    legend = axes.get_legend()
    assert legend is not None
    words = [text.get_text() for text in legend.get_texts()]
    assert "goal" in words and "where it ends" in words
    # The legend is below the axes, where no data are.
    axes.figure.canvas.draw()
    assert legend.get_window_extent().y1 < axes.get_window_extent().y0
    assert made.scene.plot(axes) is axes
