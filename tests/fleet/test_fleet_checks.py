"""Checks and reaches that may miss: identities, limits and independence of batching, at random."""

import dataclasses
import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from identity_cases import altered, failing
from random_fleets import CONFIGS, noisy_robots

from pgf_jax.fleet import EventKind, Fleet, FleetConfig, Work, WorkKind
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.stub import StubRobots, drive, missed_checks, missed_grasps, outcome
from pgf_jax.metrics.identities import verify
from pgf_jax.metrics.summary import summarise
from pgf_jax.planning.types import Status

# A check is broken off by an input, and gone on with after it.
BROKEN_OFF = FleetConfig(
    tasks=1,
    window_s=4.0,
    service_mean_s=0.0,
    service_sd_s=0.0,
    task_limit_s=20.0,
    push_limit_s=1.0,
    while_asking="plan",
)
CHANCES = st.sampled_from([None, 0.0, 0.3, 0.7, 1.0])  # None: it cannot miss


def unsure_robots(seed: int, check_miss: float | None, grasp_miss: float | None) -> StubRobots:
    """Those of `noisy_robots`, with checks and reaches that may miss; None: they cannot."""
    stub = noisy_robots(seed)
    return StubRobots(
        stub._iterate,
        stub._decide,
        check=None if check_miss is None else missed_checks(stub._iterate, check_miss, seed=seed),
        reach=None if grasp_miss is None else missed_grasps(grasp_miss, seed=seed),
    )


def simulate(
    config: FleetConfig, seed: int, check_miss: float | None, grasp_miss: float | None
) -> tuple[Fleet, list[Work]]:
    """Run a fleet to its end; returns it and all its work, in the order in which it was asked."""
    robots = unsure_robots(seed, check_miss, grasp_miss)
    fleet, asked = Fleet(config, robots), []
    while not fleet.done:
        for work in fleet.advance():
            asked.append(work)
            fleet.deliver(work, robots.compute(work))
    return fleet, asked


@settings(max_examples=200, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000), check_miss=CHANCES, grasp_miss=CHANCES)
def test_identities_hold(config, seed, check_miss, grasp_miss):
    fleet, _ = simulate(config, seed, check_miss, grasp_miss)
    assert not failing(config, fleet.records, fleet.events)
    usual = 19 + 3 * config.robots + 2 * len(fleet.records)
    counted = check_miss is not None or grasp_miss is not None
    of_attempts = (3 + (config.compute == "dedicated")) if counted else 0
    of_checks = 0 if check_miss is None else 3 + config.robots
    assert verify(config, fleet.records, fleet.events) == usual + of_attempts + of_checks


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000), check_miss=CHANCES, grasp_miss=CHANCES)
def test_work_is_asked_as_the_interface_says(config, seed, check_miss, grasp_miss):
    fleet, asked = simulate(config, seed, check_miss, grasp_miss)
    assert len(set(asked)) == len(asked)
    before: dict[int, Work] = {}
    for work in asked:
        if work.broken_off or work.kind is WorkKind.INPUT:
            continue  # beside what the robot does
        last = before.get(work.robot)
        before[work.robot] = work
        assert (work.check is None) == (work.kind is not WorkKind.CHECK)
        if work.kind is WorkKind.CHECK:
            assert check_miss is not None and last is not None
            # After the iteration that was feasible, or after the check before it.
            assert work.check is not None and 0 <= work.check < 3
            kind = WorkKind.CHECK if work.check else WorkKind.ITERATION
            assert (last.kind, last.iteration) == (kind, work.iteration)
            assert not work.check or last.check == work.check - 1
        elif work.kind is WorkKind.REACH:
            assert grasp_miss is not None and last is not None
            kind = WorkKind.ITERATION if check_miss is None else WorkKind.CHECK
            assert (last.kind, last.iteration) == (kind, work.iteration - 1)
    if check_miss == 1.0 or grasp_miss == 1.0:
        assert all(record.status is not Status.SOLVED for record in fleet.records)


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000), check_miss=CHANCES, grasp_miss=CHANCES)
def test_only_a_first_check_runs_past_the_limit(config, seed, check_miss, grasp_miss):
    fleet, _ = simulate(config, seed, check_miss, grasp_miss)
    slowest = 1 if config.compute == "dedicated" else max(1, 8 * config.robots / 16)
    check_ns = nanoseconds(config.rollout_time_s) * slowest
    for record in fleet.records:
        limited_ns = record.end_ns - record.start_ns - nanoseconds(record.execution_s)
        assert limited_ns <= nanoseconds(config.task_limit_s) + check_ns
        assert (record.checks is None) == (record.check_misses is None) == (check_miss is None)
        assert (record.attempts is None) == (check_miss is None and grasp_miss is None)
        if record.attempts is not None and record.status is not Status.CENSORED:
            solved = record.status is Status.SOLVED
            assert record.attempts >= solved
            assert grasp_miss is not None or record.attempts == solved
            assert record.first_attempt == (solved and record.attempts == 1)


@settings(max_examples=50, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000))
@example(config=BROKEN_OFF, seed=1)
def test_what_cannot_miss_changes_nothing_but_what_is_counted(config, seed):
    """Real checks that all pass, and reaches that all grasp, leave every other event as it is."""
    usual, _ = simulate(config, seed, None, None)
    sure, _ = simulate(config, seed, 0.0, 0.0)
    kept = [event for event in sure.events if event.kind is not EventKind.CHECK]
    assert repr(kept) == repr(usual.events)
    changes = {"checks": None, "check_misses": None, "attempts": None}
    assert repr([dataclasses.replace(r, **changes) for r in sure.records]) == repr(usual.records)


@settings(max_examples=50, deadline=None)
@given(
    configs=st.lists(CONFIGS, min_size=1, max_size=3),
    seed=st.integers(0, 1000),
    order=st.integers(0, 10**6).map(random.Random),
)
def test_results_do_not_depend_on_batching_interleaving_or_delivery(configs, seed, order):
    alone = [simulate(config, seed + k, 0.5, 0.3)[0] for k, config in enumerate(configs)]
    together = [
        (Fleet(config, robots := unsure_robots(seed + k, 0.5, 0.3)), robots)
        for k, config in enumerate(configs)
    ]
    outstanding: list[tuple[Fleet, StubRobots, Work]] = []
    while any(not fleet.done for fleet, _ in together):
        for fleet, robots in order.sample(together, order.randint(1, len(together))):
            outstanding += [(fleet, robots, work) for work in fleet.advance()]
        order.shuffle(outstanding)
        for _ in range(order.randint(0, len(outstanding))):
            fleet, robots, work = outstanding.pop()
            fleet.deliver(work, robots.compute(work))
    for expected, (fleet, _) in zip(alone, together, strict=True):
        assert repr(fleet.events) == repr(expected.events)
        assert repr(fleet.records) == repr(expected.records)


# -- errors are found --------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000), data=st.data())
def test_no_single_error_escapes(config, seed, data):
    config = dataclasses.replace(config, compute="dedicated")
    fleet, _ = simulate(config, seed, 0.4, 0.3)
    ended = {(r.robot, r.task) for r in fleet.records if r.status is not Status.CENSORED}
    counted = [
        i
        for i, event in enumerate(fleet.events)
        if event.kind is EventKind.CHECK
        or (event.kind is EventKind.EXECUTION_END and event.outcome in ("reach", "missed"))
        or event.kind is EventKind.ITERATION
        if (event.robot, event.task) in ended
    ]
    if counted:
        i = data.draw(st.sampled_from(counted))
        assert failing(config, fleet.records, fleet.events[:i] + fleet.events[i + 1 :])
        event = fleet.events[i]
        if event.kind is EventKind.CHECK:
            turned = event._replace(outcome="missed" if event.outcome == "passed" else "passed")
            events = [*fleet.events[:i], turned, *fleet.events[i + 1 :]]
            assert failing(config, fleet.records, events)

    j = data.draw(st.integers(0, len(fleet.records) - 1))
    field = data.draw(st.sampled_from(["checks", "check_misses", "attempts", "execution_s"]))
    records = list(fleet.records)
    records[j] = altered(records[j], field)
    assert failing(config, records, fleet.events)


# -- stub robots -------------------------------------------------------------------------------


def test_stub_robots_miss_as_often_as_they_should():
    """With 2000 tasks the rates are within 5 standard deviations of what they should be."""
    robots = StubRobots(
        iterate := lambda work: outcome(feasible=True),
        check=missed_checks(iterate, 0.4, candidates=1, seed=3),
        reach=missed_grasps(0.25, seed=3),
    )
    fleet = Fleet(FleetConfig(robots=20, tasks=100, policy="autonomous"), robots)
    drive([(fleet, robots)])
    checks = [event.outcome for event in fleet.events if event.kind is EventKind.CHECK]
    ends = [event.outcome for event in fleet.events if event.kind is EventKind.EXECUTION_END]
    for outcomes, rate in ((checks, 0.4), (ends, 0.25)):
        sd = (rate * (1 - rate) / len(outcomes)) ** 0.5
        assert abs(outcomes.count("missed") / len(outcomes) - rate) < 5 * sd
    summary = summarise(fleet.config, fleet.records, fleet.events)
    assert summary.first_attempt is not None and summary.checks is not None
    # Every reach is the first one of its task with a chance of 0.75 to grasp.
    assert summary.first_attempt.mean == pytest.approx(0.75, abs=0.05)
    assert summary.checks.mean == len(checks) / 2000


def test_candidates_bound_the_checks_of_an_iteration():
    numbers = set()
    check = missed_checks(lambda work: outcome(feasible=True, gain=2.0), 1.0, candidates=2)
    for iteration in range(50):
        work = Work(0, 0, WorkKind.CHECK, iteration, check=0)
        numbers.add(check(work).more)
        last = check(dataclasses.replace(work, check=1))
        assert not last.more and not last.passed and last.result.gain == 2.0
        assert not last.result.feasible
    assert numbers == {True, False}
