"""Exceptions that the command line prints as one line, and words for their messages."""

import dataclasses
import difflib
import types
from collections.abc import Iterable

LONGEST = 500  # most characters of a message


class BadInput(ValueError):
    """Input that cannot be used; the command line exits with code 2.

    The message names the input, what was expected and its value. It may quote text of any file, so
    it is made one line of printable text: a file must not draw on the terminal, or fill it.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(_one_line(str(message)))


class WorkersLost(RuntimeError):
    """Worker processes died or cannot be reached; the command line exits with code 1.

    The input is not at fault. The message says in one line what happened and what is kept.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(_one_line(str(message)))


def short_repr(value: object, most: int = 60) -> str:
    """`repr` for a message: one line of at most `most` characters, for any value."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an int of too many digits, lists in lists in lists, or any foreign class
        text = f"a {type(value).__name__}"
    return text if len(text) <= most else text[: most - 3] + "..."


def kind_of(value: object) -> str:
    """What a value is, for a message: "a Plan", "the class Plan", else its `short_repr`."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, types.FunctionType | types.BuiltinFunctionType | types.MethodType):
        return f"the function {value.__name__}"
    return a(type(value)) if dataclasses.is_dataclass(value) else short_repr(value)


def a(kind: type) -> str:
    """The name of a class with its article: "a Plan"."""
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"


def did_you_mean(got: str, choices: Iterable[str]) -> str:
    """`: did you mean X?` where choices are close to what was typed, nothing where none is.

    Case, underscores and leading dashes do not count; a part of a choice stands for it.
    """
    plain = {_plain(choice): choice for choice in choices}
    word = _plain(got)
    close = [word] if word in plain else [one for one in plain if _is_part(word, one)]
    if not 0 < len(close) <= 3:
        close = difflib.get_close_matches(word, plain, n=1, cutoff=0.7)
    if not close:
        close = [one for one in plain if len(one) > 2 and _is_longer(word, one)]
    return f": did you mean {' or '.join(plain[one] for one in close[:3])}?" if close else ""


def _plain(text: str) -> str:
    return text.lower().replace("_", "-").strip("-")


def _is_part(word: str, choice: str) -> bool:
    """`class` is a part of `scene-class`, and `serv` of `service-mean`."""
    return len(word) > 1 and f"-{word}" in f"-{choice}"


def _is_longer(word: str, choice: str) -> bool:
    """`output` is a longer word for `out`; `task-limit` is none for `task`."""
    return word.startswith(choice) and word[len(choice) :].isalnum()


def _one_line(text: str) -> str:
    text = _shortened(text, 4 * LONGEST)  # first, because the rest looks at each character
    if not text.isprintable():
        text = " ".join(text.splitlines())
        text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return _shortened(text, LONGEST)


def _shortened(text: str, most: int) -> str:
    """Cut the middle out: the subject stands first, and what was expected stands last."""
    if len(text) <= most:
        return text
    tail = most // 3
    return f"{text[: most - tail - 5]} ... {text[-tail:]}"
