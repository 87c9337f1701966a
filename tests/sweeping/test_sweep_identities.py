"""Sample-path identities on real runs, from the files of a sweep; and lists of costs there."""

import math

import polars as pl
import pytest

from pgf_jax.fleet import EventKind, Fleet, FleetConfig
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.metrics.attention import attention
from pgf_jax.metrics.identities import identity_sides, verify
from pgf_jax.planning.types import Status
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.tables import results
from pgf_jax.tables.parquet import encode_table

POLICIES = ("pgf", "or-hitl", "or-hitl-window", "always", "queue", "random")
# Horizons that cut off tasks in the middle of services and waits.
SWEEPS = {
    "all policies, a horizon": {"policies": POLICIES, "robots": (1, 4), "horizon": 36.0},
    "a shared computer, to the end": {
        "policies": ("pgf", "queue"),
        "compute": "shared:16",
        "predictor": "first",  # whose robots ask at the same time, so that some are refused
    },
    "two operators": {"policies": ("random", "always"), "operators": 2, "horizon": 60.0},
}


@pytest.fixture(scope="module", params=SWEEPS)
def fleets(request, tmp_path_factory):
    """What the files of a sweep's cells say: (fleet's configuration, records, events)."""
    changes = {"robots": (4,), **SWEEPS[request.param]}
    out = tmp_path_factory.mktemp("identities")
    config = SweepConfig(
        tasks=3,
        engine="planar",
        operator="heuristic",
        scene_class="wide",
        workers=1,
        world="none",
        physics="authors",
        out=out,
        **changes,
    )
    result = sweep(config, quiet=True)
    found, merged = [], (result.tasks(), result.events())
    for cell in config.cells():
        own = (pl.col("policy") == cell.policy) & (pl.col("robots") == cell.robots)
        tasks, events = result.cell(cell).tasks, result.cell(cell).events
        for table, all_ in zip((tasks, events), merged, strict=True):
            assert all_.filter(own).select(table.columns).equals(table)
        found.append((config.fleet(cell), results.task_records(tasks), results.event_log(events)))
    return request.param, found


def test_identities_hold_on_real_runs(fleets):
    name, found = fleets
    for config, records, events in found:
        sides = identity_sides(config, records, events)
        assert {key: pair for key, pair in sides.items() if pair[0] != pair[1]} == {}
        assert verify(config, records, events) == 19 + 3 * config.robots + 2 * len(records)
    # Not of nothing.
    records = [record for _, own, _ in found for record in own]
    events = [event for _, _, own in found for event in own]
    assert sum(record.waiting_s for record in records) > 0
    assert sum(record.grants for record in records) > 0
    assert sum(record.answered for record in records) > 0
    assert {EventKind.WINDOW_CLOSE, EventKind.REFUSED} <= {event.kind for event in events}
    assert any(record.status is Status.SOLVED for record in records)
    censored = [record for record in records if record.status is Status.CENSORED]
    if name == "a shared computer, to the end":
        assert not censored
    else:
        assert {record.end_ns for record in censored} == {found[0][0].horizon_s * 10**9}
        cut = {event.kind for event in events if event.outcome == "censored"}
        assert {EventKind.SERVICE_END, EventKind.TASK_END} <= cut
        assert EventKind.EXPIRED in cut or name == "two operators"
    if name == "two operators":
        grants = [event for event in events if event.kind is EventKind.GRANT]
        assert {event.operator for event in grants} == {0, 1}


def test_invariants_of_real_runs(fleets):
    """What must hold whatever the numbers are; read from the log event by event."""
    _, found = fleets
    seen = set()
    for config, records, events in found:
        times = [event.time_ns for event in events]
        assert times == sorted(times) and times[0] >= 0
        serving: dict = {}  # operator -> whom
        asked: dict = {}  # (robot, task) -> how its open ask stands
        task_of: dict = {}
        ends: dict = {}
        for event in events:
            whose = (event.robot, event.task)
            if event.kind is EventKind.TASK_START:
                assert event.robot not in task_of and whose not in ends  # one at a time, and once
                task_of[event.robot], ends[whose] = event.task, []
            elif event.robot is not None:
                assert task_of[event.robot] == event.task
            if event.kind is EventKind.BID:
                assert whose not in asked
                asked[whose] = "open"
            elif event.kind is EventKind.REFUSED:
                assert asked.pop(whose) == "open"
                seen.add("refused")
            elif event.kind is EventKind.EXPIRED:
                assert asked.pop(whose) == "open"
                seen.add("expired")
            elif event.kind is EventKind.GRANT:
                assert asked[whose] == "open" and event.operator not in serving
                assert event.operator in range(config.operators)
                asked[whose], serving[event.operator] = "granted", whose
            elif event.kind is EventKind.SERVICE_END:
                assert asked.pop(whose) == "granted" and serving.pop(event.operator) == whose
                seen.add("answered" if event.outcome in ("push", "go_on") else "expired")
            elif event.kind is EventKind.TASK_END:
                assert whose not in asked
                ends[whose].append(event.outcome)
                del task_of[event.robot]
        assert not serving and not asked and not task_of
        assert {whose: [status] for whose, (status,) in ends.items()} == {
            (record.robot, record.task): [record.status.value] for record in records
        }
    assert {"answered", "refused"} <= seen


def test_attention_of_real_runs(fleets):
    _, found = fleets
    known = 0
    for config, records, events in found:
        got = attention(config, records, events)
        assert 0 <= got.utilisation <= 1
        assert got.waiting_per_ask_s.n == sum(record.requests for record in records)
        for record in records:
            assert len(record.asked_cost) == len(record.helped_cost) == record.answered
            if config.policy == "always":
                assert all(math.isnan(cost) for cost in record.asked_cost)
            else:
                assert all(cost >= 0 for cost in record.asked_cost)
            # The cost after the last input is the task's own where no tenth iteration followed it.
            if record.answered and record.reach_iterations - record.grants_at[-1] <= 10:
                last = record.helped_cost[-1]
                assert math.isnan(last) or last == record.cost
        known += got.wasted.n
        if config.policy == "always":
            assert got.wasted.n == 0
    assert known > 0


def test_costs_that_are_not_known_come_back_from_a_file(tmp_path):
    # Before planning nothing is known; then a cost is, or is not finite.
    robots = StubRobots(lambda work: outcome(cost=math.inf if work.robot else 5.0))
    config = FleetConfig(robots=3, tasks=1, policy="always", service_sd_s=0.0, horizon_s=20.0)
    fleet = Fleet(config, robots)
    drive([(fleet, robots)])
    frame = results.tasks_frame(fleet.records, lambda robot, task: "x")
    assert frame.schema["asked_cost"] == frame.schema["helped_cost"] == pl.List(pl.Float64)
    assert frame["asked_cost"].to_list() == [[None], [None], []]
    assert frame["helped_cost"].to_list() == [[5.0], [math.inf], []]
    path = tmp_path / "tasks.parquet"
    path.write_bytes(encode_table(frame))
    again = results.task_records(results.read_results(path, results.TASK_SCHEMA))
    records = sorted(fleet.records, key=lambda record: record.robot)
    assert repr(again) == repr(records)  # nan is not equal to itself
    assert math.isnan(again[0].asked_cost[0])
