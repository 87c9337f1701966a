"""Sample-path identities: they hold, their sides are right, and errors are found."""

import dataclasses

import pytest
from fleet_script import PUSH, run
from hypothesis import given, settings
from hypothesis import strategies as st
from identity_cases import altered, failing
from random_fleets import CONFIGS, simulate

from pgf_jax.fleet import EventKind, FleetConfig
from pgf_jax.metrics.identities import identity_sides, verify

S = 10**9


@pytest.fixture(scope="module")
def windows():
    """Two robots in one window: one loses and is cut off by the horizon in a window of its own.

    Both bid at 1.5; robot 1 wins at 3.5 and is pushed for from 11.5 on. Robot 0 plans until 6.5,
    9.5 (busy: it does not ask), 12.5: it opens a window till 14.5, and the horizon is at 13.
    """
    fleet, _ = run(
        {0: "5 5", 1: "9 . f"}, inputs={(1, 0, 0): PUSH}, robots=2, horizon_s=13.0, push_limit_s=9.0
    )
    return fleet


@pytest.fixture(scope="module")
def line():
    """Three robots in line at 1.5, with a limit of 13 s; inputs take 8 s.

    Robot 0 is served till 9.5 and solves its task; robot 1 runs out of time while it is being
    served, robot 2 in line.
    """
    fleet, _ = run({0: "s f", 1: "s f", 2: "s f"}, robots=3, policy="queue", task_limit_s=13.0)
    return fleet


# -- the sides, worked by hand -----------------------------------------------------------------


def test_sides_with_windows_by_hand(windows):
    got = identity_sides(windows.config, windows.records, windows.events)
    wait, service = 2 + 2 + 0.5, 8
    assert got == {
        "asks = answered + refused + expired + withdrawn + cut off, of events": (3, 1 + 1 + 0 + 1),
        "asks, of events and of records": (3, 3),
        "answered, of events and of records": (1, 1),
        "refused, of events and of records": (1, 1),
        "expired, of events and of records": (0, 0),
        "asks cut off, of events and of records": (1, 1),
        "withdrawn, of events and of records": (0, 0),
        "grants, of events and of records": (1, 1),
        "grants = ends of services": (1, 1),
        "starts of tasks = records": (2, 2),
        "ends of tasks = records": (2, 2),
        "bids in windows = winners + losers + expired + withdrawn + cut off": (3, 1 + 1 + 1),
        "bids in windows at their close = winners + losers": (2, 2),
        "windows opened = closed + cut off": (2, 1 + 1),
        "time of closed windows = their number times T_window": (2 * S, 2 * S),
        "waiting in windows, of events and of records": (wait * S, wait * S),
        "integral of the number waiting = waiting of records": (wait * S, wait * S),
        "integral of the number of busy operators = services": (service * S, service * S),
        "integral of the number of busy operators = interaction of records": (
            service * S,
            service * S,
        ),
        "time of robot 0's tasks = its makespan": (13 * S, 13 * S),
        "time of robot 1's tasks = its makespan": (13 * S, 13 * S),
        "waits of robot 0 = waiting of its records": (2.5 * S, 2.5 * S),
        "waits of robot 1 = waiting of its records": (2 * S, 2 * S),
        "services of robot 0 = interaction of its records": (0, 0),
        "services of robot 1 = interaction of its records": (8 * S, 8 * S),
        "planning + line + interaction + execution of task 0.0 = its time": (13 * S, 13 * S),
        "planning + line + interaction + execution of task 1.0 = its time": (13 * S, 13 * S),
        "time of task 0.0, of events and of its record": (13 * S, 13 * S),
        "time of task 1.0, of events and of its record": (13 * S, 13 * S),
    }
    assert all(type(side) is int for sides in got.values() for side in sides)
    assert verify(windows.config, windows.records, windows.events) == len(got)


def test_sides_with_a_line_by_hand(line):
    got = identity_sides(line.config, line.records, line.events)
    wait, service = 8 + 11.5, 8 + 3.5
    assert got["asks, of events and of records"] == (3, 3)
    assert got["expired, of events and of records"] == (2, 2)
    assert got["integral of the number waiting = waiting of records"] == (wait * S, wait * S)
    assert got["integral of the number of busy operators = services"] == (service * S, service * S)
    assert got["bids in windows = winners + losers + expired + withdrawn + cut off"] == (0, 0)
    assert got["waits of robot 2 = waiting of its records"] == (11.5 * S, 11.5 * S)
    assert got["time of robot 0's tasks = its makespan"] == (
        (1.5 + 8 + 3 + 1.5 + 3) * S,
        17 * S,
    )
    assert not failing(line.config, line.records, line.events)


def test_a_window_that_closes_at_the_horizon_is_not_cut_off():
    fleet, _ = run({0: "5 5", 1: "9 9"}, robots=2, horizon_s=3.5)
    got = identity_sides(fleet.config, fleet.records, fleet.events)
    assert got["windows opened = closed + cut off"] == (1, 1)
    assert got["bids in windows at their close = winners + losers"] == (2, 2)
    assert got["asks cut off, of events and of records"] == (1, 1)  # the winner's, at once
    assert not failing(fleet.config, fleet.records, fleet.events)


def test_a_fleet_that_asks_nothing():
    fleet, _ = run({0: ". f"}, tasks=2, policy="autonomous")
    got = identity_sides(fleet.config, fleet.records, fleet.events)
    assert got["integral of the number waiting = waiting of records"] == (0, 0)
    assert got["time of robot 0's tasks = its makespan"] == (18 * S, 18 * S)
    assert verify(fleet.config, fleet.records, fleet.events) == 19 + 3 + 2 * 2


# -- errors are found --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("bid", "asks = answered + refused + expired + withdrawn + cut off, of events"),
        ("bid", "asks, of events and of records"),
        ("bid", "bids in windows at their close = winners + losers"),
        ("refused", "refused, of events and of records"),
        ("refused", "bids in windows = winners + losers + expired + withdrawn + cut off"),
        ("expired", "asks cut off, of events and of records"),
        ("grant", "grants, of events and of records"),
        ("grant", "integral of the number of busy operators = interaction of records"),
        ("grant", "integral of the number waiting = waiting of records"),
        ("service_end", "answered, of events and of records"),
        ("service_end", "grants = ends of services"),
        ("service_end", "integral of the number of busy operators = services"),
        ("service_end", "services of robot 1 = interaction of its records"),
        ("window_open", "windows opened = closed + cut off"),
        ("window_open", "waiting in windows, of events and of records"),
        ("window_close", "windows opened = closed + cut off"),
        ("task_start", "starts of tasks = records"),
        ("task_end", "ends of tasks = records"),
        ("task_end", "time of robot 0's tasks = its makespan"),
        ("task_end", "time of task 0.0, of events and of its record"),
    ],
)
def test_a_missing_event_shows(windows, kind, name):
    missing = next(event for event in windows.events if event.kind == kind)
    events = [event for event in windows.events if event is not missing]
    assert name in failing(windows.config, windows.records, events)


@pytest.mark.parametrize(
    ("field", "names"),
    [
        ("requests", {"asks, of events and of records", "asks cut off, of events and of records"}),
        ("grants", {"grants, of events and of records"}),
        (
            "refusals",
            {"refused, of events and of records", "asks cut off, of events and of records"},
        ),
        (
            "answered",
            {"answered, of events and of records", "asks cut off, of events and of records"},
        ),
        (
            "expired",
            {"expired, of events and of records", "asks cut off, of events and of records"},
        ),
        (
            "waiting_s",
            {
                "integral of the number waiting = waiting of records",
                "waits of robot 1 = waiting of its records",
                "time of robot 1's tasks = its makespan",
                "planning + line + interaction + execution of task 1.0 = its time",
            },
        ),
        (
            "interaction_s",
            {
                "integral of the number of busy operators = interaction of records",
                "services of robot 1 = interaction of its records",
                "time of robot 1's tasks = its makespan",
                "planning + line + interaction + execution of task 1.0 = its time",
            },
        ),
        (
            "window_wait_s",
            {
                "waiting in windows, of events and of records",
                "time of robot 1's tasks = its makespan",
                "planning + line + interaction + execution of task 1.0 = its time",
            },
        ),
        (
            "end_ns",
            {
                "planning + line + interaction + execution of task 1.0 = its time",
                "time of task 1.0, of events and of its record",
            },
        ),
    ],
)
def test_an_altered_record_shows_where_it_should(windows, field, names):
    records = [altered(r, field) if r.robot == 1 else r for r in windows.records]
    assert failing(windows.config, records, windows.events) == names


def test_the_first_identity_that_fails_is_named(windows):
    records = [altered(windows.records[0], "refusals"), *windows.records[1:]]
    message = "pgf, R = 2: refused, of events and of records: 1 is not 2"
    with pytest.raises(ValueError, match=message):
        verify(windows.config, records, windows.events)
    with pytest.raises(ValueError, match="asks, of events and of records: 3 is not 1"):
        verify(windows.config, windows.records[1:], windows.events)


def test_another_window_is_another_configuration(windows):
    config = dataclasses.replace(windows.config, window_s=2.5)
    assert "time of closed windows = their number times T_window" in failing(
        config, windows.records, windows.events
    )
    assert verify(windows.config, windows.records, windows.events) > 0


# -- in general --------------------------------------------------------------------------------

# Neither asks nor the time of tasks depends on the others.
COUNTED = [
    kind
    for kind in EventKind
    if kind
    not in (
        EventKind.ITERATION,
        EventKind.PUSH_DROPPED,
        EventKind.EXECUTION_END,
        EventKind.RETREAT_END,
    )
]
COLUMNS = (
    "planning_time_s",
    "waiting_s",
    "window_wait_s",
    "interaction_s",
    "execution_s",
    "start_ns",
    "end_ns",
    "requests",
    "answered",
    "grants",
    "refusals",
    "expired",
)
REQUEST_COLUMNS = ("asking_s", "served_s", "withdrawn")  # of fleets that plan meanwhile


@settings(max_examples=100, deadline=None)
@given(config=CONFIGS, seed=st.integers(0, 1000), data=st.data())
def test_no_single_error_escapes(config, seed, data):
    fleet, _ = simulate(config, seed)
    assert not failing(config, fleet.records, fleet.events)

    counted = [i for i, event in enumerate(fleet.events) if event.kind in COUNTED]
    i = data.draw(st.sampled_from(counted))
    assert failing(config, fleet.records, fleet.events[:i] + fleet.events[i + 1 :])

    j = data.draw(st.integers(0, len(fleet.records) - 1))
    plans = fleet.records[j].withdrawn is not None
    field = data.draw(st.sampled_from(COLUMNS + REQUEST_COLUMNS if plans else COLUMNS))
    records = list(fleet.records)
    records[j] = altered(records[j], field)
    assert failing(config, records, fleet.events)
    assert failing(config, fleet.records[:j] + fleet.records[j + 1 :], fleet.events)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 1000),
    # Times that are no sums of powers of two: their float sums would not be exact.
    service=st.floats(0.1, 30.0),
    window=st.floats(0.0, 3.0),
    rollout=st.floats(0.01, 3.0),
    policy=st.sampled_from(["pgf", "or-hitl", "or-hitl-window", "always", "queue", "random"]),
    operators=st.integers(1, 3),
    horizon=st.none() | st.floats(0.1, 200.0),
)
def test_they_hold_to_the_nanosecond(seed, service, window, rollout, policy, operators, horizon):
    config = FleetConfig(
        robots=4,
        tasks=2,
        policy=policy,
        operators=operators,
        service_mean_s=service,
        service_sd_s=service / 2,
        window_s=window,
        rollout_time_s=rollout,
        compute="shared:10",
        horizon_s=horizon,
        task_limit_s=60.0,
        seed=seed,
    )
    fleet, _ = simulate(config, seed)
    assert not failing(config, fleet.records, fleet.events)
