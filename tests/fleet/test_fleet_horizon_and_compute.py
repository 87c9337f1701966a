"""Cases worked out by hand: the horizon, and computers shared by robots."""

from fleet_script import log, run

from pgf_jax.fleet import EventKind, Fleet, FleetConfig
from pgf_jax.fleet.stub import StubRobots, outcome


def test_horizon_cuts_off_what_runs_and_starts_no_new_task():
    # Horizon 6. Robot 0 finishes its reach at 6, in time, and takes no further task. Robot 1 is
    # served from 1.5 on, robot 2 waits in line, robot 3 iterates, robot 4 executes from 4.5 on.
    fleet, _ = run(
        {0: "f", 1: "s", 2: "s", 3: ".", 4: "f"},
        robots=5,
        tasks=9,
        policy="queue",
        horizon_s=6.0,
        speeds=(1.0, 1.0, 1.0, 1.0, 1.5),
    )
    assert [line for line in log(fleet) if line.startswith("6 ")] == [
        "6 execution_end r0.0 reach",
        "6 task_end r0.0 solved",
        "6 service_end r1.0 q0 o0 censored",
        "6 task_end r1.0 censored",
        "6 expired r2.0 q0 censored",
        "6 task_end r2.0 censored",
        "6 task_end r3.0 censored",
        "6 task_end r4.0 censored",
    ]
    by_robot = sorted(fleet.records, key=lambda record: record.robot)
    assert [record.interaction_s for record in by_robot] == [0.0, 4.5, 0.0, 0.0, 0.0]
    assert [record.waiting_s for record in by_robot] == [0.0, 0.0, 4.5, 0.0, 0.0]
    assert [record.planning_time_s for record in by_robot] == [3.0, 1.5, 1.5, 6.0, 4.5]
    assert [record.execution_s for record in by_robot] == [3.0, 0.0, 0.0, 0.0, 1.5]
    assert by_robot[3].reach_iterations == 1  # ended; the one cut off at 6 does not count
    assert by_robot[2].expired == 0


def test_horizon_asks_for_no_work_that_cannot_be_needed():
    robots = StubRobots(lambda work: outcome())
    fleet = Fleet(FleetConfig(tasks=1, policy="autonomous", horizon_s=4.0), robots)
    first = fleet.advance()
    assert [work.iteration for work in first] == [0]
    fleet.deliver(first[0], outcome())
    assert fleet.advance() == []  # iteration 1 would end at 4.5
    assert fleet.done


def test_shared_computer_stretches_iterations_by_the_robots_that_plan_at_their_start():
    # C = 8 cores, 8 rollouts a robot: A robots planning take A times as long. Robot 0's iteration 0
    # takes 3 s (A = 2) and its check 3 s more; robot 1's iteration 1 starts at 3 (A = 2), takes 6 s
    # and keeps that although robot 0 executes from 6 on; its next, from 9 on, has A = 1 until
    # robot 0's next task starts at 9 as well: A = 2 for both, 6 s and 3 s.
    fleet, _ = run(
        {(0, 0): "f", (0, 1): ". f", (1, 0): ". . . f", (1, 1): "f"},
        robots=2,
        tasks=2,
        policy="autonomous",
        compute="shared:8",
    )
    assert log(fleet, "task_start")[:9] == [
        "3 iteration r0.0 i0 feasible",
        "3 iteration r1.0 i0",
        "9 execution_end r0.0 reach",
        "9 task_end r0.0 solved",
        "9 iteration r1.0 i1",
        "12 iteration r0.1 i0",
        "15 iteration r1.0 i2",
        "18 iteration r0.1 i1 feasible",
        "21 iteration r1.0 i3 feasible",
    ]


def test_shared_computer_counts_neither_waiting_nor_served_nor_executing_robots():
    # Robot 0 is served from 3 to 11 (A = 2 at the start only): robot 1 has the computer alone.
    fleet, _ = run({0: "s f", 1: ". . . f"}, robots=2, policy="or-hitl", compute="shared:8")
    times = [
        event.time_ns / 1e9
        for event in fleet.events
        if event.kind is EventKind.ITERATION and event.robot == 1
    ]
    assert times == [3.0, 6.0, 9.0, 12.0]


def test_shared_computer_can_run_a_task_out_of_time():
    # Two robots on half a computer each: an iteration takes 6 s, which does not fit before 8 s,
    # although 3 s would.
    fleet, _ = run(
        {0: ".", 1: "."}, robots=2, policy="autonomous", compute="shared:8", task_limit_s=8.0
    )
    assert log(fleet)[-2:] == ["3 task_end r0.0 timed_out", "3 task_end r1.0 timed_out"]
