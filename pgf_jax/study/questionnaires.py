"""Questionnaires: what is asked, which answers are possible, and how they are scored.

A questionnaire is a TOML file. NASA's task load index (raw: without weights; Hart 2006) and the
system usability scale (Brooke 1996) are built in; attention checks are items with a right answer.
"""

import dataclasses
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import MIB, read_file
from pgf_jax.settings import Count, check_fields

LONGEST_TEXT = 4000  # characters of an answer
BUILT_IN = Path(__file__).parent / "instruments"
Score = Literal["none", "mean", "sus"]


@dataclasses.dataclass(frozen=True)
class Item:
    """One question.

    Attributes:
      name: of its column: letters, digits and underscores.
      text: the question.
      kind: scale (a whole number from `least` to `most` in steps of `step`), choice (one of
        `options`), or text.
      low, high: what the ends of a scale mean.
      least, most, step: of a scale.
      options: of a choice.
      required: whether it must be answered.
      correct: the right option, of a choice that is an attention check; None: it is none.
    """

    name: str
    text: str
    kind: Literal["scale", "choice", "text"] = "scale"
    low: str = ""
    high: str = ""
    least: int = 0
    most: int = 100
    step: Count = 1
    options: tuple[str, ...] = ()
    required: bool = True
    correct: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.name.isidentifier() or not self.name.isascii():
            raise BadInput(
                f"name: expected letters, digits and underscores, got {short_repr(self.name)}"
            )
        if self.kind == "scale" and not self.least < self.most:
            raise BadInput(f"most: expected more than least, {self.least}, got {self.most}")
        if self.kind == "choice" and len(set(self.options)) < max(2, len(self.options)):
            raise BadInput(f"options: expected two or more, all different, got {self.options}")
        if self.correct is not None and self.correct not in self.options:
            raise BadInput(f"correct: expected one of the options, got {self.correct!r}")

    def problem(self, answer: Any) -> str:
        """Why an answer is none, in words; empty if it is one, or is missing and may be."""
        if answer is None or answer == "":
            return "please answer this question" if self.required else ""
        if self.kind == "scale":
            on_step = (
                isinstance(answer, int)
                and not isinstance(answer, bool)
                and self.least <= answer <= self.most
                and (answer - self.least) % self.step == 0
            )
            return "" if on_step else f"expected a number within {self.least}..{self.most}"
        if not isinstance(answer, str):
            return "expected text"
        if self.kind == "choice":
            return "" if answer in self.options else "expected one of the options"
        return "" if len(answer) <= LONGEST_TEXT else f"at most {LONGEST_TEXT} characters"


@dataclasses.dataclass(frozen=True)
class Questionnaire:
    """A page of questions.

    Attributes:
      name: of its file.
      title: its heading.
      items: its questions.
      score: how its scales make one number: none, mean, or sus.
      source: where it comes from, for the codebook.
    """

    name: str
    title: str
    items: tuple[Item, ...]
    score: Score = "none"
    source: str = ""

    def problems(self, answers: Mapping[str, Any]) -> dict[str, str]:
        """What is wrong with answers, by item; empty if nothing is. Unknown items are wrong."""
        known = {item.name: item.problem(answers.get(item.name)) for item in self.items}
        unknown = dict.fromkeys(answers.keys() - known.keys(), "there is no such question")
        return {name: problem for name, problem in (known | unknown).items() if problem}

    def scored(self, answers: Mapping[str, Any]) -> float:
        """The score of answers that have no problems; nan where there is none.

        `sus` is 2.5 times the sum of what odd items exceed 1 by, and even ones fall short of 5.
        """
        values = [answers.get(item.name) for item in self.items if item.kind == "scale"]
        numbers = [value for value in values if isinstance(value, int)]
        if self.score == "none" or not numbers or len(numbers) < len(values):
            return math.nan
        if self.score == "mean":
            return sum(numbers) / len(numbers)
        return 2.5 * sum(n - 1 if i % 2 == 0 else 5 - n for i, n in enumerate(numbers))

    def attentive(self, answers: Mapping[str, Any]) -> bool:
        """Whether every attention check was answered rightly."""
        return all(
            item.correct is None or answers.get(item.name) == item.correct for item in self.items
        )


def read_questionnaire(path: Path) -> Questionnaire:
    """Read a questionnaire.

    Raises:
      BadInput: one line that names the file, and the item.
    """
    content = read_toml(path, "a questionnaire")
    items = content.pop("item", None)
    if not isinstance(items, list) or not items:
        raise BadInput(f"{path}: item: expected one [[item]] or more")
    made = []
    for number, item in enumerate(items, 1):
        made.append(_made(Item, item, f"{path}: item {number}"))
    names = [item.name for item in made]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"{path}: item {names.index(name) + 1}: name {name!r} occurs twice")
    found = _made(Questionnaire, content | {"name": path.stem, "items": ()}, str(path))
    if found.score == "sus" and [(i.kind, i.least, i.most) for i in made] != [("scale", 1, 5)] * 10:
        raise BadInput(f"{path}: score: sus expects ten scales from 1 to 5")
    return dataclasses.replace(found, items=tuple(made))


def read_toml(path: Path, expected: str) -> dict[str, Any]:
    """Read a TOML file; BadInput, one line that names it, if it is none."""
    try:
        return tomllib.loads(read_file(path, expected, MIB).decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise BadInput(f"{path}: expected {expected} in TOML: {error}") from None


def _made(kind: type, values: Any, where: str) -> Any:
    """A dataclass of values that a file gives; BadInput that says where."""
    if not isinstance(values, dict):
        raise BadInput(f"{where}: expected a table, got {short_repr(values)}")
    fields = {field.name: field for field in dataclasses.fields(kind)}
    for name in values:
        if name not in fields:
            raise BadInput(f"{where}: {name}: no such field, expected one of {', '.join(fields)}")
    for name, field in fields.items():
        if name not in values and field.default is dataclasses.MISSING:
            raise BadInput(f"{where}: {name}: is missing")
    try:
        return kind(**values)
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
