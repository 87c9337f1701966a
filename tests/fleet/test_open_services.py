"""Open services, operators who come and leave, and simulated time that follows the wall clock."""

import dataclasses
import random
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from fleet_script import PUSH, Constant, log, scripted
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from random_fleets import noisy_robots

from pgf_jax.fleet import EventKind, Fleet, FleetConfig, Work, WorkKind
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.policies import policy_names
from pgf_jax.fleet.records import State
from pgf_jax.fleet.service import LogNormal, ServiceTimes
from pgf_jax.fleet.simulator import Attendance
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.metrics.identities import verify
from pgf_jax.planning.types import UNANSWERED, NoInput, Push, Status
from pgf_jax.simulation.recorded_operator import Recording
from pgf_jax.tables.event_log import EventLog

S = 10**9
ITERATIONS = ("iteration", "execution_end", "retreat_end")
Given = Push | NoInput | None


class Open:
    """All services are open: their length is unknown."""

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        return None


@dataclasses.dataclass(frozen=True)
class OpenFor:
    """The services of some robots are open, the others' take as long as in `Constant`."""

    robots: tuple[int, ...]
    value: float = 8.0

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        return None if robot in self.robots else self.value


class ManualFleet:
    """A fleet whose open services the test answers; all other work is computed at once."""

    def __init__(
        self,
        script=None,
        *,
        service: ServiceTimes | None = None,
        attendance: Iterable[Attendance] = (),
        **config,
    ) -> None:
        config.setdefault("tasks", 1)
        self.config = FleetConfig(**config)
        self.robots = scripted(script or {})
        self.fleet = Fleet(
            self.config, self.robots, service=service or Open(), attendance=attendance
        )
        self.asked: dict[int, Work] = {}  # robot -> its input

    def to(self, seconds: float) -> None:
        """Advance to a time."""
        while pending := self.fleet.advance(nanoseconds(seconds)):
            self._take(pending)

    def end(self) -> None:
        while not self.fleet.done:
            pending = self.fleet.advance()
            assert pending or self.fleet.done
            self._take(pending)

    def answer(self, robot: int, given: Given) -> None:
        self.fleet.deliver(self.asked.pop(robot), given)

    def log(self, *leave_out: str) -> list[str]:
        return log(self.fleet, *(leave_out or ("task_start", *ITERATIONS)))

    def verify(self) -> None:
        horizon = self.fleet.now_ns / 1e9 if any(
            record.status is Status.CENSORED for record in self.fleet.records
        ) else None  # fmt: skip
        config = dataclasses.replace(self.config, horizon_s=self.config.horizon_s or horizon)
        verify(config, self.fleet.records, self.fleet.events)

    def _take(self, pending: list[Work]) -> None:
        for work in pending:
            if work.kind is WorkKind.INPUT:
                self.asked[work.robot] = work
            else:
                self.fleet.deliver(work, self.robots.compute(work))


# -- one service ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "said"),
    [(PUSH, "object=3 to=(0.4,0.1) push"), (None, "go_on"), (UNANSWERED, "unanswered")],
)
def test_an_input_ends_the_service_at_the_instant_after(given, said):
    manual = ManualFleet({0: "s f"}, policy="or-hitl")
    manual.to(7.25)
    manual.answer(0, given)
    # Nothing has happened yet, nor does it at an instant that had been advanced to.
    assert manual.fleet.events[-1].kind is EventKind.GRANT
    manual.to(7.25)
    assert manual.fleet.events[-1].kind is EventKind.GRANT
    manual.to(7.25 + 1e-9)
    end = manual.fleet.events[-1]
    assert end.time_ns == nanoseconds(7.25) + 1
    assert manual.log()[-1].endswith(f"service_end r0.0 q0 o0 {said}")
    manual.end()
    (record,) = manual.fleet.records
    assert record.interaction_s == (end.time_ns - nanoseconds(1.5)) / 1e9
    assert (record.answered, record.expired) == ((0, 1) if given is UNANSWERED else (1, 0))
    assert manual.robots.calls[1:] == (
        [("start_push", 0, PUSH)] if given is PUSH else [("go_on", 0, None)]
    )
    manual.verify()


def test_an_input_is_taken_at_once_by_a_fleet_whose_clock_nobody_holds():
    # Without `until_ns` the fleet stands at the grant: nothing else can happen to it.
    manual = ManualFleet({0: "s f"}, policy="or-hitl", robots=1)
    manual.to(1.5)
    manual.answer(0, None)
    manual.end()
    (record,) = manual.fleet.records
    assert record.interaction_s == 1e-9


def test_a_service_lasts_to_the_limit_of_the_task_at_most():
    manual = ManualFleet({0: "s"}, policy="or-hitl", task_limit_s=10.0)
    manual.to(3.0)
    manual.to(10.0)
    assert manual.log() == [
        "1.5 bid r0.0 q0 i0 gain=inf",
        "1.5 grant r0.0 q0 o0",
        "10 service_end r0.0 q0 o0 expired",
        "10 task_end r0.0 stuck",
    ]
    for too_late in (PUSH, None, UNANSWERED):
        with pytest.raises(ValueError, match="not outstanding"):
            manual.fleet.deliver(manual.asked[0], too_late)
    manual.end()
    (record,) = manual.fleet.records
    assert (record.requests, record.grants, record.expired, record.answered) == (1, 1, 1, 0)
    manual.verify()


def test_an_input_at_the_limit_is_in_time():
    manual = ManualFleet({0: "s"}, policy="or-hitl", task_limit_s=10.0)
    manual.to(10.0 - 1e-9)
    manual.answer(0, None)
    manual.to(10.0)
    assert manual.log()[-2:] == ["10 service_end r0.0 q0 o0 go_on", "10 task_end r0.0 timed_out"]


def test_a_limit_that_passes_while_the_fleet_is_not_looked_at():
    # Granted and expired within one call: nobody is asked, there is nothing to hand in.
    manual = ManualFleet({0: "s"}, policy="always", task_limit_s=10.0)
    assert manual.fleet.advance(60 * S) == []
    assert manual.fleet.done
    assert [event.outcome for event in manual.fleet.events][-2:] == ["expired", "timed_out"]
    manual.verify()


def test_an_input_that_counts_after_the_limit_is_too_late():
    # Robot 1's iteration keeps the fleet from reaching the limit, but not the wall clock.
    robots = scripted({0: "s", 1: "."})
    fleet = Fleet(
        FleetConfig(robots=2, tasks=1, policy="or-hitl", task_limit_s=10.0), robots, service=Open()
    )
    first, second = fleet.advance(0)
    fleet.deliver(first, robots.compute(first))
    fleet.deliver(second, robots.compute(second))
    asked, late = fleet.advance(2 * S)
    assert (asked.kind, late.kind) == (WorkKind.INPUT, WorkKind.ITERATION)
    fleet.advance(11 * S)
    fleet.deliver(asked, None)
    fleet.deliver(late, robots.compute(late))
    while not fleet.done:
        for work in fleet.advance(12 * S):
            fleet.deliver(work, robots.compute(work))
    assert "10 service_end r0.0 q0 o0 expired" in log(fleet)


def test_results_are_checked_as_ever():
    manual = ManualFleet({0: "s"}, policy="or-hitl")
    manual.to(3.0)
    asked = manual.asked[0]
    for wrong in (outcome(), "push", True, (3, 0.4, 0.1)):
        with pytest.raises(TypeError, match="input cannot result in"):
            manual.fleet.deliver(asked, wrong)  # pyright: ignore[reportArgumentType]
    manual.fleet.deliver(asked, None)
    with pytest.raises(ValueError, match="not outstanding"):
        manual.fleet.deliver(asked, PUSH)
    manual.to(4.0)
    assert manual.log()[-1].endswith("go_on")


def test_no_answer_is_booked_and_the_robot_goes_on():
    manual = ManualFleet({0: ". s s f"}, policy="or-hitl")
    manual.to(60.0)
    assert manual.asked[0].request == 0
    manual.answer(0, UNANSWERED)
    manual.to(90.0)
    # The iteration after it is stuck as well: it asks again, under the next number.
    assert manual.asked[0].request == 1
    manual.answer(0, PUSH)
    manual.end()
    services = [
        (event.kind, event.request, event.outcome)
        for event in manual.fleet.events
        if event.kind in (EventKind.BID, EventKind.GRANT, EventKind.SERVICE_END)
    ]
    assert services == [
        ("bid", 0, None),
        ("grant", 0, None),
        ("service_end", 0, "unanswered"),
        ("bid", 1, None),
        ("grant", 1, None),
        ("service_end", 1, "push"),
    ]
    assert manual.robots.calls == [("begin", 0, 0), ("go_on", 0, None), ("start_push", 0, PUSH)]
    (record,) = manual.fleet.records
    assert (record.requests, record.grants, record.answered, record.expired) == (2, 2, 1, 1)
    assert len(record.asked_cost) == len(record.helped_cost) == 1
    assert record.status is Status.SOLVED
    manual.verify()


def test_nobody_answers_before_the_first_iteration():
    manual = ManualFleet({0: "f"}, policy="always")
    manual.to(5.0)
    manual.answer(0, UNANSWERED)
    manual.end()
    assert manual.robots.calls == [("begin", 0, 0)]  # there is nothing to go on with
    assert manual.fleet.records[0].status is Status.SOLVED
    manual.verify()


def test_open_and_timed_services_side_by_side():
    manual = ManualFleet(
        {0: "s f", 1: "s f"}, policy="queue", robots=2, operators=2, service=OpenFor((1,), 4.0)
    )
    manual.to(3.0)
    manual.answer(0, None)  # the input of a timed service: its time stays as it was
    manual.to(20.0)
    assert "5.5 service_end r0.0 q0 o0 go_on" in manual.log()
    manual.answer(1, PUSH)
    manual.end()
    ends = [e for e in manual.fleet.events if e.kind is EventKind.SERVICE_END]
    assert [(e.robot, e.time_ns) for e in ends] == [(0, nanoseconds(5.5)), (1, 20 * S + 1)]
    manual.verify()


def test_a_switch_of_context_costs_no_time_in_an_open_service():
    manual = ManualFleet({0: "f", 1: "f"}, policy="always", robots=2, context_switch_s=5.0)
    manual.to(2.0)
    manual.answer(0, None)
    manual.to(3.0)
    manual.answer(1, None)
    manual.end()
    ends = [e.time_ns for e in manual.fleet.events if e.kind is EventKind.SERVICE_END]
    assert ends == [2 * S + 1, 3 * S + 1]


def test_a_horizon_cuts_an_open_service_off():
    manual = ManualFleet({0: "s"}, policy="or-hitl", horizon_s=6.0)
    manual.to(3.0)
    manual.to(6.0)
    assert manual.fleet.done
    assert manual.log()[-2:] == ["6 service_end r0.0 q0 o0 censored", "6 task_end r0.0 censored"]
    manual.answer(0, PUSH)  # ignored
    assert manual.fleet.advance() == []
    manual.verify()


# -- operators who come and go -------------------------------------------------------------------


def test_nobody_is_granted_to_an_operator_who_is_away_in_line():
    away = [Attendance(0, 0, False), Attendance(6 * S, 0, True)]
    manual = ManualFleet({0: "f", 1: "f"}, policy="always", robots=2, attendance=away)
    manual.to(10.0)
    assert manual.log() == [
        "0 operator_away o0",
        "0 bid r0.0 q0 gain=inf",
        "0 bid r1.0 q0 gain=inf",
        "6 operator_back o0",
        "6 grant r0.0 q0 o0",
    ]
    manual.answer(0, None)
    manual.to(11.0)
    manual.answer(1, None)
    manual.end()
    assert [record.waiting_s for record in manual.fleet.records] == [6.0, 10.000000001]
    manual.verify()


def test_nobody_is_granted_to_an_operator_who_is_away_refused():
    away = [Attendance(1 * S, 0, False), Attendance(6 * S, 0, True)]
    manual = ManualFleet({0: "s s s f"}, policy="or-hitl", attendance=away)
    manual.to(8.0)
    assert manual.log()[:6] == [
        "1 operator_away o0",
        "1.5 bid r0.0 q0 i0 gain=inf",
        "1.5 refused r0.0 q0 busy",
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 refused r0.0 q0 busy",
        "6 operator_back o0",
    ]
    # Coming back grants nothing by itself: the robot asks again.
    assert manual.log()[6:] == ["7.5 bid r0.0 q0 i2 gain=inf", "7.5 grant r0.0 q0 o0"]
    manual.answer(0, None)
    manual.end()
    manual.verify()


def test_nobody_is_granted_to_an_operator_who_is_away_in_windows():
    # Away from the start, no window opens; leaving while one is open, all in it lose.
    away = [
        Attendance(0, 0, False),
        Attendance(2 * S, 0, True),
        Attendance(5 * S, 0, False),
        Attendance(7 * S, 0, True),
    ]
    manual = ManualFleet({0: "s s s f", 1: "s s s f"}, policy="pgf", robots=2, attendance=away)
    manual.to(60.0)
    assert manual.log() == [
        "0 operator_away o0",
        "2 operator_back o0",
        "4.5 window_open r0.0",
        "4.5 bid r0.0 q0 i1 gain=inf",
        "4.5 bid r1.0 q0 i1 gain=inf",
        "5 operator_away o0",
        "6.5 window_close",
        "6.5 refused r0.0 q0 lost",
        "6.5 refused r1.0 q0 lost",
        "7 operator_back o0",
        "9.5 window_open r0.0",
        "9.5 bid r0.0 q0 i2 gain=inf",
        "9.5 bid r1.0 q0 i2 gain=inf",
        "11.5 window_close",
        *manual.log()[14:],
    ]
    assert [line.split()[1] for line in manual.log()[14:16]] == ["grant", "refused"]
    manual.end()
    manual.verify()


def test_a_service_under_way_goes_on_when_its_operator_leaves():
    manual = ManualFleet({0: "f", 1: "f"}, policy="always", robots=2)
    manual.to(2.0)
    manual.fleet.set_attendance(0, False)
    manual.to(5.0)
    assert manual.log()[-1] == "2 operator_away o0"
    assert manual.fleet.operators.serving(0) == 0
    assert not manual.fleet.operators.is_present(0)
    assert manual.fleet.operators.free == 0
    manual.answer(0, PUSH)
    manual.to(20.0)
    # Robot 1 stays in line until the operator is back.
    assert manual.fleet.operators.serving(0) is None
    assert 1 not in manual.asked
    manual.fleet.set_attendance(0, True)
    manual.to(21.0)
    assert manual.log()[-2:] == ["20 operator_back o0", "20 grant r1.0 q0 o0"]
    manual.answer(1, None)
    manual.end()
    manual.verify()


def test_one_of_two_operators_is_away():
    manual = ManualFleet({0: "f", 1: "f", 2: "f"}, policy="always", robots=3, operators=2,
                attendance=[Attendance(0, 0, False)])  # fmt: skip
    manual.to(1.0)
    assert [*manual.asked] == [0]
    assert "0 grant r0.0 q0 o1" in manual.log()
    manual.fleet.set_attendance(0, True)
    manual.to(2.0)
    assert [*manual.asked] == [0, 1]
    assert manual.log()[-1].endswith("grant r1.0 q0 o0")
    for robot in range(3):
        manual.answer(robot, None)
        manual.to(3.0 + robot)
    manual.end()
    manual.verify()


def test_attendance_counts_from_the_instant_after():
    manual = ManualFleet({0: "f"}, policy="autonomous")
    manual.to(1.25)
    manual.fleet.set_attendance(0, False)
    assert manual.fleet.operators.is_present(0)
    manual.to(1.25)
    assert manual.fleet.operators.is_present(0)
    manual.to(1.25 + 1e-9)
    assert not manual.fleet.operators.is_present(0)
    assert manual.fleet.events[-1].time_ns == nanoseconds(1.25) + 1


def test_an_operator_who_leaves_with_an_answer_takes_on_nobody():
    manual = ManualFleet({0: "f", 1: "f"}, policy="always", robots=2)
    manual.to(60.0)
    manual.answer(0, UNANSWERED)
    manual.fleet.set_attendance(0, False)
    manual.to(61.0)
    assert manual.fleet.operators.serving(0) is None


@pytest.mark.parametrize(
    "changes", [[(0, True), (0, False)], [(1, False), (0, False)]], ids=["one", "two operators"]
)
def test_changes_of_one_instant_keep_their_order_in_a_replay(changes):
    script = {0: ". . . f"}
    manual = ManualFleet(
        script, policy="autonomous", operators=2, attendance=[Attendance(0, 0, False)]
    )
    manual.to(2.0)
    for operator, present in changes:
        manual.fleet.set_attendance(operator, present)
    manual.end()
    again = ManualFleet(
        script,
        policy="autonomous",
        operators=2,
        attendance=recording(manual.fleet).attendance,
    )
    again.end()
    assert again.log() == manual.log()


def test_a_change_now_comes_before_one_that_was_planned():
    manual = ManualFleet(
        {0: ". . . f"}, policy="autonomous", attendance=[Attendance(6 * S, 0, True)]
    )
    manual.to(2.0)
    manual.fleet.set_attendance(0, False)
    manual.end()
    times = [event.time_ns for event in manual.fleet.events]
    assert times == sorted(times)
    assert "2 operator_away o0" in manual.log()


# -- the clock -----------------------------------------------------------------------------------


CONFIGS = st.builds(
    FleetConfig,
    robots=st.integers(1, 5),
    tasks=st.integers(1, 3),
    policy=st.sampled_from(policy_names()),
    operators=st.integers(1, 2),
    # Multiples of the rollout time make ties the rule and not the exception.
    window_s=st.sampled_from([0.0, 1.5, 2.0]),
    service_mean_s=st.sampled_from([0.0, 3.0, 8.0, 40.0]),
    service_sd_s=st.just(0.0),
    compute=st.sampled_from(["dedicated", "shared:16"]),
    horizon_s=st.sampled_from([None, 20.0, 45.0]),
    task_limit_s=st.sampled_from([3.0, 20.0, 60.0]),
    push_limit_s=st.sampled_from([1.0, 6.0, 30.0]),
    seed=st.integers(0, 5),
    while_asking=st.sampled_from([None, "wait", "plan"]),
    while_served=st.sampled_from([None, "wait", "plan"]),
)
SEEDS = st.integers(0, 1000)
CHANCE = st.integers(0, 10**6).map(random.Random)
# Attendance that is known beforehand; at most one change an instant.
PLANS = st.lists(
    st.builds(
        Attendance, st.integers(0, 40).map(lambda half: half * S // 2), st.just(0), st.booleans()
    ),
    unique_by=lambda change: change.time_ns,
    max_size=5,
)
STEPS = [0, 1, S // 2, S, 3 * S // 2, 2 * S, 7 * S]


def step(chance: random.Random) -> int:
    return chance.choice([*STEPS, chance.randrange(3 * S)])


def same(fleet: Fleet, other: Fleet) -> bool:
    # repr: nan gains are equal then, and every bit of a float counts.
    return repr((fleet.events, fleet.records)) == repr((other.events, other.records))


@settings(max_examples=150, deadline=None)
@given(config=CONFIGS, seed=SEEDS, chance=CHANCE, plan=PLANS)
def test_a_held_clock_changes_nothing(config, seed, chance, plan):
    free = Fleet(config, expected := noisy_robots(seed), attendance=plan)
    drive([(free, expected)])
    held = Fleet(config, robots := noisy_robots(seed), attendance=plan)
    outstanding: list[Work] = []
    until_ns = 0
    for _ in range(chance.randrange(200)):
        outstanding += held.advance(until_ns)
        assert all(event.time_ns <= until_ns for event in held.events)
        assert held.now_ns <= until_ns
        waits = held.blocked_at_ns
        assert waits is None or held.done or outstanding or waits > until_ns
        chance.shuffle(outstanding)
        for _ in range(chance.choice([len(outstanding), chance.randint(0, len(outstanding))])):
            work = outstanding.pop()
            held.deliver(work, robots.compute(work))
        until_ns += step(chance)
    for work in outstanding:
        held.deliver(work, robots.compute(work))
    drive([(held, robots)])
    assert same(held, free)
    assert robots.calls == expected.calls


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=SEEDS, until=st.integers(0, 80 * S), late=st.integers(0, 4 * S))
def test_an_earlier_time_takes_nothing_back(config, seed, until, late):
    fleet = Fleet(config, robots := noisy_robots(seed))
    drive_to(fleet, robots, until)
    events = list(fleet.events)
    assert fleet.advance(max(0, until - late)) == []
    assert fleet.events == events


def drive_to(fleet: Fleet, robots: StubRobots, until_ns: int) -> None:
    while pending := fleet.advance(until_ns):
        for work in pending:
            fleet.deliver(work, robots.compute(work))


# -- stop ----------------------------------------------------------------------------------------


@settings(max_examples=150, deadline=None)
@given(
    config=CONFIGS.map(lambda config: dataclasses.replace(config, horizon_s=None)),
    seed=SEEDS,
    until_ns=st.one_of(st.integers(0, 60).map(lambda half: half * S // 2), st.integers(0, 30 * S)),
    ahead=st.booleans(),
    plan=PLANS,
)
def test_a_fleet_that_is_stopped_is_one_of_that_horizon(config, seed, until_ns, ahead, plan):
    fleet = Fleet(config, robots := noisy_robots(seed), attendance=plan)
    if ahead:  # the clock is ahead of what has been computed
        outstanding = fleet.advance(until_ns)
    else:
        drive_to(fleet, robots, until_ns)
        outstanding = []
    assume(not fleet.done)
    fleet.stop()
    for work in outstanding:
        fleet.deliver(work, robots.compute(work))
    drive([(fleet, robots)])
    config = dataclasses.replace(config, horizon_s=(until_ns + 1) / 1e9)
    other = Fleet(config, robots := noisy_robots(seed), attendance=plan)
    drive([(other, robots)])
    assert same(fleet, other)
    verify(config, fleet.records, fleet.events)


def test_a_fleet_is_stopped_in_an_open_service():
    manual = ManualFleet({0: "f", 1: "f"}, policy="always", robots=2)
    manual.to(4.0)
    manual.fleet.stop()
    manual.end()
    assert manual.log()[-4:] == [
        "4 service_end r0.0 q0 o0 censored",
        "4 task_end r0.0 censored",
        "4 expired r1.0 q0 censored",
        "4 task_end r1.0 censored",
    ]
    assert manual.fleet.now_ns == 4 * S + 1
    manual.verify()


def test_an_input_counts_when_the_fleet_is_stopped_after_it():
    manual = ManualFleet({0: "f"}, policy="always")
    manual.to(4.0)
    manual.answer(0, PUSH)
    manual.fleet.stop()
    manual.end()
    assert [line.split()[-1] for line in manual.log()[-2:]] == ["push", "censored"]
    manual.verify()


def test_a_stop_does_not_put_the_horizon_off():
    fleet = Fleet(
        FleetConfig(tasks=1, policy="autonomous", horizon_s=3.0), robots := noisy_robots(0)
    )
    pending = fleet.advance(5 * S)
    fleet.stop()
    for work in pending:
        fleet.deliver(work, robots.compute(work))
    for _ in range(20):
        for work in fleet.advance():
            fleet.deliver(work, robots.compute(work))
    assert fleet.done
    assert fleet.now_ns <= 3 * S


# -- live sessions and replays -------------------------------------------------------------------


def recording(fleet: Fleet) -> Recording:
    return Recording.of(EventLog(Path("events.jsonl"), [fleet.events], {}))


@dataclasses.dataclass
class Live:
    """A fleet that is advanced in random steps, with an operator who answers at random times.

    With `late` the computer does not keep up with the clock.
    """

    config: FleetConfig
    seed: int
    chance: random.Random
    late: bool
    service: ServiceTimes = dataclasses.field(default_factory=Open)
    until_ns: int = 0

    def run(self) -> Fleet:
        chance, robots = self.chance, noisy_robots(self.seed)
        fleet = Fleet(self.config, robots, service=self.service)
        stop_ns = chance.choice([None, None, chance.randrange(100 * S)])
        outstanding: list[Work] = []
        asked: list[Work] = []
        while not fleet.done:
            self.until_ns += step(chance)
            self._advance(fleet, robots, outstanding, asked)
            if stop_ns is not None and self.until_ns > stop_ns and not fleet.done:
                stop_ns = None
                self._stop(fleet)
            assert all(event.time_ns <= self.until_ns for event in fleet.events[-20:])
            still = [work for work in asked if self._is_served(fleet, work)]
            for work in set(asked) - set(still):
                self._is_refused(fleet, work)
            asked[:] = still
            if asked and chance.random() < 0.3:
                work = asked.pop(chance.randrange(len(asked)))
                fleet.deliver(work, chance.choice([PUSH, PUSH, None, UNANSWERED]))
            while chance.random() < 0.1:  # several at one instant, too
                fleet.set_attendance(chance.randrange(self.config.operators), chance.random() < 0.6)
        return fleet

    def _stop(self, fleet: Fleet) -> None:
        horizon_s = (self.until_ns + 1) / 1e9
        fleet.stop()
        if self.config.horizon_s is not None:
            horizon_s = min(horizon_s, self.config.horizon_s)
        self.config = dataclasses.replace(self.config, horizon_s=horizon_s)

    def _advance(self, fleet, robots, outstanding, asked) -> None:
        while True:
            for work in fleet.advance(self.until_ns):
                is_open = work.kind is WorkKind.INPUT and self.service.seconds(
                    work.robot, work.task, work.request or 0
                ) is None  # fmt: skip
                (asked if is_open else outstanding).append(work)
            if not outstanding:
                return
            self.chance.shuffle(outstanding)
            count = self.chance.randint(0, len(outstanding)) if self.late else len(outstanding)
            for _ in range(count):
                work = outstanding.pop()
                fleet.deliver(work, robots.compute(work))
            if self.late:
                return

    def _is_served(self, fleet: Fleet, work: Work) -> bool:
        run = fleet.task_run(work.robot)
        assert run is not None
        return (
            not fleet.done
            and run.state is State.SERVED
            and (run.task, run.request) == (work.task, work.request)
        )

    @staticmethod
    def _is_refused(fleet: Fleet, work: Work) -> None:
        run = fleet.task_run(work.robot)
        if not fleet.done and run is not None and run.task != work.task:
            with pytest.raises(ValueError, match="not outstanding"):
                fleet.deliver(work, None)


def replay(
    config: FleetConfig, seed: int, said: Recording, held: Callable[[], int] | None = None
) -> Fleet:
    """A second fleet that is given only the inputs of the first."""

    def decide(work: Work) -> Given:
        return said.inputs[work.robot, work.task, work.request or 0][1]

    robots = noisy_robots(seed)
    robots = StubRobots(robots.compute, decide)  # pyright: ignore[reportArgumentType]
    fleet = Fleet(config, robots, service=said, attendance=said.attendance)
    until_ns = None if held is None else 0
    while not fleet.done:
        if held is not None and until_ns is not None:
            until_ns += held()
        for work in fleet.advance(until_ns):
            service = (work.robot, work.task, work.request)
            if work.kind is WorkKind.INPUT and service not in said.inputs:
                continue  # an answer that never came
            result = decide(work) if work.kind is WorkKind.INPUT else robots.compute(work)
            fleet.deliver(work, result)  # pyright: ignore[reportArgumentType]
    return fleet


@settings(max_examples=300, deadline=None)
@given(config=CONFIGS, seed=SEEDS, chance=CHANCE, late=st.booleans())
def test_the_same_inputs_at_the_same_times_make_the_same_log_again(config, seed, chance, late):
    live = Live(config, seed, chance, late)
    fleet = live.run()
    times = [event.time_ns for event in fleet.events]
    assert times == sorted(times)
    assert same(replay(live.config, seed, recording(fleet)), fleet)
    assert same(replay(live.config, seed, recording(fleet), lambda: step(chance)), fleet)


@settings(max_examples=150, deadline=None)
@given(config=CONFIGS, seed=SEEDS, chance=CHANCE, late=st.booleans())
def test_the_identities_hold_with_people(config, seed, chance, late):
    live = Live(config, seed, chance, late)
    fleet = live.run()
    verify(live.config, fleet.records, fleet.events)
    # Nobody who was away was given a robot.
    there = dict.fromkeys(range(config.operators), True)
    for event in fleet.events:
        if event.kind in (EventKind.OPERATOR_AWAY, EventKind.OPERATOR_BACK):
            there[event.operator or 0] = event.kind is EventKind.OPERATOR_BACK
        elif event.kind is EventKind.GRANT:
            assert there[event.operator or 0]


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=SEEDS, chance=CHANCE)
def test_people_for_some_robots(config, seed, chance):
    # A machine serves robot 0; its services are of known lengths, and replayed as if they were not.
    live = Live(config, seed, chance, late=True, service=OpenFor((1, 2, 3), 3.0))
    fleet = live.run()
    assert same(replay(live.config, seed, recording(fleet)), fleet)


@settings(max_examples=50, deadline=None)
@given(config=CONFIGS, seed=SEEDS, chance=CHANCE, cut=st.floats(0, 1))
def test_a_log_that_breaks_off_is_the_beginning_of_its_replay(config, seed, chance, cut):
    live = Live(config, seed, chance, late=False)
    fleet = live.run()
    kept = fleet.events[: 1 + int(cut * (len(fleet.events) - 1))]
    said = Recording.of(EventLog(Path("events.jsonl"), [kept], {}))
    horizon = (said.end_ns + 1) / 1e9  # a task that starts at the horizon would not
    assume(all(event.outcome != "censored" for event in kept))
    again = replay(dataclasses.replace(live.config, horizon_s=horizon), seed, said)
    assert repr(again.events[: len(kept)]) == repr(kept)


def test_a_simulated_operator_is_replayed_as_well():
    config = FleetConfig(robots=4, tasks=3, policy="pgf", service_mean_s=8.0, service_sd_s=4.0)
    fleet = Fleet(config, robots := noisy_robots(3), service=LogNormal(0, 8.0, 4.0))
    drive([(fleet, robots)])
    assert same(replay(config, 3, recording(fleet)), fleet)
    assert Constant(2.0).seconds(0, 0, 0) == 2.0
