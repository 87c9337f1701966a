"""Properties of every fleet: identities in integer ns, limits, independence of batching."""

import collections
import random
import subprocess
import sys

import numpy as np
import pytest
from fleet_script import PUSH
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.fleet import EventKind, Fleet, FleetConfig, IterationResult, Work, WorkKind
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.identities import verify
from pgf_jax.fleet.metrics import busy_ns
from pgf_jax.fleet.policies import policy_names
from pgf_jax.fleet.stub import StubRobots, drive
from pgf_jax.planning.types import Push

CONFIGS = st.builds(
    FleetConfig,
    robots=st.integers(1, 6),
    tasks=st.integers(1, 3),
    policy=st.sampled_from(policy_names()),
    operators=st.integers(1, 3),
    # Multiples of the rollout time make ties the rule and not the exception.
    window_s=st.sampled_from([0.0, 1.5, 2.0, 4.0]),
    service_mean_s=st.sampled_from([0.0, 3.0, 8.0, 40.0]),
    service_sd_s=st.just(0.0),
    context_switch_s=st.sampled_from([0.0, 1.5]),
    compute=st.sampled_from(["dedicated", "shared:16"]),
    horizon_s=st.sampled_from([None, 20.0, 45.0]),
    task_limit_s=st.sampled_from([3.0, 20.0, 60.0]),
    push_limit_s=st.sampled_from([1.0, 6.0, 30.0]),
    seed=st.integers(0, 5),
)


def noisy_robots(seed: int) -> StubRobots:
    """Robots of random outcomes, keyed by the work alone."""

    def iterate(work: Work) -> IterationResult:
        rng = np.random.default_rng((seed, 0, work.robot, work.task, work.iteration))
        feasible, stuck, non_finite = rng.random(3) < (0.15, 0.4, 0.05)
        gain = float(rng.choice([np.nan, 0.5, 3.0, 7.0]))
        cost = float("inf") if non_finite else float(rng.random())
        return IterationResult(
            bool(feasible), bool(stuck), gain, (cost, 0.0, 0.0), cost, bool(non_finite)
        )

    def decide(work: Work) -> Push | None:
        rng = np.random.default_rng((seed, 1, work.robot, work.task, work.request or 0))
        return PUSH if rng.random() < 0.6 else None

    return StubRobots(iterate, decide)


def simulate(config: FleetConfig, seed: int) -> tuple[Fleet, StubRobots]:
    robots = noisy_robots(seed)
    fleet = Fleet(config, robots)
    drive([(fleet, robots)])
    return fleet, robots


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

    assert verify(config, records, events) == 18 + 3 * config.robots + 2 * len(records)
    assert busy_ns(events) == sum(nanoseconds(record.interaction_s) for record in records)


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
    robots = noisy_robots(seed)
    fleet = Fleet(config, robots)
    held: dict[int, Work] = {}
    seen: set[Work] = set()
    busy_calls = 0
    while not fleet.done:
        calls = len(robots.calls)
        batch = fleet.advance()
        # No method of a robot is called while its work is outstanding.
        busy_calls += sum(call[1] in held for call in robots.calls[calls:])
        assert [work.robot for work in batch] == sorted({work.robot for work in batch})
        assert not seen.intersection(batch)
        assert not held.keys() & {work.robot for work in batch}
        assert batch or held or fleet.done
        seen.update(batch)
        held.update({work.robot: work for work in batch})
        for robot in order.sample(sorted(held), order.randint(min(1, len(held)), len(held))):
            work = held.pop(robot)
            fleet.deliver(work, robots.compute(work))
    assert busy_calls == 0
    iterations = collections.defaultdict(list)
    for work in seen:
        if work.kind is WorkKind.ITERATION:
            iterations[work.robot, work.task].append(work.iteration)
    for numbers in iterations.values():
        assert sorted(numbers) == list(range(len(numbers)))


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
        "import sys, pgf_jax.fleet, pgf_jax.fleet.metrics, pgf_jax.fleet.stub;"
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
