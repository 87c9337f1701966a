"""Exceptions that the command line prints as one line: bad input, and lost workers."""

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
