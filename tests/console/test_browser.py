"""The console in a real browser: mouse, keyboard, and the event log of the session."""

import numpy as np
import polars as pl
from pages import (
    browser,
    click_shelf,
    console,
    interrupt,
    large,
    scene_of,
    visit,
    wait_for,
    wait_for_text,
)

import pgf_jax
from pgf_jax.console.input_panel import target_problem
from pgf_jax.guidance.view import View
from pgf_jax.planning.search import start_world
from pgf_jax.planning.types import Push
from pgf_jax.tables.event_log import first_difference, read_log

BUTTONS = ("Push", "Go on reaching", "Undo", "Operate")


def a_push(scene) -> Push:
    """A push of an object at the front to a free place."""
    positions = scene.positions

    class Shelf(View):
        def __init__(self):
            pass

    shelf = Shelf()
    object.__setattr__(shelf, "objects", start_world(positions).objects)
    for pushed in np.argsort(positions[:, 0]):
        for dx, dy in ((0.04, 0.0), (0.03, 0.05), (0.03, -0.05), (0.0, 0.07), (0.0, -0.07)):
            x, y = positions[pushed] + (dx, dy)
            if pushed != scene.goal and not target_problem(shelf, int(pushed), x, y):
                return Push(int(pushed), float(x), float(y))
    raise AssertionError("no object can be pushed anywhere")


def wait_until_enabled(page, *names: str) -> None:
    """Wait until these buttons can act, and no others."""

    def enabled():
        buttons = [(name, page.get_by_role("button", name=name, exact=True)) for name in BUTTONS]
        return {name for name, button in buttons if button.is_enabled()}

    wait_for(lambda: enabled() == set(names))


def test_a_person_clicks_an_object_and_a_place_and_the_robot_goes_on_with_that(tmp_path):
    """The operator also leaves and comes back, a second client watches; the session replays."""
    # `always` asks before it plans, so a robot asks at once.
    options = ("--robots", "2", "--tasks", "1", "--policy", "always", "--seed", "0")
    with console(tmp_path / "s", *options) as server, browser() as chromium:
        received: list[bytes] = []
        page = visit(chromium, server.url, received)
        wait_for_text(page, "Robot 0 asks")
        for text in ("Each robot must grasp its green object.", "object to grasp", "being helped"):
            wait_for_text(page, text)
        push, cell = a_push(scene_of(0, 0)), large(2, 0)
        positions = scene_of(0, 0).positions

        wait_until_enabled(page, "Go on reaching")
        click_shelf(page, cell, positions[push.object])
        wait_until_enabled(page, "Go on reaching", "Undo")
        wait_for_text(page, f"Object {push.object + 1}: now click where it should come to.")
        # Targets that are not allowed are refused, and the picked object is kept.
        click_shelf(page, cell, np.array([0.5, 0.43]))
        wait_for_text(page, "That is outside the shelf.")
        click_shelf(page, cell, positions[scene_of(0, 0).goal])
        wait_for_text(page, f"Object {scene_of(0, 0).goal + 1} stands there.")
        click_shelf(page, cell, np.array([push.x, push.y]))
        wait_for_text(page, "Push (Enter)")
        wait_until_enabled(page, "Push", "Go on reaching", "Undo")

        # A second client may watch only.
        other = visit(chromium, server.url)
        wait_for_text(other, "You watch, somebody else operates.")
        wait_until_enabled(other)
        other.keyboard.press("Enter")
        wait_for_text(other, "you watch")
        other.close()
        assert not [e for e in server.events() if e["kind"] == "service_end"]

        page.get_by_role("button", name="Push").click()
        wait_for_text(page, "m deep on the shelf")
        # The operator does not learn the policy.
        assert any(b"Robot 0: being helped" in messages for messages in received)
        assert not any(b"always" in messages or b"pgf" in messages for messages in received)
        assert "always" not in page.inner_text("body")
        given = server.wait_for(
            lambda events: [e for e in events if e["kind"] == "service_end" and e["robot"] == 0]
        )[0]
        assert (given["outcome"], given["object"]) == ("push", push.object)
        # Within two pixels of where the mouse was.
        assert np.hypot(given["x"] - push.x, given["y"] - push.y) < 0.003
        # The task goes on with that input: the robot plans the push.
        server.wait_for(
            lambda events: [
                e
                for e in events
                if e["kind"] == "iteration" and e["robot"] == 0 and e.get("object") == push.object
            ]
        )

        # The second robot has waited in line; this one is answered by keyboard.
        wait_for_text(page, "Robot 1 asks")
        page.close()
        server.wait_for(lambda events: [e for e in events if e["kind"] == "operator_away"])
        page = visit(chromium, server.url)
        server.wait_for(lambda events: [e for e in events if e["kind"] == "operator_back"])
        wait_for_text(page, "Robot 1 asks")
        page.keyboard.press("g")
        wait_for_text(page, "Go on reaching.")
        server.wait_for(
            lambda events: [
                e for e in events if e["kind"] == "service_end" and e.get("outcome") == "go_on"
            ]
        )
        wait_for(lambda: "you watch" in server.log())
        interrupt(server)

    log = read_log(tmp_path / "s")
    replayed = pgf_jax.sweep(
        pgf_jax.SweepConfig(operator="replay", log=tmp_path / "s", out=tmp_path / "r"), quiet=True
    )
    assert same_events(replayed.events(), pl.read_parquet(tmp_path / "s" / "events.parquet"))
    # The journal is the beginning of the log: the end is in the tables only.
    journal = read_log(tmp_path / "s" / "events.jsonl")
    assert first_difference(log.events, journal.events) is None


def test_a_killed_server_goes_on_where_it_was(tmp_path):
    """Acknowledged answers are kept, and the open page connects again by itself."""
    options = ("--robots", "2", "--tasks", "1", "--policy", "always")
    with browser() as chromium:
        with console(tmp_path / "s", *options) as server:
            page = visit(chromium, server.url)
            wait_for_text(page, "Robot 0 asks")
            page.keyboard.press("g")
            wait_for_text(page, "Go on reaching.")
            before = server.events()  # the answer is on the disk by now
            server.process.kill()
            server.process.wait()
        ends = [event for event in before if event["kind"] == "service_end"]
        assert [(event["robot"], event["outcome"]) for event in ends] == [(0, "go_on")]

        resume = ("--resume", "--port", str(server.port))
        with console(tmp_path / "s", *resume) as server:
            assert server.events()[: len(before)] == before
            # The new server has the address of the page, so the page connects again.
            wait_for_text(page, "You operate.")

            def answered():
                page.keyboard.press("g")  # it may take a moment until the page has its keys again
                page.wait_for_timeout(300)
                return [e for e in server.events() if e.get("outcome") == "go_on"][1:]

            (answer,) = wait_for(answered)
            assert answer["robot"] == 1
            interrupt(server)

    events = read_log(tmp_path / "s").events
    answers = [event.robot for event in events if event.outcome == "go_on"]
    assert answers == [0, 1]
    config = pgf_jax.SweepConfig(operator="replay", log=tmp_path / "s", out=tmp_path / "r")
    replayed = pgf_jax.sweep(config, quiet=True).events()
    assert same_events(replayed, pl.read_parquet(tmp_path / "s" / "events.parquet"))


def same_events(replayed: pl.DataFrame, recorded: pl.DataFrame) -> bool:
    """Whether a replay is as recorded; the two tables stack, and differ in who gave the inputs."""
    assert replayed.schema == recorded.schema
    own = ["operator_name", "log_sha256", "horizon"]
    return replayed.drop(own).equals(recorded.drop(own))
