"""Imports plugins: modules that register policies, operators or engines when they are imported."""

import importlib
import importlib.util
import os
import re
import sys
from importlib.metadata import entry_points

from pgf_jax.errors import BadInput, short_repr

GROUP = "pgf_jax.plugins"  # of entry points, by which installed packages name their modules
_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
_state = {"installed": False}


def load_plugin(module: str) -> None:
    """Import a module that registers something.

    Args:
      module: its name; it is looked for in the present folder too.

    Raises:
      BadInput: one line that names the module: there is none, or it cannot be imported.
    """
    is_file = str(module).endswith(".py")
    if not isinstance(module, str) or is_file or _NAME.fullmatch(module) is None:
        hint = ""
        if is_file:
            hint = f"; did you mean {str(module).removesuffix('.py').replace('/', '.')}?"
        raise BadInput(
            f"plugin: expected the name of a module, as in my_package.policies, got "
            f"{short_repr(module)}{hint}"
        )
    here = os.getcwd()
    if module.partition(".")[0] not in sys.modules and here not in sys.path:
        sys.path.append(here)  # last: nothing there takes the place of an installed package
    try:
        importlib.import_module(module)
    except BadInput as error:
        raise BadInput(f"plugin {module}: {error}") from None
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(error.name + ".")):
            raise BadInput(
                f"plugin: no module {module}, expected one that is installed or in {here}"
            ) from None
        raise _broken(module, error) from error
    except Exception as error:
        raise _broken(module, error) from error


def load_installed() -> None:
    """Import the plugins of installed packages, once.

    Raises:
      BadInput: one line that names the package and the module that cannot be imported.
    """
    if _state["installed"]:
        return
    _state["installed"] = True  # first, because plugins register while they are imported
    for entry in entry_points(group=GROUP):
        package = entry.dist.name if entry.dist is not None else "unknown"
        try:
            loaded = entry.load()
            if entry.attr:  # a function that registers
                loaded()
        except Exception as error:
            _state["installed"] = False
            raise BadInput(
                f"plugin {entry.value} of the installed package {package} cannot be imported "
                f"({type(error).__name__}: {error}); mend it, or uninstall {package}"
            ) from error


def _broken(module: str, error: Exception) -> BadInput:
    return BadInput(f"plugin {module} cannot be imported ({type(error).__name__}: {error})")
