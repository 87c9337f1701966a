"""The noisy operator: what the heuristic says, and the errors on top, without any rollouts."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators import heuristic
from pgf_jax.guidance.operators.heuristic import (
    HeuristicOperator,
    candidates,
    target_bounds,
)
from pgf_jax.guidance.operators.noisy import NoisyOperator
from pgf_jax.guidance.operators.registry import make_operator
from pgf_jax.guidance.trials import Trial
from pgf_jax.guidance.view import View
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene

KNOTS = 8
DECISION = (7, 1, 2, 5)  # seed, robot, task, iterations that have ended
# The goal is nearest to object 1, then 2, then 3.
OBJECTS = [(0.36, 0.05), (0.36, -0.02), (0.42, -0.10), (0.50, 0.20)]
MEANT = Push(1, 0.41, -0.02)


def shelf(objects=OBJECTS, goal=0) -> View:
    """A view of objects at rest, the hand at the origin."""
    objects = np.array(objects, float)
    return View(
        objects=objects,
        goal=goal,
        hand=np.zeros(3),
        gripper=0.0,
        path=np.broadcast_to(objects, (KNOTS, *objects.shape)),
        hands=np.zeros((KNOTS, 3)),
        force=np.zeros((KNOTS, 4)),
        bodies=np.zeros((KNOTS, 4, 2), int),
        terms=np.zeros(5),
        request=0,
        dropped=0,
    )


def decisions(count):
    return [(seed, robot, 3, i) for seed in range(2) for robot in range(5) for i in range(count)]


def distance(one: Push, other: Push) -> float:
    return math.hypot(one.x - other.x, one.y - other.y)


# -- what it starts from -------------------------------------------------------------------------


@pytest.fixture
def simulated(monkeypatch):
    """Trials without rollouts: a push is the better the deeper it ends, going on costs `go_on`."""
    costs = {"go_on": 0.5}

    def simulate_input(planner, search, push, key_paths, **limits):
        total = costs["go_on"] if push is None else 0.6 - push.x
        return Trial(total, total, True, 1, 2, push is not None, search)
        yield  # makes it a coroutine

    monkeypatch.setattr(heuristic, "simulate_input", simulate_input)
    return costs


def said(operator, view: View, decision_key=DECISION):
    """What an operator says whose trials ask for no rollouts."""
    return _run(operator.deliberate(view, None, None, decision_key))


def _run(coroutine):
    answers = None
    while True:
        try:
            requests = coroutine.send(answers)
        except StopIteration as end:
            return end.value
        answers = [_run(request.make()) for request in requests]


@pytest.mark.parametrize("preset", ["tight", "medium", "wide"])
def test_without_errors_it_is_the_heuristic(simulated, preset):
    for seed in range(5):
        scene = sample_scene(seed, preset)
        view = shelf(scene.positions, scene.goal)
        meant = said(HeuristicOperator(), view)
        assert meant is not None
        assert said(NoisyOperator(wrong=0, misplaced=0), view) == meant
        # With both, it is the heuristic's input with the errors of that decision.
        operator = NoisyOperator(wrong=1, misplaced=1)
        assert said(operator, view) == operator.with_errors(meant, view, DECISION)
        assert said(operator, view).object not in (meant.object, scene.goal)


def test_going_on_stays_going_on(simulated):
    operator = NoisyOperator(wrong=1, misplaced=1)
    assert said(operator, shelf()) is not None
    simulated["go_on"] = 0.0
    assert [said(operator, shelf(), key) for key in decisions(20)] == [None] * 200


# -- errors --------------------------------------------------------------------------------------


def test_the_wrong_object_is_the_nearest_other_one_and_moves_as_far():
    push = NoisyOperator(wrong=1, misplaced=0).with_errors(MEANT, shelf(), DECISION)
    assert push.object == 2
    assert (push.x, push.y) == pytest.approx((0.42 + 0.05, -0.10))
    # With another goal, object 0 is the nearest; of two at the same distance, the first.
    assert NoisyOperator(wrong=1).with_errors(MEANT, shelf(goal=3), DECISION).object == 0
    twins = [*OBJECTS[:2], (0.36, -0.08), (0.36, -0.08)]
    assert NoisyOperator(wrong=1).with_errors(MEANT, shelf(twins), DECISION).object == 2


def test_the_wrong_object_stays_on_the_shelf():
    view = shelf([(0.3, 0.3), (0.40, -0.02), (0.52, -0.02)])
    push = NoisyOperator(wrong=1, misplaced=0).with_errors(Push(1, 0.45, -0.02), view, DECISION)
    assert push == Push(2, 0.59 - 0.048, -0.02)  # not 0.57


def test_there_may_be_no_other_object():
    view = shelf(OBJECTS[:2])
    assert NoisyOperator(wrong=1, misplaced=0).with_errors(MEANT, view, DECISION) == MEANT


def test_a_misplaced_target_is_of_the_same_object():
    operator = NoisyOperator(wrong=0, misplaced=1)
    pushes = [operator.with_errors(MEANT, shelf(), key) for key in decisions(20)]
    assert {push.object for push in pushes} == {1}
    assert min(distance(push, MEANT) for push in pushes) > 0
    assert len(set(pushes)) == len(pushes)


def test_errors_depend_on_the_decision_key_alone():
    operator = NoisyOperator(wrong=0.5, misplaced=0.5)
    given = [operator.with_errors(MEANT, shelf(), key) for key in decisions(20)]
    backwards = [
        NoisyOperator(0.5, 0.5).with_errors(MEANT, shelf(), key) for key in decisions(20)[::-1]
    ]
    assert given == backwards[::-1]
    # Every part of the key matters.
    always = NoisyOperator(wrong=0, misplaced=1, sd_m=0.01)
    others = [DECISION, (8, 1, 2, 5), (7, 2, 2, 5), (7, 1, 3, 5), (7, 1, 2, 6), (7, 2, 1, 5)]
    assert len({always.with_errors(MEANT, shelf(), key) for key in others}) == len(others)
    # The push does not, nor the shelf, nor the rate of the other error.
    push = always.with_errors(MEANT, shelf(), DECISION)
    elsewhere = always.with_errors(Push(3, 0.43, 0.10), shelf(goal=2), DECISION)
    both = NoisyOperator(wrong=1, misplaced=1, sd_m=0.01).with_errors(MEANT, shelf(), DECISION)
    off = (push.x - MEANT.x, push.y - MEANT.y)
    assert (elsewhere.x - 0.43, elsewhere.y - 0.10) == pytest.approx(off, abs=1e-12)
    assert (both.x - 0.47, both.y + 0.10) == pytest.approx(off, abs=1e-12)


def test_errors_grow_with_their_rates():
    """Common random numbers: who errs at a low rate errs in the same way at a higher one."""
    for key in decisions(40):
        low = NoisyOperator(wrong=0.2, misplaced=0).with_errors(MEANT, shelf(), key)
        high = NoisyOperator(wrong=0.6, misplaced=0).with_errors(MEANT, shelf(), key)
        assert low in (high, MEANT)


@pytest.mark.parametrize("rates", [(0.2, 0.3), (0.7, 0.1)])
def test_errors_are_as_frequent_and_as_large_as_said(rates):
    wrong, misplaced = rates
    operator = NoisyOperator(wrong, misplaced, sd_m=0.01)  # so small that nothing is clipped
    pushes = [operator.with_errors(MEANT, shelf(), key) for key in decisions(600)]
    of_another = np.array([push.object == 2 for push in pushes])
    ends = np.array([(push.x, push.y) for push in pushes])
    off = ends - np.where(of_another[:, None], (0.47, -0.10), (0.41, -0.02))
    moved = np.abs(off).max(1) > 1e-9
    n = len(pushes)
    for errs, rate in ((of_another, wrong), (moved, misplaced), (of_another & moved, None)):
        rate = wrong * misplaced if rate is None else rate  # the two are independent
        assert abs(errs.mean() - rate) < 4 * math.sqrt(rate * (1 - rate) / n)
    off, count = off[moved], moved.sum()
    np.testing.assert_allclose(off.mean(0), 0, atol=4 * 0.01 / math.sqrt(count))
    np.testing.assert_allclose(off.std(0), 0.01, rtol=4 / math.sqrt(2 * count))
    assert abs(np.corrcoef(off.T)[0, 1]) < 4 / math.sqrt(count)
    # Normal: 68.3 % within one standard deviation, 4.55 % beyond two, on both axes together.
    assert np.mean(np.abs(off) < 0.01) == pytest.approx(0.6827, abs=4 * 0.47 / math.sqrt(2 * count))
    assert np.mean(np.abs(off) > 0.02) == pytest.approx(0.0455, abs=4 * 0.21 / math.sqrt(2 * count))


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    preset=st.sampled_from(["tight", "medium", "wide"]),
    which=st.integers(0, 10**6),
    rates=st.tuples(st.floats(0, 1), st.floats(0, 1), st.floats(0, 10)),
    iteration=st.integers(0, 60),
)
def test_any_error_is_a_legal_push(seed, preset, which, rates, iteration):
    scene = sample_scene(seed, preset)
    view = shelf(scene.positions, scene.goal)
    pushed, targets = candidates(view)
    which %= len(pushed)
    meant = Push(int(pushed[which]), *map(float, targets[which]))
    decision_key = (seed, 0, 0, iteration)
    push = NoisyOperator(*rates).with_errors(meant, view, decision_key)
    assert 0 <= push.object < len(view.objects) and push.object != scene.goal
    assert 0.28 <= push.x <= 0.59 - 0.048 and abs(push.y) <= 0.40 - 0.048
    assert NoisyOperator(0, 0).with_errors(meant, view, decision_key) == meant
    assert push == NoisyOperator(*rates).with_errors(meant, view, decision_key)


def test_the_bounds_are_those_of_the_heuristic():
    """Every target that the heuristic considers is within them, and none is left out."""
    scene = sample_scene(3, "wide")
    view = shelf(scene.positions, scene.goal)
    pushed, targets = candidates(view)
    angles = np.arange(16) * math.pi / 8
    expected = [
        (i, x + d * math.cos(a), y + d * math.sin(a))
        for i, (x, y) in enumerate(scene.positions)
        for d in (0.06, 0.10, 0.15, 0.20)
        for a in angles
        if i != scene.goal
        and 0.28 < x + d * math.cos(a) < 0.542
        and abs(y + d * math.sin(a)) < 0.352
    ]
    np.testing.assert_array_equal(pushed, [i for i, *_ in expected])
    np.testing.assert_allclose(targets, [to for _, *to in expected], atol=1e-12)
    np.testing.assert_allclose(target_bounds(view, 0), [(0.28, -0.352), (0.542, 0.352)])


# -- settings ------------------------------------------------------------------------------------


def test_it_is_made_by_its_name():
    assert make_operator("noisy") == NoisyOperator(wrong=0.2, misplaced=0.3, sd_m=0.04)
    assert make_operator("noisy").name == "noisy"
    with pytest.raises(BadInput, match=r"operator: expected .*, got 'noisy:0.5'"):
        make_operator("noisy:0.5")


@pytest.mark.parametrize("name", ["wrong", "misplaced"])
@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan, math.inf, "0.5", True, None])
def test_rates_that_cannot_be(name, value):
    with pytest.raises(BadInput, match=rf"^{name}: expected a number within 0\.\.1, got "):
        NoisyOperator(**{name: value})


@pytest.mark.parametrize("value", [-0.01, math.nan, math.inf, "0.5", True, None])
def test_deviations_that_cannot_be(value):
    with pytest.raises(BadInput, match=r"^sd_m: expected a number of metres, 0 or more, got "):
        NoisyOperator(sd_m=value)


def test_a_deviation_of_nothing_misplaces_nothing():
    operator = NoisyOperator(wrong=0, misplaced=1, sd_m=0)
    assert [operator.with_errors(MEANT, shelf(), key) for key in decisions(2)] == [MEANT] * 20
