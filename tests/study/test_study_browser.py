"""A participant in a real browser, from consent to the code."""

import json

from pages import browser
from study_platform import moved_on
from study_toys import Served, wait_for

from pgf_jax.study.block import TIMING
from pgf_jax.tables.event_log import read_log


def answer(page) -> None:
    """Fill in the form that is shown."""
    page.click("form button")  # nothing is answered yet
    wait_for(lambda: "please answer this question" in page.inner_text("form"))
    for scale in page.query_selector_all("input[type=range]"):
        scale.focus()
        scale.press("ArrowRight")
    for group in page.query_selector_all("fieldset:has(input[type=radio])"):
        group.query_selector_all("input")[1].check()
    if page.query_selector("textarea"):
        page.fill("textarea", "It was <b>fun</b>.")
    page.click("form button")


def help_robot(page) -> None:
    """Answer the robot that asks by keyboard: a push, where there is room for it."""
    page.keyboard.press("Tab")
    for _ in range(3):
        page.keyboard.press("k")
    page.wait_for_timeout(200)
    page.keyboard.press("Enter" if page.is_enabled("#push") else "g")
    page.wait_for_timeout(100)


def test_a_person_takes_part_from_consent_to_the_code(tmp_path):
    served = Served(tmp_path / "study", minutes=0.08)
    link, faults = served.server.add(), []
    try:
        with browser() as chromium:
            page = chromium.new_context(viewport={"width": 1280, "height": 720}).new_page()
            page.on("pageerror", lambda error: faults.append(str(error)))
            page.on("console", lambda message: faults.append(message.text))
            page.goto(f"http://127.0.0.1:{served.port}{link}")

            def step() -> bool:
                if page.is_visible(".code"):
                    return True
                if page.is_visible("#block"):
                    if page.evaluate("frame !== null && frame.served !== null"):
                        help_robot(page)
                elif page.is_visible("form"):
                    number = page.evaluate("page.step")
                    answer(page)
                    moved_on(page, number)
                elif page.is_visible("main > button") and page.is_enabled("main > button"):
                    number = page.evaluate("page.step")
                    page.click("main > button")
                    moved_on(page, number)
                return False

            wait_for(step)
            person = served.server.visits[0].participant
            assert page.inner_text(".code") == person.code
            assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    finally:
        served.stop()
    assert faults == []
    given = [event["answers"] for event in person.events if "answers" in event]
    assert given[0] == given[1] and set(given[0].values()) == {55}  # a step from the middle
    assert set(given[2].values()) == {2}
    assert given[3]["attention"] == "green" and given[3]["comments"] == "It was <b>fun</b>."
    seen, outcomes = set(), set()
    for one in person.steps:
        if one.kind in ("practice", "block"):
            folder = person.session(one)
            lines = (folder / TIMING).read_text().splitlines()
            seen |= {json.loads(line)["event"] for line in lines}
            outcomes |= {event.outcome for event in read_log(folder).events if event.outcome}
    assert {"shown", "first_input", "click", "submit", "acknowledged", "clock"} <= seen
    assert outcomes & {"push", "go_on"}
