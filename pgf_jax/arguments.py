"""Parses a command's arguments into its settings, with tyro; bad input is one line.

tyro reads a dataclass that is made here from the settings' own: with the options in groups, each in
a box of the help, and with shorter names of their types.
"""

import contextlib
import dataclasses
import functools
import inspect
import io
import os
import re
import shutil
import textwrap
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import tyro
from tyro import _errors as tyro_errors
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from pgf_jax.errors import BadInput, did_you_mean, short_repr
from pgf_jax.plugins.loading import load_plugin
from pgf_jax.settings import CommandLine, plural


def parse(config: type, arguments: Sequence[str], prog: str) -> Any:
    """Parse arguments.

    Args:
      config: the dataclass of the settings. A class attribute `GROUPS`, if there is one, has the
        title and the fields of each group of options.
      arguments: what was typed after the command.
      prog: the program and the command, for messages.

    Returns:
      An instance of `config`.

    Raises:
      BadInput: one line that names the option.
      SystemExit: the help was asked for, and has been printed.
    """
    box = io.StringIO()
    flags = _flags(config)

    def reject(event: tyro_errors.ParseErrorEvent) -> None:
        message = _rejection(event, prog, arguments, flags)
        if message is not None:
            raise BadInput(message)

    try:
        with contextlib.redirect_stderr(box), tyro_errors.on_parse_error(reject):
            parsed = tyro.cli(
                _grouped(config), prog=prog, description=_description(config), args=arguments
            )
        values = _values(parsed)
        for module in values.pop(_PLUGIN):
            load_plugin(module)  # first: settings may name what it registers
        return _make(config, values)
    except BadInput as error:
        raise BadInput(_as_flag(str(error), flags)) from None
    except (AssertionError, OSError, ValueError) as error:  # tyro's own options, of completions
        raise BadInput(f"arguments: {error}") from None
    except SystemExit as stop:
        if stop.code:  # an event of a kind that is not known here: tyro's own words
            words = " ".join(
                re.sub(r"[^\w\s.,:;'\"()<>=/-]|-{2,}(?!\w)", " ", box.getvalue()).split()
            )
            raise BadInput(f"arguments: {words}") from None
        raise


# --- messages -----------------------------------------------------------------------------------


def _rejection(
    event: tyro_errors.ParseErrorEvent,
    prog: str,
    typed: Sequence[str],
    flags: Mapping[str, Any],
) -> str | None:
    """One line for what tyro rejects.

    tyro's hook is private to it; its public way is a drawn box, wrapped to the terminal's width.
    """
    see = f"(see {prog} --help)"
    match event:
        case tyro_errors.UnrecognizedArgs(tokens=tokens):
            words = _stray(tokens[0], typed, flags)
            return words or f"unrecognized options: {' '.join(tokens)} {see}"
        case tyro_errors.MissingArgs(missing_arguments=missing, unrecognized_tokens=tokens):
            words = _stray(tokens[0], typed, flags) if tokens else None
            stray = f"; unrecognized: {' '.join(tokens)}" if tokens else ""
            names = ", ".join(_flag(m.arg) for m in missing)
            return words or f"options missing: {names}{stray} {see}"
        case tyro_errors.InvalidChoice(argument=argument, value=value, choices=choices):
            # The choices of an option that may be None come in another order each time.
            known = sorted({*choices} - {"None"})
            return (
                f"{_flag(argument)}: expected one of {', '.join(known)}, got {value!r}"
                f"{did_you_mean(value, known)}"
            )
        case tyro_errors.BadValue(argument=argument, offending_value=None):
            return _too_few(argument, prog, typed, flags)
        case tyro_errors.InstantiationFailure(message=message, argument=None):
            return message
        case tyro_errors.InstantiationFailure(message=message, argument=argument) if argument:
            for theirs, ours in _WORDS.items():
                _, found, value = message.partition(theirs)  # of "X | None" it tells more
                message = ours + value if found else message
            return f"{_flag(argument)}: {message}"
    return None


_WORDS = {
    "invalid literal for int() with base 10:": "expected a whole number, got",
    "could not convert string to float:": "expected a number, got",
}


def _stray(word: str, typed: Sequence[str], flags: Mapping[str, Any]) -> str | None:
    """One line for the first word that is neither an option nor a value, if more can be said."""
    name = word.partition("=")[0]
    options = [flag for flag in flags if flag.startswith("--")]
    ends = [one.rpartition("=")[2] for one in typed]  # also of --resume=yes
    before = typed[: ends.index(word) + 1] if word in ends else ()
    last = next((_option(one) for one in reversed(before) if one.startswith("--")), "")
    if len(options) == len(flags) and last in flags and not word.startswith("-"):
        if flags[last] is bool:
            return f"{last}: expected no value, got {word!r}"
        if typing.get_origin(flags[last]) is not tuple:
            return f"{last}: expected one value, got another, {word!r}"
    hint = did_you_mean(name, [*options, "--help"])
    return f"unrecognized option {name}{hint}" if hint else None


def _too_few(argument: Any, prog: str, typed: Sequence[str], flags: Mapping[str, Any]) -> str:
    """One line for an option, or an argument without a flag, that has too few values."""
    name, see = _flag(argument), f"(see {prog} --help)"
    known = {*flags, "--help"}
    stray = [word for word in typed if word.startswith("--") and _option(word) not in known]
    if not name.startswith("--") and stray:  # tyro stops at it before it has the argument
        if stray[0] == f"--{name}":
            return f"unrecognized option --{name}: expected as in {prog} {name.upper()}"
        return _stray(stray[0], typed, flags) or f"unrecognized options: {stray[0]} {see}"
    if typing.get_origin(flags.get(name)) is tuple:
        kinds = typing.get_args(flags[name])
        example = f"{name} {' '.join(map(str, argument.field.default))}"
        return f"{name}: expected {len(kinds)} {plural(kinds[0])}, as in {example}, got fewer"
    return f"{name}: expected a value, got none {see}"


def _option(word: str) -> str:
    """The option in `--robots=5` or `--scene_class`, as in the help."""
    return word.partition("=")[0].replace("_", "-")


def _flag(argument: Any) -> str:
    """The option's own name, without its aliases."""
    return argument.display_name().rpartition("/")[2]


def _as_flag(message: str, flags: Mapping[str, Any]) -> str:
    """`task_limit: ...`, as settings call it, is `--task-limit: ...` to who typed it."""
    name, colon, rest = message.partition(": ")
    flag = _dashed(name)
    return f"{flag}{colon}{rest}" if flag in flags else message


def _dashed(name: str) -> str:
    return "--" + name.replace("_", "-")


def _flags(config: type) -> dict[str, Any]:
    """The type of each option, by its flags; arguments without a flag, by their name."""
    flags: dict[str, Any] = {_dashed(_PLUGIN): str}
    for name, (_, hint, _) in _options(config).items():
        notes = typing.get_args(hint)[1:]
        aliases = [alias for note in notes for alias in getattr(note, "aliases", None) or ()]
        kind = _kind(hint)
        off = [_dashed(f"no_{name}")] if kind is bool else []
        own = name if tyro.conf.Positional in notes else _dashed(name)
        flags |= dict.fromkeys([own, *aliases, *off], kind)
    return flags


# An option of every command: what a plugin registers, all commands can be given by name.
_PLUGIN = "plugin"
_PLUGIN_TEXT = (
    "module to import first, because it registers policies, operators or engines; may be given "
    "several times. Installed packages that have the entry point pgf_jax.plugins need none."
)


# --- help ---------------------------------------------------------------------------------------


def _description(config: type) -> str:
    """What the command does: the docstring of its settings, above their attributes.

    It is indented, because tyro joins lines that begin with a letter.
    """
    text = inspect.cleandoc(config.__doc__ or "").partition("\n\nAttributes:")[0]
    return textwrap.indent(
        textwrap.fill(" ".join(text.split()), shutil.get_terminal_size().columns - 4), "  "
    )


@functools.cache
def _grouped(config: type) -> type:
    """The dataclass that tyro parses: the options of `config`, in groups.

    tyro draws one box for each dataclass within a dataclass, so a group is one; the options' names
    do not show it. Their texts come from the docstrings of base classes.
    """
    options = _options(config)
    texts = tuple(type("Texts", (), {"__doc__": _texts(kind)}) for kind in _classes(config))
    plugin = Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(name=_PLUGIN, metavar="MODULE", help=_PLUGIN_TEXT),
    ]

    def group(title: str, names: Sequence[str]) -> tuple[str, Any]:
        fields = [options.pop(name) for name in names]
        kind = dataclasses.make_dataclass(title, fields, bases=texts, kw_only=True)
        return f"{title}_group", Annotated[
            kind, tyro.conf.arg(name=title), tyro.conf.OmitArgPrefixes
        ]

    groups = [group(title, names) for title, names in getattr(config, "GROUPS", ())]
    options[_PLUGIN] = (_PLUGIN, plugin, dataclasses.field(default=()))
    groups.append(group("plugin", (_PLUGIN,)))
    fields = [*options.values(), *groups]
    return dataclasses.make_dataclass(config.__name__, fields, bases=texts, kw_only=True)


def _options(config: type) -> dict[str, tuple[str, Any, Any]]:
    """For each option of `config`, and of settings within it: name, type and default."""
    options: dict[str, tuple[str, Any, Any]] = {}
    for field, hint, inner in _fields(config):
        if inner is not None:
            options |= _options(inner)
        else:
            default = dataclasses.field(default=field.default)
            options[field.name] = (field.name, _shown(field.name, hint), default)
    return options


def _shown(name: str, hint: Any) -> Any:
    """The type of an option, shown as `INT` or `INT ...` instead of `{None}|{[INT [INT ...]]}`."""
    own = list(typing.get_args(hint)[1:]) if typing.get_origin(hint) is Annotated else []
    bare, kind = _bare(hint), _kind(hint)
    spec = _spec(kind)
    if typing.get_origin(kind) is tuple:
        spec = _list_spec(_dashed(name), typing.get_args(kind))
        own.append(spec)
    shown = tyro.conf.arg(
        metavar=None if kind is bool else spec.metavar,
        help_behavior_hint=lambda default: f"(default: {default or 'none'})",
    )
    return Annotated[bare, shown, *own]  # of two, tyro takes the last


def _kind(hint: Any) -> Any:
    """A type without its annotations and without None."""
    kind = _bare(hint)
    if typing.get_origin(kind) in (typing.Union, types.UnionType):  # X | None
        (kind,) = (one for one in typing.get_args(kind) if one is not types.NoneType)
    return _bare(kind)


def _spec(kind: Any) -> Any:
    return ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kind, set()))


def _list_spec(flag: str, kinds: Sequence[Any]) -> PrimitiveConstructorSpec:
    """How an option of several values is read; tyro's own way does not say which one is wrong."""
    one = _spec(kinds[0])
    many = Ellipsis in kinds

    def read(words: list[str]) -> tuple[Any, ...] | None:
        if words == ["None"]:
            return None
        return tuple(_read(word) for word in words)

    def _read(word: str) -> Any:
        if "," in word and not os.path.exists(word):
            apart = " ".join(re.sub(r"[][(),]", " ", word).split())
            raise ValueError(
                f"expected {plural(kinds[0])} with spaces between them, as in {flag} {apart}, "
                f"got {short_repr(word)}"
            )
        # Choices are checked with the settings, which name them.
        return word if one.choices else one.instance_from_str([word])

    return PrimitiveConstructorSpec(
        nargs="*" if many else len(kinds),
        metavar=f"{one.metavar} ..." if many else " ".join([one.metavar] * len(kinds)),
        instance_from_str=read,
        is_instance=lambda value: value is None or isinstance(value, tuple),
        str_from_instance=lambda value: ["None"] if value is None else [*map(str, value)],
    )


def _texts(config: type) -> str:
    """The docstring of `config`, with the text of each attribute in one line.

    tyro would break a text before a line that begins with something else than a letter.
    """
    return re.sub(r"\n {4,}", " ", inspect.cleandoc(config.__doc__ or ""))


# --- settings within settings -------------------------------------------------------------------


def _make(config: type, values: dict[str, Any]) -> Any:
    """An instance of `config` with values by the names of options."""
    return config(
        **{
            field.name: values[field.name] if inner is None else _make(inner, values)
            for field, _, inner in _fields(config)
        }
    )


def _values(parsed: Any) -> dict[str, Any]:
    """Values of all options, out of their groups."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(parsed):
        value = getattr(parsed, field.name)
        values |= _values(value) if dataclasses.is_dataclass(value) else {field.name: value}
    return values


def _classes(config: type) -> list[type]:
    """The class, and those of settings within it."""
    inner = (inner for _, _, inner in _fields(config) if inner is not None)
    return [config, *(kind for one in inner for kind in _classes(one))]


def _fields(config: type) -> list[tuple[dataclasses.Field, Any, type | None]]:
    """Each field, its type, and its class where it holds settings of its own."""
    hints = typing.get_type_hints(config, include_extras=True)
    kinds = ((field, hints[field.name]) for field in dataclasses.fields(config))
    return [
        (field, hint, _bare(hint) if dataclasses.is_dataclass(_bare(hint)) else None)
        for field, hint in kinds
    ]


def _bare(hint: Any) -> Any:
    """A type without its annotations, as it is on the command line."""
    bare, *notes = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
    return next((note.hint for note in notes if isinstance(note, CommandLine)), bare)
