"""Metrics of attention, and the costs before and after help, worked out by hand."""

import dataclasses
import math

import pytest
from fleet_script import PUSH, Constant
from hypothesis import given, settings
from hypothesis import strategies as st
from random_fleets import CONFIGS, noisy_robots

from pgf_jax.fleet import EventKind, Fleet, FleetConfig, IterationResult
from pgf_jax.fleet.config import plans_meanwhile
from pgf_jax.fleet.policies import make_policy
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.metrics.attention import attention, jain_index, waits_s
from pgf_jax.metrics.summary import rate_interval, summarise
from pgf_jax.planning.types import LOOK_AHEAD


def fleet_of(iterate, decide=lambda work: None, *, service=8.0, **config) -> Fleet:
    """Run one fleet of robots whose iterations and inputs are functions of the work."""
    config = {"tasks": 1, "policy": "or-hitl", **config}
    robots = StubRobots(iterate, decide)
    fleet = Fleet(FleetConfig(**config), robots, service=Constant(service))
    drive([(fleet, robots)])
    return fleet


def falling(*, stuck=(), feasible=()):
    """Iteration i of a task costs 100 - i, pushes' iterations included."""
    return lambda work: outcome(
        cost=100.0 - work.iteration,
        stuck=work.iteration in stuck,
        feasible=work.iteration in feasible,
    )


def costs(fleet: Fleet) -> tuple[tuple[float, ...], tuple[float, ...]]:
    (record,) = fleet.records
    assert len(record.asked_cost) == len(record.helped_cost) == record.answered
    return record.asked_cost, record.helped_cost


# -- costs before and after an input -----------------------------------------------------------


def test_after_ten_reach_iterations_before_the_next_input_or_at_the_end():
    # Inputs after iterations 2, 5 and 18 say go on. The second comes 3 iterations after the first;
    # iteration 15 is the tenth after it; the third has 2 more, the last of which solves the task.
    fleet = fleet_of(falling(stuck=(2, 5, 18), feasible=(20,)))
    assert fleet.records[0].grants_at == (2, 5, 18)
    assert costs(fleet) == ((98.0, 95.0, 82.0), (95.0, 85.0, 80.0))


def test_a_push_does_not_count_and_the_iteration_0_after_it_is_none_of_the_ten():
    # Work 0 to 2 reaches, 3 and 4 push, 5 is the new nominal, 6 to 15 are ten iterations.
    iterate = falling(stuck=(2,), feasible=(4, 20))
    fleet = fleet_of(iterate, lambda work: PUSH)
    assert fleet.records[0].pushes_succeeded == 1
    assert costs(fleet) == ((98.0,), (100.0 - 15,))
    # Solved by the new nominal itself.
    assert costs(fleet_of(falling(stuck=(2,), feasible=(4, 5)), lambda work: PUSH)) == (
        (98.0,),
        (95.0,),
    )


def test_a_dropped_push_counts_as_the_reach_that_restarts():
    # The push's iterations (3 and 4) take its 5 s. Work 5 is the new nominal, worse than before.
    def iterate(work):
        cost = {0: 50.0, 1: 50.0, 2: 40.0, 3: 1.0, 4: 1.0}.get(work.iteration, 80.0)
        return outcome(cost=cost, stuck=work.iteration == 2, feasible=work.iteration == 7)

    fleet = fleet_of(iterate, lambda work: PUSH, push_limit_s=5.0)
    assert [e.kind for e in fleet.events].count(EventKind.PUSH_DROPPED) == 1
    assert costs(fleet) == ((40.0,), (80.0,))
    got = attention(fleet.config, fleet.records, fleet.events)
    assert (got.wasted.mean, got.dropped.mean, got.cost_drop.mean) == (1.0, 1.0, -40.0)


def test_nothing_is_known_before_planning():
    # `always` asks before any planning; the tenth iteration after it is number 10.
    fleet = fleet_of(falling(feasible=(30,)), policy="always")
    asked, helped = costs(fleet)
    assert math.isnan(asked[0]) and helped == (90.0,)
    got = attention(fleet.config, fleet.records, fleet.events)
    assert (got.wasted.n, got.cost_drop.n, got.go_on.mean) == (0, 0, 1.0)
    assert math.isnan(got.wasted.mean)


def test_nothing_is_known_where_no_reach_iteration_follows():
    # A push before any planning, until the task's limit: served till 8, pushing till 12.5.
    fleet = fleet_of(falling(), lambda work: PUSH, policy="always", task_limit_s=13.0)
    assert fleet.records[0].status == "timed_out"
    assert [math.isnan(value) for (value,) in costs(fleet)] == [True, True]
    # Cut off by the horizon in the middle of the first iteration after the input.
    fleet = fleet_of(falling(stuck=(1,)), horizon_s=14.0)
    asked, helped = costs(fleet)
    assert asked == (99.0,) and math.isnan(helped[0])


def test_a_service_without_an_input_has_no_costs():
    fleet = fleet_of(falling(stuck=(1,)), task_limit_s=11.0)
    assert (fleet.records[0].grants, fleet.records[0].expired) == (1, 1)
    assert costs(fleet) == ((), ())


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000))
def test_costs_are_those_that_the_log_says(config, seed):
    robots = noisy_robots(seed)
    cost = {}
    drawn = robots.compute

    def remembered(work):
        result = drawn(work)
        if isinstance(result, IterationResult):
            cost[work.robot, work.task, work.iteration] = result.cost
        return result

    robots.compute = remembered
    fleet = Fleet(config, robots)
    drive([(fleet, robots)])
    _, keeps_reach = plans_meanwhile(config, make_policy(config))
    for record in fleet.records:
        asked, helped = [], []
        last, ahead, nominal, reach_nominal = math.nan, 0, True, True
        for event in fleet.events:
            if (event.robot, event.task) != (record.robot, record.task):
                continue
            if event.kind is EventKind.SERVICE_END and event.outcome in ("push", "go_on"):
                asked.append(last)
                helped.append(math.nan)
                ahead = 0
                reach_nominal = nominal
                nominal |= event.outcome == "push"
            elif event.kind is EventKind.PUSH_DROPPED:
                nominal = reach_nominal or not keeps_reach
            elif event.kind is EventKind.RETREAT_END:
                nominal = True
            elif event.kind is EventKind.ITERATION:
                if event.object is None:
                    last = cost[record.robot, record.task, event.iteration]
                    ahead += not nominal
                    if helped and ahead <= LOOK_AHEAD:
                        helped[-1] = last
                nominal = False
        assert repr((record.asked_cost, record.helped_cost)) == repr((tuple(asked), tuple(helped)))


# -- attention ---------------------------------------------------------------------------------


def test_attention_by_hand():
    # Robot 0: stuck at 1.5, served till 9.5, goes on, feasible at 12.5 with 40 instead of 100,
    # done at 17. Robot 1: stuck and refused at 1.5, 4.5 and 7.5, served from 10.5 to 18.5; its push
    # fails at 20 and is dropped; new nominal at 21.5, feasible at 24.5 with 99.5, done at 29.
    def iterate(work):
        stuck, feasible, cost = ((1, 1, 40.0), (4, 6, 99.5))[work.robot]
        if work.iteration < feasible:
            return outcome(stuck=work.iteration < stuck)
        return outcome(feasible=True, cost=cost)

    fleet = fleet_of(iterate, lambda work: PUSH if work.robot else None, robots=2, push_limit_s=2.0)
    assert fleet.now_ns == 29 * 10**9
    got = attention(fleet.config, fleet.records, fleet.events)
    assert (got.policy, got.robots, got.operators, got.seed) == ("or-hitl", 2, 1, 0)
    assert got.utilisation == 16 / 29
    assert (got.waiting_per_ask_s.mean, got.waiting_per_ask_s.n) == (0.0, 5)
    assert (got.waiting_per_task_s.mean, got.waiting_per_task_s.n) == (0.0, 2)
    assert got.refused == rate_interval(3, 5)
    assert got.expired == rate_interval(0, 5)
    assert got.go_on == got.dropped == got.wasted == rate_interval(1, 2)
    assert (got.cost_drop.mean, got.cost_drop.n) == ((60 + 0.5) / 2, 2)
    assert got.services_per_robot_hour == pytest.approx(2 / ((17 + 29) / 3600))
    assert (got.fairness_grants, got.largest_share) == (1.0, 0.5)
    rates = (1 / 17, 1 / 29)
    expected = sum(rates) ** 2 / (2 * sum(rate**2 for rate in rates))
    assert got.fairness_throughput == pytest.approx(expected)
    assert math.isnan(got.fairness_waiting)


def test_attention_with_waits_that_the_horizon_cuts_off():
    # All ask at 1.5. Robot 0 is served till 9.5 and done at 17, the horizon; robot 1 has waited for
    # 8 s then and is being served; robot 2 is still in line, after 15.5 s.
    fleet = fleet_of(falling(stuck=(0,), feasible=(1,)), robots=3, policy="queue", horizon_s=17.0)
    got = attention(fleet.config, fleet.records, fleet.events)
    assert waits_s(fleet.events) == [0.0, 8.0, 15.5]
    assert (got.waiting_per_ask_s.mean, got.waiting_per_ask_s.n) == (23.5 / 3, 3)
    assert (got.waiting_per_task_s.mean, got.waiting_per_task_s.n) == (0.0, 1)
    assert got.utilisation == 15.5 / 17
    assert got.refused == got.expired == rate_interval(0, 3)
    assert got.go_on == rate_interval(1, 1)
    assert got.services_per_robot_hour == pytest.approx(2 / (51 / 3600))
    assert got.fairness_grants == pytest.approx(4 / (3 * 2))
    assert got.largest_share == 0.5
    assert got.fairness_throughput == pytest.approx(1 / 3)
    assert got.fairness_waiting == pytest.approx(23.5**2 / (3 * (8**2 + 15.5**2)))


def test_attention_of_asks_that_expire():
    # Served till the limit at 20, and in line till then.
    fleet = fleet_of(falling(stuck=(0,)), robots=2, policy="queue", service=40.0, task_limit_s=20.0)
    got = attention(fleet.config, fleet.records, fleet.events)
    assert got.expired == rate_interval(2, 2)
    assert got.waiting_per_task_s.mean == 18.5 / 2
    assert (got.fairness_grants, got.largest_share) == (0.5, 1.0)
    assert math.isnan(got.fairness_throughput)
    assert got.go_on.n == got.dropped.n == got.wasted.n == 0


def test_censored_tasks_count_in_totals_but_not_in_what_help_did():
    # Served from 1.5 to 9.5 and from 15.5 to 23.5; an iteration ends at 26.5, the horizon is at 27.
    fleet = fleet_of(falling(stuck=(0, 2)), horizon_s=27.0)
    assert costs(fleet) == ((100.0, 98.0), (98.0, 97.0))
    got = attention(fleet.config, fleet.records, fleet.events)
    assert got.wasted.n == got.cost_drop.n == got.waiting_per_task_s.n == 0
    assert (got.go_on.n, got.waiting_per_ask_s.n) == (2, 2)
    assert (got.utilisation, got.services_per_robot_hour) == (
        16 / 27,
        pytest.approx(2 / (27 / 3600)),
    )


@pytest.mark.parametrize(
    ("before", "after", "wasted"),
    [
        (50.0, 48.9, False),
        (50.0, 49.0, True),  # not by more than 1
        (50.0, 60.0, True),
        (math.inf, 60.0, False),
        (50.0, math.inf, True),
        (math.inf, math.inf, True),
        (math.nan, 3.0, None),
        (50.0, math.nan, None),
    ],
)
def test_wasted_by_hand(before, after, wasted):
    fleet = fleet_of(falling(stuck=(0,), feasible=(1,)))
    record = dataclasses.replace(fleet.records[0], asked_cost=(before,), helped_cost=(after,))
    got = attention(fleet.config, [record], fleet.events)
    assert got.wasted == (rate_interval(0, 0) if wasted is None else rate_interval(wasted, 1)) or (
        wasted is None and got.wasted.n == 0
    )
    finite = math.isfinite(before) and math.isfinite(after)
    assert got.cost_drop.n == finite
    assert not finite or got.cost_drop.mean == before - after


def test_row_is_flat_and_a_fleet_that_asks_nothing_has_one():
    fleet = fleet_of(falling(feasible=(2,)), policy="autonomous", robots=2)
    row = attention(fleet.config, fleet.records, fleet.events).row()
    assert (row["policy"], row["utilisation"], row["services_per_robot_hour"]) == (
        "autonomous",
        0.0,
        0.0,
    )
    assert row["refused_n"] == row["wasted_n"] == 0
    unknown = ("refused", "wasted_low", "fairness_grants", "fairness_waiting", "largest_share")
    assert all(math.isnan(float(row[name])) for name in unknown)
    assert row["fairness_throughput"] == 1.0
    assert all(isinstance(value, str | int | float) for value in row.values())


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000))
def test_attention_agrees_with_the_summary(config, seed):
    robots = noisy_robots(seed)
    fleet = Fleet(config, robots)
    drive([(fleet, robots)])
    got = attention(config, fleet.records, fleet.events)
    summary = summarise(config, fleet.records, fleet.events)
    assert got.refused.n == got.expired.n == got.waiting_per_ask_s.n == summary.requests
    assert got.go_on.n == got.dropped.n == summary.answered
    assert got.cost_drop.n <= got.wasted.n <= summary.answered
    if summary.requests:
        total = sum(r.waiting_s if r.asking_s is None else r.asking_s for r in fleet.records)
        assert got.waiting_per_ask_s.mean * summary.requests == pytest.approx(total)
    for index in (got.fairness_grants, got.fairness_throughput, got.fairness_waiting):
        assert math.isnan(index) or 1 / config.robots - 1e-12 <= index <= 1 + 1e-12
    shuffled = attention(config, fleet.records[::-1], fleet.events)
    assert shuffled.row() == pytest.approx(got.row(), nan_ok=True)


def test_jain():
    assert jain_index([3, 3, 3]) == 1.0
    assert jain_index([5, 0, 0, 0]) == 0.25
    assert jain_index([1, 2, 3]) == 36 / (3 * 14)
    assert math.isnan(jain_index([0, 0])) and math.isnan(jain_index([]))
