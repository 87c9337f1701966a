"""An iteration of a sweep again: its rollouts, and what of them was not finite."""

import functools
import itertools
from typing import Any

import jax
import numpy as np
import polars as pl
import pytest
from sweep_toys import Ghost, ghost, write_checkpoints

from pgf_jax.batching.planner_service import make_planner_service
from pgf_jax.batching.requests import Step
from pgf_jax.errors import BadInput
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.guidance.predictors import registry
from pgf_jax.inspection.iteration import Fault, Reproduction
from pgf_jax.inspection.reproduce import reproduce
from pgf_jax.physics.engine import Rollout, register_engine
from pgf_jax.planning.search import Rolled
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.sweeping import resolve as resolve_module
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.resolve import CellSpec, resolve
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.tables.results import EVENT_SCHEMA, event_log, events_frame

N = 20
OTHER = "the log was written by other code, on another processor or with another predictor"


@pytest.fixture(scope="module", autouse=True)
def shipped(tmp_path_factory):
    """Untrained networks: gains to be logged, whatever the networks that ship have learned."""
    folder = write_checkpoints(tmp_path_factory.mktemp("shipped"), seed=9)
    with pytest.MonkeyPatch.context() as patch:
        for module in (registry, resolve_module):
            patch.setattr(module, "shipped_checkpoints", lambda: folder)
        yield folder


SIDE, TURN = 0.16, 0.12  # m, rad: so that some iterations of some tasks are hit


class Brittle(Ghost):
    """A ghost for which things break.

    Where a hand has come so far to a side at a knot's end, objects are lost from then on: to the
    left number 4, to the right 7 and 11. While it is turned so far all contact slots are in use.
    """

    name = "brittle"

    def rollout(self, start, controls, gripper, substeps, wanted=None):
        out = super().rollout(start, controls, gripper, substeps, wanted)
        objects, force = out.objects.copy(), out.force.copy()
        moved = out.hand - np.asarray(start.hand)[:, None]
        for lost, gone in (([4], moved[..., 1] > SIDE), ([7, 11], moved[..., 1] < -SIDE)):
            b, t = np.nonzero(np.logical_or.accumulate(gone, 1))
            for number in lost:
                objects[b, t, number] = np.nan
        force[np.abs(moved[..., 2]) > TURN] = 0.01
        return out._replace(objects=objects, force=force)


register_engine("brittle", Brittle)  # pyright: ignore[reportArgumentType]


def service_of(spec: CellSpec):
    return make_planner_service(*spec.fleet.compile_key)


def cell_log(result, spec) -> list[Event]:
    """The events of a cell of a sweep."""
    cell = spec.cell
    own = (pl.col("policy") == cell.policy) & (pl.col("robots") == cell.robots)
    return event_log(result.events().filter(own).select(list(EVENT_SCHEMA)))


def iterations(events) -> list[tuple[int, int, int]]:
    return [(e.robot, e.task, e.iteration) for e in events if e.kind is EventKind.ITERATION]


def same(ours: Any, theirs: Any) -> bool:
    """Bit for bit, as far as there are bits of a nan."""
    equal = functools.partial(np.array_equal, equal_nan=True)
    return all(jax.tree.leaves(jax.tree.map(equal, ours, theirs)))


# -- what broke ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """A sweep in which rollouts broke: its cells, and its result."""
    config = ghost(
        tmp_path_factory.mktemp("sweep") / "broken",
        engine="brittle",
        operator="nudge",
        robots=(3,),
        policies=("or-hitl", "eager"),
        seed=4,
        horizon=110.0,
    )
    return resolve(config).cells, sweep(config, quiet=True)


@pytest.fixture(scope="module")
def again(broken) -> dict[tuple, Reproduction]:
    """Every iteration of it, by (policy, robot, task, iteration)."""
    cells, result = broken
    return {
        (spec.cell.policy, *which): reproduce(
            spec, log, **dict(zip(("robot", "task", "iteration"), which, strict=True))
        )
        for spec in cells
        for log in [cell_log(result, spec)]
        for which in iterations(log)
    }


def test_what_a_record_counts_is_what_broke(broken, again):
    """Each iteration that a record names, and no other; each rollout that it counts."""
    _, result = broken
    found = {}
    for (policy, robot, task, iteration), one in again.items():
        at, full = found.setdefault((policy, robot, task), ([], []))
        at += [] if one.finite.all() else [iteration]
        full.append(int(one.saturated.any(-1).sum()))
    for row in result.tasks().rows(named=True):
        at, full = found[row["policy"], row["robot"], row["task"]]
        # The horizon cuts off an iteration that is not in the log, and not in the record either.
        assert row["non_finite_at"] == sorted(at) and row["non_finite"] == len(at)
        assert row["saturated"] == sum(full)
    some = [row for row in found.values() if 0 < len(row[0]) < len(row[1])]
    assert len(some) > 2 and any(not at for at, _ in found.values())
    counts = result.tasks().group_by("policy").agg(pl.col("non_finite", "saturated").sum())
    for policy, lost, full in counts.rows():
        (summary,) = (s for s in result.summaries if s.policy == policy)
        assert (summary.non_finite, summary.saturated) == (lost, full) and lost * full > 0
    table = pl.read_csv(result.out / "summary.csv")
    assert table["saturated"].to_list() == [s.saturated for s in result.summaries]


def test_the_very_rollouts_knots_and_objects(broken, again):
    """By the state and the controls alone."""
    knot_s, seen = service_of(broken[0][0]).engine.physics.knot_s, set()
    for one in again.values():
        assert (one.start.hand == 0).all() or one.iteration > 0
        luck = 9e3 * np.asarray(one.start.objects, float).sum() % 1
        way = np.cumsum(one.controls.astype(float), 1) * knot_s * max(0.0, 1.2 * luck - 0.2)
        assert len(one.faults) == len(way) == len(one.cost) == len(one.finite)
        for fault, finite, cost, moved, full in zip(
            one.faults, one.finite, one.cost, way, one.saturated, strict=True
        ):
            sides = np.flatnonzero(np.abs(moved[:, 1]) > SIDE)
            expected = None
            if len(sides):
                first = int(sides[0])
                expected = Fault(first, "position", (4,) if moved[first, 1] > 0 else (7, 11))
            assert fault == expected
            assert finite == np.isfinite(cost) == (expected is None)
            np.testing.assert_array_equal(full, np.abs(moved[:, 2]) > TURN)
            seen.add(expected)
    assert None in seen and len({fault.knot for fault in seen - {None}}) > 2
    assert {fault.bodies for fault in seen - {None}} == {(4,), (7, 11)}


def test_a_segment_begins_with_one_rollout(again):
    for one in again.values():
        first = one.before.iteration < 0
        assert len(one.cost) == (1 if first else 8) and one.controls.shape[1:] == (8, 3)
        assert (one.winner == 0) or not first


def test_in_words(again):
    one = next(r for r in again.values() if (~r.finite).sum() >= 2 and r.saturated.any())
    lines = one.text().splitlines()
    assert lines[0].startswith(
        f"robot {one.robot}, task {one.task} of seed 4, scene {one.scene}: iteration "
        f"{one.iteration}, {int(one.after.iteration)} of its segment, "
    )
    assert lines[1] == f"its key: 4 {one.robot} {one.task} {one.iteration} 0"
    lost, full = int((~one.finite).sum()), int(one.saturated.any(1).sum())
    assert lines[2] == (
        f"rollouts: 8 of 8 knots; {lost} with a cost that is not finite, {full} with every contact "
        "slot in use"
    )
    assert len(lines) == 5 + 8
    for line, fault, cost, knots in zip(
        lines[5:], one.faults, one.cost, one.saturated, strict=True
    ):
        words = "-"
        if fault is not None:
            words = f"knot {fault.knot}: position of object {fault.bodies[0]}"
            words += " and 1 more" if fault.bodies == (7, 11) else ""
        assert f"  {words}" in line and f" {cost:.6g} " in line
        assert line.endswith(" ".join(map(str, np.flatnonzero(knots))) or "-")
    pushes = [r for r in again.values() if r.push is not None]
    assert pushes and all(f"pushing object {r.push.object} to (" in r.text() for r in pushes)  # pyright: ignore[reportOptionalMemberAccess]


def test_files(broken, again, tmp_path):
    (policy, *_), one = next((name, r) for name, r in again.items() if not r.finite.all())
    path = tmp_path / "folder" / "iteration.npz"
    one.save(path)
    with np.load(path) as arrays:
        assert arrays["words"].tolist() == list(one.key_path)
        for name, value in (
            *((f"start_{name}", x) for name, x in one.start._asdict().items()),
            *one.rollout._asdict().items(),
            ("controls", one.controls),
            ("gripper", one.gripper),
            ("cost", one.cost),
            ("terms", one.rolled.value.terms),
            ("saturated", one.saturated),
            ("best_cost", one.after.value.total),
        ):
            assert same(arrays[name], value), name
        faults = zip(
            *(arrays[f"fault_{k}"].tolist() for k in ("knot", "what", "body")), strict=True
        )
        assert [*faults] == [
            (-1, "", -1) if f is None else (f.knot, f.what, f.bodies[0]) for f in one.faults
        ]
    (spec,) = (spec for spec in broken[0] if spec.cell.policy == policy)
    which = {name: getattr(one, name) for name in ("robot", "task", "iteration")}
    reproduce(spec, cell_log(broken[1], spec), **which).save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match=r"file/x\.npz: cannot be written"):
        one.save(tmp_path / "file" / "x.npz")


def test_what_is_first():
    """By hand: 4 knots, 3 objects, 2 slots; a position, a force, a velocity, the hand."""
    rollouts, t, n = 6, 4, 3
    rolled = Rollout(
        objects=np.zeros((rollouts, t, n, 2)),
        hand=np.zeros((rollouts, t, 3)),
        velocities=np.zeros((rollouts, n, 2)),
        force=np.zeros((rollouts, t, 2)),
        bodies=np.zeros((rollouts, t, 2, 2), np.int32),
    )
    rolled.objects[1, 2:, 1, 0] = np.inf
    rolled.hand[1, 2:] = np.nan
    rolled.force[1, 3] = np.nan
    rolled.force[2, 1, 1] = np.inf
    rolled.bodies[2, 1] = [(0, 1), (2, 3)]
    rolled.objects[2, 2] = np.nan
    rolled.velocities[3, 2] = np.nan
    rolled.hand[4, 0, 2] = np.nan
    rolled.force[5, 0] = 1.0
    rolled.force[5, 2] = 0.5, 0.0
    value: Any = None
    search: Any = None
    one = Reproduction(0, 0, 0, "x", (0, 0, 0, 0, 0), search, search, Rolled(None, rolled, value))
    assert one.faults == (
        None,
        Fault(2, "position", (1, 3)),
        Fault(1, "force", (2, 3)),
        Fault(3, "velocity", (2,)),
        Fault(0, "position", (3,)),
        None,
    )
    assert [one._first(i, fault) for i, fault in enumerate(one.faults) if fault] == [
        "knot 2: position of object 1 and 1 more",
        "knot 1: force of object 2 on hand",
        "knot 3: velocity of object 2",
        "knot 0: position of hand",
    ]
    assert np.argwhere(one.saturated).tolist() == [[5, 0]]


# -- the same iteration --------------------------------------------------------------------------


class Fleet(dict):
    """A fleet run here: the search after each of its iterations, and its log and records."""

    def __init__(self, config: SweepConfig) -> None:
        (spec,) = resolve(config).cells
        on = service_of(spec)
        compute = on.compute

        def note(requests):
            results = compute(requests)
            for request, result in zip(requests, results, strict=True):
                if isinstance(request, Step):
                    self[request.key_path[1:4]] = request.search, result
            return results

        on.compute = note
        robots = spec.fleet.planned_robots(spec.fleet.search_cache(on))
        fleet = spec.fleet.new_fleet(robots)
        list(run_fleets([PlannedFleet(fleet, robots)], on))
        self.spec, self.events = spec, fleet.events

    def again(self, robot, task, iteration, events=None):
        return reproduce(
            self.spec,
            self.events if events is None else events,
            robot=robot,
            task=task,
            iteration=iteration,
        )


def settings(**changes) -> SweepConfig:
    """One cell, whose operator gives pushes that are found, and some that are dropped."""
    values = {
        "robots": (2,),
        "policies": ("eager",),
        "tasks": 2,
        "seed": 1,
        "operator": "nudge",
        "horizon": 110.0,
        "world": "none",
        "physics": "authors",
    }
    return SweepConfig(**(values | changes))


ONE = {"robots": (1,), "horizon": 80.0}
PLANS = {"while_asking": "plan", "while_served": "plan"}


@pytest.mark.parametrize(
    ("changes", "every", "happens"),
    [
        ({"engine": "native", "seed": 3, **ONE}, 1, ("retreat_end", "push_dropped")),
        # The last iterations of the task are after all this.
        ({"engine": "planar", "lanes": 4, "seed": 2, **ONE}, 5, ("retreat_end", "go_on")),
        ({"engine": "ghost", "lanes": 4, "update": "stomp"}, 1, ("push_dropped", "go_on")),
        ({"engine": "ghost", "lanes": 4, "update": "stomp", **PLANS}, 1, ("push_dropped", "go_on")),
        (
            {"engine": "ghost", "lanes": 4, "random_winner": 0.5, "policies": ("oracle-gain",)},
            1,
            ("push_dropped",),
        ),
    ],
    ids=["native", "planar", "stomp", "planning-on", "random-winner"],
)
def test_every_iteration_is_the_one_that_was(changes, every, happens):
    """The search before and after it, bit for bit; and the rollouts are those it was made from."""
    fleet = Fleet(settings(**changes))
    ways = iterations(fleet.events)[::-every]
    assert {*happens} <= {word for event in fleet.events for word in (event.kind, event.outcome)}
    stomp, kept = changes.get("update") == "stomp", set()
    for which in ways:
        one = fleet.again(*which)
        before, after = fleet[which]
        assert same(one.before, before) and same(one.after, after)
        assert one.key_path == (fleet.spec.fleet.config.seed, *which, 0)
        rounds = 1 if before.iteration < 0 else 8
        assert len(one.cost) == rounds + stomp
        kept.add(one.winner)
        cheapest = float(one.cost[rounds:].min() if stomp else one.cost.min())
        if one.winner is None:
            assert after.value.total == before.value.total
        else:
            assert same(one.controls[one.winner], after.controls)
            assert same(jax.tree.map(lambda x, i=one.winner: x[i], one.rollout), after.best)
            # Evaluated by another program.
            assert one.cost[one.winner] == pytest.approx(float(after.value.total), rel=1e-5)
            if "random_winner" not in changes:
                assert one.cost[one.winner] == cheapest
    assert None in kept and len(kept) > 2
    # Read from a file, where a gain that is not known is null, it is the same log.
    events = event_log(events_frame(fleet.events))
    assert same(fleet.again(*ways[0], events).after, fleet[ways[0]][1])


def test_the_cost_that_was_recorded(broken):
    """A record's cost is that of the best after the last iteration of reaching."""
    cells, result = broken
    checked = 0
    for spec in cells:
        events = cell_log(result, spec)
        for row in result.tasks().filter(policy=spec.cell.policy).rows(named=True):
            own = [e for e in events if (e.robot, e.task) == (row["robot"], row["task"])]
            reaches = [e for e in own if e.kind is EventKind.ITERATION and e.object is None]
            if not reaches:
                continue
            assert reaches[-1].iteration is not None
            one = reproduce(
                spec,
                events,
                robot=row["robot"],
                task=row["task"],
                iteration=reaches[-1].iteration,
            )
            cost = float(one.after.value.total)
            assert cost == row["cost"]
            checked += 1
    assert checked > 6


# -- bad input -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def toy() -> Fleet:
    return Fleet(settings(engine="ghost", lanes=4))


def last(fleet: Fleet, robot=0, task=0) -> int:
    return max(i for r, t, i in iterations(fleet.events) if (r, t) == (robot, task))


def test_an_iteration_that_is_not_there(toy):
    for changes, words in (
        ({"robot": 2}, r"robot: expected 0\.\.1 of cell eager_R2, got 2"),
        ({"robot": -1}, r"robot: expected 0\.\.1 of cell eager_R2, got -1"),
        ({"task": 2}, r"task: expected 0\.\.1 of cell eager_R2, got 2"),
        (
            {"iteration": last(toy) + 1},
            rf"iteration: task 0 of robot 0 has iterations 0\.\.{last(toy)} in the log, got "
            rf"{last(toy) + 1}$",
        ),
        ({"iteration": -1}, "got -1"),
    ):
        which = {"robot": 0, "task": 0, "iteration": 0} | changes
        with pytest.raises(BadInput, match=words):
            toy.again(**which)
    with pytest.raises(BadInput, match="task: task 1 of robot 0 is not in the log"):
        toy.again(0, 1, 0, [event for event in toy.events if event.task == 0])
    began = list(itertools.takewhile(lambda e: e.kind is not EventKind.ITERATION, toy.events))
    with pytest.raises(BadInput, match="task 0 of robot 0 has no iteration in the log, got 0"):
        toy.again(0, 0, 0, began)


def altered(fleet: Fleet, first, changes: dict[str, Any]):
    """The log with an event changed; and (robot, task, iteration) of the second iteration after."""
    events = list(fleet.events)
    for place, event in enumerate(events):
        after = [which for which in iterations(events[place:]) if which[:2] == event[2:4]]
        if first(event) and len(after) > 1:
            events[place] = event._replace(**changes)
            return events, after[1]
    raise AssertionError("no such event in the log")


def an_iteration(event: Event) -> bool:
    return event.kind is EventKind.ITERATION


def a_push(event: Event) -> bool:
    return event.kind is EventKind.SERVICE_END and event.outcome == "push"


def to_go_on(event: Event) -> bool:
    return event.kind is EventKind.SERVICE_END and event.outcome == "go_on"


def a_retreat(event: Event) -> bool:
    return event.kind is EventKind.RETREAT_END


@pytest.mark.parametrize(
    ("first", "changes", "words"),
    [
        (an_iteration, {"outcome": "maybe"}, "outcome 'maybe' in the log, "),
        (an_iteration, {"outcome": "maybe"}, OTHER),
        (an_iteration, {"gain": 1.5}, "gain 1.5 in the log, "),
        (an_iteration, {"object": 3}, "object 3 in the log, "),
        (an_iteration, {"iteration": 40}, "iteration 40 comes where [0-9]+ should; expected the"),
        (a_push, {"object": 3}, "object [0-9]+ in the log, 3 here"),
        (a_push, {"x": None}, "a push without its object or place is given"),
        (a_push, {"object": 20}, r"push: object must be within 0\.\.19"),
        (a_push, {"x": float("inf")}, "push: target must be finite"),
        (a_push, {"outcome": "maybe"}, "a service ends with 'maybe'"),
        (a_push, {"outcome": "go_on"}, "in the log, None here"),
        (to_go_on, {"kind": EventKind.PUSH_DROPPED}, "a push is dropped where none is planned"),
        (to_go_on, {"kind": EventKind.RETREAT_END}, "a retreat ends after no push"),
        (a_retreat, {"kind": EventKind.SERVICE_END, "outcome": "go_on"}, "ends while a push"),
        (a_retreat, {"kind": EventKind.PUSH_DROPPED}, "a push is dropped where none is planned"),
        (a_retreat, {"kind": EventKind.BID}, "planning goes on with what is feasible"),
    ],
)
def test_a_log_of_something_else(toy, first, changes, words):
    events, which = altered(toy, first, changes)
    assert toy.again(*which).iteration == which[2]
    with pytest.raises(BadInput, match=words):
        toy.again(*which, events)


def test_another_seed_is_noticed(toy):
    (spec,) = resolve(settings(engine="ghost", lanes=4, seed=2)).cells
    with pytest.raises(BadInput, match=OTHER):
        reproduce(spec, toy.events, robot=0, task=0, iteration=last(toy))
