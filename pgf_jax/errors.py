"""The one exception for bad input: the command line prints it as one line and exits with code 2."""


class BadInput(ValueError):
    """Input that cannot be used; the message names it, its value and what was expected."""
