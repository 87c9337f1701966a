"""The one exception for bad input: the command line prints it as one line and exits with code 2."""

LONGEST = 500  # characters of a message


class BadInput(ValueError):
    """Input that cannot be used; the message names it, its value and what was expected.

    What the message quotes may come from anywhere, so it is made one line of printable text here:
    a file must not be able to draw on the terminal, or to fill it.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(_one_line(str(message)))


class WorkersLost(RuntimeError):
    """What computes has gone, through no fault of the input; the command line exits with code 1.

    The message says so in one line, and what is kept.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(_one_line(str(message)))


def short_repr(value: object, most: int = 60) -> str:
    """`repr` for a message: one line, not longer than `most`, whatever the value is."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an int of too many digits, lists in lists in lists, or any foreign class
        text = f"a {type(value).__name__}"
    return text if len(text) <= most else text[: most - 3] + "..."


def _one_line(text: str) -> str:
    text = _shortened(text, 4 * LONGEST)  # before it is looked at letter by letter
    if not text.isprintable():
        text = " ".join(text.splitlines())
        text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return _shortened(text, LONGEST)


def _shortened(text: str, most: int) -> str:
    """Less its middle: what it is about is said first, and what was expected last."""
    if len(text) <= most:
        return text
    tail = most // 3
    return f"{text[: most - tail - 5]} ... {text[-tail:]}"
