"""Digests of what a registered object is made of: its package's files, and its settings.

A cell of a sweep is named by everything that its results depend on. Of a built-in object that is
its name and a revision; of a plugin it is the content of its whole top-level package, because a
policy may import anything from its own package, and the settings of the object itself.
"""

import dataclasses
import enum
import functools
import hashlib
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.files import sha256

MAIN = ("__main__", "__mp_main__")  # the second is the main script in a worker process
_OURS = "pgf_jax"
_NOT_SOURCE = (".pyc", ".pyo")
_PLAIN = (bool, int, float, complex, str, bytes, Path, enum.Enum)


def module_name(module: str) -> str:
    """The importable name of a module: of one that is run by `python -m`, its own name."""
    if module not in MAIN:
        return module
    spec = getattr(sys.modules.get(module), "__spec__", None)
    return MAIN[0] if spec is None else spec.name


def source_file(names: Mapping[str, Any]) -> str | None:
    """The file of a module, by its names; None for a notebook, a prompt, or standard input."""
    file = names.get("__file__")
    return file if isinstance(file, str) and Path(file).is_file() else None


def is_interactive(module: str) -> bool:
    """Whether a module is a notebook or a prompt, which no other process can import."""
    return module == MAIN[0] and source_file(vars(sys.modules[module])) is None


def source_digest(module: str, make: Any, file: str | None = None) -> str | None:
    """The digest of the package that holds a module.

    Args:
      module: that registers an object, as `module_name` gives it.
      make: what it registers; in a notebook its code counts, and that of what it uses.
      file: of the module, where that is the main script; None: a notebook or a prompt.

    Returns:
      Hex digits; None where there is neither a file nor Python code to see.
    """
    if module == MAIN[0] and file is None:
        return _code_digest(make)
    loaded = None if module == MAIN[0] else sys.modules.get(module.partition(".")[0])
    folders = getattr(loaded, "__path__", None)
    if folders:
        return _files_digest(tuple(folders))
    file = getattr(loaded, "__file__", file)
    return None if file is None else sha256(Path(file).read_bytes())


@functools.cache
def _files_digest(folders: tuple[str, ...]) -> str:
    """The digest of all files of a package: modules, and data beside them."""
    digest = hashlib.sha256()
    for folder in map(Path, folders):
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder)
            hidden = any(part.startswith((".", "__pycache__")) for part in inside.parts)
            if hidden or path.suffix in _NOT_SOURCE or not path.is_file():
                continue
            content = path.read_bytes()
            digest.update(f"{inside.as_posix()}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()


# -- settings ------------------------------------------------------------------------------------


def settings_digest(made: Any) -> str:
    """The digest of an object's settings: its class, and its attributes with theirs.

    Raises:
      BadInput: it holds something whose content cannot be seen.
    """
    return sha256("\n".join(_words(made, ())).encode())


def packages_of(made: Any) -> set[str]:
    """Names of the modules that define an object's class and its bases, except for our own."""
    kind = made if isinstance(made, type) else type(made)
    modules = {module_name(base.__module__) for base in kind.__mro__}
    known = {_OURS, *sys.stdlib_module_names} - set(MAIN)
    return {name for name in modules if name.partition(".")[0] not in known}


def _words(value: Any, within: tuple[int, ...]) -> Iterator[str]:
    """A value as lines of text, the same for equal values in every process."""
    if value is None or value is ... or isinstance(value, _PLAIN):
        yield f"{type(value).__name__} {value!r}"
        return
    if id(value) in within:
        yield "itself"
        return
    inside = (*within, id(value))
    if isinstance(value, type):
        yield f"class {_name(value)}"
    elif isinstance(value, types.ModuleType):
        yield f"module {value.__name__}"
    elif isinstance(value, types.FunctionType):
        yield f"function {_name(value)}"
        held = [cell.cell_contents for cell in value.__closure__ or () if _is_filled(cell)]
        yield from _words([*held, value.__defaults__, value.__kwdefaults__], inside)
    elif isinstance(value, types.MethodType):
        yield from _words((value.__func__, value.__self__), inside)
    elif isinstance(value, functools.partial):
        yield from _words((value.func, value.args, value.keywords), inside)
    elif isinstance(value, Mapping):
        yield f"mapping of {len(value)}"
        for key, item in value.items():
            yield from _words(key, inside)
            yield from _words(item, inside)
    elif isinstance(value, list | tuple):
        yield f"list of {len(value)}"
        for item in value:
            yield from _words(item, inside)
    elif isinstance(value, set | frozenset):
        yield from sorted("\n".join(_words(item, inside)) for item in value)
    elif hasattr(value, "__array__"):  # of NumPy, JAX, and others
        array = np.asarray(value)
        yield f"array {array.dtype} {array.shape} {sha256(np.ascontiguousarray(array).tobytes())}"
    else:
        yield f"object of {_name(type(value))}"
        yield from _words(_attributes(value), inside)


def _attributes(value: Any) -> dict[str, Any]:
    """The attributes of an object, by name."""
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    slots = [name for base in type(value).__mro__ for name in _slots(base)]
    if not hasattr(value, "__dict__") and not slots and type(value) is not object:
        raise BadInput(f"holds a {_name(type(value))}, whose content cannot be seen")
    held = {name: getattr(value, name) for name in slots if hasattr(value, name)}
    return dict(sorted({**held, **getattr(value, "__dict__", {})}.items()))


def _slots(kind: type) -> tuple[str, ...]:
    slots = vars(kind).get("__slots__", ())
    return (slots,) if isinstance(slots, str) else tuple(slots)


def _name(value: Any) -> str:
    """The name of a class or function; the main script has two names."""
    module = value.__module__ or ""
    return f"{'__main__' if module in MAIN else module}.{value.__qualname__}"


def _is_filled(cell: types.CellType) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:  # a name that has not been given a value yet
        return False


# -- code of a notebook --------------------------------------------------------------------------


def _code_digest(make: Any) -> str | None:
    """The digest of the code of a class or function, and of what it uses of the same notebook."""
    seen: dict[str, str] = {}
    _see(make, seen)
    if not seen:
        return None
    return sha256("\n".join(f"{name} {seen[name]}" for name in sorted(seen)).encode())


def _see(value: Any, seen: dict[str, str]) -> None:
    """Add the code of a class or function, and of what it uses, to what has been seen."""
    if isinstance(value, functools.partial):
        return _see(value.func, seen)
    if isinstance(value, types.MethodType):
        return _see(value.__func__, seen)
    if getattr(value, "__module__", None) not in MAIN or not hasattr(value, "__qualname__"):
        return None
    if _name(value) in seen:
        return None
    if isinstance(value, type):
        seen[_name(value)] = "class"
        for base in value.__bases__:
            _see(base, seen)
        for name, member in vars(value).items():
            function = getattr(member, "__func__", getattr(member, "fget", member))
            if isinstance(function, types.FunctionType):
                _see(function, seen)
            elif not name.startswith("__"):
                seen[f"{_name(value)}.{name}"] = _settled(member)
    elif isinstance(value, types.FunctionType):
        seen[_name(value)] = "\n".join(_code_words(value.__code__))
        used = {name for code in _codes(value.__code__) for name in code.co_names}
        for name in sorted(used & value.__globals__.keys()):
            found = value.__globals__[name]
            if getattr(found, "__module__", None) in MAIN and hasattr(found, "__qualname__"):
                _see(found, seen)
            else:
                seen[f"{value.__module__}.{name}"] = _settled(found)
    return None


def _settled(value: Any) -> str:
    try:
        return settings_digest(value)
    except BadInput:
        return _name(type(value))


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """A function's code, and that of the functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _code_words(code: types.CodeType) -> Iterator[str]:
    """What a code does, without where it stands."""
    for one in _codes(code):
        yield f"{one.co_code.hex()} {one.co_names} {one.co_varnames}"
        yield from _words([c for c in one.co_consts if not isinstance(c, types.CodeType)], ())
