"""Properties of every fleet: identities in integer ns, limits, independence of batching."""

import collections
import random
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_fleets import CONFIGS, noisy_robots, simulate

from pgf_jax.fleet import EventKind, Fleet, FleetConfig, Work, WorkKind
from pgf_jax.fleet.config import plans_meanwhile
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.policies import make_policy
from pgf_jax.fleet.stub import StubRobots, drive
from pgf_jax.metrics.identities import verify
from pgf_jax.metrics.summary import busy_ns


@settings(max_examples=150, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000))
def test_sample_path_identities(config, seed):
    fleet, _ = simulate(config, seed)
    events, records = fleet.events, fleet.records
    assert [event.time_ns for event in events] == sorted(event.time_ns for event in events)

    # At most one ask of a robot is open at a time, and an operator serves one robot at a time.
    ends = {EventKind.REFUSED, EventKind.EXPIRED, EventKind.SERVICE_END}
    open_asks, serving = set(), {}
    for event in events:
        if event.kind is EventKind.BID:
            assert event.robot not in open_asks
            open_asks.add(event.robot)
        elif event.kind in ends:
            open_asks.remove(event.robot)
        if event.kind is EventKind.GRANT:
            assert event.operator not in serving
            assert event.operator in range(config.operators)
            serving[event.operator] = event.robot
        elif event.kind is EventKind.SERVICE_END:
            assert serving.pop(event.operator) == event.robot
    assert not open_asks
    assert not serving

    assert verify(config, records, events) == 19 + 3 * config.robots + 2 * len(records)
    served_s = [r.interaction_s if r.served_s is None else r.served_s for r in records]
    assert busy_ns(events) == sum(map(nanoseconds, served_s))


@settings(max_examples=150, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000))
def test_every_task_adds_up_and_keeps_its_limits(config, seed):
    fleet, _ = simulate(config, seed)
    horizon = None if config.horizon_s is None else nanoseconds(config.horizon_s)
    slowest = 1 if config.compute == "dedicated" else max(1, 8 * config.robots / 16)
    check = nanoseconds(config.rollout_time_s) * slowest
    for record in fleet.records:
        ns = {
            name: round(getattr(record, name) * 1e9)
            for name in (
                "planning_time_s", "waiting_s", "window_wait_s", "interaction_s", "execution_s"
            )
        }  # fmt: skip
        line = ns["waiting_s"] - ns["window_wait_s"]
        limited = ns["planning_time_s"] + line + ns["interaction_s"]
        assert limited + ns["execution_s"] == record.end_ns - record.start_ns
        solved = record.status == "solved"
        assert limited <= nanoseconds(config.task_limit_s) + (check if solved else 0) or (
            record.status == "censored"
        )
        assert (record.status == "censored") <= (record.end_ns == horizon)
        assert horizon is None or record.end_ns <= horizon
        assert len(record.successful_grants_at) == record.pushes_succeeded <= record.pushes_planned
        assert set(record.successful_grants_at) <= set(record.grants_at)
        assert record.requests >= record.grants >= record.answered
    ends = collections.Counter((record.robot, record.task) for record in fleet.records)
    assert set(ends.values()) == {1}
    if horizon is None:
        assert len(ends) == config.robots * config.tasks

    # Nothing is asked while pushing, waiting, being served or executing.
    pushing: dict[int | None, bool] = dict.fromkeys(range(config.robots), False)
    for event in fleet.events:
        if event.kind is EventKind.SERVICE_END:
            pushing[event.robot] = event.outcome == "push"
        elif event.kind in (EventKind.PUSH_DROPPED, EventKind.RETREAT_END, EventKind.TASK_END):
            pushing[event.robot] = False
        elif event.kind is EventKind.BID:
            assert not pushing[event.robot]


@settings(max_examples=100, deadline=None)
@given(
    configs=st.lists(CONFIGS, min_size=1, max_size=4),
    seed=st.integers(0, 1000),
    order=st.integers(0, 10**6).map(random.Random),
)
def test_results_do_not_depend_on_batching_interleaving_or_delivery(configs, seed, order):
    # Reference: each fleet alone, each piece of work delivered as soon as it is known.
    alone = [simulate(config, seed + k) for k, config in enumerate(configs)]

    # Together: any fleet advances at any time, any handful of outstanding work is delivered.
    together = [(Fleet(c, r := noisy_robots(seed + k)), r) for k, c in enumerate(configs)]
    outstanding: list[tuple[Fleet, StubRobots, Work]] = []
    while any(not fleet.done for fleet, _ in together):
        for fleet, robots in order.sample(together, order.randint(1, len(together))):
            outstanding += [(fleet, robots, work) for work in fleet.advance()]
        order.shuffle(outstanding)
        for _ in range(order.randint(0, len(outstanding))):
            fleet, robots, work = outstanding.pop()
            fleet.deliver(work, robots.compute(work))

    for (expected, its_robots), (fleet, robots) in zip(alone, together, strict=True):
        # repr: nan gains are equal then, and every bit of a float counts.
        assert repr(fleet.events) == repr(expected.events)
        assert repr(fleet.records) == repr(expected.records)
        assert robots.calls == its_robots.calls


@settings(max_examples=50, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000), order=st.integers(0, 10**6).map(random.Random))
def test_work_is_handed_out_once_by_robot_and_one_piece_a_robot(config, seed, order):
    """One piece of what it does; beside it the input it has asked for, if it plans meanwhile."""
    robots = noisy_robots(seed)
    fleet = Fleet(config, robots)
    _, plans = plans_meanwhile(config, make_policy(config))
    held: dict[tuple[int, bool], Work] = {}
    seen: set[Work] = set()
    busy_calls = 0

    def whose(work: Work) -> tuple[int, bool]:
        return work.robot, work.kind is WorkKind.INPUT and plans

    while not fleet.done:
        calls = len(robots.calls)
        batch = fleet.advance()
        # No method of a robot is called while its work is outstanding.
        busy_calls += sum((call[1], False) in held for call in robots.calls[calls:])
        assert [work.robot for work in batch] == sorted(work.robot for work in batch)
        assert len({whose(work) for work in batch}) == len(batch)
        assert not seen.intersection(batch)
        assert not held.keys() & {whose(work) for work in batch} or robots.discarded
        assert batch or held or fleet.done
        seen.update(batch)
        held.update({whose(work): work for work in batch})
        for robot in order.sample(sorted(held), order.randint(min(1, len(held)), len(held))):
            work = held.pop(robot)
            fleet.deliver(work, robots.compute(work))
    assert busy_calls == 0 or robots.discarded
    iterations = collections.defaultdict(list)
    for work in seen:
        if work.kind is WorkKind.ITERATION:
            iterations[work.robot, work.task].append(work.iteration)
    for numbers in iterations.values():
        assert sorted(set(numbers)) == list(range(max(numbers) + 1))
        assert len(set(numbers)) == len(numbers) or robots.discarded


def test_deliver_refuses_what_was_not_asked_for():
    robots = noisy_robots(0)
    fleet = Fleet(FleetConfig(robots=2, tasks=1), robots)
    first, second = fleet.advance()
    with pytest.raises(ValueError, match="not outstanding"):
        fleet.deliver(Work(0, 0, WorkKind.RETREAT, 0), None)
    with pytest.raises(TypeError, match="iteration cannot result in None"):
        fleet.deliver(first, None)
    fleet.deliver(first, robots.compute(first))
    with pytest.raises(ValueError, match="not outstanding"):
        fleet.deliver(first, robots.compute(first))
    assert fleet.advance() == []
    fleet.deliver(second, robots.compute(second))
    assert fleet.advance() != []


def test_a_robots_batch_mates_do_not_touch_it():
    # Without an operator's attention to share, a robot's task is the same in any fleet.
    def tasks(robots: int) -> list:
        fleet, _ = simulate(FleetConfig(robots=robots, tasks=3, policy="autonomous"), seed=5)
        return [record for record in fleet.records if record.robot == 0]

    assert repr(tasks(1)) == repr(tasks(2)) == repr(tasks(9))


def test_the_fleet_imports_neither_jax_nor_mujoco():
    code = (
        "import sys, pgf_jax.fleet, pgf_jax.metrics.summary, pgf_jax.fleet.stub;"
        "print([m for m in ('jax', 'mujoco', 'scipy') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_runs_repeat_bit_for_bit():
    config = FleetConfig(robots=5, tasks=2, seed=random.Random(3).randrange(2**40))
    first, second = simulate(config, 1)[0], simulate(config, 1)[0]
    assert repr(first.events) == repr(second.events)
    other = Fleet(FleetConfig(robots=5, tasks=2, seed=config.seed + 1), robots := noisy_robots(1))
    drive([(other, robots)])
    assert repr(first.events) != repr(other.events)
