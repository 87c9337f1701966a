"""Trials, and operators that make trials: a trial's result is what would happen."""

import itertools

import numpy as np
import pytest
from coroutines import (
    DONE,
    FOUND,
    HOPELESS,
    native,
    run,
    run_all,
    stepped,
    traced,
    turn,
    unsolved,
)
from registered import registered

from pgf_jax.batching.requests import (
    NOISE,
    TRIAL_STEPS,
    Retreat,
    Step,
    gather,
    robot_key_path,
    trial_key_path,
)
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.policies import once_after
from pgf_jax.guidance.operators import heuristic, oracle, registry
from pgf_jax.guidance.operators.base import NoOperator, ask_operator
from pgf_jax.guidance.operators.heuristic import HeuristicOperator
from pgf_jax.guidance.operators.oracle import TOTAL, OracleOperator
from pgf_jax.guidance.trials import PUSH_ITERATIONS, simulate_input
from pgf_jax.guidance.view import View
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push
from pgf_jax.scene import sample_scene
from pgf_jax.simulation.loop import run_fleets
from pgf_jax.simulation.single_robot import single_robot

pytestmark = pytest.mark.usefixtures("remembered_rollouts")


def cost(search) -> float:
    return float(np.sum(search.value.terms[:3]))


def recorded_rows(seed: int, operator) -> list[dict]:
    """Rows that a fleet of one robot records after its only request, made after iteration 4."""
    planner_service = native()
    config = FleetConfig(
        tasks=1,
        policy=once_after(DONE - 1),
        task_limit_s=120.0,
        service_mean_s=0.0,
        service_sd_s=0.0,
        seed=seed,
    )
    with registered(registry.OPERATORS, given=lambda: operator):
        planned = single_robot(
            planner_service, sample_scene(seed, "tight"), config, operator="given"
        )
    (done,) = run_fleets([planned], planner_service)
    rows = done.robots.robots[0].log.frame().rows(named=True)
    assert [row["iteration"] for row in rows if row["asked_before"]] == [DONE]
    return rows[DONE:]


class Says:
    """Gives one input, whatever it sees."""

    name = "says"

    def __init__(self, push: Push | None) -> None:
        self.push = push

    def decide(self, view: View) -> Push | None:
        return self.push


# -- one trial -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 2])
def test_going_on_is_stepping_by_hand(seed):
    planner, key_paths = native().planner, trial_key_path(*turn(seed), 3)
    trial = run(simulate_input(planner, unsolved(seed), None, key_paths, reach_limit=4))
    search, steps = unsolved(seed), 0
    while steps < 4 and not planner.terminate(search):
        search = stepped(search, key_paths(steps))
        steps += 1
    assert (trial.cost, trial.total) == (cost(search), float(search.value.total))
    assert (trial.solved, trial.iterations) == (planner.terminate(search), steps)
    assert trial.pushed is False and steps > 0
    # Iteration 0s are made in a trial that begins before them.
    nominal = planner.begin_reach(unsolved(seed).start, int(unsolved(seed).task.goal))
    first = run(simulate_input(planner, nominal, None, key_paths, reach_limit=1))
    assert first.iterations == 2
    by_hand = stepped(stepped(nominal, key_paths(0)), key_paths(1))
    assert first.total == float(by_hand.value.total)


@pytest.mark.parametrize(
    ("seed", "kind"), [(0, "found"), (2, "found"), (2, "dropped"), (0, "go on"), (2, "go on")]
)
def test_a_trial_with_the_robot_s_own_keys_is_what_the_robot_does(seed, kind):
    push = {"found": FOUND[seed], "dropped": HOPELESS[seed], "go on": None}[kind]
    rows = recorded_rows(seed, Says(push))
    reach_limit = len(rows)  # enough: the fleet ended by itself
    coroutine = simulate_input(
        native().planner, unsolved(seed), push, robot_key_path(*turn(seed)), reach_limit=reach_limit
    )
    trial = run(coroutine)
    assert trial.solved and rows[-1]["feasible"]
    assert trial.iterations == len(rows)
    assert trial.cost == pytest.approx(sum(rows[-1][c] for c in ("c_d", "c_f", "c_b")), rel=1e-6)
    pushes = [row for row in rows if row["kind"] == "push"]
    assert trial.pushed == (kind == "found") == any(row["feasible"] for row in pushes)
    counts = {
        "found": range(1, 2 + PUSH_ITERATIONS),
        "dropped": [1 + PUSH_ITERATIONS],
        "go on": [0],
    }
    assert len(pushes) in counts[kind]


def test_a_dropped_push_restarts_from_the_old_shelf():
    planner, search = native().planner, unsolved(0)
    coroutine = simulate_input(
        planner, search, HOPELESS[0], robot_key_path(*turn(0)), push_limit=1, reach_limit=0
    )
    trial, asked = traced(coroutine)
    assert not trial.pushed and not any(isinstance(request, Retreat) for request in asked)
    nominal = stepped(planner.begin_reach(search.start, int(search.task.goal)), (9, 9, 9, 9, 9))
    assert (trial.cost, trial.total) == (cost(nominal), float(nominal.value.total))
    assert trial.iterations == 2 + 1
    # A push that is found changes it.
    found, asked = traced(
        simulate_input(planner, search, FOUND[0], robot_key_path(*turn(0)), reach_limit=0), native()
    )
    assert found.pushed and sum(isinstance(request, Retreat) for request in asked) == 1
    assert found.total != trial.total


def steps_of(asked) -> tuple[int, int]:
    """Iterations of the push and of the reach."""
    pushing = [bool(r.search.task.pushing) for r in asked if isinstance(r, Step)]
    assert pushing == sorted(pushing, reverse=True)  # the push first
    return sum(pushing), len(pushing) - sum(pushing)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        # (of the push, of the reach), iteration 0s included
        ({"push_limit": 0, "reach_limit": 0}, (1, 1)),
        ({"push_limit": 3, "reach_limit": 2}, (4, 3)),
        ({"reach_limit": 1}, (1 + PUSH_ITERATIONS, 2)),
        ({"push_limit": 3, "reach_limit": 9, "total_limit": 5}, (4, 3)),
        ({"push_limit": 3, "reach_limit": 1, "total_limit": 5}, (4, 2)),
        ({"push_limit": 3, "reach_limit": 9, "total_limit": 2}, (3, 1)),
        ({"reach_limit": 9, "total_limit": 0}, (1, 1)),
    ],
)
def test_limits(limits, expected):
    # Nothing may be solved before its limit: 2's hopeless push, and its reach from the start.
    coroutine = simulate_input(
        native().planner, unsolved(2), HOPELESS[2], trial_key_path(*turn(2), 0), **limits
    )
    trial, asked = traced(coroutine)
    assert steps_of(asked) == expected
    assert trial.iterations == sum(expected)
    assert not trial.solved and not trial.pushed


@pytest.mark.parametrize(("reach", "total", "steps"), [(1, None, 1), (0, None, 0), (3, 1, 1)])
def test_limits_of_going_on_count_from_now(reach, total, steps):
    coroutine = simulate_input(
        native().planner,
        unsolved(2),
        None,
        robot_key_path(*turn(2)),
        reach_limit=reach,
        total_limit=total,
    )
    trial, asked = traced(coroutine)
    assert trial.iterations == len(asked) == steps
    if not steps:
        assert trial.total == float(unsolved(2).value.total)


# -- keys ----------------------------------------------------------------------------------------


def test_the_longest_trial_has_keys_enough():
    longest = 1 + PUSH_ITERATIONS + 1 + max(TOTAL, 40)  # 120 s of iterations
    assert longest < TRIAL_STEPS


def test_the_oracle_tries_with_keys_of_its_own():
    view, planner = View.of(unsolved(2)), native().planner
    operator = OracleOperator(ranked=1, others=1, again=1, repeats=1)
    given, asked = traced(operator.deliberate(view, unsolved(2), planner, turn(2)))
    paths = [request.key_path for request in asked if isinstance(request, Step)]
    assert len(set(paths)) == len(paths) > 3
    assert all(path[:4] == turn(2) and path[4] != NOISE for path in paths)
    # The same decision key, the same trials; another one has others.
    again, asked = traced(operator.deliberate(view, unsolved(2), planner, turn(2)))
    assert again == given and [r.key_path for r in asked if isinstance(r, Step)] == paths
    assert operator._pushes(view, turn(2)) == operator._pushes(view, turn(2))
    drawn = {operator._pushes(view, (2, 0, 0, i))[-1] for i in range(6)}
    assert len(drawn) > 1


# -- several -------------------------------------------------------------------------------------


def several(planner) -> list:
    """Trials of two robots: pushes that are found and not, and going on."""
    return [
        simulate_input(
            planner,
            unsolved(seed),
            push,
            trial_key_path(*turn(seed), number),
            push_limit=1,
            reach_limit=1,
        )
        for seed in (0, 2)
        for number, push in enumerate((None, FOUND[seed], HOPELESS[seed]))
    ]


@pytest.fixture(scope="module")
def alone():
    planner = native(1).planner
    return [run(coroutine, native(1)) for coroutine in several(planner)]


@pytest.mark.parametrize("lanes", [1, 3, 4])
def test_trials_do_not_depend_on_their_company(alone, computed_rollouts, lanes):
    """Bit for bit: side by side, backwards, or as coroutines of one scheduler."""
    planner_service = native(lanes)
    assert run(gather(several(planner_service.planner)), planner_service) == alone
    backwards = run(gather(several(planner_service.planner)[::-1]), planner_service)
    assert backwards[::-1] == alone
    assert run_all(several(planner_service.planner), planner_service) == alone
    assert len({trial.total for trial in alone}) == 6


# -- operators that simulate pushes --------------------------------------------------------------


def simulated(search: Search, push: Push) -> Search | None:
    """The reach after a push without noise, worked out call by call; None: the push fails."""
    planner = native().planner
    goal, path = int(search.task.goal), (4, 3, 2, 1, 0)  # no noise: any key will do
    pushed = stepped(planner.begin_push(search.start, goal, push), path)
    if not planner.terminate(pushed):
        return None
    (world,) = planner.retreat([pushed])
    return stepped(planner.begin_reach(world, goal), path)


def total(reach: Search | None) -> float:
    return np.inf if reach is None else float(reach.value.total)


@pytest.mark.parametrize("seed", [0, 2])
def test_the_heuristic_gives_the_push_that_ends_best_when_simulated(seed, monkeypatch):
    monkeypatch.setattr(heuristic, "SIMULATED", 12)
    operator, view = HeuristicOperator(), View.of(unsolved(seed))
    given = run(operator.deliberate(view, unsolved(seed), native().planner, turn(seed)))
    pushes = operator.ranked(view, 12)
    ends = [total(simulated(unsolved(seed), push)) for push in pushes]
    assert np.isinf(ends).any() and min(ends) < unsolved(seed).value.total
    assert given == pushes[int(np.argmin(ends))]
    # Neither noise nor company decides.
    for lanes in (1, 4):
        planner_service = native(lanes)
        other = (seed + 1, 5, 6, 7)
        again = operator.deliberate(view, unsolved(seed), planner_service.planner, other)
        assert run(again, planner_service) == given


def test_the_heuristic_imagines_a_second_push_where_no_first_one_leads_to_a_grasp(monkeypatch):
    """By hand: the best two of the first pushes, two second ones after each."""
    monkeypatch.setattr(heuristic, "SIMULATED", 4)
    monkeypatch.setattr(heuristic, "FIRST", 2)
    monkeypatch.setattr(heuristic, "SECOND", 2)
    planner, operator, search = native().planner, HeuristicOperator(), unsolved(2)
    pushes = operator.ranked(View.of(search), 4)
    reaches = [simulated(search, push) for push in pushes]
    assert not any(reach is not None and planner.terminate(reach) for reach in reaches)
    ends = [total(reach) for reach in reaches]
    first = ends.index(min(ends))
    for i in np.argsort(ends)[:2]:
        seconds = operator.ranked(View.of(reaches[i]), 2)
        ends[i] = min([ends[i], *(total(simulated(reaches[i], second)) for second in seconds)])
    given = run(operator.deliberate(View.of(search), search, planner, turn(2)))
    assert given == pushes[ends.index(min(ends))] != pushes[first]


def test_the_heuristic_imagines_a_push_from_a_shelf_once():
    on, search = native(), unsolved(2)
    later = stepped(search, (2, 0, 0, DONE, 0))  # the same shelf, an iteration later
    operator, imagined, steps = HeuristicOperator(), {}, []

    def asked(reach: Search, kept: dict | None):
        before = on.steps
        view = View.of(reach, imagined=kept)
        given = run(operator.deliberate(view, reach, on.planner, turn(2)), on)
        steps.append(on.steps - before)
        return given

    afresh = [asked(reach, None) for reach in (search, later)]
    assert [asked(reach, imagined) for reach in (search, later)] == afresh
    # What the trajectories make it look at differs, so a few pushes may be new.
    assert steps[2] == steps[0] and steps[3] < 0.5 * steps[1]
    assert [asked(reach, imagined) for reach in (search, later)] == afresh and steps[4:] == [0, 0]


def asked(request: int, *, content: bool):
    """What the heuristic says to its `request`th request, of a robot that has done well or not."""
    search = unsolved(0)
    if content:  # no push that it simulates ends better
        search = search._replace(value=search.value._replace(total=np.float32(-1.0)))
    view = View.of(search, request)
    return run(HeuristicOperator().deliberate(view, search, native().planner, turn(0)))


def test_the_heuristic_loses_its_patience(monkeypatch):
    monkeypatch.setattr(heuristic, "SIMULATED", 3)
    given = [asked(request, content=True) for request in range(7)]
    assert [push is not None for push in given] == [False] * 3 + [True, False, True, False]
    # When it is better to push anyway, it always does.
    assert [asked(request, content=False) for request in (0, 4)] == [given[3]] * 2


@pytest.mark.parametrize("pushes", [[], [HOPELESS[0]]])
def test_without_a_push_that_can_be_found_the_robot_goes_on(monkeypatch, pushes):
    monkeypatch.setattr(HeuristicOperator, "ranked", lambda self, view, count: pushes)
    assert [asked(request, content=False) for request in (0, 3, 5)] == [None] * 3


def test_an_operator_that_only_looks_requests_nothing():
    planner, view = native().planner, View.of(unsolved(0))
    for operator, said in ((NoOperator(), None), (Says(FOUND[0]), FOUND[0])):
        asking = ask_operator(operator, view, unsolved(0), planner, turn(0))
        assert traced(asking) == (said, [])


# -- the clairvoyant -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 2])
def test_what_the_clairvoyant_foresees_is_what_happens(seed, monkeypatch):
    """The trial that it chose is what the fleet records then; no other push would end sooner."""
    foreseen = []
    score = oracle._score

    def remembered(trial):
        foreseen.append(trial)
        return score(trial)

    monkeypatch.setattr(oracle, "_score", remembered)
    operator = OracleOperator("few", ranked=3, others=2, clairvoyant=True)
    rows = recorded_rows(seed, operator)
    best = min(foreseen, key=score)
    assert len(foreseen) == 6 and best.solved
    assert (best.iterations, best.solved) == (len(rows), rows[-1]["feasible"])
    ended = sum(rows[-1][c] for c in ("c_d", "c_f", "c_b"))
    assert best.cost == pytest.approx(ended, rel=1e-6)
    # What it did not choose would have happened as well.
    inputs = [None, *operator._pushes(View.of(unsolved(seed)), turn(seed))]
    monkeypatch.setattr(oracle, "_score", score)
    for push, trial in itertools.islice(zip(inputs, foreseen, strict=True), 3):
        if trial.solved:
            rows = recorded_rows(seed, Says(push))
            assert (len(rows), rows[-1]["feasible"]) == (trial.iterations, True)
            assert best.iterations <= trial.iterations


def test_a_rollout_limit_ends_it_before_the_iteration_that_would_pass_it():
    """An iteration takes two rollouts: with 5, two iterations are done."""
    planner, key_paths = native().planner, robot_key_path(*turn(2))
    for limit, done in ((5, 2), (4, 2), (1, 0)):
        trial = run(
            simulate_input(
                planner, unsolved(2), None, key_paths, reach_limit=9, rollout_limit=limit
            )
        )
        assert (trial.iterations, trial.rollouts) == (done, 2 * done)


def test_a_push_that_is_not_found_gives_the_search_back():
    search, key_paths = unsolved(2), robot_key_path(*turn(2))
    push, planner = HOPELESS[2], native().planner
    trial = run(
        simulate_input(planner, search, push, key_paths, push_limit=1, reach_limit=0, keep=True)
    )
    assert not trial.pushed and trial.iterations == 2 and trial.rollouts == 3
    assert np.array_equal(trial.reach.controls, search.controls)
    assert int(trial.reach.iteration) == int(search.iteration) and trial.reach.stuck_count == 0
    again = run(
        simulate_input(planner, search, push, key_paths, push_limit=1, reach_limit=0, keep=False)
    )
    assert int(again.reach.iteration) == 0 and again.rollouts == 4  # a new nominal
