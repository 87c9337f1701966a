"""Features of a reach, worked out by hand."""

import numpy as np
import pytest
from coroutines import DONE, native, stepped, unsolved

from pgf_jax.guidance.predictors.features import (
    FEATURES,
    STATE,
    history_features,
    state_features,
)
from pgf_jax.physics import hand
from pgf_jax.planning.search import start_world
from pgf_jax.scene import sample_scene
from pgf_jax.scene.shelf import BACK_WALL_X, SIDE_WALL_Y


def test_history_features():
    assert np.isnan(history_features(20, [(1, 2, 3), (4, 5, 6)])).all()
    history = [(0, 0, 0), (1, 2, 3), (4, 5, 6), (7, 8, 9)]
    assert history_features(12, history).tolist() == [12, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert FEATURES[0] == "n_objects"
    assert FEATURES[1:4] == ("c_d[t-2]", "c_f[t-2]", "c_b[t-2]")
    assert FEATURES[7:] == ("c_d[t-0]", "c_f[t-0]", "c_b[t-0]")


def test_the_paper_s_features_come_first():
    assert STATE[: len(FEATURES)] == FEATURES
    assert len(set(STATE)) == len(STATE)


@pytest.mark.parametrize("seed", [0, 2])
def test_a_state_by_hand(seed):
    search = unsolved(seed)
    state = dict(zip(STATE, state_features(search).tolist(), strict=True))
    history = np.asarray(search.history, float)
    assert [state[name] for name in FEATURES] == [20, *history.ravel()]
    assert state["iteration"] == DONE - 1 and state["stuck_count"] == search.stuck_count
    goal = int(search.task.goal)
    at, end = np.asarray(search.start.objects[goal], float), search.best.objects[-1]
    assert state["goal_x"] == pytest.approx(at[0])
    assert state["room"] == pytest.approx(SIDE_WALL_Y - abs(at[1]))
    # The hand begins at the origin.
    line = at - hand.EE_POINT
    assert state["range"] == pytest.approx(np.hypot(*line))
    assert state["goal_moved"] == pytest.approx(np.linalg.norm(end[goal] - at), abs=1e-7)
    assert state["end_depth"] == pytest.approx(BACK_WALL_X - end[goal, 0])
    assert state["distance"] == pytest.approx(float(search.value.distance))
    deeper = [i for i in range(20) if search.start.objects[i, 0] > at[0]]
    assert state["deeper"] == len(deeper)
    near = [np.linalg.norm(p - at) < 0.09 for i, p in enumerate(search.start.objects) if i != goal]
    assert state["neighbours"] == sum(near) >= state["wall_side"]
    inside = [
        i
        for i, p in enumerate(np.asarray(search.start.objects, float) - hand.EE_POINT)
        if i != goal
        and 0 < p @ line / np.hypot(*line) < np.hypot(*line) - 0.01
        and abs(p[0] * line[1] - p[1] * line[0]) / np.hypot(*line) < 0.065
    ]
    assert state["corridor"] == len(inside) >= state["corridor_last"]
    assert all(np.isfinite(list(state.values())))


def test_there_is_no_state_before_three_iterations_or_after_a_blow_up():
    scene = sample_scene(0, "tight")
    search = native().planner.begin_reach(start_world(scene.positions), scene.goal)
    for i in range(3):  # iterations 0, 1, 2
        search = stepped(search, (0, 0, 0, i, 0))
        assert np.isnan(state_features(search)).all()
    search = stepped(search, (0, 0, 0, 3, 0))
    assert np.isfinite(state_features(search)).all()
    broken = search.best._replace(objects=search.best.objects * np.float32(np.nan))
    assert np.isnan(state_features(search._replace(best=broken))).all()
