"""Robots that plan while they ask and are served, against an independent SimPy model.

Here a robot is a process, its request is another, and each interrupts the other: the robot when it
has found its way or has no time left, the request when the operator gives a push.
"""

import dataclasses
from typing import Any

import pytest
import simpy
from test_fleet_simpy import Model, Process, World, compare, world

from pgf_jax.fleet.event_calendar import nanoseconds

POLICIES = ["pgf+plan", "or-hitl+plan", "queue"]


@dataclasses.dataclass
class Task:
    """What the processes of a robot and of its request tell each other."""

    robot: simpy.Process
    deadline: float
    request: simpy.Process | None = None
    number: int = 0  # of the next service
    go_on: bool = False

    def end_request(self, why: str) -> None:
        """The robot has found its way, or has no time left."""
        if self.request is not None:
            self.request.interrupt(why)
            self.request = None


class PlanningModel(Model):
    """The model in which robots go on planning."""

    def attempt(self, robot: int, task: int) -> Process:
        env, config, world = self.env, self.config, self.world
        assert env.active_process is not None
        rollout = nanoseconds(config.rollout_time_s)
        it = Task(env.active_process, env.now + nanoseconds(config.task_limit_s))
        pushing, push_deadline = False, 0.0
        fresh, stuck, checking = True, False, False
        iteration = number = 0
        result: Any = None
        while True:
            factor = world.slowdown(robot, task, iteration, 0)
            if checking:
                lasts = round(rollout * factor)
                if number and env.now + lasts > it.deadline:
                    it.end_request("expired")
                    return "stuck" if stuck else "timed_out"
            else:
                lasts = round((1 if fresh else 2) * rollout * factor)
                if pushing and env.now + lasts > min(push_deadline, it.deadline):
                    self.note("push_dropped", robot, task)
                    pushing, fresh, stuck = False, False, False  # the search as it was
                    lasts = round(2 * rollout * factor)
                if env.now + lasts > it.deadline:
                    it.end_request("expired")
                    return "stuck" if stuck else "timed_out"
            try:
                yield env.timeout(lasts)
            except simpy.Interrupt:  # the operator has given a push
                pushing, fresh, stuck, checking = True, True, False, False
                it.go_on = False
                push_deadline = env.now + nanoseconds(config.push_limit_s)
                continue
            if checking:
                passed = world.p_check_miss is None
                if not passed:
                    check = world.check(robot, task, iteration - 1, number)
                    passed, result, stuck = check.passed, check.result, check.result.stuck
                    self.note("check", robot, task, outcome="passed" if passed else "missed")
                    if not passed and check.more:
                        number += 1
                        continue
                checking = False
                if passed:
                    it.end_request("solved_meanwhile")
                    yield env.timeout(3 * 10**9)
                    self.note("execution_end", robot, task, outcome="reach")
                    return "solved"
            else:
                result = world.iterate(robot, task, iteration)
                fresh, stuck, iteration = False, result.stuck, iteration + 1
                self.note("iteration", robot, task)
                if result.feasible and pushing:
                    yield from self.push(robot, task)
                    it.deadline += 4 * 10**9
                    pushing, fresh, stuck = False, True, False
                    continue
                if result.feasible:
                    checking, number = True, 0
                    continue
                if pushing:
                    continue
            asks = result.stuck
            if it.go_on:
                it.go_on = stuck = asks = False
            if env.now + 2 * rollout > it.deadline:
                it.end_request("expired")
                return "stuck" if stuck else "timed_out"
            if self.windows:
                asks = result.gain > 1
            if it.request is None and asks:
                it.request = env.process(self.request(robot, task, result.gain, it))
                # An operator who is free is granted first, also to a robot that ends at this very
                # instant: a slow computer has no time left for what an ask takes for granted.
                for _ in range(3):
                    yield env.timeout(0)

    @property
    def windows(self) -> bool:
        return self.config.policy.startswith("pgf")

    def request(self, robot: int, task: int, gain: float, it: Task) -> Process:
        env = self.env
        ask = self.in_window if self.windows else self.in_line
        waits, operator = True, None
        try:
            operator = yield from ask(robot, task, gain, it.deadline)
            waits = False
            if operator == "expired":
                self.note("expired", robot, task, outcome="limit")
            if operator not in (None, "expired"):
                self.note("grant", robot, task, operator)
                lasts = nanoseconds(self.world.seconds(robot, task, it.number))
                in_time = env.now + lasts <= it.deadline
                yield env.timeout(min(lasts, it.deadline - env.now))
                self.release(operator)
                if not in_time:
                    self.note("service_end", robot, task, operator, "expired")
                else:
                    push = self.world.decide(robot, task, it.number)
                    it.number += 1
                    self.note("service_end", robot, task, operator, "push" if push else "go_on")
                    if push:
                        it.robot.interrupt()
                    else:
                        it.go_on = True
            it.request = None
        except simpy.Interrupt as interrupt:
            why = interrupt.cause
            if waits:
                self.leave(robot)
                self.note("expired", robot, task, outcome="limit" if why == "expired" else why)
            else:
                self.note("service_end", robot, task, operator, why)
                self.release(operator)

    def release(self, operator: Any) -> None:
        if self.windows:
            self.free.append(operator)
        else:
            self.store.put(operator)

    def leave(self, robot: int) -> None:
        """Of a robot that waits, in the window or in line."""
        if self.windows:
            assert self.window is not None
            del self.window[robot]
        else:
            self.turns.pop(robot).cancel()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("operators", [1, 2])
@pytest.mark.parametrize("check_miss", [None, 0.5])
@pytest.mark.parametrize("policy", POLICIES)
def test_every_event_matches_the_model(policy, check_miss, operators, seed):
    found = compare(given(policy, seed, check_miss), policy, operators, PlanningModel)
    outcomes = {(row[1], row[5]) for row in found}
    assert {("service_end", "push"), ("task_end", "solved")} <= outcomes


def given(policy: str, seed: int, check_miss: float | None) -> World:
    p_feasible = 0.06 if check_miss is None else 0.15
    paper = policy.removesuffix("+plan")
    return dataclasses.replace(world(paper, seed), p_feasible=p_feasible, p_check_miss=check_miss)


def test_the_cases_above_reach_every_ending_of_an_ask():
    seen = set()
    for policy in POLICIES:
        for seed in range(6):
            found = compare(given(policy, seed, 0.5), policy, 1, PlanningModel)
            seen |= {(row[1], row[5]) for row in found}
    assert {
        ("refused", "busy"),
        ("refused", "lost"),
        ("expired", "limit"),
        ("expired", "solved_meanwhile"),
        ("service_end", "expired"),
        ("service_end", "go_on"),
        ("service_end", "solved_meanwhile"),
        ("push_dropped", None),
        ("check", "missed"),
        ("task_end", "timed_out"),
    } <= seen
