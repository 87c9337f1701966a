"""Where participants are: their steps, and the journal."""

import itertools
import json

import pytest

from pgf_jax.errors import BadInput
from pgf_jax.study.design import DESIGN, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.progress import (
    ABOUT,
    JOURNAL,
    Participant,
    Step,
    add_participant,
    participants,
    steps_of,
)


@pytest.fixture
def design(tmp_path):
    write_example(tmp_path / "study")
    return load_design(tmp_path / "study")


def test_the_steps_of_a_participant(design):
    names = [(step.kind, step.name, step.block) for step in steps_of(design, design.blocks_of(1))]
    assert names == [
        ("text", "consent", None),
        ("text", "instructions", None),
        ("practice", "practice", None),
        ("block", "time", 0),
        ("questions", "nasa_tlx", 0),
        ("break", "break", 0),
        ("block", "stuck", 1),
        ("questions", "nasa_tlx", 1),
        ("questions", "sus", None),
        ("questions", "own", None),
        ("closing", "closing", None),
    ]


def test_participants_are_numbered_and_have_a_token_each(design):
    added = [add_participant(design) for _ in range(3)]
    assert participants(design.folder) == [folder for folder, _ in added]
    people = [Participant(design, folder) for folder, _ in added]
    assert [person.number for person in people] == [0, 1, 2]
    for person, (_, token) in itertools.product(people, added):
        assert person.is_token(token) == (token == added[person.number][1])
    assert not people[0].is_token("") and len({person.code for person in people}) == 3
    for folder, token in added:  # who reads the folder cannot enter
        assert all(token not in path.read_text() for path in folder.iterdir())


def test_a_participant_goes_on_where_they_were(design):
    folder, _ = add_participant(design)
    person = Participant(design, folder)
    assert person.step == Step("text", "consent") and person.finish(0, {"agreed": True})
    person.note("left")
    assert not person.finish(0) and not person.finish(2)  # sent twice; not yet
    assert person.finish(1)
    person.close()
    with (folder / JOURNAL).open("ab") as file:
        file.write(b'{"kind": "done", "ste')  # the server was killed while it wrote
    again = Participant(design, folder)
    assert again.done == 2 and again.step == Step("practice", "practice")
    assert [event["kind"] for event in again.events] == ["done", "left", "done"]
    assert again.events[0]["agreed"] and again.events[1]["name"] == "instructions"
    assert again.session(again.steps[2]).name == "practice"
    assert again.session(again.steps[6]).name == "block2"
    for step in range(2, len(again.steps)):
        assert again.finish(step)
    assert again.step is None and not again.finish(len(again.steps))
    again.close()
    assert Participant(design, folder).step is None
    lines = (folder / JOURNAL).read_text().splitlines()
    assert [json.loads(line)["kind"] for line in lines] == [e["kind"] for e in again.events]


def test_conditions_do_not_change_under_participants(design):
    folder, _ = add_participant(design)
    path = design.folder / DESIGN
    text = path.read_text().replace("[conditions.time]", "[conditions.a]\n[conditions.time]")
    path.write_text(text.replace("[1, 2]", "[1, 2, 3]"))
    with pytest.raises(BadInput, match="other blocks than the study gives now"):
        Participant(load_design(design.folder), folder)


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [
        (ABOUT, b"{}", "number: expected int"),
        (ABOUT, b"[", "participant.json"),
        (JOURNAL, b"{}\n", "line 1: expected an event"),
        (JOURNAL, b"nonsense\n", "line 1: expected an event"),
        (JOURNAL, b'{"kind": "done", "step": 1}\n', "steps that are done in order"),
    ],
)
def test_files_that_are_not_a_participants_are_one_line(design, file, content, says):
    folder, _ = add_participant(design)
    (folder / file).write_bytes(content)
    with pytest.raises(BadInput) as error:
        Participant(design, folder)
    assert says in str(error.value) and "\n" not in str(error.value)
