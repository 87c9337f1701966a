"""The fleet against an independent model of it, written as SimPy processes: every event matches.

The model knows nothing of calendars, requests or results: each robot is a process that plans, waits
and is served; patience is a timeout; operators are a store (in line) or a list (in windows).
Durations are jittered, so that no two events share an instant and no rule for ties is needed.
"""

import dataclasses
import itertools
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest
import simpy

from pgf_jax.fleet import (
    CheckResult,
    EventKind,
    Fleet,
    FleetConfig,
    IterationResult,
    ReachResult,
    Work,
)
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.stub import StubRobots, drive
from pgf_jax.planning.types import Push

Process = Generator[Any, Any, Any]


def uniform(*key: int) -> np.ndarray:
    """[4] numbers that depend on the key alone."""
    return np.random.default_rng(key).random(4)


@dataclasses.dataclass(frozen=True)
class World:
    """Outcomes and durations by key, the inputs of both simulations."""

    seed: int
    p_feasible: float
    p_stuck: float
    p_push: float
    p_check_miss: float | None = None  # None: checks have no outcome
    p_grasp_miss: float | None = None  # None: a reach cannot miss

    def iterate(self, robot: int, task: int, iteration: int) -> IterationResult:
        u = uniform(self.seed, 1, robot, task, iteration)
        return IterationResult(
            feasible=bool(u[0] < self.p_feasible),
            stuck=bool(u[1] < self.p_stuck),
            gain=4 * float(u[2]) - 1,
            terms=(1.0, 0.0, 0.0),
            cost=1.0,
        )

    def check(self, robot: int, task: int, iteration: int, number: int) -> CheckResult:
        assert self.p_check_miss is not None
        u = uniform(self.seed, 5, robot, task, iteration, number)
        passed = bool(u[0] >= self.p_check_miss)
        result = IterationResult(
            feasible=passed,
            stuck=bool(u[1] < self.p_stuck),
            gain=4 * float(u[2]) - 1,
            terms=(1.0, 0.0, 0.0),
            cost=1.0,
        )
        return CheckResult(passed, more=bool(u[3] < 0.6) and number < 2, result=result)

    def reach(self, robot: int, task: int, iteration: int) -> ReachResult:
        assert self.p_grasp_miss is not None
        u = uniform(self.seed, 6, robot, task, iteration)
        return ReachResult(bool(u[0] >= self.p_grasp_miss), float(u[1]))

    def decide(self, robot: int, task: int, request: int) -> Push | None:
        u = uniform(self.seed, 2, robot, task, request)
        return Push(int(20 * u[0]), float(u[1]), float(u[2])) if u[3] < self.p_push else None

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        return 0.5 + float(uniform(self.seed, 3, robot, task, iteration)[0])

    def seconds(self, robot: int, task: int, request: int) -> float:
        return 12 * float(uniform(self.seed, 4, robot, task, request)[0])


def world(policy: str, seed: int) -> World:
    # No stuck robots in windows: they all bid +inf, and the model knows no rule for ties.
    return World(seed, p_feasible=0.06, p_stuck=0.0 if policy == "pgf" else 0.4, p_push=0.7)


class Model:
    """The SimPy model; `rows` are (time_ns, kind, robot, task, operator, outcome)."""

    def __init__(self, config: FleetConfig, world: World) -> None:
        self.env = simpy.Environment()
        self.config, self.world = config, world
        self.rows: list[tuple] = []
        self.window: dict[int, tuple[float, simpy.Event]] | None = None
        self.free = list(range(config.operators))
        self.store = simpy.PriorityStore(self.env)
        self.turns: dict[int, Any] = {}  # robot -> its place in line
        for operator in range(config.operators):
            self.store.put(operator)
        for robot in range(config.robots):
            self.env.process(self.robot(robot))

    def note(self, kind: str, robot: int, task: int, operator=None, outcome=None) -> None:
        self.rows.append((self.env.now, kind, robot, task, operator, outcome))

    def robot(self, robot: int) -> Process:
        for task in range(self.config.tasks):
            self.note("task_start", robot, task)
            status = yield from self.attempt(robot, task)
            self.note("task_end", robot, task, outcome=status)

    def attempt(self, robot: int, task: int) -> Process:
        env, config, world = self.env, self.config, self.world
        rollout = nanoseconds(config.rollout_time_s)
        deadline = env.now + nanoseconds(config.task_limit_s)
        pushing, push_deadline = False, 0
        fresh, stuck = True, False
        iteration = request = 0
        while True:
            factor = world.slowdown(robot, task, iteration, 0)
            lasts = round((1 if fresh else 2) * rollout * factor)
            if pushing and env.now + lasts > min(push_deadline, deadline):
                self.note("push_dropped", robot, task)
                pushing, fresh, stuck = False, True, False
                lasts = round(rollout * factor)
            if env.now + lasts > deadline:
                return "stuck" if stuck else "timed_out"
            yield env.timeout(lasts)
            result = world.iterate(robot, task, iteration)
            fresh, stuck, iteration = False, result.stuck, iteration + 1
            self.note("iteration", robot, task)
            if result.feasible and pushing:
                yield from self.push(robot, task)
                deadline += 4 * 10**9
                pushing, fresh, stuck = False, True, False
                continue
            if result.feasible:
                checked = yield from self.checks(robot, task, iteration, deadline)
                if isinstance(checked, str):  # no time for the next check
                    return checked
                if checked is None:
                    yield env.timeout(3 * 10**9)
                    if world.p_grasp_miss is None or world.reach(robot, task, iteration).grasped:
                        self.note("execution_end", robot, task, outcome="reach")
                        return "solved"
                    self.note("execution_end", robot, task, outcome="missed")
                    yield env.timeout(10**9)
                    self.note("retreat_end", robot, task)
                    deadline += 4 * 10**9
                    fresh, stuck = True, False
                    continue
                result, stuck = checked, checked.stuck
            elif pushing:
                continue
            if env.now + 2 * rollout > deadline:
                return "stuck" if stuck else "timed_out"
            reason = result.gain > 1 if config.policy == "pgf" else result.stuck
            if not reason:
                continue
            ask = self.in_window if config.policy == "pgf" else self.in_line
            operator = yield from ask(robot, task, result.gain, deadline)
            if operator == "expired":
                self.note("expired", robot, task, outcome="limit")
                return "stuck" if stuck else "timed_out"
            if operator is None:
                continue
            self.note("grant", robot, task, operator)
            lasts = nanoseconds(world.seconds(robot, task, request))
            yield env.timeout(min(lasts, deadline - env.now))
            if config.policy == "pgf":
                self.free.append(operator)
            else:
                self.store.put(operator)
            if lasts and env.now == deadline:
                self.note("service_end", robot, task, operator, "expired")
                return "stuck" if stuck else "timed_out"
            push = world.decide(robot, task, request)
            request += 1
            self.note("service_end", robot, task, operator, "push" if push else "go_on")
            stuck = False
            if push:
                pushing, fresh = True, True
                push_deadline = env.now + nanoseconds(config.push_limit_s)

    def push(self, robot: int, task: int) -> Process:
        """Execute a push, and retract."""
        yield self.env.timeout(3 * 10**9)
        self.note("execution_end", robot, task, outcome="push")
        yield self.env.timeout(10**9)
        self.note("retreat_end", robot, task)

    def checks(self, robot: int, task: int, iteration: int, deadline: float) -> Process:
        """Check the candidates of the iteration before `iteration`.

        Returns None: go and execute; an iteration's result: all missed; or how the task ends.
        """
        lasts = round(
            nanoseconds(self.config.rollout_time_s) * self.world.slowdown(robot, task, iteration, 0)
        )
        yield self.env.timeout(lasts)
        if self.world.p_check_miss is None:
            return None
        for number in range(3):
            check = self.world.check(robot, task, iteration - 1, number)
            self.note("check", robot, task, outcome="passed" if check.passed else "missed")
            if check.passed:
                return None
            if not check.more:
                return check.result
            if self.env.now + lasts > deadline:
                return "stuck" if check.result.stuck else "timed_out"
            yield self.env.timeout(lasts)
        raise AssertionError("a fourth check")

    def in_window(self, robot: int, task: int, gain: float, deadline: float) -> Process:
        if self.window is None:
            if not self.free:
                return None
            self.window = {}
            self.note("window_open", robot, task)
            self.env.process(self.close())
        self.note("bid", robot, task)
        told = self.env.event()
        self.window[robot] = (gain, told)
        yield told | self.env.timeout(deadline - self.env.now)
        if not told.triggered:
            del self.window[robot]
            return "expired"
        if told.value is None:
            self.note("refused", robot, task, outcome="lost")
        return told.value

    def close(self) -> Process:
        yield self.env.timeout(nanoseconds(self.config.window_s))
        bids, self.window = sorted((self.window or {}).values(), key=lambda bid: -bid[0]), None
        self.rows.append((self.env.now, "window_close", None, None, None, None))
        for _, told in bids:
            self.free.sort()
            told.succeed(self.free.pop(0) if self.free else None)

    def in_line(self, robot: int, task: int, gain: float, deadline: float) -> Process:
        self.note("bid", robot, task)
        if self.config.policy.startswith("or-hitl") and not self.store.items:
            self.note("refused", robot, task, outcome="busy")
            return None
        turn = self.turns[robot] = self.store.get()
        yield turn | self.env.timeout(deadline - self.env.now)
        if not turn.triggered:
            turn.cancel()
            return "expired"
        if self.env.now == deadline:
            # The one tie that jitter leaves: tasks begun at 0 share their limits, and a service cut
            # off there frees an operator for a robot that leaves at that instant.
            self.store.put(turn.value)
            return "expired"
        return turn.value


def rows(fleet: Fleet) -> list[tuple]:
    """The fleet's log in the columns of the model; iterations' own outcomes left out."""
    return [
        (e.time_ns, str(e.kind), e.robot, e.task, e.operator, None)
        if e.kind is EventKind.ITERATION
        else (e.time_ns, str(e.kind), e.robot, e.task, e.operator, e.outcome)
        for e in fleet.events
    ]


def by_instant(log: list[tuple]) -> list[tuple]:
    # What happens at one instant follows from one cause; its rows have no order of their own.
    return sorted(log, key=lambda row: (row[0], str(row)))


def compare(
    given: World, policy: str, operators: int, simulation: type[Model] = Model
) -> list[tuple]:
    """Run both simulations; returns the rows of the model, which are those of the fleet."""
    plans: Any = {} if simulation is Model else {"while_asking": "plan", "while_served": "plan"}
    config = FleetConfig(
        robots=7,
        tasks=3,
        policy=policy,
        operators=operators,
        push_limit_s=8.0,
        task_limit_s=60.0,
        **plans,
    )

    def decide(work: Work) -> Push | None:
        assert work.request is not None
        return given.decide(work.robot, work.task, work.request)

    def check(work: Work) -> CheckResult:
        assert work.check is not None
        return given.check(work.robot, work.task, work.iteration, work.check)

    robots = StubRobots(
        lambda work: given.iterate(work.robot, work.task, work.iteration),
        decide,
        check=None if given.p_check_miss is None else check,
        reach=None
        if given.p_grasp_miss is None
        else lambda work: given.reach(work.robot, work.task, work.iteration),
    )
    fleet = Fleet(config, robots, service=given, compute=given)
    drive([(fleet, robots)])

    model = simulation(config, given)
    model.env.run()
    assert by_instant(rows(fleet)) == by_instant(model.rows)
    return model.rows


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("operators", [1, 2])
@pytest.mark.parametrize("policy", ["pgf", "or-hitl", "queue"])
def test_every_event_matches_an_independent_model(policy, operators, seed):
    found = compare(world(policy, seed), policy, operators)
    # The case is no trivial one: everything that can happen to an ask does.
    outcomes = {(row[1], row[5]) for row in found}
    assert {("service_end", "push"), ("push_dropped", None), ("task_end", "solved")} <= outcomes


def test_the_cases_above_reach_every_ending_of_an_ask():
    seen = set()
    for policy in ("pgf", "or-hitl", "queue"):
        for seed in range(4):
            config = FleetConfig(
                robots=7, tasks=3, policy=policy, push_limit_s=8.0, task_limit_s=60.0
            )
            model = Model(config, world(policy, seed))
            model.env.run()
            seen |= {(row[1], row[5]) for row in model.rows}
    assert {
        ("refused", "busy"),
        ("refused", "lost"),
        ("expired", "limit"),
        ("service_end", "expired"),
        ("service_end", "go_on"),
        ("task_end", "stuck"),
        ("task_end", "timed_out"),
    } <= seen


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("policy", ["pgf", "or-hitl", "queue"])
@pytest.mark.parametrize(
    ("check_miss", "grasp_miss"), [(0.6, None), (None, 0.4), (0.6, 0.4)], ids=str
)
def test_checks_and_misses_match_an_independent_model(check_miss, grasp_miss, policy, seed):
    given = dataclasses.replace(
        world(policy, seed), p_feasible=0.2, p_check_miss=check_miss, p_grasp_miss=grasp_miss
    )
    found = compare(given, policy, operators=1)
    outcomes = {(row[1], row[5]) for row in found}
    wanted = {("task_end", "solved")}
    wanted |= {("check", "missed"), ("check", "passed")} if check_miss else set()
    wanted |= {("execution_end", "missed")} if grasp_miss else set()
    assert wanted <= outcomes


def test_the_cases_above_reach_what_may_follow_a_miss():
    """After a last miss a robot asks, or plans on; where no check fits, its task ends."""
    after = set()
    for policy in ("pgf", "or-hitl", "queue"):
        for seed in range(4):
            config = FleetConfig(
                robots=7, tasks=3, policy=policy, push_limit_s=8.0, task_limit_s=60.0
            )
            given = dataclasses.replace(
                world(policy, seed), p_feasible=0.2, p_check_miss=0.6, p_grasp_miss=0.4
            )
            model = Model(config, given)
            model.env.run()
            for robot in range(config.robots):
                own = [row for row in model.rows if row[2] == robot]
                after |= {
                    (then[1], then[0] == row[0])
                    for row, then in itertools.pairwise(own)
                    if (row[1], row[5]) == ("check", "missed")
                }
    asks = {("bid", True), ("window_open", True)}
    assert after == asks | {("check", False), ("iteration", False), ("task_end", True)}
