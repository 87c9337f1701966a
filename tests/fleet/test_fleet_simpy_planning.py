"""Robots that plan while they ask and are served, against an independent SimPy model.

Here a robot is a process, its request is another, and each interrupts the other: the robot when it
has found its way or has no time left, the request when the operator gives a push. Where robots do
not ask but are ranked, one more process wakes at every event and serves whom it finds.
"""

import dataclasses
from typing import Any

import pytest
import simpy
from registered import registered
from test_fleet_index import HighestGain
from test_fleet_simpy import Model, Process, World, compare, world

from pgf_jax.fleet import FleetConfig
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.policies import POLICIES as REGISTRY

POLICIES = ["pgf+plan", "or-hitl+plan", "queue"]


@dataclasses.dataclass
class Task:
    """What the processes of a robot and of its request tell each other."""

    task: int
    robot: simpy.Process
    deadline: float
    request: simpy.Process | None = None
    number: int = 0  # of the next service
    go_on: bool = False
    pushing: bool = False
    fresh: bool = True  # no nominal yet
    checking: bool = False
    iteration: int = 0  # the next one
    helped_at: int = 0  # the next one when it was served last
    gain: float = 0.0  # of its last iteration

    def end_request(self, why: str) -> None:
        """The robot has found its way, or has no time left."""
        if self.request is not None:
            self.request.interrupt(why)
            self.request = None


class PlanningModel(Model):
    """The model in which robots go on planning."""

    asks = True  # whether robots ask

    def __init__(self, config: FleetConfig, world: World) -> None:
        super().__init__(config, world)
        self.tasks: dict[int, Task] = {}  # of the robots that plan

    def attempt(self, robot: int, task: int) -> Process:
        status = yield from self.plan(robot, task)
        self.tasks.pop(robot, None)
        return status

    def wake(self) -> None:
        """Something has happened."""

    def plan(self, robot: int, task: int) -> Process:
        env, config, world = self.env, self.config, self.world
        assert env.active_process is not None
        rollout = nanoseconds(config.rollout_time_s)
        it = Task(task, env.active_process, env.now + nanoseconds(config.task_limit_s))
        self.tasks[robot] = it
        push_deadline, stuck, number = 0.0, False, 0
        result: Any = None
        while True:
            # An operator who is free is granted first, also to a robot that ends at this very
            # instant: a slow computer has no time left for what an ask takes for granted.
            for _ in range(3):
                yield env.timeout(0)
            factor = world.slowdown(robot, task, it.iteration, 0)
            if it.checking:
                lasts = round(rollout * factor)
                if number and env.now + lasts > it.deadline:
                    it.end_request("expired")
                    return "stuck" if stuck else "timed_out"
            else:
                lasts = round((1 if it.fresh else 2) * rollout * factor)
                if it.pushing and env.now + lasts > min(push_deadline, it.deadline):
                    self.note("push_dropped", robot, task)
                    it.pushing, it.fresh, stuck = False, False, False  # the search as it was
                    lasts = round(2 * rollout * factor)
                if env.now + lasts > it.deadline:
                    it.end_request("expired")
                    return "stuck" if stuck else "timed_out"
            try:
                yield env.timeout(lasts)
            except simpy.Interrupt:  # the operator has given a push
                it.pushing, it.fresh, stuck, it.checking = True, True, False, False
                it.go_on = False
                push_deadline = env.now + nanoseconds(config.push_limit_s)
                continue
            if it.checking:
                passed = world.p_check_miss is None
                if not passed:
                    check = world.check(robot, task, it.iteration - 1, number)
                    passed, result, stuck = check.passed, check.result, check.result.stuck
                    it.gain = result.gain
                    self.note("check", robot, task, outcome="passed" if passed else "missed")
                    if not passed and check.more:
                        number += 1
                        continue
                it.checking = False
                if passed:
                    self.wake()
                    del self.tasks[robot]
                    it.end_request("solved_meanwhile")
                    yield env.timeout(3 * 10**9)
                    self.note("execution_end", robot, task, outcome="reach")
                    return "solved"
            else:
                result = world.iterate(robot, task, it.iteration)
                it.fresh, stuck, it.iteration = False, result.stuck, it.iteration + 1
                self.note("iteration", robot, task)
                if result.feasible and it.pushing:
                    yield from self.push(robot, task)
                    it.deadline += 4 * 10**9
                    it.pushing, it.fresh, stuck = False, True, False
                    continue
                if result.feasible:
                    it.checking, number, it.gain = True, 0, result.gain
                    continue
                if it.pushing:
                    continue
            it.gain = result.gain
            asks = result.stuck
            if it.go_on:
                it.go_on = stuck = asks = False
            if env.now + 2 * rollout > it.deadline:
                it.end_request("expired")
                return "stuck" if stuck else "timed_out"
            if self.windows:
                asks = result.gain > 1
            if self.asks and it.request is None and asks:
                it.request = env.process(self.request(robot, task, result.gain, it))

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
                    it.helped_at = it.iteration
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
        if self.windows or not self.asks:
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


class RankingModel(PlanningModel):
    """The model in which free operators take the robots of highest gain, from 1 on."""

    asks = False

    def __init__(self, config: FleetConfig, world: World) -> None:
        super().__init__(config, world)
        self.event = self.env.event()
        self.env.process(self.serve())

    def note(self, kind: str, *args, **more) -> None:
        super().note(kind, *args, **more)
        if kind not in ("bid", "grant"):
            self.wake()

    def wake(self) -> None:
        if not self.event.triggered:
            self.event.succeed()

    def serve(self) -> Process:
        while True:
            yield self.event
            self.event = self.env.event()
            yield self.env.timeout(0)  # all that happens now has happened
            found = [(-it.gain, robot) for robot, it in self.tasks.items() if self.may(it)]
            for _, robot in sorted(found)[: len(self.free)]:
                it = self.tasks[robot]
                it.request = self.env.process(self.request(robot, it.task, it.gain, it))

    def may(self, it: Task) -> bool:
        reaches = not (it.fresh or it.pushing or it.checking)
        return reaches and it.request is None and it.iteration > it.helped_at and it.gain > 1

    def in_line(self, robot: int, task: int, gain: float, deadline: float) -> Process:
        self.note("bid", robot, task)
        self.free.sort()
        yield from ()  # it need not wait: an operator is free
        return self.free.pop(0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("operators", [1, 2])
@pytest.mark.parametrize("check_miss", [None, 0.5])
@pytest.mark.parametrize("policy", POLICIES)
def test_every_event_matches_the_model(policy, check_miss, operators, seed):
    found = compare(given(policy, seed, check_miss), policy, operators, PlanningModel)
    outcomes = {(row[1], row[5]) for row in found}
    assert {("service_end", "push"), ("task_end", "solved")} <= outcomes


@pytest.mark.parametrize("seed", range(16))
@pytest.mark.parametrize("operators", [1, 2, 3])
@pytest.mark.parametrize("check_miss", [None, 0.5])
def test_every_event_of_ranked_robots_matches_the_model(check_miss, operators, seed):
    with registered(REGISTRY, highest=lambda config: HighestGain()):
        found = compare(given("highest", seed, check_miss), "highest", operators, RankingModel)
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
