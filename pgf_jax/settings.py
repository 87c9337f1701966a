"""Checks of settings, each with its one line of BadInput."""

import dataclasses
import functools
import numbers
import operator
import os
import sys
import types
import typing
from pathlib import Path
from typing import Any, Literal

from pgf_jax.errors import BadInput, short_repr

MAX_SEED = 2**32 - 1  # a seed is one word of a noise key


def check_choice(name: str, value: object, choices: list[str]) -> None:
    """BadInput unless `value` is one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        raise BadInput(f"{name}: expected one of {', '.join(choices)}, got {short_repr(value)}")


def check_int(name: str, value: object, least: int, most: int | None = None) -> None:
    """BadInput unless `value` is a whole number within least..most."""
    if (
        not isinstance(value, int)
        or isinstance(value, bool)
        or value < least
        or (most is not None and value > most)
    ):
        bounds = f"{least} or more" if most is None else f"within {least}..{most}"
        raise BadInput(f"{name}: expected a whole number {bounds}, got {short_repr(value)}")


def check_seconds(name: str, value: float, least: float) -> None:
    """BadInput unless `value` is a finite number of seconds, `least` or more."""
    # A whole number may be too large for what it is used as.
    if not isinstance(value, int | float) or not least <= value <= sys.float_info.max:
        raise BadInput(
            f"{name}: expected a number of seconds, {least:g} or more, got {short_repr(value)}"
        )


_MOST = 10_000  # values in a list


def check_fields(config: Any) -> None:
    """Give every field of a frozen dataclass the type that it declares.

    Text becomes a path and a path text, lists become tuples and NumPy's numbers Python's, where the
    other is declared. After this, checks of ranges can compare without looking at types.

    Raises:
      BadInput: one line that names the field: its value is of another type, or a number is too
        large to be one.
    """
    for name, hint in _hints(type(config)).items():
        value = getattr(config, name)
        taken = _taken(name, value, hint)
        if taken is not value:
            object.__setattr__(config, name, taken)


@functools.cache
def _hints(config: type) -> dict[str, Any]:
    hints = typing.get_type_hints(config)
    return {field.name: hints[field.name] for field in dataclasses.fields(config)}


def _taken(name: str, value: Any, hint: Any) -> Any:
    """The value as its type says, or BadInput."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):  # X | None
        (kind,) = (one for one in inner if one is not types.NoneType)
        return None if value is None else _taken(name, value, kind)
    if origin is Literal:
        if not isinstance(value, str) or value not in inner:
            raise _wrong(name, f"one of {', '.join(inner)}", value)
        return value
    if origin is tuple:
        if not isinstance(value, list | tuple | range) or value[_MOST:]:
            raise _wrong(name, f"a list of at most {_MOST} values", value)
        kinds = inner[:1] * len(value) if Ellipsis in inner or len(inner) != len(value) else inner
        taken = tuple(_taken(name, one, kind) for one, kind in zip(value, kinds, strict=True))
        same = isinstance(value, tuple) and all(map(operator.is_, taken, value))
        return value if same else taken
    if hint is Path:
        return _path(name, value)
    if hint is str and isinstance(value, Path):
        return str(value)
    if hint in (int, float):
        return _number(name, value, hint)
    if not isinstance(value, hint):
        words = {str: "text", bool: "true or false"}
        raise _wrong(name, words.get(hint, f"a {hint.__name__}"), value)
    return value


def _path(name: str, value: Any) -> Path:
    if isinstance(value, Path):
        path = value
    elif isinstance(value, str | os.PathLike):
        try:
            path = Path(value)
        except Exception:  # a path of bytes, or a foreign class that fails
            raise _wrong(name, "a path", value) from None
    else:
        raise _wrong(name, "a path", value)
    if "\0" in str(path):
        raise _wrong(name, "a path", value)
    return path


def _number(name: str, value: Any, kind: Any) -> Any:
    words = "a whole number" if kind is int else "a number"
    wanted: Any = numbers.Integral if kind is int else numbers.Real  # NumPy's are, too
    if not isinstance(value, wanted) or isinstance(value, bool):
        raise _wrong(name, words, value)
    try:
        taken = kind(value)
    except Exception:  # an int that is too large for a float, where it will be used as one
        raise _wrong(name, words, value) from None
    if kind is int and not -(2**63) <= taken < 2**63:
        raise _wrong(name, "a whole number of 64 bits", value)
    return value if isinstance(value, int | float) else taken


def _wrong(name: str, expected: str, value: Any) -> BadInput:
    return BadInput(f"{name}: expected {expected}, got {short_repr(value)}")
