"""Configuration, policies, service times, allocator and metrics, each by itself."""

import math

import numpy as np
import pytest
import scipy.stats
from fleet_script import PUSH, run
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.fleet import Event, EventKind, Fleet, FleetConfig
from pgf_jax.fleet.allocator import AskOutcome, BidWindow, FifoQueue, LossSystem
from pgf_jax.fleet.compute import Dedicated, Shared, parse_compute
from pgf_jax.fleet.operators import OperatorPool
from pgf_jax.fleet.policies import Discipline, PolicyBase, check_policy, register_policy
from pgf_jax.fleet.service import LogNormal
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.metrics.summary import (
    busy_ns,
    mean_interval,
    paired_difference,
    rate_interval,
    summarise,
    t_quantile,
    window_sizes,
)
from pgf_jax.streams import stream

# --- configuration ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("robots", 0),
        ("robots", 2.0),
        ("robots", True),
        ("tasks", -1),
        ("operators", 0),
        ("rollouts", 0),
        ("seed", -1),
        ("policy", "pfg"),
        ("compute", "shared"),
        ("compute", "shared:0"),
        ("compute", "shared:-4"),
        ("compute", "shared:1_0"),
        ("compute", "shared:x"),
        ("compute", "mine"),
        ("window_s", -0.1),
        ("window_s", math.nan),
        ("service_mean_s", -1.0),
        ("service_sd_s", math.inf),
        ("context_switch_s", -1.0),
        ("rollout_time_s", 0.0),
        ("rollout_time_s", "1.5"),
        ("task_limit_s", 0.0),
        ("push_limit_s", -3.0),
        ("horizon_s", 0.0),
        ("horizon_s", -5.0),
        ("bid_threshold", math.nan),
        ("reach_execution_s", None),
    ],
)
def test_bad_configuration_is_refused_in_one_line(field, value):
    with pytest.raises(BadInput) as error:
        FleetConfig(**{field: value})
    message = str(error.value)
    assert message.startswith(f"{field}: expected ")
    assert repr(value) in message
    assert "\n" not in message


def test_spread_without_a_mean_is_refused():
    with pytest.raises(BadInput, match="service_sd_s: expected 0 with service_mean_s 0"):
        FleetConfig(service_mean_s=0.0)
    FleetConfig(service_mean_s=0.0, service_sd_s=0.0)


def test_compute_models():
    assert parse_compute("dedicated") == Dedicated()
    assert parse_compute("shared:96") == Shared(96, 8)
    # The paper's computer: full at 12 robots, oversubscribed 2.5 times at 30.
    factors = [Shared(96, 8).slowdown(0, 0, 0, planning) for planning in (1, 12, 13, 30)]
    assert factors == [1.0, 1.0, 8 * 13 / 96, 2.5]


def test_a_policy_of_ones_own():
    class AfterTwo(PolicyBase):
        discipline = Discipline.LINE

        def bid(self, result, progress):
            return 1.0 if progress.reach_iterations == 2 and not progress.grants else None

    with pytest.raises(BadInput, match="after-two"):
        FleetConfig(policy="after-two")
    register_policy("after-two", lambda config: AfterTwo())
    with pytest.raises(ValueError, match="registered already"):
        register_policy("pgf", lambda config: AfterTwo())
    check_policy("after-two")
    fleet, _ = run({0: ". . . . . f"}, policy="after-two")
    assert fleet.records[0].grants_at == (2,)


def test_progress_tells_the_time_that_remains():
    seen = []

    class Watch(PolicyBase):
        discipline = Discipline.LINE

        def bid(self, result, progress):
            seen.append((progress.reach_iterations, progress.grants, progress.remaining_s))
            return 1.0 if progress.reach_iterations == 1 and not progress.grants else None

    register_policy("watch", lambda config: Watch())
    run({0: ". . f . . f"}, policy="watch", inputs={(0, 0, 0): PUSH}, task_limit_s=100.0)
    # 8 s of service and 1.5 + 3 s of pushing count; 4 s of execution and retreat do not. The push
    # takes iterations 2 and so one only: feasible at its iteration 0.
    assert seen == [(0, 0, 98.5), (1, 0, 95.5), (1, 1, 84.5), (2, 1, 81.5)]


# --- service times ------------------------------------------------------------------------------


def test_service_times_are_log_normal():
    times = LogNormal(seed=0, mean_s=8.0, sd_s=4.0)
    draws = np.array([times.seconds(r, t, 0) for r in range(20) for t in range(100)])
    sigma = math.sqrt(math.log(1.25))
    mu = math.log(8.0) - sigma**2 / 2
    assert scipy.stats.kstest(np.log(draws), "norm", args=(mu, sigma)).pvalue > 0.01
    assert mean_interval(draws.tolist(), confidence=0.99).low < 8.0
    assert mean_interval(draws.tolist(), confidence=0.99).high > 8.0


def test_service_times_depend_on_every_part_of_their_key_and_on_nothing_else():
    def draw(seed: int, *key: int) -> float:
        return LogNormal(seed, 8.0, 4.0).seconds(*key)

    base = draw(1, 2, 3, 4)
    assert base == draw(1, 2, 3, 4)
    keys = [
        (2, 2, 3, 4),
        (1, 3, 3, 4),
        (1, 2, 4, 4),
        (1, 2, 3, 5),
        (1, 2, 3, 0),
        (1 + 2**32, 2, 3, 4),
    ]
    assert len({base, *(draw(*key) for key in keys)}) == len(keys) + 1
    assert LogNormal(0, 8.0, 0.0).seconds(5, 5, 5) == 8.0
    # Streams of different purposes are different streams.
    assert stream(0, "service", 1).random() != stream(0, "window", 1).random()


def test_the_same_inputs_take_the_same_time_under_every_policy():
    # Common random numbers: the n-th input of a task, whoever asked and however often.
    lengths: dict[tuple, set] = {}
    for policy in ("pgf", "or-hitl", "or-hitl-window", "queue", "random"):
        robots = StubRobots(
            lambda work: outcome(stuck=work.iteration < 9, feasible=work.iteration > 8)
        )
        fleet = Fleet(
            FleetConfig(robots=3, tasks=2, policy=policy, seed=4, task_limit_s=1e4), robots
        )
        drive([(fleet, robots)])
        since = {}
        for event in fleet.events:
            if event.kind is EventKind.GRANT:
                since[event.robot] = event.time_ns
            elif event.kind is EventKind.SERVICE_END:
                assert event.outcome == "go_on"
                key = (event.robot, event.task, event.request)
                lengths.setdefault(key, set()).add(event.time_ns - since[event.robot])
    assert len(lengths) >= 12
    assert all(len(values) == 1 for values in lengths.values())


# --- allocator ----------------------------------------------------------------------------------

BIDS = st.dictionaries(
    st.integers(0, 9), st.sampled_from([1.0, 2.0, 3.0, math.inf]), min_size=1, max_size=10
)


@given(bids=BIDS, free=st.integers(1, 4), seed=st.integers(0, 20), order=st.randoms())
def test_windows_give_the_free_operators_to_the_highest_bids(bids, free, seed, order):
    def close(robots: list[int]) -> tuple[list[int], list[int]]:
        window = BidWindow(seed=seed, robots=10)
        replies = [window.ask(robot, bids[robot], free=free) for robot in robots]
        assert replies == [AskOutcome.OPENS_WINDOW] + [AskOutcome.WAITS] * (len(robots) - 1)
        return window.close_window(free=free)

    robots = sorted(bids)
    winners, losers = close(robots)
    assert sorted(winners + losers) == robots
    assert losers == sorted(losers)
    assert len(winners) == min(free, len(robots))
    assert [bids[r] for r in winners] == sorted(bids.values(), reverse=True)[: len(winners)]
    order.shuffle(robots)
    assert close(robots) == (winners, losers)
    # Taking out a loser changes no winner.
    if losers:
        robots.remove(losers[0])
        assert close(robots)[0] == winners


def test_a_window_needs_a_free_operator_to_open_but_not_to_join():
    window = BidWindow(seed=0, robots=3)
    assert window.ask(0, 1.0, free=0) is AskOutcome.IGNORED
    assert window.ask(0, 1.0, free=1) is AskOutcome.OPENS_WINDOW
    assert window.ask(1, 2.0, free=0) is AskOutcome.WAITS
    window.withdraw(1)
    assert window.match(free=1) == []
    assert window.close_window(free=1) == ([0], [])
    with pytest.raises(ValueError, match="robot 2 bids nan"):
        window.ask(2, math.nan, free=1)


def test_line_and_refusal():
    line = FifoQueue()
    for robot in (4, 2, 7):
        assert line.ask(robot, 0.0, free=0) is AskOutcome.WAITS
    line.withdraw(2)
    assert line.match(free=0) == []
    assert line.match(free=1) == [4]
    assert line.match(free=3) == [7]
    refuse = LossSystem()
    assert refuse.ask(1, 0.0, free=0) is AskOutcome.REFUSED
    assert refuse.match(free=1) == []
    assert refuse.ask(1, 0.0, free=1) is AskOutcome.WAITS
    assert refuse.match(free=1) == [1]


def test_operators():
    operators = OperatorPool(2)
    assert operators.acquire(5) == (0, False)
    assert operators.acquire(6) == (1, False)
    assert operators.free == 0
    assert operators.release(5) == 0
    assert operators.acquire(5) == (0, False)
    assert operators.release(5) == 0
    assert operators.acquire(7) == (0, True)


# --- metrics ------------------------------------------------------------------------------------


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.975, 0.995])
@pytest.mark.parametrize("dof", [1, 2, 3, 4, 7, 30, 999, 1000])
def test_t_quantile(probability, dof):
    expected = scipy.stats.t.ppf(probability, dof)
    assert t_quantile(probability, dof) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@settings(max_examples=50)
@given(n=st.integers(1, 400), share=st.floats(0, 1))
def test_rate_interval_is_wilsons(n, share):
    successes = round(share * n)
    got = rate_interval(successes, n)
    expected = scipy.stats.binomtest(successes, n).proportion_ci(method="wilson")
    assert (got.low, got.high) == pytest.approx((expected.low, expected.high), abs=1e-9)
    assert 0 <= got.low <= got.mean <= got.high <= 1


def test_mean_interval():
    got = mean_interval([1.0, 2.0, 3.0, 6.0])
    expected = scipy.stats.t.interval(0.95, 3, loc=3.0, scale=scipy.stats.sem([1, 2, 3, 6]))
    assert (got.low, got.high) == pytest.approx(expected)
    assert (got.mean, got.n) == (3.0, 4)
    one = mean_interval([4.0])
    assert (one.mean, one.n) == (4.0, 1)
    assert math.isnan(one.low)
    assert math.isnan(mean_interval([]).mean)


def test_summary_of_a_case_worked_by_hand():
    # Robot 0: solved with one push at reach iteration 1. Robot 1 loses the window that it joins,
    # and runs out of time while it has the operator: its limit is 40 s, it is served from 30.5 on.
    config = FleetConfig(robots=2, tasks=1, service_mean_s=8.0, service_sd_s=0.0, task_limit_s=40.0)
    fleet, _ = run(
        {0: ". 5 f f", 1: ". 3 . . . . . . s"},
        inputs={(0, 0, 0): PUSH},
        robots=2,
        task_limit_s=40.0,
        service=12.0,
    )
    # Robot 0: window 4.5 to 6.5, served to 18.5, push 20, executed 24, reach 25.5, check 27, 30.
    # Robot 1: iteration 8 ends at 6.5 + 7 * 3 = 27.5; window to 29.5, served till the limit at 40.
    summary = summarise(config, fleet.records, fleet.events)
    assert fleet.now_ns == 40 * 10**9
    assert (summary.tasks, summary.solved, summary.stuck, summary.censored) == (2, 1, 1, 0)
    assert summary.tasks_per_hour == pytest.approx(90.0)
    assert (summary.success.mean, summary.helped.mean) == (0.5, 1.0)
    planning = (4.5 + 2 + 1.5 + 1.5 + 1.5, 29.5)
    assert summary.planning_time_s.mean == pytest.approx(sum(planning) / 2)
    assert summary.planning_time_solved_s.mean == planning[0]
    assert summary.waiting_s.mean == (2 + 4) / 2
    assert summary.interaction_s.mean == (12 + 10.5) / 2
    assert summary.utilisation == pytest.approx(22.5 / 40)
    assert (summary.windows, summary.window_size_mean, summary.window_size_max) == (2, 1.5, 2)
    assert (summary.requests, summary.grants, summary.refusals) == (3, 2, 1)
    assert (summary.answered, summary.expired) == (1, 1)
    assert (summary.pushes_planned, summary.pushes_succeeded) == (1, 1)
    assert (summary.first_bid.mean, summary.first_bid.n) == (1.0, 2)
    assert summary.first_grant.mean == summary.every_grant.mean == (1 + 8) / 2
    assert (summary.every_successful_grant.mean, summary.every_successful_grant.n) == (1.0, 1)
    row = summary.row()
    assert row["success"] == 0.5
    assert row["success_low"] == summary.success.low
    assert row["planning_time_s_n"] == 2


def test_tasks_cut_off_by_the_horizon_have_no_outcome():
    fleet, _ = run({(0, 0): "f", 1: "."}, robots=2, tasks=2, policy="autonomous", horizon_s=7.0)
    summary = summarise(fleet.config, fleet.records, fleet.events)
    assert (summary.tasks, summary.solved, summary.censored) == (1, 1, 2)
    assert summary.success.mean == 1.0
    assert summary.planning_time_s.mean == 3.0
    assert summary.tasks_per_hour == pytest.approx(3600 / 7)


def test_paired_differences_match_tasks_and_leave_out_cut_ones():
    ours, _ = run({(0, 0): "f", (0, 1): ". f", (0, 2): "f"}, tasks=3, policy="autonomous")
    theirs, _ = run({(0, 0): ". f", (0, 1): ". . f"}, tasks=3, policy="autonomous", horizon_s=25.0)
    assert [record.status for record in theirs.records] == ["solved", "solved", "censored"]
    got = paired_difference(reversed(ours.records), theirs.records, lambda r: r.planning_time_s)
    # Each took one iteration, 3 s, less: there is no spread left.
    assert (got.mean, got.low, got.high, got.n) == (-3.0, -3.0, -3.0, 2)


def test_busy_time_and_window_sizes_from_events_alone():
    def event(seconds: int, kind: EventKind, operator: int | None = None) -> Event:
        return Event(seconds * 10**9, kind, operator=operator)

    events = [
        event(0, EventKind.WINDOW_OPEN),
        event(0, EventKind.BID),
        event(1, EventKind.BID),
        event(2, EventKind.WINDOW_CLOSE),
        event(2, EventKind.GRANT, 0),
        event(3, EventKind.WINDOW_OPEN),
        event(3, EventKind.BID),
        event(4, EventKind.EXPIRED),
        event(5, EventKind.WINDOW_CLOSE),
        event(6, EventKind.GRANT, 1),
        event(7, EventKind.SERVICE_END, 0),
        event(9, EventKind.SERVICE_END, 1),
    ]
    assert busy_ns(events) == 8 * 10**9
    assert window_sizes(events) == [2, 0]
