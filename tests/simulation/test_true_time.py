"""The true time that a reach still takes, against a robot that goes on by hand."""

import math

import pytest
from coroutines import DONE, FOUND, HOPELESS, Says, native, run, stepped, turn, unsolved

from pgf_jax.batching.requests import robot_key_path
from pgf_jax.guidance.trials import simulate_input
from pgf_jax.planning.search import start_world
from pgf_jax.scene import sample_scene
from pgf_jax.simulation.search_cache import Node, SearchCache
from pgf_jax.simulation.true_time import TrueTime

pytestmark = pytest.mark.usefixtures("remembered_rollouts")

LIMIT = 41.0  # rollouts of the task


def cache(push, seed: int) -> SearchCache:
    return SearchCache(
        native(), scenes=lambda *_: sample_scene(seed, "tight"), operator=Says(push), seed=seed
    )


def asks_for(push, node: Node):
    def said():
        return push
        yield

    return node.memoised("said", said)


def after(left) -> float:
    """Iterations after which it is solved, for certain."""
    assert set(left) <= {0.0, 1.0} and sorted(left, reverse=True) == list(left)
    return left.index(0.0) + 1 if 0.0 in left else math.inf


@pytest.mark.parametrize(("seed", "kind"), [(0, "found"), (2, "found"), (2, "dropped")])
def test_it_is_what_comes(seed, kind):
    push = {"found": FOUND, "dropped": HOPELESS}[kind][seed]
    node, keys = Node(unsolved(seed)), cache(push, seed)
    oracle = TrueTime(LIMIT, keep=True)
    coroutine = oracle.simulate(keys, node, asks_for(push, node), turn(seed), None)
    left = run(coroutine)
    search, alone = unsolved(seed), 0
    rollouts = LIMIT - DONE  # at most: of the iterations before, each took one or more
    while not native().planner.terminate(search) and 2 * (alone + 1) <= rollouts:
        search = stepped(search, (seed, 0, 0, DONE + alone, 0))
        alone += 1
    solved = native().planner.terminate(search)
    assert after(left.alone) == (alone if solved else math.inf)
    trial = run(
        simulate_input(
            native().planner,
            unsolved(seed),
            push,
            robot_key_path(*turn(seed)),
            reach_limit=math.inf,
            rollout_limit=rollouts,
            keep=True,
        )
    )
    assert trial.pushed == (kind == "found")
    assert after(left.helped) == (math.ceil(trial.rollouts / 2) if trial.solved else math.inf)


def test_who_is_told_to_go_on_takes_as_long_as_alone_and_nothing_is_computed_twice():
    node, keys = Node(unsolved(2)), cache(None, 2)
    oracle = TrueTime(LIMIT, keep=True)
    first, second = native(), native()
    coroutines = [oracle.simulate(keys, node, asks_for(None, node), turn(2), None) for _ in "12"]
    left, again = run(coroutines[0], first), run(coroutines[1], second)
    assert left.alone == left.helped and again == left
    assert first.steps > 0 == second.steps


def test_nothing_is_known_of_a_reach_that_has_just_begun():
    planner, scene = native().planner, sample_scene(2, "tight")
    node = Node(planner.begin_reach(start_world(scene.positions), scene.goal))
    oracle = TrueTime(LIMIT, keep=True)
    assert run(oracle.simulate(cache(None, 2), node, asks_for(None, node), turn(2), None)) is None
