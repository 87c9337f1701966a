"""The design of a study, and the example that is written."""

import re

import pytest

from pgf_jax.cli import main
from pgf_jax.errors import BadInput
from pgf_jax.study.design import DESIGN, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.orders import Block


@pytest.fixture
def folder(tmp_path):
    write_example(tmp_path / "study")
    return tmp_path / "study"


def test_the_example_is_a_study(folder, tmp_path):
    design = load_design(folder)
    assert list(design.conditions) == ["stuck", "time"]
    assert list(design.questionnaires) == ["nasa_tlx", "sus", "own"]
    assert "consent" in design.texts and design.texts["closing"].startswith("# Thank you")
    config = design.session(Block(1, 0), tmp_path / "out")
    assert (config.policy, config.seed, config.horizon) == ("gain-rate", 1, 300.0)
    assert (config.robots, config.scene_class, config.operator) == (6, "packed", "live")
    practice = design.practice_session(tmp_path / "out")
    assert (practice.policy, practice.robots, practice.horizon) == ("random", 2, 600.0)


def test_the_example_says_what_every_entry_is(folder):
    lines = (folder / DESIGN).read_text().splitlines()
    for number, line in enumerate(lines):
        if line.startswith("["):
            assert lines[number - 1].startswith("#") or re.match(r"\[conditions\.", line)


def test_the_command_writes_and_checks(tmp_path, capsys):
    where = str(tmp_path / "mine")
    assert main(["study", "init", where]) == 0 and "written" in capsys.readouterr().out
    assert main(["study", "check", where]) == 0
    said = capsys.readouterr().out
    assert "time, scenes 2" in said and "2 participants balance the orders" in said
    assert "consent, instructions, practice, stuck, nasa_tlx, break, time" in said
    assert main(["study", "init", where]) == 2 and "is not empty" in capsys.readouterr().err
    assert main(["study", "check", str(tmp_path)]) == 2
    assert "no such file, expected a study" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("version = 1", "version = 2", "version: expected 1, got 2"),
        ("version = 1", "versoin = 1", "versoin: no such entry"),
        ('title = "Robots that ask for help"', "title = 3", "title: expected text, got 3"),
        ('title = "Robots that ask for help"', 'title = " "', "title: expected text"),
        ("robots = 6", "robots = 0", "conditions.stuck: robots: expected a whole number within"),
        ("robots = 6", "robbots = 6", "conditions.stuck: got an unexpected keyword argument"),
        ("robots = 6", "seed = 6", "fleet: seed: the study decides that itself"),
        ('policy = "gain-rate"', 'policy = "gain"', "conditions.time: policy: expected one of"),
        ('policy = "gain-rate"', "tasks = 3", "conditions.time: tasks: the study decides"),
        ("[conditions.time]", "[conditions]\ntime = 3\n[fleet.x]", "time: expected a table"),
        ("scene_seeds = [1, 2]", "scene_seeds = [1]", "scene_seeds: expected 2 different ones"),
        ("scene_seeds = [1, 2]", "scene_seeds = [1, 1]", "scene_seeds: expected 2 different ones"),
        ("scene_seeds = [1, 2]", "", "blocks: missing 1 required"),
        ("scene_seeds = [1, 2]", "scene_seeds = [1, -2]", "scene_seeds: expected"),
        ("minutes = 5.0", "minutes = 0", "blocks: minutes: expected a number of minutes"),
        ("minutes = 5.0", "minutes = nan", "blocks: minutes: expected a number of minutes"),
        ("pushes = 3", 'pushes = "three"', "practice: pushes: expected a whole number"),
        ('scene_class = "tight"', 'scene_class = "neat"', "practice: scene_class: expected one of"),
        ('["nasa_tlx"]', '["../secret"]', "no name of a questionnaire: '../secret'"),
        ('["nasa_tlx"]', '["tlx"]', "no such file, expected a questionnaire"),
        ('["nasa_tlx"]', "3", "questions: after_block: expected"),
    ],
)
def test_a_bad_design_is_one_line(folder, old, new, says):
    path = folder / DESIGN
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput) as error:
        load_design(folder)
    message = str(error.value)
    assert message.startswith(str(folder)) and says in message and "\n" not in message


def test_texts_have_to_be_there(folder):
    (folder / "break.md").unlink()
    with pytest.raises(BadInput, match="no such file, expected a text in Markdown"):
        load_design(folder)
    (folder / "break.md").write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match="expected a text in UTF-8"):
        load_design(folder)
