"""The searches that fleets share: what is kept and for how long; nothing is computed twice."""

import itertools
import types
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweep_toys import Nudge, ways, write_scene

from pgf_jax.batching.planner_service import make_planner_service
from pgf_jax.batching.requests import Step
from pgf_jax.batching.scheduler import BatchScheduler
from pgf_jax.fleet import Fleet, FleetConfig, Work, WorkKind
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.guidance.view import View
from pgf_jax.physics.config import Physics
from pgf_jax.planning.config import Planner
from pgf_jax.planning.types import Push
from pgf_jax.scene import load_scene, sample_scene
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.search_cache import Node, SearchCache
from pgf_jax.tables.results import events_frame


def scene(robot: int, task: int):
    return sample_scene(np.array([0, robot, task], np.uint32))


class Watched(Nudge):
    """An operator that remembers whose turn it was."""

    def __init__(self) -> None:
        self.asked: list[tuple] = []
        self.views: list[tuple[tuple, View]] = []  # with the decision

    def deliberate(self, view, search, planner, decision_key):
        self.asked.append(decision_key)
        self.views.append((decision_key, view))
        return self.decide(view)
        yield


class Column:
    """A predictor that says what is in a column, and counts the states."""

    def __init__(self, name: str) -> None:
        self.column, self.asked = STATE.index(name), 0

    def gain(self, states: np.ndarray) -> np.ndarray:
        self.asked += len(states)
        return states[:, self.column].astype(np.float32)


class Shared:
    """Fleets that share searches in a toy world, and every iteration that they have computed."""

    def __init__(self, configs: Sequence[FleetConfig], predictors: Sequence[Any] = ()) -> None:
        self.planner_service, self.operator = (
            make_planner_service("ghost", Physics(), Planner(), 4),
            Watched(),
        )
        self.steps: list[tuple] = []
        compute = self.planner_service.compute
        self.planner_service.compute = lambda requests: self._note(requests) or compute(requests)
        self.search_cache = SearchCache(
            self.planner_service, scenes=scene, operator=self.operator, seed=0
        )
        predictors = predictors or [None] * len(configs)
        all_robots = [
            PlannedRobots(
                self.search_cache, robots=config.robots, tasks=config.tasks, predictor=predictor
            )
            for config, predictor in zip(configs, predictors, strict=True)
        ]
        self.fleets = [
            PlannedFleet(Fleet(config, robots), robots)
            for config, robots in zip(configs, all_robots, strict=True)
        ]

    def _note(self, requests) -> None:
        self.steps += [
            (r.key_path, hash(tuple(np.asarray(x).tobytes() for x in jax.tree.leaves(r.search))))
            for r in requests
            if isinstance(r, Step)
        ]

    def run(self, **how) -> int:
        """Run them to their ends; returns how many iterations robots have requested."""
        done = list(run_fleets(self.fleets, self.planner_service, **how))
        assert sorted(map(id, done)) == sorted(map(id, self.fleets))
        return sum(planned.robots.iterations for planned in done)

    def logs(self):
        return [events_frame(planned.fleet.events) for planned in self.fleets]


def turns(gone) -> list[tuple]:
    """Whose turn it was there: seed, robot, task, iterations that had ended."""
    return sorted((0, way[0], way[1], way.count("iteration")) for way, _ in gone)


def fleet(policy: str, robots: int, tasks: int, **changes) -> FleetConfig:
    return FleetConfig(policy=policy, robots=robots, tasks=tasks, **changes)


# These give input to stuck robots, and before planning: "go on" changes what comes after it.
NEEDY = [
    fleet("or-hitl", 2, 2),
    fleet("or-hitl", 1, 3, service_mean_s=2.0),
    fleet("queue", 3, 1),
    fleet("always", 2, 2),
    fleet("eager", 3, 1),
    fleet("autonomous", 2, 2),
    fleet("or-hitl", 2, 2, operators=2, horizon_s=90.0),
]


# -- nodes ---------------------------------------------------------------------------------------


def test_what_follows_from_a_node_is_made_once():
    node, made = Node("search"), []  # pyright: ignore[reportArgumentType]

    def make(name) -> Any:
        return lambda: made.append(name) or name

    after = node.child("go on", make("a"))
    assert node.child("go on", make("b")) is after and after.search == "a"
    other = node.child("drop", make("c"))
    assert other is not after and other.search == "c" and made == ["a", "c"]
    assert after.child("go on", make("d")) is not after
    # What is asked for is kept by the node, each by itself.
    one, same = node.memoised("x", make("x")), node.memoised("y", make("y"))
    third = after.memoised("x", None)  # pyright: ignore[reportArgumentType]
    assert one.cache is same.cache and one.cache is not third.cache and one.key == "x"
    assert made == ["a", "c", "d"]


def test_what_is_imagined_is_kept_until_the_shelf_changes():
    shared = Shared(NEEDY)
    shared.run()
    together, apart = 0, 0
    for (one, a), (other, b) in itertools.combinations(shared.operator.views, 2):
        assert a.imagined is not None
        if a.imagined is b.imagined:
            assert one[:3] == other[:3]
            assert (a.hand == b.hand).all() and (a.objects == b.objects).all()
            together += one[3] != other[3]
        else:
            apart += one[:3] == other[:3]
    assert together and apart  # asked again after an iteration; and after a push


class Counts:
    """Gives another input each time."""

    name = "counts"

    def decide(self, view):
        return Push(view.request, 0.4, 0.1)


def test_what_an_operator_says_the_second_time_is_another_thing():
    """Even where nothing has happened since, as when it says "go on" before planning."""
    on, said = make_planner_service("ghost", Physics(), Planner(), 4), []
    search_cache = SearchCache(on, scenes=scene, operator=Counts(), seed=0)
    all_robots, scheduler = [PlannedRobots(search_cache) for _ in range(3)], BatchScheduler(on)
    for planned, times in zip(all_robots, (1, 2, 1), strict=True):
        planned.begin(0, 0)
        for i in range(times):
            work = Work(0, 0, WorkKind.INPUT, 0, i)
            planned.request(work)
            scheduler.submit(planned.coroutine(work), said.append)
            planned.end(work)
        planned.start_push(0, said[-1])
    assert [push.object for push in said] == [0, 0, 1, 0]
    first, second, third = (planned.robots[0].node for planned in all_robots)
    assert first is third and first is not second
    assert [int(node.search.task.pushed) for node in (first, second)] == [0, 1]


# -- for how long --------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(
    fleets=st.lists(st.tuples(st.integers(1, 3), st.integers(1, 3)), min_size=1, max_size=4),
    data=st.data(),
)
def test_a_task_is_kept_until_all_that_retained_it_have_released_it(fleets, data):
    planner = types.SimpleNamespace(begin_reach=lambda world, goal, shelf: None)
    planner_service = types.SimpleNamespace(
        engine=types.SimpleNamespace(n_objects=20), planner=planner
    )
    drawn = []

    def draw(robot, task):
        drawn.append((robot, task))
        return SCENE

    search_cache = SearchCache(planner_service, scenes=draw, operator=Nudge(), seed=0)  # pyright: ignore[reportArgumentType]
    left, begun = {}, {}
    for robots, tasks in fleets:
        search_cache.retain(robots, tasks)
        for key in ((robot, task) for robot in range(robots) for task in range(tasks)):
            left[key] = left.get(key, 0) + 1
    turns = [(key, turn) for key, count in left.items() for turn in range(count)]
    for key, _ in data.draw(st.permutations(turns)):
        if data.draw(st.booleans()):  # or the horizon came before
            task = search_cache.task(*key)
            assert begun.setdefault(key, task) is task and task.scene is SCENE
            assert search_cache.task(*key) is task
        search_cache.release(*key)
        left[key] -= 1
        assert len(search_cache) == sum(left[k] > 0 for k in begun)
    assert len(search_cache) == 0 and sorted(drawn) == sorted(begun)


SCENE = scene(0, 0)


@pytest.mark.parametrize("at_once", [None, 1])
def test_no_task_outlives_its_fleets(at_once):
    """Of different sizes; the horizon leaves tasks of the second unbegun, and some under way."""
    shared = Shared([fleet("or-hitl", 1, 3), fleet("autonomous", 3, 20, horizon_s=15.0)])
    kept = []

    def look():
        kept.append(len(shared.search_cache))
        under_way = [p.robots.robots for p in shared.fleets if not p.fleet.done]
        assert kept[-1] >= len({(r, robots[r].task) for robots in under_way for r in robots})

    shared.run(at_once=at_once, on_batch=look)
    (whole, first, _), (cut, second, _) = shared.fleets
    assert max(kept) >= 3 and len(shared.search_cache) == 0
    assert first.robots.keys() == {0} and second.robots.keys() == {0, 1, 2}  # their last tasks
    begun = [{(r.robot, r.task) for r in ended.records} for ended in (whole, cut)]
    assert (0, 2) in begun[0] - begun[1] and (2, 0) in begun[1]


def test_a_fleet_that_begins_later_finds_what_others_left_for_it():
    shared = Shared([fleet("or-hitl", 2, 2), fleet("or-hitl", 2, 2)])
    asked = shared.run(at_once=1)
    (first, *_), (second, *_) = shared.fleets
    assert repr(first.events) == repr(second.events)
    assert asked == 2 * len(shared.steps) > 0 and len(shared.search_cache) == 0


def test_scenes_of_any_number_of_objects(tmp_path):
    path = tmp_path / "shelf.xml"
    write_scene(path, n_objects=4)
    on = make_planner_service("ghost", Physics(), Planner(), 4)
    search_cache = SearchCache(on, scenes=lambda *_: load_scene(path), operator=Nudge(), seed=0)
    search = search_cache.task(0, 0).root.search
    assert search.objects == 4 and search.shelf is None


# -- nothing twice -------------------------------------------------------------------------------


def test_no_branch_is_computed_twice_and_no_input_given_twice():
    shared = Shared(NEEDY)
    asked = shared.run()
    gone, logs = ways(*shared.logs()), shared.logs()
    assert len(set(shared.steps)) == len(shared.steps) == len(gone.iterations)
    assert asked == sum((log["kind"] == "iteration").sum() for log in logs) > len(shared.steps)
    assert sorted(shared.operator.asked) == turns(gone.inputs)
    answers = sum(log["outcome"].is_in(["push", "go_on"]).sum() for log in logs)
    assert answers > len(gone.inputs)
    # All that may happen did.
    happened = {each for way in gone.iterations for each in way[2:]}
    assert {"iteration", "push_dropped", "retreat_end", (None, None, None)} < happened


def test_gains_are_predicted_once_for_each_predictor():
    distance, number = Column("distance"), Column("iteration")
    shared = Shared(NEEDY[:3], [distance, number, distance])
    shared.run()
    first, second, third = shared.logs()
    assert distance.asked == len(ways(first, third).reaches)
    assert distance.asked < len(ways(first).reaches) + len(ways(third).reaches)
    assert number.asked == len(ways(second).reaches)
    assert 0 < len(ways(second).gains) < len(ways(second).reaches)
    # Each hears its own predictor, where it went the way of the others as well.
    for log, whole in ((first, False), (second, True), (third, False)):
        gains = log["gain"].drop_nulls().drop_nans()
        gains = gains.filter(gains.is_finite())  # bids are infinite
        assert len(gains) > 0 and (gains == gains.round()).all() == whole


class Seen(TrueGain):
    """The true gain, and whose turn it was."""

    turns: ClassVar[list[tuple]] = []

    def simulate_gain(self, search, input_request, planner, decision_key, place=None):
        self.turns.append(decision_key)
        given = search, input_request, planner, decision_key, place
        return (yield from super().simulate_gain(*given))


def test_true_gains_and_the_operator_ask_for_one_input():
    """The input that the gain is of is the one that is given; and so for all fleets."""
    configs = [fleet("oracle-gain", 2, 2), fleet("or-hitl", 1, 2), fleet("oracle-gain", 1, 2)]
    shared = Shared(configs, [Seen(), None, Seen()])
    Seen.turns.clear()
    shared.run()
    gone, (first, _, third) = ways(*shared.logs()), shared.logs()
    assert len(gone.gains - gone.inputs) > 0 and len(gone.gains & gone.inputs) > 0
    assert sorted(shared.operator.asked) == turns(gone.gains | gone.inputs)
    assert sorted(Seen.turns) == turns(ways(first, third).reaches)
    # Of the two, the gains of one robot are those of the other's.
    alone = Shared(configs[2:], [TrueGain()])
    alone.run()
    assert repr(alone.fleets[0].fleet.events) == repr(shared.fleets[2].fleet.events)


# -- exactness -----------------------------------------------------------------------------------

CONFIGS = st.builds(
    FleetConfig,
    robots=st.integers(1, 2),
    tasks=st.integers(1, 2),
    policy=st.sampled_from(
        ("pgf", "or-hitl", "or-hitl-window", "always", "autonomous", "random", "queue", "eager")
    ),
    operators=st.integers(1, 2),
    window_s=st.sampled_from((0.0, 2.0, 7.0)),
    service_mean_s=st.sampled_from((1.0, 8.0)),
    rollout_time_s=st.sampled_from((1.5, 0.4)),
    compute=st.sampled_from(("dedicated", "shared:8")),
    horizon_s=st.none() | st.floats(5.0, 200.0),
)
SPEAK = [Column("distance"), Column("iteration"), None]  # what may be bid


@settings(max_examples=8, deadline=None)
@given(
    fleets=st.lists(st.tuples(CONFIGS, st.sampled_from(SPEAK)), min_size=2, max_size=4),
    at_once=st.sampled_from((None, 1, 2)),
)
def test_fleets_that_share_searches_do_what_they_do_alone(fleets, at_once):
    together = Shared([c for c, _ in fleets], [predictor for _, predictor in fleets])
    together.run(at_once=at_once)
    assert len(together.search_cache) == 0
    for (config, predictor), (shared, *_) in zip(fleets, together.fleets, strict=True):
        own = Shared([config], [predictor])
        own.run()
        ((alone, *_),) = own.fleets
        assert repr(alone.events) == repr(shared.events)
        assert sorted(map(repr, alone.records)) == sorted(map(repr, shared.records))
        assert len(own.steps) <= len(together.steps)
