"""Recorded operators: what a log says of them, and sweeps that bring a session back from it."""

import dataclasses
import json
import math
import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweep_toys import ghost
from write_log import write_log

import pgf_jax
from pgf_jax.console.live_operator import InputRequest, LiveOperator
from pgf_jax.errors import BadInput
from pgf_jax.fleet import Event, EventKind, Fleet
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.simulator import Attendance
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.simulation.recorded_operator import Recording
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.replay import (
    agreed_settings,
    replay,
    replay_config,
    replay_difference,
    settings_of,
)
from pgf_jax.sweeping.resolve import resolve
from pgf_jax.sweeping.stored_fleet import snapshots
from pgf_jax.sweeping.sweep import sweeps
from pgf_jax.tables import results
from pgf_jax.tables.event_log import JOURNAL, TABLE, EventLog, Journal, digest, line
from pgf_jax.tables.parquet import encode_table

S = 10**9
FEW = [
    Event(0, EventKind.TASK_START, 0, 0),
    Event(0, EventKind.TASK_START, 1, 0),
    Event(5, EventKind.GRANT, 0, 0, 0, 0),
    Event(12, EventKind.SERVICE_END, 0, 0, 0, 0, object=5, x=0.25, y=-0.1, outcome="push"),
    Event(12, EventKind.OPERATOR_AWAY, operator=0),
    Event(20, EventKind.OPERATOR_BACK, operator=0),
    Event(20, EventKind.GRANT, 1, 0, 0, 0),
    Event(20, EventKind.SERVICE_END, 1, 0, 0, 0, outcome="go_on"),
    Event(30, EventKind.GRANT, 0, 0, 1, 0),
    Event(100, EventKind.SERVICE_END, 0, 0, 1, 0, outcome="unanswered"),
    Event(110, EventKind.GRANT, 1, 0, 1, 0),
    Event(120, EventKind.SERVICE_END, 1, 0, 1, 0, outcome="expired"),
    Event(120, EventKind.TASK_END, 1, 0, outcome="timed_out"),
    Event(130, EventKind.GRANT, 0, 0, 2, 0),
]


def log_of(events, about=None) -> EventLog:
    return EventLog(Path("events.jsonl"), [list(events)], about or {})


# -- what a log says of the operator ---------------------------------------------------------------


def test_what_was_said_and_when():
    recording = Recording.of(log_of(FEW))
    assert recording.inputs == {
        (0, 0, 0): (7, Push(5, 0.25, -0.1)),
        (1, 0, 0): (0, None),
        (0, 0, 1): (70, UNANSWERED),
    }
    assert recording.attendance == (Attendance(12, 0, False), Attendance(20, 0, True))
    assert recording.end_ns == 130
    assert recording.sha256 == digest(FEW) != digest(FEW[:-1])
    assert recording.seconds(0, 0, 0) == 7e-9
    assert recording.seconds(1, 0, 1) is None  # cut off by the task's limit
    assert recording.seconds(0, 0, 2) is None  # not answered any more
    assert recording.seconds(3, 0, 0) is None


def test_the_log_of_nothing():
    recording = Recording.of(log_of([]))
    assert (recording.inputs, recording.attendance, recording.end_ns) == ({}, (), 0)


def test_an_end_at_the_horizon_is_no_answer():
    cut = Event(140, EventKind.SERVICE_END, 0, 0, 2, 0, outcome="censored")
    assert Recording.of(log_of([*FEW, cut])).inputs == Recording.of(log_of(FEW)).inputs


@settings(max_examples=300)
@given(start=st.integers(0, 2**50), length=st.integers(0, 2**50))
def test_lengths_come_back_to_the_nanosecond(start, length):
    events = [
        Event(start, EventKind.GRANT, 0, 0, 0, 0),
        Event(start + length, EventKind.SERVICE_END, 0, 0, 0, 0, outcome="go_on"),
    ]
    seconds = Recording.of(log_of(events)).seconds(0, 0, 0)
    assert seconds is not None and nanoseconds(seconds) == length


BROKEN = {
    "no grant": ({3: None, 2: None}, {}, None),
    "an end without its beginning": ({2: None}, {}, "event 3: a service ends that did not begin"),
    "another request": ({}, {3: {"request": 1}}, "event 4: a service ends that did not begin"),
    "no object": ({}, {3: {"object": None}}, "event 4: a push without its object or place"),
    "no x": ({}, {3: {"x": None}}, "event 4: a push without its object or place"),
    "no y": ({}, {3: {"y": None}}, "event 4: a push without its object or place"),
    "no outcome": ({}, {3: {"outcome": None}}, "event 4: unknown end of a service None"),
    "odd outcome": ({}, {3: {"outcome": "pull"}}, "event 4: unknown end of a service 'pull'"),
    "nobody's grant": ({}, {2: {"robot": None}}, "event 3: a service without its robot"),
    "no task": ({}, {2: {"task": None}}, "event 3: a service without its robot, task"),
    "no request": ({}, {3: {"request": None}}, "event 4: a service without its robot, task or"),
    "nobody comes": ({}, {4: {"operator": None}}, "event 5: expected which operator, got none"),
    "nobody leaves": ({}, {5: {"operator": None}}, "event 6: expected which operator, got none"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_log_that_is_none_of_one_fleet(what):
    dropped, changed, words = BROKEN[what]
    events = [
        event._replace(**changed.get(number, {}))
        for number, event in enumerate(FEW)
        if number not in dropped
    ]
    if words is None:
        assert len(Recording.of(log_of(events)).inputs) == 2
        return
    with pytest.raises(BadInput) as caught:
        Recording.of(log_of(events))
    assert str(caught.value).startswith(f"events.jsonl: {words}")


def test_the_log_of_several_fleets_is_of_no_operator():
    with pytest.raises(BadInput, match="expected the log of one fleet, got 2"):
        Recording.of(EventLog(Path("events.parquet"), [FEW, FEW], {}))


# -- settings --------------------------------------------------------------------------------------


def test_settings_are_as_json_has_them(tmp_path):
    config = ghost(tmp_path, scenes=tmp_path, horizon=7.0)
    found = settings_of(config)
    assert json.loads(json.dumps(found)) == found
    assert found["scenes"] == str(tmp_path) and found["robots"] == [1, 2]
    assert not {"operator", "log", "out", "resume", "workers"} & set(found)


def test_settings_that_agree():
    recorded = {"a": 1, "b": 2, "c": [3], "more": 0}
    defaults = {"a": 0, "b": 0, "c": None}
    path = Path("log")
    whole = {"a": 1, "b": 2, "c": [3]}
    for ours in (defaults, whole, defaults | {"b": 2}):
        assert agreed_settings(ours, defaults, recorded, path) == whole
    with pytest.raises(BadInput) as caught:
        agreed_settings(defaults | {"b": 3}, defaults, recorded, path)
    assert str(caught.value) == "b: 3, but log was recorded with 2; leave it out"
    with pytest.raises(BadInput) as caught:
        agreed_settings(defaults, defaults, {"a": 1, "b": 2}, path)
    assert str(caught.value) == "log: its settings lack c"
    # One that was added later was recorded with the value that was built in then.
    later = defaults | {"task_limit": 180.0}
    assert agreed_settings(later, later, recorded, path) == whole | {"task_limit": 180.0}


def about(**changes) -> dict:
    config = ghost(Path("out"), robots=(2,), policies=("or-hitl",), **changes)
    return {"settings": settings_of(config), "identity": {"versions": {"pgf_jax": "7"}}}


CONFIG = SweepConfig(operator="replay", log=Path("events.jsonl"))


def test_a_replay_takes_over_what_was_recorded():
    log = log_of([], about(seed=5, tasks=3, window=4.0))
    config = replay_config(dataclasses.replace(CONFIG, out=Path("here")), log)
    assert (config.seed, config.tasks, config.window, config.engine) == (5, 3, 4.0, "ghost")
    assert (config.robots, config.policies) == ((2,), ("or-hitl",))
    assert (config.operator, config.log, config.out) == ("replay", CONFIG.log, Path("here"))
    with pytest.raises(BadInput, match=r"seed: 4, but events\.jsonl was recorded with 5"):
        replay_config(dataclasses.replace(CONFIG, seed=4), log)


def ended(tasks, time_ns=50):
    return [Event(time_ns, EventKind.TASK_END, r, t, outcome="solved") for r, t in tasks]


@pytest.mark.parametrize(
    ("events", "horizon"),
    [
        (ended([(0, 0), (0, 1), (1, 0), (1, 1)]), None),
        ([*ended([(0, 0), (0, 1), (1, 0)]), Event(70, EventKind.GRANT, 1, 1, 0, 0)], "after"),
        ([Event(0, EventKind.TASK_START, 0, 0)], "after"),
        ([], "after"),
        (
            [
                *ended([(0, 0), (0, 1), (1, 0)]),
                Event(70, EventKind.TASK_END, 1, 1, outcome="censored"),
            ],
            70,
        ),
    ],
    ids=["whole", "killed", "killed at once", "nothing", "stopped"],
)
def test_the_horizon_of_a_replay(events, horizon):
    config = replay_config(CONFIG, log_of(events, about()))
    if horizon is None:
        assert config.horizon is None
        return
    assert config.horizon is not None
    if horizon == "after":
        # At its last event at least; what comes later is not known.
        end_ns = events[-1].time_ns if events else 0
        assert max(1, end_ns) <= nanoseconds(config.horizon) <= end_ns + 1
    else:
        assert nanoseconds(config.horizon) == horizon


def test_a_recorded_horizon_is_kept():
    whole = ended([(0, 0), (0, 1), (1, 0), (1, 1)])
    assert replay_config(CONFIG, log_of(whole, about(horizon=90.0))).horizon == 90.0


def changed_settings(**changes):
    return about() | {"settings": about()["settings"] | changes}


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({}, "does not say its settings, expected the log of a session"),
        ({"settings": {}}, "its settings lack"),
        (changed_settings(robots=[1, 2]), "settings that cannot be used"),
        (changed_settings(robots=None), "settings that cannot be used"),
        (changed_settings(robots=7), "settings that cannot be used"),
        (changed_settings(policies=[]), "settings that cannot be used"),
        (changed_settings(policies=["none such"]), "settings that cannot be used"),
        (changed_settings(engine="none such"), "settings that cannot be used"),
        (changed_settings(tasks=-1), "settings that cannot be used"),
        (changed_settings(tasks="many"), "settings that cannot be used"),
        (changed_settings(seed=None), "settings that cannot be used"),
        (changed_settings(horizon="inf"), "settings that cannot be used"),
        (changed_settings(scenes=5), "settings that cannot be used"),
        (changed_settings(preset="quick"), "settings that cannot be used"),
        (changed_settings(random_winner=7), "settings that cannot be used"),
        (changed_settings(compute="none such"), "settings that cannot be used"),
    ],
)
def test_settings_of_a_log_that_cannot_be_used(said, words):
    with pytest.raises(BadInput) as caught:
        replay_config(CONFIG, log_of([], said))
    assert str(caught.value).startswith(f"events.jsonl: {words}")
    assert "\n" not in str(caught.value)


def test_where_a_replay_went_another_way():
    log = log_of(FEW, about())
    assert replay_difference(FEW, log) is None
    assert replay_difference([*FEW, FEW[0]], log) is None
    others = [*FEW[:4], FEW[4]._replace(time_ns=13), *FEW[5:]]
    assert replay_difference(others, log) == (
        "events.jsonl: the replay differs from event 5 on; it was recorded with pgf_jax 7"
    )
    assert str(replay_difference(FEW[:2], log_of(FEW))).endswith("event 3 on; it was recorded with "
                                                       "other versions")  # fmt: skip


def test_live_and_replay_have_their_places(tmp_path):
    with pytest.raises(BadInput, match="operator: live is "):
        pgf_jax.sweep(ghost(tmp_path / "out", operator="live"), quiet=True)
    assert not (tmp_path / "out").exists()
    with pytest.raises(BadInput, match="log: expected with operator replay and only with it"):
        ghost(tmp_path, operator="replay")
    for name in ("none", "heuristic", "live"):
        with pytest.raises(BadInput, match=f"log: expected .* got log with '{name}'"):
            ghost(tmp_path, operator=name, log=Path("log"))
    for log in (tmp_path / "none.jsonl", tmp_path):
        with pytest.raises(BadInput, match=f"^{log}: "):
            pgf_jax.sweep(SweepConfig(operator="replay", log=log, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


# -- sessions, brought back ------------------------------------------------------------------------


@dataclasses.dataclass
class Recorded:
    """A session with a person who does as chance will have it, and what it left behind."""

    folder: Path
    runner: FleetRunner
    about: dict

    @property
    def events(self) -> list[Event]:
        return self.runner.fleet.events

    def write(self, folder: Path, events: list[Event], name: str = JOURNAL) -> Path:
        if name == TABLE:
            folder.mkdir(exist_ok=True)
            write_log(folder / TABLE, events, self.about)
        else:
            journal = Journal(folder / JOURNAL, self.about)
            journal.append(events)
            journal.close()
        return folder / name


def record(folder: Path, seed: int, *, stop_ns: int | None = None, **changes) -> Recorded:
    settings = {"robots": (2,), "policies": ("eager",), "operator": "live", "seed": 0}
    config = ghost(folder, **(settings | changes))
    (cell,) = resolve(config).cells
    asked: list[InputRequest] = []
    operator = LiveOperator(asked.append, None)

    def new_fleet(planned):
        return Fleet(cell.fleet.config, planned, service=operator)

    runner = FleetRunner.of(cell.fleet, new_fleet=new_fleet, operator=operator)
    chance, time_ns = random.Random(seed), 0
    while not runner.fleet.done:
        time_ns += chance.choice([1, S // 3, 2 * S, 11 * S])
        runner.run_until(time_ns)
        if stop_ns is not None and time_ns > stop_ns:
            runner.fleet.stop()
            runner.run_until()
            break
        asked[:] = [each for each in asked if runner.fleet.operators.serving(0) == each.robot][-1:]
        if asked and chance.random() < 0.6:
            each = asked.pop()
            x, y = map(float, each.view.objects[5])
            each.answer(
                chance.choice(
                    [None, UNANSWERED, Push(5, x, y), Push(5, x, y), Push(6, 0.9 * x, -y)]
                )
            )
        if chance.random() < 0.1:
            runner.fleet.set_attendance(0, chance.random() < 0.7)
    about = {"settings": settings_of(config), "identity": cell.identity}
    return Recorded(folder, runner, about)


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Recorded:
    """All kinds of answers, pushes that succeed and that do not."""
    found = record(tmp_path_factory.mktemp("session"), 3)
    outcomes = {event.outcome for event in found.events if event.kind is EventKind.SERVICE_END}
    assert outcomes >= {"push", "go_on", "unanswered"}
    kinds = {event.kind for event in found.events}
    assert kinds >= {"push_dropped", "retreat_end", "operator_away", "operator_back"}
    return found


def swept(log: Path, out: Path, **changes) -> list[Event]:
    config = SweepConfig(operator="replay", log=log, out=out, **changes)
    frame = pgf_jax.sweep(config, quiet=True).events()
    return results.event_log(frame.select(list(results.EVENT_SCHEMA)))


def same(events, others) -> bool:
    return [*map(line, events)] == [*map(line, others)]


@pytest.mark.parametrize("name", [JOURNAL, TABLE, "folder"])
def test_a_sweep_replays_a_session(name, session, tmp_path):
    log = session.write(tmp_path / "log", session.events, name if name != "folder" else JOURNAL)
    out = tmp_path / "out"
    assert same(swept(log.parent if name == "folder" else log, out), session.events)
    tasks = results.read_results(out / "tasks.parquet", results.TASK_SCHEMA)
    assert repr(results.task_records(tasks)) == repr(
        sorted(session.runner.fleet.records, key=lambda record: (record.robot, record.task))
    )
    # Named again, the settings are the same; and it can be gone on with like any sweep.
    assert same(
        swept(log, out, robots=(2,), engine="ghost", tasks=2, resume=True), session.events
    )  # fmt: skip
    with pytest.raises(BadInput, match=r"tasks: 7, but .* was recorded with 2; leave it out"):
        swept(log, tmp_path / "other", tasks=7)


def test_a_session_that_was_stopped_is_replayed(tmp_path):
    session = record(tmp_path / "s", 5, stop_ns=60 * S)
    assert any(event.outcome == "censored" for event in session.events)
    log = session.write(tmp_path / "log", session.events, TABLE)
    assert same(swept(log, tmp_path / "out"), session.events)


def cut_points(session: Recorded, kind: EventKind) -> list[int]:
    return [n + 1 for n, event in enumerate(session.events) if event.kind is kind]


@pytest.mark.parametrize("kind", ["grant", "service_end", "iteration", "operator_away", "bid"])
def test_a_session_whose_server_was_killed_is_replayed(kind, session, tmp_path):
    number = cut_points(session, EventKind(kind))[-1]
    # All of an instant is written at once, unless a line was cut off.
    log = session.write(tmp_path / "log", session.events[:number])
    assert same(swept(log, tmp_path / "out")[:number], session.events[:number])


def test_a_session_that_was_killed_at_the_start_of_a_task_is_replayed(session, tmp_path):
    number = cut_points(session, EventKind.TASK_START)[-1]
    assert session.events[number - 1].time_ns > 0
    log = session.write(tmp_path / "log", session.events[:number])
    assert same(swept(log, tmp_path / "out")[:number], session.events[:number])


def replayed(log: Path) -> str | None:
    """What a replay says of a log, without a sweep's files."""
    runner, recorded = replay(log)
    runner.run_until()
    return replay_difference(runner.fleet.events, recorded)


def test_a_runner_replays_a_session(session, tmp_path):
    log = session.write(tmp_path / "log", session.events)
    assert replayed(log) is None
    frames = list(snapshots(log, every_ns=7 * S))
    assert frames[-1].time_ns >= session.events[-1].time_ns
    assert [frame.time_ns for frame in frames] == [7 * S * n for n in range(len(frames))]


def services(session: Recorded, outcome: str) -> list[int]:
    return [n for n, event in enumerate(session.events) if event.outcome == outcome]


def tampered(session: Recorded, how: str) -> list[Event]:
    events = list(session.events)
    push = services(session, "push")[0]
    if how == "another place":
        events[push] = events[push]._replace(x=(events[push].x or 0) + 0.2)
    elif how == "another object":
        events[push] = events[push]._replace(object=11)
    elif how == "no push":
        events[push] = events[push]._replace(object=None, x=None, y=None, outcome="go_on")
    elif how == "a ns later":
        events[push] = events[push]._replace(time_ns=events[push].time_ns + 1)
    elif how == "another gain":
        number = next(n for n, e in enumerate(events) if e.gain is not None and e.gain < math.inf)
        events[number] = events[number]._replace(gain=(events[number].gain or 0) + 1e-9)
    elif how == "another end":
        events[-1] = events[-1]._replace(outcome="non_finite")
    else:
        number = next(n for n, event in enumerate(events) if event.kind == how)
        del events[number]
    return events


# Not what would make the log of another session: a coming or going that nobody waited for.
TAMPERING = (
    "another place", "another object", "no push", "a ns later", "another gain", "another end",
    "task_start", "iteration", "bid", "grant", "service_end", "push_dropped",
    "execution_end", "retreat_end", "task_end",
)  # fmt: skip


@pytest.mark.parametrize("how", TAMPERING)
def test_a_log_that_was_changed_does_not_pass_for_a_replay(how, session, tmp_path):
    events = tampered(session, how)
    assert not same(events, session.events)
    log = session.write(tmp_path / "log", events)
    try:
        difference = replayed(log)
    except BadInput as refused:
        difference = str(refused)
    assert difference is not None and difference.startswith(str(log)) and "\n" not in difference


@pytest.mark.parametrize("how", ["another place", "iteration"])
def test_a_sweep_says_so(how, session, tmp_path):
    log = session.write(tmp_path / "log", tampered(session, how))
    with pytest.raises(BadInput, match=r"the replay differs from event \d+ on; .* jax \d"):
        swept(log, tmp_path / "out")
    # Nor does it pass the second time, when its cell is there.
    with pytest.raises(BadInput, match="the replay differs"):
        swept(log, tmp_path / "out", resume=True)


def test_a_push_of_an_object_that_is_not_there(session, tmp_path):
    events = list(session.events)
    push = services(session, "push")[0]
    events[push] = events[push]._replace(object=20)
    log = session.write(tmp_path / "log", events)
    with pytest.raises(BadInput, match="object 20 on a shelf with 20 objects"):
        swept(log, tmp_path / "out")


def test_an_operator_who_is_not_there(session, tmp_path):
    events = list(session.events)
    number = next(n for n, e in enumerate(events) if e.kind is EventKind.OPERATOR_AWAY)
    events[number] = events[number]._replace(operator=1)
    log = session.write(tmp_path / "log", events)
    try:
        assert replayed(log) is not None
    except BadInput as refused:
        assert "\n" not in str(refused)


def test_a_log_of_a_sweep_is_not_replayed(tmp_path):
    config = ghost(tmp_path / "sweep", robots=(1,), tasks=1)
    found = pgf_jax.sweep(config, quiet=True)
    cell = config.cells()[0]
    one = tmp_path / TABLE  # of one fleet, as that of a session
    one.write_bytes(encode_table(found.cell(cell).events))
    for log in (found.out, one):
        with pytest.raises(BadInput, match="does not say its settings"):
            swept(log, tmp_path / "out")
    with pytest.raises(BadInput, match=rf"{found.files[cell]}: column time_ns must be Int64, got"):
        swept(found.files[cell], tmp_path / "out")


def test_two_logs_in_one_process(session, tmp_path):
    others = record(tmp_path / "s", 11)
    assert not same(others.events, session.events)
    logs = [
        each.write(tmp_path / f"log{n}", each.events) for n, each in enumerate((session, others))
    ]
    configs = [
        SweepConfig(operator="replay", log=log, out=tmp_path / f"out{n}")
        for n, log in enumerate(logs)
    ]
    found = sweeps(configs, quiet=True)
    for result, each in zip(found, (session, others), strict=True):
        frame = result.events().select(list(results.EVENT_SCHEMA))
        assert same(results.event_log(frame), each.events)
