"""Parses a command's arguments into its settings, with tyro; bad input is one line.

tyro reads a dataclass that is made here from the settings' own: with the options in groups, each in
a box of the help, and with shorter names of their types.
"""

import contextlib
import dataclasses
import inspect
import io
import re
import shutil
import textwrap
import types
import typing
from collections.abc import Sequence
from typing import Annotated, Any

import tyro
from tyro import _errors as tyro_errors
from tyro.constructors import ConstructorRegistry, PrimitiveTypeInfo

from pgf_jax.errors import BadInput
from pgf_jax.plugins.loading import load_plugin
from pgf_jax.settings import CommandLine


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

    def reject(event: tyro_errors.ParseErrorEvent) -> None:
        message = _rejection(event, prog)
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
        raise BadInput(_as_flag(str(error))) from None
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


def _rejection(event: tyro_errors.ParseErrorEvent, prog: str) -> str | None:
    """One line for what tyro rejects.

    tyro's hook is private to it; its public way is a drawn box, wrapped to the terminal's width.
    """
    see = f"(see {prog} --help)"
    match event:
        case tyro_errors.UnrecognizedArgs(tokens=tokens):
            return f"unrecognized options: {' '.join(tokens)} {see}"
        case tyro_errors.MissingArgs(missing_arguments=missing):
            return f"options missing: {', '.join(_flag(m.arg) for m in missing)} {see}"
        case tyro_errors.InvalidChoice(argument=argument, value=value, choices=choices):
            # The choices of an option that may be None come in another order each time.
            expected = ", ".join(sorted({*choices} - {"None"}))
            return f"{_flag(argument)}: expected one of {expected}, got {value!r}"
        case tyro_errors.BadValue(argument=argument, offending_value=None):
            return f"{_flag(argument)}: expected a value, got none {see}"
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


def _flag(argument: Any) -> str:
    """The option's own name, without its aliases."""
    return argument.display_name().rpartition("/")[2]


def _as_flag(message: str) -> str:
    """`task_limit: ...`, as settings call it, is `--task-limit: ...` to who typed it."""
    return re.sub(r"^([a-z][a-z_]*)(?=: )", lambda m: "--" + m[1].replace("_", "-"), message)


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
            options[field.name] = (field.name, _shown(hint), default)
    return options


def _shown(hint: Any) -> Any:
    """The type of an option, shown as `INT` or `INT ...` instead of `{None}|{[INT [INT ...]]}`."""
    bare, *own = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
    bare = next((one.hint for one in own if isinstance(one, CommandLine)), bare)
    kind = bare
    if typing.get_origin(kind) in (typing.Union, types.UnionType):  # X | None
        (kind,) = (one for one in typing.get_args(kind) if one is not types.NoneType)
    many = typing.get_args(kind)[1:] == (Ellipsis,)
    spec: Any = ConstructorRegistry.get_primitive_spec(
        PrimitiveTypeInfo.make(typing.get_args(kind)[0] if many else kind, set())
    )
    shown = tyro.conf.arg(
        metavar=None if kind is bool else f"{spec.metavar} ..." if many else spec.metavar,
        help_behavior_hint=lambda default: f"(default: {default or 'none'})",
    )
    return Annotated[bare, shown, *own]  # of two, tyro takes the last


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
    """A type without its annotations."""
    return typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
