"""Registries: find the built-in policies, operators and engines by name, and those of plugins."""

import dataclasses
import importlib
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import sha256
from pgf_jax.plugins import loading
from pgf_jax.plugins.digest import (
    is_interactive,
    module_name,
    packages_of,
    settings_digest,
    source_digest,
    source_file,
)
from pgf_jax.settings import check_choice

Make = TypeVar("Make", bound=Callable[..., Any])


@dataclasses.dataclass(frozen=True)
class Plugin:
    """A registered object of a plugin, as results and other processes know it.

    Attributes:
      kind: policy, operator or engine.
      name: under which it is registered.
      module: that registers it, when it is imported.
      version: as stated; None: none was.
      source: digest of the module's package; None: a version is stated instead.
    """

    kind: str
    name: str
    module: str
    version: str | None
    source: str | None

    @property
    def words(self) -> str:
        """Kind and name, for messages."""
        return f"{self.kind} {self.name!r}"


@dataclasses.dataclass(frozen=True)
class _Entry(Generic[Make]):
    """A registered object: what makes it, and the plugin that it is of; None: it is built in."""

    make: Make | str  # "module:attribute" is imported when it is first used
    plugin: Plugin | None = None


class Registry(Generic[Make]):
    """The objects of one kind, by name.

    Args:
      kind: what they are: policy, operator or engine.
      built_in: name -> what makes one, or "module:attribute" of that.
      revisions: of those whose results have changed since they were first released: name -> 2 or
        more. Whoever changes what an object computes raises its revision.
    """

    def __init__(
        self,
        kind: str,
        built_in: Mapping[str, Make | str],
        revisions: Mapping[str, int] | None = None,
    ) -> None:
        self.kind = kind
        self._entries: dict[str, _Entry[Make]] = {n: _Entry(make) for n, make in built_in.items()}
        self._revisions = dict(revisions or {})
        REGISTRIES[kind] = self

    def add_built_in(self, name: str, make: Make) -> None:
        """Add a built-in object, unless it is there."""
        self._entries.setdefault(name, _Entry(make))

    def register(
        self, name: str, make: Make, *, caller: "Caller", version: str | None, replace: bool
    ) -> None:
        """Add an object of a plugin; for the arguments see `register_policy` and its like.

        Raises:
          BadInput: the name is taken or none, or there is nothing to tell versions apart by.
        """
        if not isinstance(name, str) or not name or not name.isprintable() or "/" in name:
            raise BadInput(
                f"register_{self.kind}: expected a name of printable text without /, "
                f"got {short_repr(name)}"
            )
        if not callable(make):
            raise BadInput(
                f"register_{self.kind}: {name!r}: expected a class or a function that makes one, "
                f"got {short_repr(make)}"
            )
        if name in self._entries and not replace:
            raise BadInput(
                f"{self.kind} {name!r} is registered already; expected another name, or "
                "replace=True"
            )
        source = None if version is not None else source_digest(caller.module, make, caller.file)
        if version is None and source is None:
            raise BadInput(
                f"register_{self.kind}: {name!r}: cannot see its source, so that results could not "
                "say what made them; expected version='1', raised when what it does changes"
            )
        self._entries[name] = _Entry(make, Plugin(self.kind, name, caller.module, version, source))

    def unregister(self, name: str) -> None:
        """Remove an object."""
        self._entries.pop(name, None)

    def names(self) -> list[str]:
        """All names: the built-in ones first, then those of plugins as they were registered."""
        loading.load_installed()
        return list(self._entries)

    def check(self, name: object, field: str | None = None) -> None:
        """BadInput, with the name of a setting, unless an object of that name is registered."""
        loading.load_installed()
        if not isinstance(name, str) or name not in self._entries:
            try:
                check_choice(field or self.kind, name, self.names())
            except BadInput as error:
                if "did you mean" in str(error):
                    raise
                raise BadInput(
                    f"{error} (one of a plugin: import it, or --plugin MODULE)"
                ) from None

    def make(self, name: str) -> Make:
        """What makes the object of that name; BadInput if there is none."""
        self.check(name)
        make = self._entries[name].make
        if isinstance(make, str):
            module, attribute = make.split(":")
            return getattr(importlib.import_module(module), attribute)
        return make

    def plugin(self, name: str) -> Plugin | None:
        """The plugin that an object is of; None: it is built in."""
        self.check(name)
        return self._entries[name].plugin

    def made_of(self, name: str, *arguments: Any, built: bool = True) -> tuple[Plugin, str] | None:
        """The plugin that an object is of, and the digest of everything that it is made of.

        Args:
          name: of the object.
          *arguments: to make it with.
          built: whether its settings are those of the object; else those of what makes it.

        Returns:
          None where it is built in.
        """
        plugin = self.plugin(name)
        if plugin is None:
            return None
        make = self.make(name)
        return plugin, made_of(plugin, make(*arguments) if built else make)

    def revision(self, name: str) -> int:
        """The revision of a built-in object; 1 unless its results have changed."""
        return self._revisions.get(name, 1) if self.plugin(name) is None else 1


REGISTRIES: dict[str, "Registry[Any]"] = {}


class Caller(NamedTuple):
    """The module that registers something.

    Attributes:
      module: its name.
      file: of its source; None where it has none.
    """

    module: str
    file: str | None


def caller() -> Caller:
    """The module that calls the function that calls this."""
    names = sys._getframe(2).f_globals
    return Caller(module_name(names.get("__name__", "")), source_file(names))


def made_of(plugin: Plugin, made: Any) -> str:
    """The digest of everything that an object of a plugin is made of.

    Args:
      plugin: of the object.
      made: the object, or what makes it: its settings count, and the packages of its classes.

    Raises:
      BadInput: one line that names the object: its settings cannot be seen, and no version is
        stated.
    """
    parts = [plugin.module, str(plugin.version), str(plugin.source)]
    try:
        parts.append(settings_digest(made))
    except (BadInput, RecursionError) as error:
        if plugin.version is None:
            raise BadInput(
                f"{plugin.words}: {error}; expected settings of numbers, text, lists and the like, "
                "or version='1' where it is registered"
            ) from None
    if plugin.version is None:
        for module in sorted(packages_of(made) - {plugin.module}):
            file = getattr(sys.modules.get(module), "__file__", None)
            parts.append(f"{module} {source_digest(module, type(made), file)}")
    return sha256("\n".join(parts).encode())


def plugins_record(plugins: Iterable[tuple[Plugin, str]]) -> dict[str, Any]:
    """Where objects of plugins come from, as JSON.

    Args:
      plugins: each with the digest of everything that the object is made of, see `made_of`.
    """
    return {
        f"{plugin.kind} {plugin.name}": {
            "module": plugin.module,
            "version": plugin.version,
            "source_sha256": plugin.source,
            "sha256": made,
        }
        for plugin, made in plugins
    }


# -- in worker processes -------------------------------------------------------------------------


def check_importable(plugin: Plugin, workers: str) -> None:
    """BadInput where a worker process cannot import what registers an object.

    Args:
      plugin: of the object.
      workers: "here" for processes of this computer, which run the main script; else "elsewhere".
    """
    module = plugin.module
    if is_interactive(module):
        where = "a notebook or at a prompt"
    elif module_name(module) == "__main__" and workers != "here":
        where = "the main script"
    else:
        return
    raise BadInput(
        f"{plugin.words} is defined in {where}, which the workers cannot import: put it in a "
        "module of its own, and name that with --plugin (or import it), or compute with workers=1"
    )


def require(plugin: Plugin, where: str) -> None:
    """Have an object of a plugin here, as it is in the process that asks.

    Args:
      plugin: as it is there.
      where: this process, for messages.

    Raises:
      BadInput: one line: it cannot be imported here, or is another one.
    """
    registry = REGISTRIES[plugin.kind]
    loading.load_installed()
    if plugin.name not in registry._entries and plugin.module != "__main__":
        loading.load_plugin(plugin.module)
    entry = registry._entries.get(plugin.name)
    if entry is None or entry.plugin is None:
        how = f"importing {plugin.module} does not register it"
        if plugin.module == "__main__":
            how = (
                "the main script registers it under `if __name__ == '__main__'`, which workers do "
                "not run: register it outside of that, or compute with workers=1"
            )
        raise BadInput(f"{where}: has no {plugin.words}: {how}")
    ours = entry.plugin
    if (ours.version, ours.source) != (plugin.version, plugin.source):
        raise BadInput(
            f"{where}: has another source of {plugin.words} (module {plugin.module}) than here"
        )
