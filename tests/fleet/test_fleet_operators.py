"""Cases worked out by hand, several robots and operators: windows, ties, refusals, expiry."""

import math

import pytest
from fleet_script import PUSH, log, run

from pgf_jax.fleet import EventKind, Fleet, FleetConfig
from pgf_jax.fleet.stub import StubRobots, drive, outcome

QUIET = ("task_start", "task_end", "iteration", "execution_end", "retreat_end")


def test_window_takes_the_highest_bid_and_losers_plan_on():
    # All end iteration 0 at 1.5 and bid; robot 3 has nothing to gain. The losers' next iteration
    # ends at 6.5, while the operator is busy: their gain still exceeds 1, and nobody joins.
    fleet, _ = run({0: "5 5 f", 1: "9 f", 2: "2 2 f", 3: "1 f"}, robots=4)
    assert log(fleet, "task_start", "task_end", "execution_end") == [
        "1.5 iteration r0.0 i0 gain=5",
        "1.5 window_open r0.0",
        "1.5 bid r0.0 q0 i0 gain=5",
        "1.5 iteration r1.0 i0 gain=9",
        "1.5 bid r1.0 q0 i0 gain=9",
        "1.5 iteration r2.0 i0 gain=2",
        "1.5 bid r2.0 q0 i0 gain=2",
        "1.5 iteration r3.0 i0 gain=1",
        "3.5 window_close",
        "3.5 grant r1.0 q0 o0",
        "3.5 refused r0.0 q0 lost",
        "3.5 refused r2.0 q0 lost",
        "4.5 iteration r3.0 i1 feasible",
        "6.5 iteration r0.0 i1 gain=5",
        "6.5 iteration r2.0 i1 gain=2",
        "9.5 iteration r0.0 i2 feasible",
        "9.5 iteration r2.0 i2 feasible",
        "11.5 service_end r1.0 q0 o0 go_on",
        "14.5 iteration r1.0 i1 feasible",
    ]
    assert [record.refusals for record in fleet.records] == [0, 1, 1, 0]


def test_a_stuck_robot_outbids_every_gain_and_needs_no_history():
    fleet, _ = run({0: "1e9 f", 1: "s f"}, robots=2)
    assert "3.5 grant r1.0 q0 o0" in log(fleet)


@pytest.mark.parametrize(("window", "winner"), [(3.0, 1), (2.9, 0)])
def test_a_bid_at_the_closing_instant_is_inside(window, winner):
    # Robot 1's iteration 1 ends at 4.5, when a window of 3 s opened at 1.5 closes.
    fleet, _ = run({0: "5 f", 1: ". 9 f"}, robots=2, window_s=window)
    grants = [event.robot for event in fleet.events if event.kind is EventKind.GRANT]
    assert grants[0] == winner


def test_ties_fall_by_a_key_of_seed_and_window_whoever_else_bids():
    def winner(seed: int, script: dict) -> int | None:
        fleet, _ = run(script, robots=4, seed=seed)
        return next(event.robot for event in fleet.events if event.kind is EventKind.GRANT)

    both = [winner(seed, {0: "5 f", 3: "5 f"}) for seed in range(40)]
    assert set(both) == {0, 3}
    assert both == [winner(seed, {0: "5 f", 1: "2 f", 3: "5 f"}) for seed in range(40)]
    # Fair within 4 standard deviations of a fair coin.
    assert abs(both.count(0) - 20) <= 4 * math.sqrt(40) / 2

    # Later windows of the same fleet draw another key.
    fleet, _ = run({0: "5", 1: "5"}, robots=2, task_limit_s=180.0, service=0.0)
    grants = [event.robot for event in fleet.events if event.kind is EventKind.GRANT]
    assert set(grants) == {0, 1}


def test_two_operators_serve_the_two_highest_bids():
    fleet, _ = run({0: "5 f", 1: "2 f", 2: "9 f"}, robots=3, operators=2)
    assert log(fleet, *QUIET)[4:] == [
        "3.5 window_close",
        "3.5 grant r2.0 q0 o0",
        "3.5 grant r0.0 q0 o1",
        "3.5 refused r1.0 q0 lost",
        "11.5 service_end r0.0 q0 o1 go_on",
        "11.5 service_end r2.0 q0 o0 go_on",
    ]


def test_an_operator_freed_at_the_closing_instant_counts():
    # Two operators. Robot 0 is served from 3.5 to 6.5 by the first; robots 1 and 2 bid at 4.5 and
    # their window, opened for the second operator, closes at 6.5: by then both are free.
    fleet, _ = run({0: "5 f", 1: ". 5 f", 2: ". 9 f"}, robots=3, operators=2, service=3.0)
    assert log(fleet, *QUIET) == [
        "1.5 window_open r0.0",
        "1.5 bid r0.0 q0 i0 gain=5",
        "3.5 window_close",
        "3.5 grant r0.0 q0 o0",
        "4.5 window_open r1.0",
        "4.5 bid r1.0 q0 i1 gain=5",
        "4.5 bid r2.0 q0 i1 gain=9",
        "6.5 service_end r0.0 q0 o0 go_on",
        "6.5 window_close",
        "6.5 grant r2.0 q0 o0",
        "6.5 grant r1.0 q0 o1",
        "9.5 service_end r1.0 q0 o1 go_on",
        "9.5 service_end r2.0 q0 o0 go_on",
    ]


def test_or_hitl_refuses_while_busy_and_is_asked_again_every_iteration():
    # Robot 1 asks at 1.5, 4.5, 7.5 and is served at 10.5; the operator is free at 9.5.
    fleet, _ = run({0: "s f", 1: "s s s s f"}, robots=2, policy="or-hitl")
    assert log(fleet, *QUIET) == [
        "1.5 bid r0.0 q0 i0 gain=inf",
        "1.5 grant r0.0 q0 o0",
        "1.5 bid r1.0 q0 i0 gain=inf",
        "1.5 refused r1.0 q0 busy",
        "4.5 bid r1.0 q0 i1 gain=inf",
        "4.5 refused r1.0 q0 busy",
        "7.5 bid r1.0 q0 i2 gain=inf",
        "7.5 refused r1.0 q0 busy",
        "9.5 service_end r0.0 q0 o0 go_on",
        "10.5 bid r1.0 q0 i3 gain=inf",
        "10.5 grant r1.0 q0 o0",
        "18.5 service_end r1.0 q0 o0 go_on",
    ]
    record = fleet.records[1]
    assert (record.requests, record.refusals, record.grants) == (4, 3, 1)
    assert (record.first_bid, record.first_grant) == (0, 3)
    assert record.waiting_s == 0.0


def test_service_ends_before_iterations_do():
    # The service ends at 4.5, exactly when robot 1 asks again: it is granted.
    fleet, _ = run({0: "s f", 1: "s s f"}, robots=2, policy="or-hitl", service=3.0)
    assert log(fleet, *QUIET)[4:7] == [
        "4.5 service_end r0.0 q0 o0 go_on",
        "4.5 bid r1.0 q0 i1 gain=inf",
        "4.5 grant r1.0 q0 o0",
    ]


def test_tie_order_of_one_instant():
    # At 6.0: robot 3's service of 3 s ends; robot 1's reach ends; robot 2, slower, ends iteration 1
    # and bids into the window that robot 0 opened at 4.5; it closes; robot 1 takes a new task.
    # The robots are not in that order, so that the order by robot cannot stand in for it.
    fleet, _ = run(
        {(0, 0): ". 3 f", (1, 0): "f", (2, 0): ". 4 f", (3, 0): "s f"},
        robots=4,
        operators=2,
        tasks=2,
        window_s=1.5,
        service=3.0,
        speeds=(1.0, 1.0, 4 / 3, 1.0),
    )
    assert [line for line in log(fleet) if line.startswith("6 ")] == [
        "6 service_end r3.0 q0 o0 go_on",
        "6 execution_end r1.0 reach",
        "6 task_end r1.0 solved",
        "6 iteration r2.0 i1 gain=4",
        "6 bid r2.0 q0 i1 gain=4",
        "6 window_close",
        "6 grant r2.0 q0 o0",
        "6 grant r0.0 q0 o1",
        "6 task_start r1.1",
    ]


def test_queue_serves_in_order_of_arrival():
    # Robot 0 is the slowest to get stuck, so it comes last; robots 1 and 2 arrive together.
    fleet, _ = run(
        {0: "s f", 1: "s f", 2: "s f"},
        robots=3,
        policy="queue",
        service=4.0,
        speeds=(2.0, 1.0, 1.0),
    )
    assert log(fleet, *QUIET) == [
        "1.5 bid r1.0 q0 i0 gain=inf",
        "1.5 grant r1.0 q0 o0",
        "1.5 bid r2.0 q0 i0 gain=inf",
        "3 bid r0.0 q0 i0 gain=inf",
        "5.5 service_end r1.0 q0 o0 go_on",
        "5.5 grant r2.0 q0 o0",
        "9.5 service_end r2.0 q0 o0 go_on",
        "9.5 grant r0.0 q0 o0",
        "13.5 service_end r0.0 q0 o0 go_on",
    ]
    waits = {record.robot: record.waiting_s for record in fleet.records}
    assert waits == {0: 6.5, 1: 0.0, 2: 4.0}


def test_an_ask_in_line_expires_and_a_service_under_way_ends_at_the_limit():
    # Limit 12 s. Robot 0 is served from 1.5 to 11.5. Robot 1 then, but only until 12; robot 2 is
    # still in line at 12 and leaves it before the operator, free at that instant, could turn to it.
    fleet, _ = run(
        {0: "s", 1: "s", 2: "s"}, robots=3, policy="queue", service=10.0, task_limit_s=12.0
    )
    assert log(fleet, "task_start", "iteration") == [
        "1.5 bid r0.0 q0 i0 gain=inf",
        "1.5 grant r0.0 q0 o0",
        "1.5 bid r1.0 q0 i0 gain=inf",
        "1.5 bid r2.0 q0 i0 gain=inf",
        "11.5 service_end r0.0 q0 o0 go_on",
        "11.5 grant r1.0 q0 o0",
        "11.5 task_end r0.0 timed_out",  # no time for an iteration; "go on" cleared the counter
        "12 expired r2.0 q0 limit",
        "12 task_end r2.0 stuck",
        "12 service_end r1.0 q0 o0 expired",
        "12 task_end r1.0 stuck",
    ]
    by_robot = sorted(fleet.records, key=lambda record: record.robot)
    assert [record.answered for record in by_robot] == [1, 0, 0]
    assert [record.expired for record in by_robot] == [0, 1, 1]
    assert [record.grants for record in by_robot] == [1, 1, 0]
    assert [record.interaction_s for record in by_robot] == [10.0, 0.5, 0.0]


def test_an_input_at_the_limit_itself_is_in_time():
    # The service ends at 11.5, the limit of robot 0, which still takes the push; robot 1, in line,
    # has no time left then.
    fleet, robots = run(
        {0: "s", 1: "s"},
        robots=2,
        policy="queue",
        service=10.0,
        task_limit_s=11.5,
        inputs={(0, 0, 0): PUSH},
    )
    assert log(fleet, "task_start", "iteration")[3:] == [
        "11.5 expired r1.0 q0 limit",
        "11.5 task_end r1.0 stuck",
        "11.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "11.5 push_dropped r0.0 object=3",
        "11.5 task_end r0.0 timed_out",
    ]
    assert ("start_push", 0, PUSH) in robots.calls


def test_a_bid_expires_in_a_window_that_outlasts_its_task():
    # A window of 5 s from 4.5 to 9.5, and time until 8 only. The window stays open, empty.
    fleet, _ = run(
        {0: ". 5 f", 1: ". 5 f"},
        robots=2,
        window_s=5.0,
        task_limit_s=8.0,
        service=0.25,
    )
    assert log(fleet, *QUIET) == [
        "4.5 window_open r0.0",
        "4.5 bid r0.0 q0 i1 gain=5",
        "4.5 bid r1.0 q0 i1 gain=5",
        "8 expired r0.0 q0 limit",
        "8 expired r1.0 q0 limit",
        "9.5 window_close",
    ]
    assert [record.waiting_s for record in fleet.records] == [3.5, 3.5]
    assert [record.planning_time_s for record in fleet.records] == [8.0, 8.0]


def test_a_robot_whose_task_expired_bids_again_in_the_same_window():
    # Robot 0 leaves at 8 and its next task, from 8 on, bids at 9.5, when the window closes.
    fleet, _ = run(
        {(0, 0): ". 5", (0, 1): "7 f"}, tasks=2, window_s=5.0, task_limit_s=8.0, service=0.25
    )
    assert log(fleet, *QUIET) == [
        "4.5 window_open r0.0",
        "4.5 bid r0.0 q0 i1 gain=5",
        "8 expired r0.0 q0 limit",
        "9.5 bid r0.1 q0 i0 gain=7",
        "9.5 window_close",
        "9.5 grant r0.1 q0 o0",
        "9.75 service_end r0.1 q0 o0 go_on",
    ]


def test_a_loser_without_time_for_an_iteration_ends_its_task_once():
    # The window of 5 s leaves it half a second: its task ends at 9.5, and nothing expires at 10.
    fleet, _ = run({0: ". 5", 1: ". 9"}, robots=2, window_s=5.0, task_limit_s=10.0, service=0.25)
    assert log(fleet, "task_start", "iteration")[3:] == [
        "9.5 window_close",
        "9.5 grant r1.0 q0 o0",
        "9.5 refused r0.0 q0 lost",
        "9.5 task_end r0.0 timed_out",
        "9.75 service_end r1.0 q0 o0 go_on",
        "9.75 task_end r1.0 timed_out",
    ]


def test_planning_starts_by_robot_whatever_happened_first():
    # At 6.0 robot 1's service ends (first) and robot 0's push iteration does; neither push has time
    # for another one, robot 1 being slow.
    fleet, _ = run(
        {0: "s . . f", 1: "s . . f"},
        robots=2,
        operators=2,
        policy="or-hitl",
        service=3.0,
        push_limit_s=1.5,
        inputs={(0, 0, 0): PUSH, (1, 0, 0): PUSH},
        speeds=(1.0, 2.0),
    )
    assert [line for line in log(fleet) if line.startswith("6 ")] == [
        "6 service_end r1.0 q0 o1 object=3 to=(0.4,0.1) push",
        "6 iteration r0.0 i1 object=3",
        "6 push_dropped r0.0 object=3",
        "6 push_dropped r1.0 object=3",
    ]


@pytest.mark.parametrize(
    ("policy", "bids"),
    [
        ("pgf", {0: 5.0, 1: math.inf}),
        ("oracle-gain", {0: 5.0, 1: math.inf}),
        ("or-hitl", {1: math.inf}),
        ("or-hitl-window", {1: math.inf}),
        ("queue", {1: math.inf}),
        ("random", {0: 1.0, 1: 1.0, 2: 1.0, 3: 1.0}),
        ("classifier", {0: 1.0, 1: 1.0, 2: 1.0}),
        ("always", {0: math.inf, 1: math.inf, 2: math.inf, 3: math.inf}),
        ("autonomous", {}),
    ],
)
def test_who_bids_what(policy, bids):
    # Robot 0 has much to gain, robot 1 is stuck, robot 2 gains (or fails with probability) 0.9,
    # robot 3 knows nothing yet.
    fleet, _ = run({0: "5 f", 1: "s f", 2: "0.9 f", 3: ". f"}, robots=4, policy=policy)
    first = {}
    for event in fleet.events:
        if event.kind is EventKind.BID:
            first.setdefault(event.robot, event.gain)
    if policy == "always":
        assert first == bids
    else:
        at_once = [e for e in fleet.events if e.kind is EventKind.BID and e.time_ns == 15 * 10**8]
        assert {event.robot: event.gain for event in at_once} == bids


def test_or_hitl_window_grants_one_of_the_stuck_at_the_windows_end():
    fleet, _ = run({0: "s f", 1: "s f"}, robots=2, policy="or-hitl-window")
    lines = log(fleet, *QUIET)
    assert lines[3] == "3.5 window_close"
    assert lines[4].startswith("3.5 grant")
    assert lines[5].endswith("lost")


def test_context_switch_is_paid_when_an_operator_turns_to_another_robot():
    # Robot 0 twice in a row, then robot 1: only the third service costs 5 s more.
    fleet, _ = run(
        {0: "s s f", 1: ". . . s f"}, robots=2, policy="queue", service=1.0, context_switch_s=5.0
    )
    starts = {}
    lengths = []
    for event in fleet.events:
        if event.kind is EventKind.GRANT:
            starts[event.robot] = event.time_ns
        elif event.kind is EventKind.SERVICE_END:
            lengths.append((event.robot, (event.time_ns - starts[event.robot]) / 1e9))
    assert lengths == [(0, 1.0), (0, 1.0), (1, 6.0)]


def test_request_numbers_count_inputs_not_refusals():
    # A policy that was refused more often must draw the same service times.
    seen = []

    class Noted:
        def seconds(self, robot: int, task: int, request: int) -> float:
            seen.append((robot, task, request))
            return 4.0

    robots = StubRobots(
        lambda work: outcome(stuck=work.iteration < 6, feasible=work.iteration >= 6)
    )
    fleet = Fleet(FleetConfig(robots=2, tasks=2, policy="or-hitl"), robots, service=Noted())
    drive([(fleet, robots)])
    assert any(event.kind is EventKind.REFUSED for event in fleet.events)
    for robot in range(2):
        for task in range(2):
            requests = [key[2] for key in seen if key[:2] == (robot, task)]
            assert requests == list(range(len(requests)))
            assert requests
