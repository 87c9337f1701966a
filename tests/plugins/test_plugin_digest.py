"""What a plugin is made of decides on its digest, and nothing else does."""

import dataclasses
import functools
import sys
import types
from typing import Any

import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.plugins import digest
from pgf_jax.plugins.digest import settings_digest, source_digest
from pgf_jax.plugins.registry import Plugin, made_of


@dataclasses.dataclass
class Settled:
    a: float = 1.0
    b: Any = None


class Plain:
    def __init__(self, **attributes):
        self.__dict__.update(attributes)


class Slotted:
    __slots__ = ("x",)

    def __init__(self, x):
        self.x = x


def closure(x):
    return lambda config: x


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package on the disk that has been imported; returns its folder, and how to look again."""
    folder = tmp_path / "some_policies"
    (folder / "inner").mkdir(parents=True)
    for name in ("__init__.py", "inner/__init__.py", "inner/rules.py", "weights.json"):
        (folder / name).write_text("x = 1\n")
    module = types.ModuleType("some_policies")
    module.__path__ = [str(folder)]
    monkeypatch.setitem(sys.modules, "some_policies", module)

    def look() -> str | None:
        digest._files_digest.cache_clear()
        return source_digest("some_policies.inner.rules", None)

    return folder, look


@pytest.mark.parametrize("name", ["__init__.py", "inner/rules.py", "weights.json"])
def test_every_file_of_the_package_counts(package, name):
    folder, look = package
    before = look()
    (folder / name).write_text("x = 2\n")
    after = look()
    assert before is not None and after != before
    (folder / name).write_text("x = 1\n")
    assert look() == before


def test_a_new_file_counts_and_a_compiled_one_does_not(package):
    folder, look = package
    before = look()
    for name in ("__pycache__/rules.pyc", ".hidden", "rules.pyc"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("?")
    assert look() == before
    (folder / "more.py").write_text("")
    assert look() != before


def test_a_module_of_one_file(tmp_path, monkeypatch):
    file = tmp_path / "alone.py"
    module = types.ModuleType("alone")
    module.__file__ = str(file)
    monkeypatch.setitem(sys.modules, "alone", module)
    digests = []
    for text in ("x = 1", "x = 2", "x = 1"):
        file.write_text(text)
        digests.append(source_digest("alone", None))
    assert digests[0] == digests[2] != digests[1]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Settled(1.0), Settled(2.0)),
        (Settled(1.0), Settled(1)),
        (Settled(b=[1, 2]), Settled(b=[2, 1])),
        (Settled(b={"x": 1}), Settled(b={"x": 2})),
        (Settled(b=np.arange(3)), Settled(b=np.arange(3.0))),
        (Settled(b=np.arange(3)), Settled(b=np.arange(3) + 1)),
        (Settled(b=Plain(x=1)), Settled(b=Plain(x=2))),
        (Plain(x=1), Plain(x=2)),
        (Plain(x=1), Plain(y=1)),
        (Slotted(1), Slotted(2)),
        (closure(1), closure(2)),
        (functools.partial(Plain, x=1), functools.partial(Plain, x=2)),
        (Plain(x=Plain), Plain(x=Settled)),
        (Plain(x={1, 2}), Plain(x={1, 3})),
        (Plain(x=Settled().__eq__), Plain(x=Settled(2.0).__eq__)),
    ],
)
def test_settings_count(one, other):
    assert settings_digest(one) != settings_digest(other)


def test_equal_settings_have_one_digest():
    for make in (
        lambda: Settled(3.0, [np.ones(2), {"a": (1, None)}]),
        lambda: Plain(x=Slotted("a"), y={"b", "a"}),
        lambda: closure(Settled()),
    ):
        assert settings_digest(make()) == settings_digest(make())
    itself = Plain(x=1)
    itself.me = itself  # pyright: ignore[reportAttributeAccessIssue]
    assert settings_digest(itself) == settings_digest(itself)


def test_what_cannot_be_seen_needs_a_version():
    hidden = Plain(generator=np.random.default_rng(0))
    plugin = Plugin("policy", "hidden", "some_module", None, "abc")
    with pytest.raises(BadInput, match=r"policy 'hidden': holds a .*; expected .* version='1'"):
        made_of(plugin, hidden)
    first, second = (dataclasses.replace(plugin, version=version) for version in "12")
    assert made_of(first, hidden) == made_of(first, hidden) != made_of(second, hidden)


# -- notebooks -----------------------------------------------------------------------------------

CELL = """
LIMIT = {limit}
def helper(x):
    return x + {add}
class Base:
    def inherited(self): return {base}
class Mine(Base):
    factor = {factor}
    def bid(self, result): {comment}
        return [helper(result) for _ in range(3)] if result > LIMIT else {{'a', 'b'}}
make = lambda config: Mine()
"""
VALUES = {"limit": 1, "add": 1, "base": 1, "factor": 1, "comment": ""}


def of_notebook(monkeypatch, **changes) -> str | None:
    notebook = types.ModuleType("__main__")  # without a file
    monkeypatch.setitem(sys.modules, "__main__", notebook)
    exec(compile(CELL.format(**(VALUES | changes)), "<cell>", "exec"), vars(notebook))
    found = source_digest("__main__", notebook.make)
    monkeypatch.undo()
    return found


def test_the_code_of_a_notebook_counts(monkeypatch):
    first = of_notebook(monkeypatch)
    assert first is not None and of_notebook(monkeypatch) == first
    assert of_notebook(monkeypatch, comment="# a comment") == first
    changed = [of_notebook(monkeypatch, **{name: 2}) for name in ("limit", "add", "base", "factor")]
    assert len({first, *changed}) == 5


def test_no_code_at_all(monkeypatch):
    monkeypatch.setitem(sys.modules, "__main__", types.ModuleType("__main__"))
    assert source_digest("__main__", len) is None


def test_a_module_without_a_file_that_is_there(tmp_path):
    (tmp_path / "here.py").write_text("")
    assert digest.source_file({"__file__": str(tmp_path / "here.py")}) is not None
    for names in ({}, {"__file__": None}, {"__file__": "<stdin>"}):
        assert digest.source_file(names) is None
