"""Checks of settings: types and bounds; whatever is wrong is one line of BadInput.

The bounds of a setting stand in its type, and `check_fields` reads both:

    robots: Count = 1
    port: Annotated[int, Bounds(0, 65535)] = 8080
"""

import dataclasses
import functools
import numbers
import operator
import os
import sys
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pgf_jax.errors import BadInput, a, did_you_mean, kind_of, short_repr

MAX_SEED = 2**32 - 1  # a seed is one word of a noise key


@dataclasses.dataclass(frozen=True)
class Bounds:
    """The range of a number, as metadata of its type; the number must be finite, too.

    Attributes:
      least: the smallest value.
      most: the largest value.
      above: the value is larger than this.
      below: the value is smaller than this.
      unit: what is counted, for the message: "seconds" or nothing.
    """

    least: float | None = None
    most: float | None = None
    above: float | None = None
    below: float | None = None
    unit: str = ""

    def contains(self, value: float) -> bool:
        """Whether `value` lies within; nan never does."""
        return (
            # Not math.isfinite: a whole number may be too large to be a float.
            abs(value) <= sys.float_info.max
            and (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
            and (self.above is None or value > self.above)
            and (self.below is None or value < self.below)
        )

    def words(self, kind: type) -> str:
        """What is expected, for the message: "a whole number 1 or more"."""
        noun = "a whole number" if kind is int else "a number"
        if self.unit:
            noun += f" of {self.unit},"
        ends = []
        if self.least is not None and self.most is not None:
            ends.append(f"within {_digits(self.least)}..{_digits(self.most)}")
        elif self.least is not None:
            ends.append(f"{_digits(self.least)} or more")
        elif self.most is not None:
            ends.append(f"{_digits(self.most)} or less")
        if self.above is not None:
            ends.append(f"above {_digits(self.above)}")
        if self.below is not None:
            ends.append(f"below {_digits(self.below)}")
        return f"{noun} {' and '.join(ends)}" if ends else f"a finite {noun.removeprefix('a ')}"


def _digits(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"


@dataclasses.dataclass(frozen=True)
class CommandLine:
    """The type of a setting on the command line, where in Python it can be more.

    Attributes:
      hint: the type.
    """

    hint: Any


Count = Annotated[int, Bounds(1)]  # how many: of robots, tasks, processes ...
Index = Annotated[int, Bounds(0)]  # which one, counted from 0
Seed = Annotated[int, Bounds(0, MAX_SEED)]
Seconds = Annotated[float, Bounds(0.0, unit="seconds")]


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """BadInput unless `value` is one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        raise _wrong(name, f"one of {', '.join(choices)}", value, choices)


def check_type(
    name: str, value: object, kind: type, *, expected: str | None = None, hint: str = ""
) -> None:
    """BadInput unless `value` is a `kind`.

    Args:
      name: of the argument.
      value: what was given.
      kind: its class.
      expected: what is expected, for the message; None: the class.
      hint: how to come by one, for the message.
    """
    if isinstance(value, kind):
        return
    more = f"; {hint}" if hint else ""
    if value is kind:
        more = f": did you mean {kind.__name__}(...)?"
    raise BadInput(f"{name}: expected {expected or a(kind)}, got {kind_of(value)}{more}")


def check_path(name: str, value: Any) -> Path:
    """The value as a path; BadInput unless it is a path, or text that can be one."""
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


def check_int(name: str, value: object, least: int, most: int | None = None) -> None:
    """BadInput unless `value` is a whole number within least..most, which other settings decide."""
    _number(name, value, int, Bounds(least, most))


_MOST = 10_000  # values in a list


def check_fields(config: Any) -> None:
    """Check every field of a frozen dataclass, and give it the type that it declares.

    Text becomes a path and a path text, lists become tuples and NumPy's numbers Python's, where the
    other is declared. `Bounds` in a field's type are checked: of the number, or of each number in a
    list. After this, further checks can compare values without looking at types.

    Raises:
      BadInput: one line that names the field: its value is of another type or out of bounds.
    """
    for name, hint in _hints(type(config)).items():
        value = getattr(config, name)
        taken = _taken(name, value, hint)
        if taken is not value:
            object.__setattr__(config, name, taken)


@functools.cache
def _hints(config: type) -> dict[str, Any]:
    hints = typing.get_type_hints(config, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(config)}


def _taken(name: str, value: Any, hint: Any, bounds: Bounds | None = None) -> Any:
    """The value as its type says, or BadInput."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        bounds = next((one for one in inner[1:] if isinstance(one, Bounds)), bounds)
        return _taken(name, value, inner[0], bounds)
    if origin in (typing.Union, types.UnionType):  # X | None, or X | tuple[Y, ...] | None
        kinds = [one for one in inner if one is not types.NoneType]
        if len(kinds) > 1:
            lists = isinstance(value, list | tuple)
            kinds = [one for one in kinds if (typing.get_origin(one) is tuple) == lists]
        return None if value is None else _taken(name, value, kinds[0], bounds)
    if origin is Literal:
        if not isinstance(value, str) or value not in inner:
            raise _wrong(name, f"one of {', '.join(inner)}", value, inner)
        return value
    if origin is tuple:
        if not isinstance(value, list | tuple | range) or value[_MOST:]:
            raise _wrong(name, _list_words(name, value, inner, bounds), value)
        kinds = inner[:1] * len(value) if Ellipsis in inner or len(inner) != len(value) else inner
        pairs = zip(value, kinds, strict=True)
        taken = tuple(_taken(name, one, kind, bounds) for one, kind in pairs)
        same = isinstance(value, tuple) and all(map(operator.is_, taken, value))
        return value if same else taken
    if hint is Path:
        return check_path(name, value)
    if hint is str and isinstance(value, Path):
        return str(value)
    if hint in (int, float):
        return _number(name, value, hint, bounds)
    if not isinstance(value, hint):
        words = {str: "text", bool: "true or false"}
        raise _wrong(name, words.get(hint, f"a {hint.__name__}"), value)
    return value


def _list_words(name: str, value: Any, inner: tuple[Any, ...], bounds: Bounds | None) -> str:
    """What is expected in place of `value`, which is no list or too long a one."""
    if isinstance(value, list | tuple | range):
        return f"a list of at most {_MOST} values"
    if Ellipsis not in inner:
        return f"a list of {len(inner)} {plural(inner[0])}"
    words = f"a list of {plural(inner[0])}"
    try:
        _taken(name, value, inner[0], bounds)
    except BadInput:
        return words
    several = tuple(value.replace(",", " ").split()) if isinstance(value, str) else (value,)
    return f"{words}, as in {name}={short_repr(several)}"


def plural(hint: Any) -> str:
    """Several values of a type, for a message: "whole numbers"."""
    kind = typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
    return {int: "whole numbers", float: "numbers", Path: "paths"}.get(kind, "names")


def _number(name: str, value: Any, kind: Any, bounds: Bounds | None) -> Any:
    words = "a whole number" if kind is int else "a number"
    if bounds is not None:
        words = bounds.words(kind)
    wanted: Any = numbers.Integral if kind is int else numbers.Real  # NumPy's are, too
    if not isinstance(value, wanted) or isinstance(value, bool):
        raise _wrong(name, words, value)
    try:
        taken = kind(value)
    except Exception:  # an int that is too large for a float, where it will be used as one
        raise _wrong(name, words, value) from None
    if kind is int and not -(2**63) <= taken < 2**63:
        raise _wrong(name, "a whole number of 64 bits", value)
    taken = value if isinstance(value, int | float) else taken
    if bounds is not None and not bounds.contains(taken):
        raise _wrong(name, words, value)
    return taken


def _wrong(name: str, expected: str, value: Any, choices: Sequence[str] = ()) -> BadInput:
    hint = did_you_mean(value, choices) if isinstance(value, str) else ""
    return BadInput(f"{name}: expected {expected}, got {kind_of(value)}{hint}")


def named_values(name: str, texts: Sequence[str], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Parse NAME=VALUE texts of a setting.

    Args:
      name: of the setting, for messages.
      texts: as given; a value is a number, or two with a comma between.
      defaults: the names that there are; a default shows whether a value is a pair.

    Returns:
      Name -> value, whole numbers where the default is one.

    Raises:
      BadInput: no such name, a name twice, or no such value.
    """
    values: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        check_choice(name, key, list(defaults))
        try:
            kind = int if isinstance(defaults[key], int) else float
            numbers = [kind(word) for word in value.split(",")]
        except ValueError:
            numbers = []
        pair = isinstance(defaults[key], tuple)
        if not equals or key in values or len(numbers) != (2 if pair else 1):
            form = "LOW,HIGH" if pair else "NUMBER"
            raise BadInput(f"{name}: expected {key}={form} once, got {short_repr(text)}")
        values[key] = tuple(numbers) if pair else numbers[0]
    return values


def stored_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as they were stored, in today's words.

    Where they lack a world they are of a time when there was none: `physics` default was what is
    called authors today, and the shipped predictors were those that are called first.
    """
    if "world" in settings:
        return dict(settings)
    today = {**settings, "world": "none"}
    if settings.get("physics", "default") == "default":
        today["physics"] = "authors"
    if "predictor" in settings:
        names = {"paper": "first", "best": "first-best"}
        today["predictor"] = names.get(settings["predictor"], settings["predictor"])
    return today
