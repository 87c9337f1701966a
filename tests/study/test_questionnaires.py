"""Questionnaires: what may be asked and answered, and the scores."""

import math

import pytest

from pgf_jax.errors import BadInput
from pgf_jax.study.questionnaires import BUILT_IN, LONGEST_TEXT, Item, read_questionnaire

SUS = read_questionnaire(BUILT_IN / "sus.toml")
TLX = read_questionnaire(BUILT_IN / "nasa_tlx.toml")


def test_the_load_index_is_the_mean_of_six_scales():
    assert [item.name for item in TLX.items] == [
        "mental_demand", "physical_demand", "temporal_demand", "performance", "effort",
        "frustration",
    ]  # fmt: skip
    answers = dict(zip((item.name for item in TLX.items), (0, 5, 10, 95, 100, 90), strict=True))
    assert TLX.problems(answers) == {} and TLX.scored(answers) == 50.0
    assert TLX.problems(answers | {"effort": 93}) == {"effort": "expected a number within 0..100"}


@pytest.mark.parametrize(
    ("given", "score"), [([5, 1] * 5, 100.0), ([1, 5] * 5, 0.0), ([3] * 10, 50.0)]
)
def test_the_usability_scale_counts_even_items_the_other_way(given, score):
    answers = {f"sus_{i}": value for i, value in enumerate(given, 1)}
    assert SUS.problems(answers) == {} and SUS.scored(answers) == score
    # Brooke's own example: 3 1 4 0 ... is one by hand; here one item changes it by 2.5.
    assert abs(SUS.scored(answers | {"sus_1": given[0] - 1 or 2}) - score) == 2.5
    del answers["sus_4"]
    assert SUS.problems(answers) == {"sus_4": "please answer this question"}
    assert math.isnan(SUS.scored(answers))


@pytest.mark.parametrize(
    ("item", "good", "bad"),
    [
        (Item("a", "?", step=5), [0, 5, 100], [3, -5, 105, 5.0, "5", True, [5], None, ""]),
        (Item("a", "?", least=1, most=5), [1, 5], [0, 6]),
        (Item("a", "?", required=False), [None, "", 7], [101]),
        (Item("a", "?", "choice", options=("x", "y")), ["x"], ["z", 1, None, ["x"]]),
        (Item("a", "?", "text"), ["x" * LONGEST_TEXT], ["x" * (LONGEST_TEXT + 1), 1, None, ""]),
    ],
)
def test_what_an_answer_may_be(item, good, bad):
    assert [item.problem(answer) for answer in good] == [""] * len(good)
    assert all(item.problem(answer) for answer in bad)


def test_answers_to_nothing_are_refused():
    assert TLX.problems({"mental": 5})["mental"] == "there is no such question"
    assert len(TLX.problems({})) == 6


def test_attention_checks_have_a_right_answer(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'title = "t"\n[[item]]\nname = "a"\ntext = "green"\nkind = "choice"\n'
        'options = ["red", "green"]\ncorrect = "green"\n[[item]]\nname = "b"\ntext = "?"\n'
    )
    own = read_questionnaire(path)
    assert own.attentive({"a": "green", "b": 3}) and not own.attentive({"a": "red", "b": 3})
    assert math.isnan(own.scored({"a": "green", "b": 3})) and TLX.attentive({})


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "item: expected one"),
        ("title = ", "expected a questionnaire in TOML"),
        ("item = 3", "item: expected one"),
        ('title = "t"\n[[item]]\nname = "a"', "item 1: text: is missing"),
        ('title = "t"\n[[item]]\ntext = "?"\nname = "a b"', "item 1: name: expected letters"),
        ('title = "t"\n[[item]]\ntext = "?"\nname = "a"\nsize = 1', "size: no such field"),
        ('title = "t"\n[[item]]\ntext = "?"\nname = "a"\nmost = 0', "most: expected more than"),
        ('title = "t"\n[[item]]\ntext = "?"\nname = "a"\nkind = "radio"', "kind: expected one of"),
        ('title = "t"\n[[item]]\ntext = "?"\nname = "a"\nkind = "choice"', "options: expected two"),
        ('title = "t"\n[[item]]\ntext = "?"\nname = "a"\ncorrect = "x"', "correct: expected one"),
        ('title = "t"\n' + '[[item]]\ntext = "?"\nname = "a"\n' * 2, "name 'a' occurs twice"),
        ('[[item]]\ntext = "?"\nname = "a"', "title: is missing"),
        ('title = "t"\nscore = "sus"\n[[item]]\ntext = "?"\nname = "a"', "sus expects ten scales"),
        ("a = " + "[" * 10_000, "in TOML"),
    ],
)
def test_a_bad_questionnaire_is_one_line(text, says, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(BadInput) as error:
        read_questionnaire(path)
    message = str(error.value)
    assert message.startswith(str(path)) and says in message and "\n" not in message
