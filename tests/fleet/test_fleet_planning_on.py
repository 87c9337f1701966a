"""Robots that plan while they ask and are served, worked out by hand.

Iteration 0 takes 1.5 s, an iteration 3 s, a check 1.5 s, the execution of a reach 3 s.
"""

from typing import Any

import pytest
from fleet_script import PUSH, Constant, log, run, scripted

from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet, FleetConfig
from pgf_jax.fleet.simulator import Attendance
from pgf_jax.fleet.stub import drive
from pgf_jax.metrics.identities import verify
from pgf_jax.metrics.summary import busy_ns

S = 10**9
PLANNING = ("task_start", "iteration", "execution_end", "retreat_end", "window_open")
ALONE = "or-hitl+plan"
PLANS: Any = {"while_asking": "plan", "while_served": "plan"}


def checked(*args, **settings) -> Fleet:
    """Run a fleet, whose identities hold."""
    fleet, _ = run(*args, **settings)
    verify(fleet.config, fleet.records, fleet.events)
    return fleet


def test_a_robot_that_finds_its_way_while_it_is_served_frees_the_operator():
    fleet = checked({0: ". s f"}, policy=ALONE, service=20.0)
    assert log(fleet) == [
        "0 task_start r0.0",
        "1.5 iteration r0.0 i0",
        "4.5 iteration r0.0 i1 stuck",
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 grant r0.0 q0 o0",
        "7.5 iteration r0.0 i2 feasible",
        "9 service_end r0.0 q0 o0 solved_meanwhile",  # when the check has passed, not before
        "12 execution_end r0.0 reach",
        "12 task_end r0.0 solved",
    ]
    (record,) = fleet.records
    assert (record.planning_time_s, record.waiting_s, record.interaction_s) == (9.0, 0.0, 0.0)
    assert (record.asking_s, record.served_s, record.lost_s) == (0.0, 4.5, 0.0)
    assert (record.withdrawn, record.expired, record.answered) == (1, 0, 0)
    assert busy_ns(fleet.events) == 4.5 * S  # the operator's time that was lost


def test_a_push_breaks_the_iteration_off_and_takes_its_number():
    fleet = checked({0: ". s . . . f f"}, policy=ALONE, inputs={(0, 0, 0): PUSH}, service=4.0)
    assert log(fleet, "task_start") == [
        "1.5 iteration r0.0 i0",
        "4.5 iteration r0.0 i1 stuck",
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 grant r0.0 q0 o0",
        "7.5 iteration r0.0 i2",
        "8.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "10 iteration r0.0 i3 object=3",
        "13 iteration r0.0 i4 object=3",
        "16 iteration r0.0 i5 object=3 feasible",
        "19 execution_end r0.0 object=3 push",
        "20 retreat_end r0.0 object=3",
        "21.5 iteration r0.0 i6 feasible",
        "26 execution_end r0.0 reach",
        "26 task_end r0.0 solved",
    ]
    (record,) = fleet.records
    assert (record.lost_s, record.served_s, record.iterations) == (1.0, 4.0, 4)


def test_go_on_takes_nothing_from_the_iteration_under_way():
    """The counter is cleared when that iteration ends, so that the robot does not ask at once."""
    fleet = checked({0: ". s s s s f"}, policy=ALONE, service=4.0)
    assert log(fleet, *PLANNING) == [
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 grant r0.0 q0 o0",
        "8.5 service_end r0.0 q0 o0 go_on",  # within iteration 3, which ends stuck at 10.5
        "13.5 bid r0.0 q1 i4 gain=inf",
        "13.5 grant r0.0 q1 o0",
        "17.5 service_end r0.0 q1 o0 go_on",  # within the check of iteration 5, which passes at 18
        "21 task_end r0.0 solved",
    ]
    assert fleet.records[0].lost_s == 0.0


def test_a_push_that_fails_gives_back_the_search_as_it_was():
    """Not with a nominal: after it comes an iteration of 3 s, and no iteration 0."""
    told: Any = {"inputs": {(0, 0, 0): PUSH}, "service": 4.5, "push_limit_s": 5.0}
    fleet, robots = run({0: ". s . . . f"}, policy=ALONE, **told)
    assert log(fleet, "task_start", "bid", "grant") == [
        "1.5 iteration r0.0 i0",
        "4.5 iteration r0.0 i1 stuck",
        "7.5 iteration r0.0 i2",
        "9 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "10.5 iteration r0.0 i3 object=3",
        "13.5 iteration r0.0 i4 object=3",
        "13.5 push_dropped r0.0 object=3",
        "16.5 iteration r0.0 i5 feasible",
        "21 execution_end r0.0 reach",
        "21 task_end r0.0 solved",
    ]
    assert robots.calls == [("begin", 0, 0), ("start_push", 0, PUSH), ("drop_push", 0, None)]
    assert fleet.records[0].reach_iterations == 3


# -- equal instants ------------------------------------------------------------------------------


def test_solved_when_the_window_closes_is_not_granted():
    """Its check passes at 9, before the window that closes then; the other one wins."""
    fleet = checked(
        {0: ". 9 f", 1: ". 5 . . . f"},
        robots=2,
        policy="pgf+plan",
        inputs={(1, 0, 0): PUSH},
        window_s=4.5,
    )
    assert log(fleet, *PLANNING)[:5] == [
        "4.5 bid r0.0 q0 i1 gain=9",
        "4.5 bid r1.0 q0 i1 gain=5",
        "9 expired r0.0 q0 solved_meanwhile",
        "9 window_close",
        "9 grant r1.0 q0 o0",
    ]
    solved, helped = fleet.records
    assert (solved.asking_s, solved.served_s, solved.withdrawn) == (4.5, 0.0, 1)
    assert (helped.asking_s, helped.served_s, helped.lost_s) == (4.5, 8.0, 0.5)


def test_solved_when_the_answer_comes_is_solved():
    """Limit, end of the iteration or check, end of the service: in this order."""
    fleet = checked({0: ". s f"}, policy=ALONE, service=4.5, inputs={(0, 0, 0): PUSH})
    assert log(fleet, *PLANNING)[-2:] == [
        "9 service_end r0.0 q0 o0 solved_meanwhile",
        "12 task_end r0.0 solved",
    ]


def test_an_answer_at_the_end_of_an_iteration_sees_none_to_break_off():
    fleet = checked({0: ". s . . f f"}, policy=ALONE, service=3.0, inputs={(0, 0, 0): PUSH})
    assert log(fleet, "bid", "grant", "task_start")[2:5] == [
        "7.5 iteration r0.0 i2",
        "7.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "9 iteration r0.0 i3 object=3",
    ]
    assert fleet.records[0].lost_s == 0.0


def test_the_limit_ends_the_request_with_the_task():
    fleet = checked({0: ". s ."}, policy=ALONE, service=100.0, task_limit_s=12.0)
    assert log(fleet, *PLANNING)[-2:] == [
        "10.5 service_end r0.0 q0 o0 expired",  # no iteration fits any more
        "10.5 task_end r0.0 timed_out",
    ]
    assert fleet.records[0].expired == 1


def test_a_check_may_run_past_the_limit_but_no_request_does():
    fleet = checked({0: ". s f"}, policy=ALONE, service=100.0, task_limit_s=8.0)
    assert log(fleet, *PLANNING)[-2:] == [
        "8 service_end r0.0 q0 o0 expired",
        "12 task_end r0.0 solved",  # its check ended at 9
    ]


def test_the_horizon_cuts_the_request_off():
    fleet = checked({0: ". s ."}, policy=ALONE, service=100.0, horizon_s=8.0)
    assert log(fleet, *PLANNING)[-2:] == [
        "8 service_end r0.0 q0 o0 censored",
        "8 task_end r0.0 censored",
    ]
    assert fleet.records[0].withdrawn == fleet.records[0].expired == 0


# -- checks, operators ---------------------------------------------------------------------------


def test_a_check_that_fails_leaves_the_request_as_it_stands():
    fleet = checked({0: ". s f . f"}, checks={(0, 2): "s"}, policy=ALONE, service=30.0)
    assert log(fleet, "task_start", "execution_end")[2:] == [
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 grant r0.0 q0 o0",
        "7.5 iteration r0.0 i2 feasible",
        "9 check r0.0 i2 missed",
        "12 iteration r0.0 i3",
        "15 iteration r0.0 i4 feasible",
        "16.5 check r0.0 i4 passed",
        "16.5 service_end r0.0 q0 o0 solved_meanwhile",
        "19.5 task_end r0.0 solved",
    ]


def test_whoever_is_freed_turns_to_who_waits_in_line():
    """Two operators, three robots in line; robot 0 finds its way, and robot 2 is next."""
    script = {0: ". s f", 1: ". s . . . . f", 2: ". s . . . f"}
    fleet = checked(script, robots=3, operators=2, policy="queue", service=20.0, **PLANS)
    assert log(fleet, *PLANNING) == [
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 grant r0.0 q0 o0",
        "4.5 bid r1.0 q0 i1 gain=inf",
        "4.5 grant r1.0 q0 o1",
        "4.5 bid r2.0 q0 i1 gain=inf",
        "9 service_end r0.0 q0 o0 solved_meanwhile",
        "9 grant r2.0 q0 o0",
        "12 task_end r0.0 solved",
        "18 service_end r2.0 q0 o0 solved_meanwhile",
        "21 task_end r2.0 solved",
        "21 service_end r1.0 q0 o1 solved_meanwhile",
        "24 task_end r1.0 solved",
    ]


def test_an_operator_who_leaves_is_given_nobody_else():
    robots = scripted({0: ". s f", 1: ". s . . . f"})
    config = FleetConfig(robots=2, tasks=1, policy="queue", **PLANS)
    away = [Attendance(6 * S, 0, False), Attendance(15 * S, 0, True)]
    fleet = Fleet(config, robots, service=Constant(20.0), attendance=away)
    drive([(fleet, robots)])
    verify(config, fleet.records, fleet.events)
    assert log(fleet, *PLANNING)[3:] == [
        "6 operator_away o0",
        "9 service_end r0.0 q0 o0 solved_meanwhile",
        "12 task_end r0.0 solved",
        "15 operator_back o0",
        "15 grant r1.0 q0 o0",
        "18 service_end r1.0 q0 o0 solved_meanwhile",
        "21 task_end r1.0 solved",
    ]


# -- one of the two ------------------------------------------------------------------------------


def test_planning_while_asking_alone_stops_at_the_grant():
    """Iteration 2 is broken off at 6.5, and its number is used again at 14.5."""
    fleet = checked({0: ". 5 f"}, policy="pgf", while_asking="plan")
    assert log(fleet, "task_start", "window_open")[2:] == [
        "4.5 bid r0.0 q0 i1 gain=5",
        "6.5 window_close",
        "6.5 grant r0.0 q0 o0",
        "14.5 service_end r0.0 q0 o0 go_on",
        "17.5 iteration r0.0 i2 feasible",
        "22 execution_end r0.0 reach",
        "22 task_end r0.0 solved",
    ]
    (record,) = fleet.records
    assert (record.planning_time_s, record.interaction_s, record.lost_s) == (11.0, 8.0, 2.0)


def test_a_check_that_the_grant_breaks_off_is_made_again():
    fleet = checked({0: ". 5 f"}, checks={}, policy="pgf", while_asking="plan", window_s=4.0)
    assert log(fleet, "task_start", "window_open", "bid")[2:] == [
        "7.5 iteration r0.0 i2 feasible",
        "8.5 window_close",
        "8.5 grant r0.0 q0 o0",
        "16.5 service_end r0.0 q0 o0 go_on",
        "18 check r0.0 i2 passed",
        "21 execution_end r0.0 reach",
        "21 task_end r0.0 solved",
    ]


def test_a_push_after_a_check_that_was_broken_off_is_planned():
    given: Any = {"inputs": {(0, 0, 0): PUSH}, "while_asking": "plan", "window_s": 4.0}
    fleet = checked({0: ". 5 f f f"}, checks={}, policy="pgf", **given)
    assert log(fleet, "task_start", "window_open", "bid")[5:7] == [
        "16.5 service_end r0.0 q0 o0 object=3 to=(0.4,0.1) push",
        "18 iteration r0.0 i3 object=3 feasible",
    ]


def test_planning_while_served_alone_stands_still_in_the_window():
    fleet = checked({0: ". 5 f"}, policy="pgf", while_served="plan")
    assert log(fleet, "task_start", "window_open")[2:] == [
        "4.5 bid r0.0 q0 i1 gain=5",
        "6.5 window_close",
        "6.5 grant r0.0 q0 o0",
        "9.5 iteration r0.0 i2 feasible",
        "11 service_end r0.0 q0 o0 solved_meanwhile",
        "14 execution_end r0.0 reach",
        "14 task_end r0.0 solved",
    ]
    assert (fleet.records[0].waiting_s, fleet.records[0].asking_s) == (2.0, 2.0)


def test_settings_go_before_the_policy_s_own():
    told: Any = {"inputs": {(0, 0, 0): PUSH}}
    wait: Any = {"while_asking": "wait", "while_served": "wait"}
    for paper, variant in (("pgf", "pgf+plan"), ("or-hitl", ALONE)):
        stands, _ = run({0: ". 5 s f f f"}, policy=variant, **wait, **told)
        usual, _ = run({0: ". 5 s f f f"}, policy=paper, **told)
        assert stands.events == usual.events and stands.records == usual.records
        plans, _ = run({0: ". 5 s f f f"}, policy=paper, **PLANS, **told)
        other, _ = run({0: ". 5 s f f f"}, policy=variant, **told)
        assert plans.events == other.events != usual.events


def test_a_wrong_word_is_one_line():
    with pytest.raises(BadInput, match="while_asking: expected one of wait, plan, got 'stop'"):
        FleetConfig(while_asking="stop")  # pyright: ignore[reportArgumentType]
