"""The conversation with a participant, without a network."""

import json
import weakref

import numpy as np
import pytest
from study_toys import ToyPage, answers, arrive, take_part, toy_study, wait_for

from pgf_jax.console.session import Session
from pgf_jax.fleet import FleetConfig
from pgf_jax.guidance.predictors.features import state_features
from pgf_jax.guidance.predictors.survival import survival
from pgf_jax.physics.config import Physics
from pgf_jax.planning.config import Planner
from pgf_jax.simulation.fleet_spec import FleetSpec, TaskScenes
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.study import block
from pgf_jax.study.block import TIMING, has_ended
from pgf_jax.study.sureness import WITHIN, Sureness
from pgf_jax.study.visit import Turns, Visit
from pgf_jax.tables.event_log import read_log


@pytest.fixture
def study(tmp_path):
    return toy_study(tmp_path / "study")


def session_of(visit: Visit) -> Session:
    """The session that runs, once it does."""
    return wait_for(lambda: visit._runner and visit._runner._session)


def done(visit, page, **more) -> None:
    visit.receive({"type": "done", "step": page.page["step"], **more})


def to_practice(visit, page) -> None:
    done(visit, page)
    done(visit, page)


def test_a_participant_goes_from_consent_to_the_code(study):
    visit, page = arrive(study)
    person, kinds = visit.participant, []
    assert "<h1>Welcome</h1>" in page.page["html"] and page.page["of"] == len(person.steps)
    while page.page["kind"] != "closing":
        kind, step = page.page["kind"], page.page["step"]
        kinds.append(kind)
        if kind == "questions":
            done(visit, page, answers=answers()[page.page["heading"]])
        elif kind == "break":
            wait_for(lambda: done(visit, page) or page.page["kind"] != "break")
        elif kind == "text":
            done(visit, page)
        wait_for(lambda s=step: page.page["step"] > s)
    assert kinds == [step.kind for step in person.steps[:-1]]
    assert page.page["code"] == person.code and person.step == person.steps[-1]
    sessions = [person.session(step) for step in person.steps if step.kind in ("practice", "block")]
    assert all(has_ended(folder) for folder in sessions)
    settings = [read_log(folder).settings or {} for folder in sessions]
    assert [one["policies"] for one in settings] == [["random"], ["asking"], ["always"]]
    given = [event["answers"] for event in person.events if "answers" in event]
    assert len(given) == 4 and given[-1] == answers()["Before you go"]
    # No condition is named to the participant.
    assert not any(name in json.dumps(page.of("page")) for name in ("stuck", "asking", "always"))
    visit.close()


def test_a_questionnaire_is_finished_when_it_is_answered(study):
    visit, page = arrive(study)
    person = visit.participant
    place = [step.name for step in person.steps].index("own")
    for step in range(place):
        person.finish(step)
    visit.attach(page.put)
    items = {item["name"]: item for item in page.page["items"]}
    assert items["attention"]["options"] == ("red", "green", "blue") and "correct" not in items
    assert "correct" not in items["attention"]  # what a page is told
    done(visit, page, answers={"preferred": "the third", "comments": "x" * 5000})
    assert page.of("problems")[-1]["problems"].keys() == {"preferred", "attention", "comments"}
    assert person.done == place
    done(visit, page, answers={"preferred": "the first", "attention": "red"})
    assert page.page["kind"] == "closing" and not person.events[-2]["attentive"]
    # The same page once more changes nothing.
    visit.receive({"type": "done", "step": place, "answers": {}})
    assert person.done == place + 1
    visit.close()


def test_the_clock_stands_while_the_page_is_lost_and_the_gap_is_recorded(tmp_path):
    design = toy_study(tmp_path / "study", minutes=0.1, pushes=10_000)
    visit, page = arrive(design)
    to_practice(visit, page)
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["running"])
    visit.detach()
    session = session_of(visit)
    wait_for(lambda: not session.clock.running)
    stood = session.clock.now_ns()
    again = ToyPage()
    visit.attach(again.put)
    wait_for(lambda: again.of("frame") and again.of("frame")[-1]["running"])
    # All of it; a frame that was under way when the page came back may be before it.
    shown = [robot["robot"] for frame in again.of("frame") for robot in frame["robots"]]
    assert set(shown) == {0, 1}
    assert session.clock.now_ns() >= stood and session_of(visit) is session
    again.wait_for("block")
    kinds = [event["kind"] for event in visit.participant.events]
    assert kinds == ["connected", "done", "done", "lost", "connected", "done"]
    visit.close()


def test_a_server_that_stops_goes_on_in_the_same_session(tmp_path):
    design = toy_study(tmp_path / "study", minutes=0.2, pushes=10_000)
    visit, page = arrive(design)
    to_practice(visit, page)
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["time_s"] > 1)
    visit.close()
    folder = visit.participant.session(visit.participant.steps[2])
    before = read_log(folder).events
    assert before and not has_ended(folder)
    again, page = arrive(design, folder=visit.participant.folder)
    assert page.page["kind"] == "practice"
    wait_for(lambda: page.of("frame"))
    assert page.of("frame")[0]["time_s"] >= before[-1].time_ns / 1e9 - 0.1
    page.wait_for("block")
    assert read_log(folder).events[: len(before)] == before
    again.close()


def test_one_session_at_a_time(tmp_path):
    design = toy_study(tmp_path / "study", minutes=0.1, pushes=10_000)
    turns = Turns(1)
    (first, one), (second, two) = arrive(design, turns), arrive(design, turns)
    to_practice(first, one)
    to_practice(second, two)
    assert two.messages[-1]["type"] == "queued" and second._runner is None
    first.detach()  # who is away holds nobody up
    second.begin()
    wait_for(lambda: two.of("frame"))
    first.attach(one.put)
    assert one.messages[-1]["type"] == "queued"
    two.wait_for("block", step=3)
    first.close()
    second.close()


def test_a_session_that_fails_holds_nobody_up_and_is_tried_again(tmp_path, monkeypatch):
    design, turns = toy_study(tmp_path / "study", minutes=0.1, pushes=10_000), Turns(1)
    visit, page = arrive(design, turns)

    def fail(config):
        raise RuntimeError("a secret")

    with monkeypatch.context() as patch:
        patch.setattr(block.SessionSpec, "load", fail)
        to_practice(visit, page)
        wait_for(lambda: page.of("failed"))
    assert "secret" not in json.dumps(page.messages)
    visit.begin()
    assert turns.enter(99)  # somebody else may
    turns.leave(99)
    visit.detach()
    visit.attach(page.put)
    page.wait_for("block")
    visit.close()


def test_who_is_there_already_is_not_shown_everything_again(tmp_path):
    visit, page = arrive(toy_study(tmp_path / "study", minutes=0.1, pushes=10_000))
    to_practice(visit, page)
    runner = wait_for(lambda: visit._runner)
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["running"])
    sent = runner._sent
    visit.begin()  # as the server does from time to time
    assert runner._sent is sent and sent
    visit.detach()
    visit.attach(page.put)
    assert runner._sent is not sent
    visit.close()


def test_the_experimenter_pauses(tmp_path):
    design = toy_study(tmp_path / "study", minutes=0.1, pushes=10_000)
    visit, page = arrive(design)
    to_practice(visit, page)
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["running"])
    visit.pause(True)
    assert page.of("paused")
    wait_for(lambda: not session_of(visit).clock.running)
    visit.pause(False)
    page.wait_for("block")
    visit.close()


def test_what_happens_at_the_page_is_recorded(tmp_path):
    design = toy_study(tmp_path / "study", minutes=0.1, pushes=10_000)
    visit, page = arrive(design)
    visit.receive({"type": "timing", "event": "hidden", "client_ms": 5.5})
    assert visit.participant.events[-1]["event"] == "hidden"
    to_practice(visit, page)
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["served"] is not None)
    visit.receive({"type": "timing", "event": "shown", "client_ms": 7, "robot": 1, "x": "no"})
    visit.receive({"type": "act", "do": "go_on", "id": 3})
    reply = wait_for(lambda: page.of("feedback"))[-1]
    assert (reply["id"], reply["ok"], reply["answered"]) == (3, True, True)
    visit.receive({"type": "ping", "t": 12.5})
    assert page.of("pong")[-1]["t"] == 12.5
    folder = visit.participant.session(visit.participant.steps[2])
    (line,) = (folder / TIMING).read_text().splitlines()
    event = json.loads(line)
    assert event.pop("server_ms") > 0
    assert event == {"event": "shown", "client_ms": 7, "robot": 1}
    visit.close()


@pytest.mark.parametrize(
    "message",
    [
        {},
        {"type": "nonsense"},
        {"type": "timing", "event": "shown"},
        {"type": "timing", "event": "nonsense", "client_ms": 1},
        {"type": "timing", "event": "shown", "client_ms": True},
    ],
)
def test_messages_that_no_page_sends(study, message):
    visit, _ = arrive(study)
    with pytest.raises(ValueError, match=r"no|unknown"):
        visit.receive(message)
    visit.close()


def test_a_session_does_not_end_because_a_page_says_so(study):
    visit, page = arrive(study)
    to_practice(visit, page)
    with pytest.raises(ValueError, match="does not end so"):
        done(visit, page)
    with pytest.raises(ValueError, match="no action"):
        wait_for(lambda: visit._runner)
        visit.receive({"type": "act", "do": "win", "id": 1})
    visit.close()


def test_the_experimenter_ends_a_session(tmp_path):
    design = toy_study(tmp_path / "study", minutes=1.0, pushes=10_000)
    visit, page = arrive(design)
    to_practice(visit, page)
    visit.end_session()  # nothing runs yet, or it has just begun
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["running"])
    visit.end_session()
    page.wait_for("block", step=3)
    folder = visit.participant.session(visit.participant.steps[2])
    wait_for(lambda: has_ended(folder))
    assert read_log(folder).events[-1].time_ns < 60e9
    assert "ended_by_experimenter" in [event["kind"] for event in visit.participant.events]
    visit.close()
    visit.end_session()


def test_a_session_that_has_ended_is_not_kept(tmp_path):
    """A server that runs for a week would not have the memory."""
    visit, page = arrive(toy_study(tmp_path / "study", minutes=10.0, pushes=10_000))
    to_practice(visit, page)
    session = weakref.ref(session_of(visit))
    wait_for(lambda: page.of("frame") and page.of("frame")[-1]["running"])
    visit.end_session()
    page.wait_for("block", step=3)
    wait_for(lambda: session() is None)
    visit.close()


def test_a_page_shows_how_sure_robots_are_in_all_conditions(study):
    visit, page = arrive(study)
    take_part(visit, page)
    visit.close()
    for condition in (3, 6):  # steps of the two blocks
        start = next(i for i, m in enumerate(page.messages)
                     if m["type"] == "page" and m["step"] == condition)  # fmt: skip
        end = next(i for i, m in enumerate(page.messages)
                   if m["type"] == "page" and m["step"] > condition)  # fmt: skip
        shown = [robot for message in page.messages[start:end] if message["type"] == "frame"
                 for robot in message["robots"]]  # fmt: skip
        assert shown and all(robot["sure"] is None or 0 <= robot["sure"] <= 1 for robot in shown)
        assert all(len(robot["heights"]) == len(robot["objects"]) for robot in shown)


def test_how_sure_a_robot_is_follows_its_search():
    config = FleetConfig(robots=2, tasks=1, task_limit_s=60.0)
    spec = FleetSpec(config, "planar", Physics(), Planner(), 4, TaskScenes(0, "tight"), "none")
    runner, sureness = FleetRunner.of(spec), Sureness()
    runner.run_until(0)
    assert sureness.of(runner.robots) == {0: None, 1: None}  # no history yet
    runner.run_until(30 * 10**9)
    network = sureness._network
    searches = [robot.search for robot in runner.robots.robots.values()]
    found = sureness.of(runner.robots)
    for number, search in enumerate(searches):
        expected = 1 - survival(network, state_features(search)[None])[0, WITHIN - 1]
        assert found[number] == (pytest.approx(expected) if np.isfinite(expected) else None)
    assert any(found.values())
