"""Cases worked out by hand, one robot at a time: segments, limits, input, statuses."""

import dataclasses
import math

import pytest
from fleet_script import PUSH, log, run, scripted

from pgf_jax.fleet import Fleet, FleetConfig, TaskRecord
from pgf_jax.fleet.stub import StubRobots, drive, outcome


def test_two_tasks_without_help():
    # Iteration 0 1.5 s, an iteration 3 s, the final check 1.5 s, the reach 3 s.
    fleet, robots = run({(0, 0): "f", (0, 1): ". . f"}, tasks=2, policy="autonomous")
    assert log(fleet) == [
        "0 task_start r0.0",
        "1.5 iteration r0.0 i0 feasible",
        "6 execution_end r0.0 reach",
        "6 task_end r0.0 solved",
        "6 task_start r0.1",
        "7.5 iteration r0.1 i0",
        "10.5 iteration r0.1 i1",
        "13.5 iteration r0.1 i2 feasible",
        "18 execution_end r0.1 reach",
        "18 task_end r0.1 solved",
    ]
    assert robots.calls == [("begin", 0, 0), ("begin", 0, 1)]
    assert [record.planning_time_s for record in fleet.records] == [3.0, 9.0]
    assert [record.execution_s for record in fleet.records] == [3.0, 3.0]
    assert [record.reach_iterations for record in fleet.records] == [0, 2]


def test_a_push_from_bid_to_solution():
    fleet, robots = run({0: ". 5 . f . f"}, inputs={(0, 0, 0): PUSH})
    assert log(fleet) == [
        "0 task_start r0.0",
        "1.5 iteration r0.0 i0",
        "4.5 iteration r0.0 i1 gain=5",
        "4.5 window_open r0.0",
        "4.5 bid r0.0 q0 i1 gain=5",
        "6.5 window_close",
        "6.5 grant r0.0 q0 o0",
        "14.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "16 iteration r0.0 i2 object=3",
        "19 iteration r0.0 i3 object=3 feasible",
        "22 execution_end r0.0 object=3 push",  # a feasible push needs no final check
        "23 retreat_end r0.0 object=3",
        "24.5 iteration r0.0 i4",
        "27.5 iteration r0.0 i5 feasible",
        "32 execution_end r0.0 reach",
        "32 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0), ("start_push", 0, PUSH)]
    assert fleet.records == [
        TaskRecord(
            robot=0,
            task=0,
            status=fleet.records[0].status,
            planning_time_s=4.5 + 2.0 + 4.5 + 4.5 + 1.5,  # reach, window, push, reach, check
            waiting_s=2.0,
            window_wait_s=2.0,
            interaction_s=8.0,
            execution_s=7.0,
            start_ns=0,
            end_ns=32 * 10**9,
            iterations=3,
            reach_iterations=2,
            pushes_planned=1,
            pushes_succeeded=1,
            requests=1,
            answered=1,
            grants=1,
            refusals=0,
            expired=0,
            first_bid=1,
            first_grant=1,
            grants_at=(1,),
            successful_grants_at=(1,),
            asked_cost=(100.0,),
            helped_cost=(10.0,),
            cost=10.0,
            terms=(10.0, 0.0, 0.0),
            non_finite=0,
            non_finite_at=(),
            saturated=0,
        )
    ]
    assert fleet.records[0].status == "solved"


def test_go_on_keeps_the_trajectory_and_bids_again_while_the_reason_lasts():
    fleet, robots = run({0: "s s f"}, policy="or-hitl", service=2.0)
    assert log(fleet, "task_start", "iteration") == [
        "1.5 bid r0.0 q0 i0 gain=inf",
        "1.5 grant r0.0 q0 o0",
        "3.5 service_end r0.0 q0 o0 go_on",
        # No iteration 0: the next one takes 3 s.
        "6.5 bid r0.0 q1 i1 gain=inf",
        "6.5 grant r0.0 q1 o0",
        "8.5 service_end r0.0 q1 o0 go_on",
        "16 execution_end r0.0 reach",
        "16 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0), ("go_on", 0, None), ("go_on", 0, None)]
    assert fleet.records[0].grants_at == (0, 1)
    assert fleet.records[0].successful_grants_at == ()


def test_a_push_that_is_not_feasible_within_its_limit_is_dropped():
    # The push starts at 9.5, its limit is 14.5: iteration 0 ends at 11, iteration 1 at 14, and a
    # third would end at 17. Nothing is bid meanwhile, though stuck and gain say so.
    fleet, robots = run(
        {0: "s s 9 f"}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, push_limit_s=5.0
    )
    assert log(fleet, "task_start") == [
        "1.5 iteration r0.0 i0 stuck",
        "1.5 bid r0.0 q0 i0 gain=inf",
        "1.5 grant r0.0 q0 o0",
        "9.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "11 iteration r0.0 i1 object=3 stuck",
        "14 iteration r0.0 i2 gain=9 object=3",
        "14 push_dropped r0.0 object=3",
        "15.5 iteration r0.0 i3 feasible",  # a new nominal: iteration 0 again
        "20 execution_end r0.0 reach",
        "20 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0), ("start_push", 0, PUSH), ("drop_push", 0, None)]
    record = fleet.records[0]
    assert (record.pushes_planned, record.pushes_succeeded) == (1, 0)
    assert (record.iterations, record.reach_iterations) == (1, 0)
    assert record.successful_grants_at == ()


@pytest.mark.parametrize(("limit", "iterations"), [(5.0, 2), (4.5, 2), (4.4, 1), (1.4, 0)])
def test_a_push_iteration_may_end_at_the_limit_but_not_after_it(limit, iterations):
    fleet, _ = run(
        {0: "s . . . ."},
        policy="or-hitl",
        inputs={(0, 0, 0): PUSH},
        push_limit_s=limit,
        task_limit_s=30.0,
    )
    pushes = [event for event in fleet.events if event.object is not None]
    assert sum(event.kind == "iteration" for event in pushes) == iterations


def test_a_push_has_no_more_time_than_the_task():
    # Served from 1.5 to 9.5; the push's iterations end at 11, 14, 17 and the next would at 20.
    # The task ends at 18: the push is dropped at 17 and the new nominal, till 18.5, does not fit.
    fleet, _ = run({0: "s ."}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, task_limit_s=18.0)
    assert log(fleet)[-3:] == [
        "17 iteration r0.0 i3 object=3",
        "17 push_dropped r0.0 object=3",
        "17 task_end r0.0 timed_out",
    ]
    # With half a second more it fits, and the final check of what it finds runs past the limit.
    fleet, _ = run({0: "s . . . f"}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, task_limit_s=18.5)
    assert log(fleet)[-4:] == [
        "17 push_dropped r0.0 object=3",
        "18.5 iteration r0.0 i4 feasible",
        "23 execution_end r0.0 reach",
        "23 task_end r0.0 solved",
    ]
    assert fleet.records[0].planning_time_s == 1.5 + 7.5 + 1.5 + 1.5


def test_iterations_stop_before_the_task_limit():
    fleet, _ = run({0: "."}, policy="autonomous")
    assert log(fleet)[-1] == "178.5 task_end r0.0 timed_out"
    assert fleet.records[0].reach_iterations == 59
    # One that ends at the limit itself is started.
    fleet, _ = run({0: "."}, policy="autonomous", task_limit_s=10.5)
    assert log(fleet)[-2:] == ["10.5 iteration r0.0 i3", "10.5 task_end r0.0 timed_out"]
    fleet, _ = run({0: "."}, policy="autonomous", task_limit_s=1.0)
    assert log(fleet) == ["0 task_start r0.0", "0 task_end r0.0 timed_out"]
    assert math.isnan(fleet.records[0].cost)


def test_execution_and_retreat_do_not_count_against_the_limit():
    # 1.5 s of planning, 8 s of service, 1.5 s of pushing, then 4 s that do not count: the limit of
    # 18.5 s is at 22.5, so the reach iterations end at 16.5, 19.5 and 22.5.
    fleet, _ = run(
        {0: "s f . . . ."}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, task_limit_s=18.5
    )
    assert log(fleet)[-5:] == [
        "15 retreat_end r0.0 object=3",
        "16.5 iteration r0.0 i2",
        "19.5 iteration r0.0 i3",
        "22.5 iteration r0.0 i4",
        "22.5 task_end r0.0 timed_out",
    ]


@pytest.mark.parametrize(
    ("script", "status"),
    [(". . . s", "stuck"), (". s s .", "timed_out"), (". . . x", "non_finite")],
)
def test_status_of_a_task_that_runs_out_of_time(script, status):
    fleet, _ = run({0: script}, policy="autonomous", task_limit_s=12.0)
    assert fleet.records[0].status == status
    assert fleet.records[0].non_finite == (status == "non_finite")


def test_a_new_segment_is_not_stuck():
    # Stuck, pushed in vain, out of time: the counter restarted with the push and again without it.
    fleet, _ = run({0: "s s"}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, task_limit_s=14.0)
    assert log(fleet)[-1] == "14 task_end r0.0 timed_out"


def test_a_pushs_cost_is_not_the_tasks():
    fleet, _ = run({0: "s x"}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, task_limit_s=14.0)
    record = fleet.records[0]
    assert (record.status, record.cost, record.non_finite) == ("timed_out", 100.0, 2)


def test_which_iterations_broke_is_counted_over_the_task():
    # Reaching: 0 and 1. Asked, and pushing till the push is dropped: 2 and 3. Reaching: 4, 5, 6.
    fleet, _ = run(
        {0: "x s x w x w f"}, policy="or-hitl", inputs={(0, 0, 0): PUSH}, push_limit_s=5.0
    )
    assert [line for line in log(fleet) if "iteration" not in line][3:] == [
        "12.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "17 push_dropped r0.0 object=3",
        "29 execution_end r0.0 reach",
        "29 task_end r0.0 solved",
    ]
    record = fleet.records[0]
    assert (record.non_finite, record.non_finite_at, record.saturated) == (3, (0, 2, 4), 6)


def test_a_robot_without_time_for_an_iteration_does_not_ask():
    fleet, _ = run({0: ". . s"}, policy="or-hitl", task_limit_s=10.0)
    assert log(fleet)[-2:] == ["7.5 iteration r0.0 i2 stuck", "7.5 task_end r0.0 stuck"]
    fleet, _ = run({0: ". . s"}, policy="or-hitl", task_limit_s=10.5)
    assert log(fleet)[4] == "7.5 bid r0.0 q0 i2 gain=inf"


def test_feasibility_is_tested_before_anything_is_asked():
    result = dataclasses.replace(outcome(feasible=True), stuck=True, gain=50.0)
    for policy in ("pgf", "or-hitl", "queue", "random", "classifier"):
        robots = StubRobots(lambda work: result)
        fleet = Fleet(FleetConfig(tasks=1, policy=policy), robots)
        drive([(fleet, robots)])
        assert fleet.records[0].requests == 0
        assert fleet.records[0].status == "solved"


def test_always_asks_once_before_planning_and_waits_in_line():
    # Robot 1's input is a push, planned before any reaching.
    fleet, robots = run({0: "s f", 1: "f f"}, robots=2, policy="always", inputs={(1, 0, 0): PUSH})
    assert log(fleet) == [
        "0 task_start r0.0",
        "0 bid r0.0 q0 gain=inf",
        "0 grant r0.0 q0 o0",
        "0 task_start r1.0",
        "0 bid r1.0 q0 gain=inf",
        "8 service_end r0.0 q0 o0 go_on",
        "8 grant r1.0 q0 o0",
        "9.5 iteration r0.0 i0 stuck",
        "12.5 iteration r0.0 i1 feasible",
        "16 service_end r1.0 q0 o0 object=3 to=(0.4,0.1) push",
        "17 execution_end r0.0 reach",
        "17 task_end r0.0 solved",
        "17.5 iteration r1.0 i0 object=3 feasible",
        "20.5 execution_end r1.0 object=3 push",
        "21.5 retreat_end r1.0 object=3",
        "23 iteration r1.0 i1 feasible",
        "27.5 execution_end r1.0 reach",
        "27.5 task_end r1.0 solved",
    ]
    # "Go on" before any planning has nothing to keep: no call, and iteration 0 comes first.
    assert ("go_on", 0, None) not in robots.calls
    second = fleet.records[1]
    assert (second.waiting_s, second.window_wait_s, second.interaction_s) == (8.0, 0.0, 8.0)
    assert second.planning_time_s == 1.5 + 1.5 + 1.5  # not the wait in line


# -- checks with outcomes, and reaches that miss -----------------------------------------------


def test_two_checks_miss_and_the_third_passes():
    # Iterations end at 1.5 and 4.5; each check takes 1.5 s, the reach 3 s.
    fleet, robots = run({0: ". f"}, policy="autonomous", checks={(0, 1): ". . p"})
    assert log(fleet) == [
        "0 task_start r0.0",
        "1.5 iteration r0.0 i0",
        "4.5 iteration r0.0 i1 feasible",
        "6 check r0.0 i1 missed",
        "7.5 check r0.0 i1 missed",
        "9 check r0.0 i1 passed",
        "12 execution_end r0.0 reach",
        "12 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0)]
    record = fleet.records[0]
    assert (record.checks, record.check_misses, record.attempts) == (3, 2, 1)
    assert (record.iterations, record.reach_iterations) == (1, 1)
    assert (record.planning_time_s, record.execution_s) == (9.0, 3.0)
    assert record.first_attempt and record.grasp_misses == 0
    assert record.cost == 10.0  # of the one that passed


def test_after_the_last_miss_planning_goes_on():
    # Nothing restarts: the next iteration takes 3 s and is the next of its segment.
    fleet, _ = run({0: "f f"}, policy="autonomous", checks={(0, 0): "w ."})
    assert log(fleet)[1:] == [
        "1.5 iteration r0.0 i0 feasible",
        "3 check r0.0 i0 missed",
        "4.5 check r0.0 i0 missed",
        "7.5 iteration r0.0 i1 feasible",
        "9 check r0.0 i1 passed",
        "12 execution_end r0.0 reach",
        "12 task_end r0.0 solved",
    ]
    # What a check says of its iteration's rollouts was counted when the iteration ended.
    assert fleet.records[0].saturated == 0
    assert (fleet.records[0].checks, fleet.records[0].check_misses) == (3, 2)


@pytest.mark.parametrize(
    ("limit", "end"),
    [
        # The iteration ends at 4.5, the checks at 6 and 7.5. No limit stops the first one.
        (4.5, "6 task_end r0.0 stuck"),
        (7.4, "6 task_end r0.0 stuck"),
        (7.5, "10.5 task_end r0.0 solved"),
    ],
)
def test_a_second_check_must_end_by_the_limit(limit, end):
    fleet, _ = run({0: ". f"}, policy="autonomous", checks={(0, 1): "s p"}, task_limit_s=limit)
    assert log(fleet)[3] == "6 check r0.0 i1 missed"
    assert log(fleet)[-1] == end
    solved = end.endswith("solved")
    record = fleet.records[0]
    assert (record.checks, record.check_misses, record.attempts) == (1 + solved, 1, int(solved))
    assert record.cost == (10.0 if solved else 100.0)


def test_a_slow_computer_slows_every_check():
    # Twice as slow: 3 s, then 3 s a check; the second ends at 9, past the limit of 8.
    fleet, _ = run(
        {0: "f"}, policy="autonomous", checks={(0, 0): ". p"}, speeds=(2.0,), task_limit_s=8.0
    )
    assert log(fleet)[1:] == [
        "3 iteration r0.0 i0 feasible",
        "6 check r0.0 i0 missed",
        "6 task_end r0.0 timed_out",
    ]


def test_a_last_miss_that_leaves_no_time_ends_the_task_unasked():
    # At 3 an iteration would end at 6, past 5.9: the robot does not ask although it is stuck.
    fleet, _ = run({0: "f"}, policy="or-hitl", checks={(0, 0): "s"}, task_limit_s=5.9)
    assert log(fleet)[2:] == ["3 check r0.0 i0 missed", "3 task_end r0.0 stuck"]
    fleet, _ = run({0: "f f"}, policy="or-hitl", checks={(0, 0): "s"}, task_limit_s=6.0)
    assert log(fleet)[3] == "3 bid r0.0 q0 i0 gain=inf"


def test_the_last_miss_makes_the_robot_stuck_and_it_bids_at_that_instant():
    fleet, robots = run({0: "f f"}, policy="or-hitl", checks={(0, 0): ". s"})
    assert log(fleet) == [
        "0 task_start r0.0",
        "1.5 iteration r0.0 i0 feasible",
        "3 check r0.0 i0 missed",
        "4.5 check r0.0 i0 missed",
        "4.5 bid r0.0 q0 i0 gain=inf",
        "4.5 grant r0.0 q0 o0",
        "12.5 service_end r0.0 q0 o0 go_on",
        "15.5 iteration r0.0 i1 feasible",
        "17 check r0.0 i1 passed",
        "20 execution_end r0.0 reach",
        "20 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0), ("go_on", 0, None)]
    record = fleet.records[0]
    # The cost at the answer is what the last check left, and not that of what it refuted.
    assert (record.asked_cost, record.helped_cost) == ((100.0,), (10.0,))
    assert (record.first_bid, record.grants_at) == (0, (0,))
    assert record.planning_time_s == 1.5 + 3.0 + 3.0 + 1.5


def test_after_the_last_miss_a_robot_bids_the_gain_of_then():
    fleet, _ = run({0: "f f"}, policy="pgf", checks={(0, 0): "9 5"}, inputs={(0, 0, 0): PUSH})
    assert log(fleet)[2:10] == [
        "3 check r0.0 i0 gain=9 missed",
        "4.5 check r0.0 i0 gain=5 missed",
        "4.5 window_open r0.0",
        "4.5 bid r0.0 q0 i0 gain=5",
        "6.5 window_close",
        "6.5 grant r0.0 q0 o0",
        "14.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "16 iteration r0.0 i1 object=3 feasible",  # a push is executed unchecked
    ]
    assert log(fleet)[10:12] == [
        "19 execution_end r0.0 object=3 push",
        "20 retreat_end r0.0 object=3",
    ]


def test_a_grasp_that_misses():
    # The first reach is executed after two iterations; the hand retracts in 1 s and plans again.
    fleet, robots = run({0: ". f . f"}, policy="autonomous", checks={}, missed={(0, 2)})
    assert log(fleet) == [
        "0 task_start r0.0",
        "1.5 iteration r0.0 i0",
        "4.5 iteration r0.0 i1 feasible",
        "6 check r0.0 i1 passed",
        "9 execution_end r0.0 missed",
        "10 retreat_end r0.0",
        "11.5 iteration r0.0 i2",  # a new segment: iteration 0
        "14.5 iteration r0.0 i3 feasible",
        "16 check r0.0 i3 passed",
        "19 execution_end r0.0 reach",
        "19 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0)]
    record = fleet.records[0]
    assert (record.checks, record.check_misses, record.attempts) == (2, 0, 2)
    assert not record.first_attempt and record.grasp_misses == 1
    assert record.planning_time_s == 4.5 + 1.5 + 4.5 + 1.5
    assert record.execution_s == 3.0 + 1.0 + 3.0


def test_a_grasp_may_miss_where_checks_have_no_outcome():
    fleet, _ = run({0: "f f"}, policy="autonomous", missed={(0, 1)})
    assert log(fleet)[1:] == [
        "1.5 iteration r0.0 i0 feasible",
        "6 execution_end r0.0 missed",
        "7 retreat_end r0.0",
        "8.5 iteration r0.0 i1 feasible",
        "13 execution_end r0.0 reach",
        "13 task_end r0.0 solved",
    ]
    record = fleet.records[0]
    assert (record.checks, record.check_misses, record.attempts) == (None, None, 2)


@pytest.mark.parametrize(
    ("limit", "end"),
    [
        # The check ends at 3, the reach misses at 6, the hand is back at 7: the limit moves by 4 s.
        # Iterations end at 8.5 and 11.5.
        (7.5, ["11.5 iteration r0.0 i2", "11.5 task_end r0.0 timed_out"]),
        (7.4, ["8.5 iteration r0.0 i1", "8.5 task_end r0.0 timed_out"]),
        (4.4, ["7 retreat_end r0.0", "7 task_end r0.0 timed_out"]),
    ],
)
def test_a_missed_grasp_does_not_count_against_the_limit(limit, end):
    fleet, _ = run(
        {0: "f . ."}, policy="autonomous", checks={}, missed={(0, 1)}, task_limit_s=limit
    )
    assert log(fleet)[3:5] == ["6 execution_end r0.0 missed", "7 retreat_end r0.0"]
    assert log(fleet)[-2:] == end


def test_a_new_segment_after_a_missed_grasp_is_not_stuck():
    fleet, _ = run({0: "f"}, policy="autonomous", checks={(0, 0): "s p"}, missed={(0, 1)},
                   task_limit_s=4.6)  # fmt: skip
    assert log(fleet)[-2:] == ["8.5 retreat_end r0.0", "8.5 task_end r0.0 timed_out"]


@pytest.mark.parametrize("horizon", [4.0, 8.0, 9.5])
def test_the_horizon_cuts_checks_reaches_and_retreats_off(horizon):
    # The check ends at 6, the reach misses at 9, the hand is back at 10.
    fleet, _ = run({0: ". f"}, policy="autonomous", checks={}, missed={(0, 2)}, horizon_s=horizon)
    assert log(fleet)[-1] == f"{horizon:g} task_end r0.0 censored"
    record = fleet.records[0]
    assert (record.checks, record.attempts) == ((0, 0) if horizon < 6 else (1, 1))
    assert record.execution_s == max(0.0, horizon - 6.0)


def test_work_is_asked_for_once_and_in_this_order():
    robots = scripted({0: ". f . f"}, checks={(0, 1): ". p"}, missed={(0, 2)})
    fleet, asked = Fleet(FleetConfig(tasks=1, policy="autonomous"), robots), []
    while not fleet.done:
        for work in fleet.advance():
            asked.append((str(work.kind), work.iteration, work.check))
            fleet.deliver(work, robots.compute(work))
    assert asked == [
        ("iteration", 0, None),
        ("iteration", 1, None),
        ("check", 1, 0),
        ("check", 1, 1),
        ("reach", 2, None),
        ("retreat", 2, None),
        ("iteration", 2, None),
        ("iteration", 3, None),
        ("check", 3, 0),
        ("reach", 4, None),
    ]


def test_without_outcomes_nothing_is_counted():
    fleet, _ = run({0: "f"}, policy="autonomous")
    record = fleet.records[0]
    assert (record.checks, record.check_misses, record.attempts) == (None, None, None)
    assert not record.first_attempt and record.grasp_misses is None
