"""Sessions without a page: what a person does is in the log, and the log replays it."""

import dataclasses
import json
import random
import types
from pathlib import Path

import pytest
from session_toys import ME, OTHER, Person, toy

import pgf_jax
from pgf_jax.console import session as session_module
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.input_panel import Feedback
from pgf_jax.console.session import Session, WallClock
from pgf_jax.console.session_spec import SessionSpec
from pgf_jax.errors import BadInput
from pgf_jax.fleet import Event, EventKind
from pgf_jax.planning.types import Push
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.replay import replay, replay_difference
from pgf_jax.tables import results
from pgf_jax.tables.event_log import JOURNAL, TABLE, line, read_log

S = 10**9
ENDS = ("push", "go_on")


def answers(events: list[Event]) -> list[tuple[tuple, Push | None]]:
    """The services that were answered, with their inputs, by the log."""
    return [
        (
            (event.robot, event.task, event.request),
            None if event.object is None else Push(event.object, event.x or 0.0, event.y or 0.0),
        )
        for event in events
        if event.kind is EventKind.SERVICE_END and event.outcome in ENDS
    ]


def same(events, others) -> bool:
    return [*map(line, events)] == [*map(line, others)]


def replayed(log: Path, out: Path) -> list[Event]:
    """The events of a sweep that replays a log."""
    result = pgf_jax.sweep(SweepConfig(operator="replay", log=log, out=out), quiet=True)
    return results.event_log(result.events().select(list(results.EVENT_SCHEMA)))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Person:
    """A session that ran to its end; its tables are not written yet."""
    person = Person(toy(tmp_path_factory.mktemp("whole") / "session"))
    with person:
        assert person.take().text == "You operate."
        person.serve()
    return person


@pytest.fixture(scope="module")
def closed(whole) -> Person:
    """The same session, with its tables written."""
    whole.session.recorder.close()
    return whole


# -- answers ---------------------------------------------------------------------------------------


def test_answers_arrive_as_they_were_acknowledged(whole):
    said = [(service, given) for service, given, _ in whole.acknowledged]
    assert len(said) >= 4
    assert {type(given) for _, given in said} == {Push, type(None)}
    log = read_log(whole.journal)
    assert answers(log.events) == said
    assert same(log.events, whole.events)
    assert whole.session.runner.fleet.done


def test_nothing_is_acknowledged_before_it_is_on_the_disk(whole, tmp_path):
    for number, (_, _, data) in enumerate(whole.acknowledged):
        path = tmp_path / f"{number}.jsonl"
        path.write_bytes(data)
        log = read_log(path)
        assert log.size == len(data)  # whole lines
        assert answers(log.events)[number] == whole.acknowledged[number][:2]


def test_a_session_replays(closed, tmp_path):
    folder = closed.journal.parent
    assert same(replayed(folder, tmp_path / "table"), closed.events)
    assert same(replayed(folder / JOURNAL, tmp_path / "journal"), closed.events)
    tasks = results.read_results(folder / "tasks.parquet", results.TASK_SCHEMA)
    again = results.read_results(tmp_path / "table" / "tasks.parquet", results.TASK_SCHEMA)
    assert tasks.equals(again)


@pytest.mark.parametrize(
    "settings",
    [{"while_asking": "plan", "while_served": "plan"}, {"policy": "gain-rate"}],
    ids=["asking", "ranked"],
)
def test_a_session_in_which_robots_plan_on_replays(settings, tmp_path):
    person = Person(toy(tmp_path / "session", tasks=1, rollout_time=3.0, **settings))

    def planned_on() -> bool:
        """Whether a robot has iterated while it was served."""
        served = set()
        for event in [*person.events]:
            if event.kind is EventKind.GRANT:
                served.add(event.robot)
            elif event.kind is EventKind.SERVICE_END:
                served.discard(event.robot)
            elif event.kind is EventKind.ITERATION and event.robot in served:
                return True
        return False

    with person:
        person.take()
        person.wait(planned_on)
        person.serve()
    person.session.recorder.close()
    said = [given[:2] for given in person.acknowledged]
    assert answers(read_log(person.journal).events) == said != []
    assert same(replayed(tmp_path / "session", tmp_path / "replay"), person.events)


def test_tables_are_written_at_the_end(closed):
    folder = closed.journal.parent
    assert read_log(folder).path == folder / TABLE
    assert same(read_log(folder).events, closed.events)
    assert same(read_log(folder / JOURNAL).events, closed.events)
    tasks = results.read_results(folder / "tasks.parquet", results.TASK_SCHEMA)
    assert len(tasks) == 4 and set(tasks["status"]) <= {"solved", "stuck", "timed_out"}
    summary = (folder / "summary.csv").read_text().splitlines()
    assert len(summary) == 2 and summary[1].startswith("asking,2,")
    about = json.loads((folder / "session.json").read_text())
    assert about["settings"]["speed"] == 50.0
    assert about["settings"] == read_log(folder).settings
    assert about["identity"] == read_log(folder / JOURNAL).about["identity"]


def test_what_there_is_to_see(whole):
    frames = whole.frames
    times = [frame.fleet.time_ns for frame in frames]
    assert times == sorted(times)
    assert [frame.over for frame in frames] == [False] * (len(frames) - 1) + [True]
    last = frames[-1]
    assert last.picked is None and not last.running
    assert all(len(robot.done) == 2 for robot in last.fleet.robots)
    for frame in frames:
        if frame.picked is not None:
            assert frame.picked.robot == frame.fleet.serving


# -- operators that come and go --------------------------------------------------------------------


def test_the_clock_starts_when_an_operator_has_come(tmp_path):
    with Person(toy(tmp_path)) as person:
        person.wait(lambda: len(person.frames) >= 2)
        assert not any(frame.running for frame in person.frames)
        assert person.frames[-1].fleet.time_ns == 0
        feedback = person.act(lambda panel: panel.go_on(ME))
        assert (feedback.text, feedback.ok) == ("Nobody operates; you watch.", False)
        assert person.session.runner.fleet.now_ns == 0
        person.take()
        person.wait(lambda: person.frames[-1].running)
        assert not person.take(OTHER).ok
        assert person.act(lambda panel: panel.go_on(OTHER), client=OTHER).ok is False
    assert person.count(EventKind.OPERATOR_AWAY) == 0


def test_one_who_gives_no_answer_is_away_until_they_act(tmp_path):
    with Person(toy(tmp_path, robots=1, tasks=1, patience=5.0)) as person:
        person.take()
        person.wait_for(EventKind.OPERATOR_AWAY)
        (grant,) = [event for event in person.events if event.kind is EventKind.GRANT]
        (end,) = [event for event in person.events if event.kind is EventKind.SERVICE_END]
        assert end.outcome == "unanswered"
        assert end.time_ns - grant.time_ns >= 5 * S
        assert person.session.panel.pending is None
        feedback = person.act(lambda panel: panel.go_on(ME))
        assert (feedback.text, feedback.ok) == ("No robot is being served.", False)
        person.wait_for(EventKind.OPERATOR_BACK)
        # An action of a client that only watches brings no operator back.
        away = person.count(EventKind.OPERATOR_AWAY)
        person.act(lambda panel: panel.undo(OTHER), client=OTHER)
        assert person.count(EventKind.OPERATOR_BACK) == away
    kinds = [event.kind for event in person.events]
    assert kinds.index(EventKind.OPERATOR_AWAY) < kinds.index(EventKind.OPERATOR_BACK)
    person.session.recorder.close()
    assert same(replayed(tmp_path, tmp_path / "replay"), read_log(tmp_path / TABLE).events)


def test_an_operator_who_leaves_and_one_who_comes(tmp_path):
    with Person(toy(tmp_path, patience=1e6)) as person:
        person.take()
        person.wait(lambda: person.session.panel.pending)
        person.session.leave(OTHER)  # who only watched
        person.session.leave(ME)
        person.wait_for(EventKind.OPERATOR_AWAY)
        assert person.session.panel.operator is None
        assert not person.act(lambda panel: panel.go_on(ME)).ok
        assert person.take(OTHER).ok
        person.wait_for(EventKind.OPERATOR_BACK)
        assert (person.count(EventKind.OPERATOR_AWAY), person.count(EventKind.OPERATOR_BACK)) == (
            1, 1
        )  # fmt: skip
        # The service under way went on meanwhile.
        assert person.answer(lambda number: 2, client=OTHER).answered
    assert answers(person.events) == [given[:2] for given in person.acknowledged]


def test_a_service_that_expires_closes_the_panel(tmp_path):
    with Person(toy(tmp_path, robots=1, patience=1e6, speed=1000.0)) as person:
        person.take()
        person.wait(lambda: person.session.panel.pending)
        first = person.session.panel.pending
        assert first is not None
        person.act(lambda panel: panel.click(ME, 0, *map(float, first.view.objects[5])))
        person.wait_for(EventKind.SERVICE_END, outcome="expired")
        person.wait(lambda: person.session.panel.pending is not first)
        seen: list = []

        def look(panel):
            seen.append((panel.pending, panel.object, panel.target))
            return Feedback("seen")

        person.act(look)
        ((pending, picked, target),) = seen
        assert (picked, target) == (None, None)
        assert pending is None or pending.task == 1
    assert answers(person.events) == []


def test_an_act_that_fails_stops_nothing(tmp_path):
    with Person(toy(tmp_path, horizon=500.0)) as person:
        person.take()

        def fail(panel):
            raise RuntimeError("the page sent nonsense")

        for _ in range(3):
            feedback = person.act(fail)
            assert feedback == Feedback("That did not work.", ok=False)
        feedback = person.act(lambda panel: panel.click(ME, 0, "left", None))  # pyright: ignore[reportArgumentType]
        assert not feedback.ok
        person.wait(lambda: person.session.panel.pending)
        assert person.answer(lambda number: 2).answered
        person.wait_for(EventKind.ITERATION)
    assert person.error is None


@pytest.mark.parametrize("changes", [{"horizon": 10.0}, {}], ids=["horizon", "limit"])
def test_an_answer_that_comes_too_late_for_the_fleet(changes, tmp_path):
    # The computation of robot 1 is late. Here the test is the session's thread, and sets the
    # clock.
    config = toy(tmp_path, policy="first asks", robots=2, tasks=1, patience=1e6, **changes)
    session = Session(SessionSpec.load(config), lambda frame: None)
    clock = types.SimpleNamespace(running=True, at_ns=0, now_ns=lambda: clock.at_ns,
                                  hold=lambda at_ns: None, held_s=0.0)  # fmt: skip
    session.clock = clock  # pyright: ignore[reportAttributeAccessIssue]
    feedbacks: list[Feedback] = []

    def turn():
        session._take_in()
        session._advance()

    session.take(ME, feedbacks.append)
    turn()
    assert session.panel.pending is not None and len(session.runner.scheduler) == 1
    clock.at_ns = 9 * S if changes else 179 * S
    turn()
    clock.at_ns += 2 * S  # past the horizon, or the limit of robot 0's task
    turn()
    session.act(ME, lambda panel: panel.go_on(ME), feedbacks.append)
    turn()
    while len(session.runner.scheduler):
        session.runner.scheduler.run_batch()
        turn()
    turn()
    assert len(feedbacks) == 2
    said = answers(session.runner.fleet.events)
    assert feedbacks[1].answered == (said == [((0, 0, 0), None)])
    session.recorder.close()
    runner, log = replay(tmp_path / JOURNAL)
    runner.run_until()
    assert replay_difference(runner.fleet.events, log) is None


# -- the end, and resuming -------------------------------------------------------------------------


def test_a_session_that_was_stopped_can_be_resumed(tmp_path):
    out = tmp_path / "session"
    with Person(toy(out)) as person:
        person.take()
        person.wait(lambda: person.session.panel.pending)
        person.answer(lambda number: 0)
        person.wait_for(EventKind.GRANT, 2)
    summary = person.session.recorder.close()
    assert summary.censored > 0
    journal, table = read_log(out / JOURNAL), read_log(out / TABLE)
    # The table says that the session was cut off; the journal does not, as it can be resumed.
    assert same(table.events[: len(journal.events)], journal.events)
    assert table.events[-1].outcome == "censored"
    assert all(event.outcome != "censored" for event in journal.events)
    assert same(replayed(out, tmp_path / "stopped"), table.events)

    again = Person(toy(out, resume=True))
    assert not (out / TABLE).exists()
    with again:
        again.wait(lambda: again.frames)
        assert not again.frames[0].running
        again.take(OTHER)
        again.answer(lambda number: 2, client=OTHER)
        again.session.leave(OTHER)
        again.take()
        again.serve()
    again.session.recorder.close()
    log = read_log(out / JOURNAL)
    assert same(log.events[: len(journal.events)], journal.events)
    said = [given[:2] for given in person.acknowledged + again.acknowledged]
    assert answers(log.events) == said
    assert same(replayed(out, tmp_path / "whole"), log.events)


def kills(acknowledged: list[tuple], whole_log: bytes, chance: random.Random):
    """Yield (answers acknowledged, bytes on the disk) of servers that are killed at random."""
    # With the first event of the last instant on the disk, the session has ended.
    lines = whole_log.splitlines(keepends=True)
    times = [json.loads(text)["time_ns"] for text in lines[1:]]
    last = sum(map(len, lines[: 1 + times.index(times[-1])]))
    sizes = [len(data) for *_, data in acknowledged if len(data) <= last]
    for number in sorted(chance.sample(range(len(sizes)), 3)):
        end = [*sizes, last][number + 1]
        yield number + 1, whole_log[: chance.randint(sizes[number], end)]
    head = whole_log.index(b"\n") + 1
    yield 0, whole_log[: chance.randrange(head, sizes[0])]


def test_nothing_that_was_acknowledged_is_lost_with_the_server(whole, tmp_path):
    chance = random.Random(0)
    data = whole.journal.read_bytes()
    assert all(data.startswith(earlier) for *_, earlier in whole.acknowledged)
    for count, left in kills(whole.acknowledged, data, chance):
        out = tmp_path / f"{count}"
        out.mkdir()
        (out / JOURNAL).write_bytes(left)
        kept = read_log(out / JOURNAL).events
        with Person(dataclasses.replace(toy(out), resume=True)) as person:
            assert (out / JOURNAL).read_bytes() == left[: left.rindex(b"\n") + 1]
            person.take()
            person.serve(lambda number: (number + 1) % 3)
        person.session.recorder.close()
        log = read_log(out / JOURNAL)
        assert same(log.events[: len(kept)], kept)
        said = answers(log.events)
        assert said[:count] == [given[:2] for given in whole.acknowledged[:count]]
        # An answer may be on the disk that was not acknowledged yet.
        assert said[len(answers(kept)) :] == [given[:2] for given in person.acknowledged]
        assert same(read_log(out).events, log.events)
        assert same(replayed(out, tmp_path / f"replay {count}"), log.events)


def test_folders_that_hold_a_session_are_not_taken(closed, tmp_path):
    folder = closed.journal.parent
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    for name in (JOURNAL, TABLE):
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(BadInput, match=f"{name} exists; expected a new folder, or --resume"):
            SessionSpec.load(toy(tmp_path))
        (tmp_path / name).unlink()
    with pytest.raises(BadInput, match="exists"):
        SessionSpec.load(toy(folder))
    with pytest.raises(BadInput, match="the session has ended; there is nothing to resume"):
        Person(toy(folder, resume=True))
    assert {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()} == before


def with_head(journal: Path, folder: Path, change) -> Path:
    head, *lines = journal.read_bytes().splitlines(keepends=True)
    content = json.loads(head)
    change(content)
    folder.mkdir()
    (folder / JOURNAL).write_bytes(
        b"".join([json.dumps(content).encode() + b"\n", *lines[: len(lines) // 2]])
    )
    return folder


def test_a_session_is_resumed_as_it_was_or_not_at_all(whole, tmp_path):
    out = with_head(whole.journal, tmp_path / "as it was", lambda head: None)
    before = (out / JOURNAL).read_bytes()
    for changes in ({"seed": 7}, {"robots": 3}, {"tasks": 5}, {"speed": 3.0}, {"patience": 7.0}):
        (name,) = changes
        with pytest.raises(
            BadInput, match=rf"^{name}: .*, but .* was recorded with .*leave it out"
        ):
            SessionSpec.load(toy(out, resume=True, **changes))
    # Settings that are not given are as recorded; host and port are those of the new server.
    spec = SessionSpec.load(ConsoleConfig(out=out, resume=True, port=0, host="0.0.0.0"))
    assert spec.config == toy(out, resume=True, port=0, host="0.0.0.0")
    assert spec.start_ns == read_log(out / JOURNAL).events[-1].time_ns

    def version(head):
        head["identity"]["versions"]["jax"] = "0.0.1"

    def device(head):
        head["identity"]["device"] = "an abacus"

    def settings(head):
        head["settings"]["engine"] = "none such"

    def size(head):
        head["settings"]["robots"] = [2, 3]

    def lacking(head):
        del head["settings"]["patience"]

    for change, message in (
        (version, "recorded with another versions than there is now"),
        (device, "recorded with another device than there is now"),
        (settings, "settings that cannot be used"),
        (size, "expected settings with one of robots"),
        (lacking, "its settings lack patience"),
    ):
        other = with_head(whole.journal, tmp_path / change.__name__, change)
        with pytest.raises(BadInput) as caught:
            SessionSpec.load(ConsoleConfig(out=other, resume=True))
        assert message in str(caught.value) and str(other) in str(caught.value)
    assert (out / JOURNAL).read_bytes() == before


def test_a_session_with_other_events_is_not_resumed(whole, tmp_path):
    out = with_head(whole.journal, tmp_path / "out", lambda head: None)
    lines = (out / JOURNAL).read_bytes().splitlines(keepends=True)
    number = next(n for n, text in enumerate(lines) if b'"iteration"' in text)
    for name, left in (
        ("dropped", lines[:number] + lines[number + 1 :]),
        ("changed", [text.replace(b'"push"', b'"go_on"', 1) for text in lines]),
    ):
        other = tmp_path / name
        other.mkdir()
        (other / JOURNAL).write_bytes(b"".join(left))
        with pytest.raises(BadInput, match=r"the replay differs from event \d+ on"):
            Person(toy(other, resume=True))
        assert (other / JOURNAL).read_bytes() == b"".join(left)


def test_there_is_nothing_to_resume(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        SessionSpec.load(toy(tmp_path, resume=True))
    (tmp_path / JOURNAL).write_bytes(b'{"what": "pgf_jax ses')
    with pytest.raises(BadInput, match="is empty, expected an event log"):
        SessionSpec.load(toy(tmp_path, resume=True))


def test_a_horizon_ends_a_session(tmp_path):
    person = Person(toy(tmp_path / "session", horizon=40.0, patience=1e6))
    with person:
        person.take()
        person.join()
    person.session.recorder.close()
    assert person.events[-1].time_ns == 40 * S
    assert person.events[-1].outcome == "censored"
    assert same(read_log(tmp_path / "session" / JOURNAL).events, person.events)
    assert same(replayed(tmp_path / "session", tmp_path / "replay"), person.events)
    with pytest.raises(BadInput, match="the session has ended"):
        Person(toy(tmp_path / "session", resume=True))


# -- other operators -------------------------------------------------------------------------------


def test_simulated_operators_are_watched(tmp_path):
    person = Person(toy(tmp_path / "session", operator="none", speed=1000.0))
    with person:
        person.join()  # the clock starts without an operator
    person.session.recorder.close()
    assert {event.outcome for event in person.events if event.kind is EventKind.SERVICE_END} <= {
        "go_on", "expired"
    }  # fmt: skip
    assert same(replayed(tmp_path / "session", tmp_path / "replay"), person.events)


def test_a_replay_is_watched(closed, tmp_path):
    log = closed.journal.parent
    person = Person(ConsoleConfig(operator="replay", log=log, out=tmp_path, robots=2, tasks=2,
                                  policy="asking", engine="phantom", lanes=4, rollout_time=6.0,
                                  speed=1000.0))  # fmt: skip
    with person:
        # A client that operates changes nothing.
        assert person.take().ok
        assert not person.act(lambda panel: panel.go_on(ME)).ok
        person.session.leave(ME)
        person.join()
    person.session.recorder.close()
    assert same(person.events, closed.events)
    assert same(read_log(tmp_path).events, closed.events)


# -- settings --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robots": 0}, "robots: expected a whole number within 1..100, got 0"),
        ({"robots": 101}, "robots: expected a whole number within 1..100, got 101"),
        ({"robots": 2.0}, "robots: expected a whole number"),
        ({"tasks": 0}, "tasks: expected a whole number 1 or more, got 0"),
        ({"speed": 0.0}, "speed: expected a number"),
        ({"speed": -1.0}, "speed: expected a number"),
        ({"speed": float("nan")}, "speed: expected a number"),
        ({"speed": float("inf")}, "speed: expected a number"),
        ({"patience": 0.0}, "patience: expected a number"),
        ({"patience": "long"}, "patience: expected a number"),
        ({"port": -1}, "port: expected a whole number within 0..65535, got -1"),
        ({"port": 65536}, "port: expected a whole number"),
        ({"host": "localhost"}, "host: expected an address such as 127.0.0.1 or 0.0.0.0"),
        ({"host": ""}, "host: expected an address"),
        ({"host": "127.0.0.1:80"}, "host: expected an address"),
        ({"operator": "somebody"}, "operator: expected one of live, replay, "),
        ({"operator": "replay"}, "log: expected with operator replay and only with it"),
        ({"log": Path("log")}, "log: expected with operator replay and only with it"),
        ({"operator": "none", "resume": True}, "resume: only live sessions are resumed"),
        ({"policy": "none such"}, "policy: expected one of pgf, "),
        ({"engine": "none such"}, "engine: expected one of "),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"window": -1.0}, "window: expected a number"),
        ({"horizon": 0.0}, "horizon: expected a number"),
        ({"compute": "shared"}, "compute: expected dedicated, or shared:C"),
        ({"scene_class": "narrow"}, "scene_class: expected one of"),
        ({"random_winner": 2.0}, "random_winner"),
    ],
)
def test_settings_that_cannot_be_used(changes, message):
    with pytest.raises(BadInput) as caught:
        ConsoleConfig(**changes)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_a_live_session_has_no_oracle():
    with pytest.raises(BadInput, match="oracle-gain"):
        ConsoleConfig(policy="oracle-gain")


@pytest.mark.parametrize(
    ("host", "needed"),
    [("127.0.0.1", False), ("127.8.9.1", False), ("::1", False), ("0.0.0.0", True),
     ("::", True), ("192.168.1.7", True)],
)  # fmt: skip
def test_who_needs_a_token(host, needed):
    assert ConsoleConfig(host=host).needs_token is needed


# -- the clock -------------------------------------------------------------------------------------


def test_the_clock(monkeypatch):
    wall = types.SimpleNamespace(now=100.0)
    wall.monotonic = lambda: wall.now
    monkeypatch.setattr(session_module, "time", wall)
    clock = WallClock(2.0, 7 * S)
    assert (clock.now_ns(), clock.running) == (7 * S, False)
    wall.now += 50
    assert clock.now_ns() == 7 * S
    clock.start()
    wall.now += 1.5
    assert (clock.now_ns(), clock.running) == (10 * S, True)
    clock.hold(9 * S)  # the computer is that late
    assert (clock.now_ns(), clock.held_s) == (9 * S, 0.5)
    wall.now += 1
    assert clock.now_ns() == 11 * S
    clock.stop()
    wall.now += 1
    assert (clock.now_ns(), clock.running) == (11 * S, False)
    clock.start()
    wall.now += 0.5
    assert clock.now_ns() == 12 * S


def test_a_session_that_is_paused_stands_still_until_somebody_operates(tmp_path):
    with Person(toy(tmp_path, robots=1, tasks=1, patience=5.0)) as person:
        person.take()
        person.wait_for(EventKind.GRANT)
        person.session.pause(OTHER)  # who does not operate pauses nothing
        person.act(lambda panel: panel.undo(OTHER), client=OTHER)
        assert person.session.clock.running
        person.session.pause(ME)
        person.act(lambda panel: panel.undo(OTHER), client=OTHER)
        assert not person.session.clock.running and person.session.panel.operator is None
        stood, frames = person.session.clock.now_ns(), len(person.frames)
        person.wait(lambda: len(person.frames) > frames + 2)
        assert person.session.clock.now_ns() == stood and not person.frames[-1].running
        assert person.session.panel.pending is not None  # nobody has run out of patience
        assert person.take(OTHER).ok
        person.wait(lambda: person.session.clock.now_ns() > stood)
    assert person.count(EventKind.OPERATOR_AWAY) == 0
