"""What `oracle-gain` bids: the true gain, against trials made one by one."""

import numpy as np
import pytest
from coroutines import DONE, FOUND, HOPELESS, Says, native, run, stepped, traced, turn, unsolved

from pgf_jax.batching.requests import Memoised, Step, robot_key_path
from pgf_jax.guidance.operators.base import ask_operator
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.guidance.trials import PUSH_ITERATIONS, simulate_input
from pgf_jax.guidance.view import View
from pgf_jax.planning.search import start_world
from pgf_jax.scene import sample_scene

pytestmark = pytest.mark.usefixtures("remembered_rollouts")

LOOK_AHEAD = 10  # reach iterations
PUSHED = 1 + PUSH_ITERATIONS  # of a push that is not found, and then dropped


def asks_for(push, search, key) -> Memoised:
    """The request for an operator's input."""
    planner, view = native().planner, View.of(search)
    return Memoised({}, "input", lambda: ask_operator(Says(push), view, search, planner, key))


def true_gain(search, push, key):
    return TrueGain().simulate_gain(search, asks_for(push, search, key), native().planner, key)


@pytest.mark.parametrize(("seed", "kind"), [(0, "found"), (2, "found"), (2, "dropped")])
def test_it_is_the_cost_alone_less_the_cost_helped(seed, kind):
    search, key_paths = unsolved(seed), robot_key_path(*turn(seed))
    push = {"found": FOUND, "dropped": HOPELESS}[kind][seed]
    alone, helped = (
        run(simulate_input(native().planner, search, given, key_paths, reach_limit=LOOK_AHEAD))
        for given in (None, push)
    )
    assert helped.pushed == (kind == "found")
    gain = run(true_gain(search, push, turn(seed)))
    assert gain == alone.cost - helped.cost != 0


def simulated(seed: int, push, terms_of) -> tuple[float, list[list[Step]]]:
    """The gain where no iteration finds anything, and the requests that come at a time."""
    coroutine, answers, asked = true_gain(unsolved(seed), push, turn(seed)), None, []
    while True:
        try:
            requests = coroutine.send(answers)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            return end.value, asked
        if isinstance(requests[0], Memoised):
            answers = [push]
            continue
        asked.append(requests)
        answers = []
        for request in requests:
            assert isinstance(request, Step)
            search = request.search
            terms = np.full_like(search.value.terms, terms_of(search))
            value = search.value._replace(terms=terms)
            answers.append(search._replace(iteration=search.iteration + 1, value=value))


def test_both_futures_are_ten_reach_iterations_with_the_robot_s_own_noise():
    gain, asked = simulated(0, FOUND[0], lambda search: 7.0 if is_helped(search) else 9.0)
    assert gain == 3 * 9.0 - 3 * 7.0
    assert [len(requests) for requests in asked] == [2] * LOOK_AHEAD + [1] * (PUSHED + 1)
    alone = [requests[0].key_path for requests in asked[:LOOK_AHEAD]]
    helped = [requests[-1].key_path for requests in asked]
    assert alone == helped[:LOOK_AHEAD]  # both have the same noise
    assert helped == [(0, 0, 0, DONE + i, 0) for i in range(PUSHED + 1 + LOOK_AHEAD)]
    pushing = [bool(requests[-1].search.task.pushing) for requests in asked]
    assert pushing == [True] * PUSHED + [False] * (1 + LOOK_AHEAD)


def is_helped(search) -> bool:
    """Going on keeps the trajectory."""
    return search.controls is not unsolved(0).controls


@pytest.mark.parametrize("blown", [np.nan, np.inf])
@pytest.mark.parametrize("helped", [False, True])
def test_it_is_unknown_where_a_future_blows_up(helped, blown):
    gain, _ = simulated(0, FOUND[0], lambda search: blown if is_helped(search) == helped else 1.0)
    assert np.isnan(gain)


def test_going_on_gains_nothing_and_takes_no_trial():
    search = unsolved(0)
    gain = true_gain(search, None, turn(0))
    (request,) = next(gain)
    assert isinstance(request, Memoised)
    with pytest.raises(StopIteration) as end:
        gain.send([None])
    assert end.value.value == 0.0


def test_it_is_unknown_while_the_history_is_short():
    """Known after iteration 3, as the paper's prediction is, and again after a restart's third."""
    scene, planner = sample_scene(0, "tight"), native().planner
    search = planner.begin_reach(start_world(scene.positions), scene.goal)
    for i in range(DONE):
        assert not planner.terminate(search)
        gain = true_gain(search, None, (0, 0, 0, i))
        if i <= 3:  # i iterations, iteration 0 among them
            value, asked = traced(gain)
            assert np.isnan(value) and asked == []
        else:
            assert run(gain) == 0.0
        search = stepped(search, (0, 0, 0, i, 0))


def test_it_is_unknown_when_all_is_done():
    search = unsolved(0)
    solved = search._replace(value=search.value._replace(feasible=np.True_))
    value, asked = traced(true_gain(solved, FOUND[0], turn(0)))
    assert np.isnan(value) and asked == []
