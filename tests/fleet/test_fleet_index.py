"""The discipline `index`: free operators take the robots of highest index."""

import dataclasses
import math
import random
from typing import Any

import pytest
from fleet_script import PUSH, log, run
from hypothesis import given, settings
from hypothesis import strategies as st
from random_fleets import CONFIGS, noisy_robots, simulate
from registered import registered

import pgf_jax
from pgf_jax.errors import BadInput
from pgf_jax.fleet import EventKind, Fleet, Work
from pgf_jax.fleet.policies import POLICIES
from pgf_jax.fleet.stub import StubRobots
from pgf_jax.metrics.identities import verify

QUIET = ("task_start", "iteration", "execution_end", "retreat_end", "task_end")


class LongestUnhelped(pgf_jax.PolicyBase):
    """Who has been without help for longest is served first, from 4 s on."""

    discipline = "index"
    plans_on = True

    def index(self, robots):
        return [robot.unhelped_s if robot.unhelped_s >= 4.0 else None for robot in robots]


class HighestGain(pgf_jax.PolicyBase):
    discipline = "index"
    plans_on = True

    def index(self, robots):
        return [r.result.gain if r.result.gain > 1.0 else None for r in robots]


@pytest.fixture(autouse=True)
def policies():
    with registered(
        POLICIES,
        **{"longest": lambda config: LongestUnhelped(), "highest": lambda config: HighestGain()},
    ):
        yield


def checked(*args, **settings) -> Fleet:
    fleet, _ = run(*args, **settings)
    verify(fleet.config, fleet.records, fleet.events)
    return fleet


def test_the_highest_index_is_served_as_soon_as_an_operator_is_free():
    """No window: at 4.5 robot 1; at 8.5, in the midst of iterations, robot 0 by its last one."""
    script = {0: ". 5 3 . f", 1: ". 9 8 . . f", 2: ". 2 2 2 f"}
    fleet = checked(script, robots=3, policy="highest", service=4.0)
    assert log(fleet, *QUIET)[:6] == [
        "4.5 bid r1.0 q0 i1 gain=9",
        "4.5 grant r1.0 q0 o0",
        "8.5 service_end r1.0 q0 o0 go_on",
        # Not robot 1 again, which has not iterated since; robot 0 bids what it has now.
        "8.5 bid r0.0 q0 i2 gain=3",
        "8.5 grant r0.0 q0 o0",
        "12.5 service_end r0.0 q0 o0 go_on",
    ]
    assert all(record.waiting_s == record.asking_s == 0.0 for record in fleet.records)


def test_two_operators_take_the_two_highest():
    fleet = checked(
        {0: ". 5 f", 1: ". 9 f", 2: ". 7 f"}, robots=3, operators=2, policy="highest", service=20.0
    )
    assert log(fleet, *QUIET)[:6] == [
        "4.5 bid r1.0 q0 i1 gain=9",
        "4.5 grant r1.0 q0 o0",
        "4.5 bid r2.0 q0 i1 gain=7",
        "4.5 grant r2.0 q0 o1",
        "9 service_end r1.0 q0 o0 solved_meanwhile",
        "9 service_end r2.0 q0 o1 solved_meanwhile",
    ]


def test_who_checks_or_pushes_or_is_below_the_reservation_value_is_not_ranked():
    """Robot 0 checks from 7.5 on, robot 1 pushes, robot 2 gains too little."""
    script = {0: ". 9 f", 1: ". 99 . . . f", 2: ". 0.5 f"}
    fleet = checked(
        script, robots=3, policy="highest", service=3.0, inputs={(1, 0, 0): PUSH}, tasks=1
    )
    assert log(fleet, *QUIET) == [
        "4.5 bid r1.0 q0 i1 gain=99",
        "4.5 grant r1.0 q0 o0",
        "7.5 service_end r1.0 q0 o0 object=3 to=(0.4,0.1) push",
    ]


def test_a_policy_in_ten_lines_that_sees_the_whole_fleet():
    script = {0: ". . . . . . f", 1: ". . . . . . f"}
    fleet = checked(script, robots=2, policy="longest", service=3.0)
    served = [event.robot for event in fleet.events if event.kind is EventKind.GRANT]
    assert served[:4] in ([0, 1, 0, 1], [1, 0, 1, 0])


def test_waiting_while_served_is_possible_too():
    fleet = checked({0: ". 5 f"}, policy="highest", service=8.0, while_served="wait")
    assert log(fleet, "task_start")[2:] == [
        "4.5 bid r0.0 q0 i1 gain=5",
        "4.5 grant r0.0 q0 o0",
        "12.5 service_end r0.0 q0 o0 go_on",
        "15.5 iteration r0.0 i2 feasible",
        "20 execution_end r0.0 reach",
        "20 task_end r0.0 solved",
    ]


def test_ties_are_broken_by_a_key_of_the_seed_and_the_decision():
    def first(robots: int, seed: int) -> Any:
        script = dict.fromkeys(range(robots), ". 5 5 5 f")
        fleet = checked(script, robots=robots, policy="highest", seed=seed)
        return next(event.robot for event in fleet.events if event.kind is EventKind.GRANT)

    winners = [first(4, seed) for seed in range(12)]
    assert len(set(winners)) > 1 and winners == [first(4, seed) for seed in range(12)]


@settings(max_examples=60, deadline=None)
@given(
    config=CONFIGS,
    name=st.sampled_from(["longest", "highest"]),
    seed=st.integers(0, 1000),
    order=st.integers(0, 10**6).map(random.Random),
)
def test_identities_hold_and_results_do_not_depend_on_batching(config, name, seed, order):
    config = dataclasses.replace(config, policy=name)
    alone, _ = simulate(config, seed)
    verify(config, alone.records, alone.events)
    fleet = Fleet(config, robots := noisy_robots(seed))
    outstanding: list[tuple[StubRobots, Work]] = []
    while not fleet.done:
        outstanding += [(robots, work) for work in fleet.advance()]
        order.shuffle(outstanding)
        for _ in range(order.randint(0, len(outstanding))):
            robots, work = outstanding.pop()
            fleet.deliver(work, robots.compute(work))
    assert repr(fleet.events) == repr(alone.events)
    assert repr(fleet.records) == repr(alone.records)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda robots: [], "policy 'wrong': index: expected 1 numbers, one a robot, got"),
        (lambda robots: 1.0, "policy 'wrong': index: expected 1 numbers, one a robot, got"),
        (lambda robots: [math.nan], "policy 'wrong': index: expected a number or None, got nan"),
        (lambda robots: ["x"], "policy 'wrong': index: expected a number or None, got 'x'"),
    ],
)
def test_a_policy_that_answers_wrongly_is_one_line(answer, message):
    wrong = HighestGain()
    wrong.index = answer
    with registered(POLICIES, wrong=lambda config: wrong), pytest.raises(BadInput, match=message):
        run({0: ". 5 f"}, policy="wrong")


def test_a_policy_without_an_index_is_one_line():
    class Empty(pgf_jax.PolicyBase):
        discipline = "index"

    with (
        registered(POLICIES, empty=lambda config: Empty()),
        pytest.raises(BadInput, match=r"policy 'empty': .* has no method index"),
    ):
        run({0: "f"}, policy="empty")
