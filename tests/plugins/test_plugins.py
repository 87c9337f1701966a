"""Policies, operators and engines of the user's own: registered, checked, and named in results."""

import dataclasses
import importlib.metadata
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from registered import registered
from sweep_toys import ghost

import pgf_jax
from pgf_jax.errors import BadInput
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.policies import POLICIES, AskWhenStuck, Discipline, make_policy
from pgf_jax.guidance.operators.base import check_input
from pgf_jax.guidance.operators.registry import OPERATORS, make_operator
from pgf_jax.guidance.view import View
from pgf_jax.physics.engine import ENGINES
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.plugins import loading, registry
from pgf_jax.plugins.registry import Caller, Plugin, check_importable, require
from pgf_jax.sweeping.sweep import sweep

WINDOW = Discipline.WINDOW


@dataclasses.dataclass(frozen=True)
class Asks(pgf_jax.PolicyBase):
    """Bids a number after each iteration."""

    number: Any = 1.0
    discipline: Any = "line"

    def bid(self, result, progress):
        return self.number


def asks(**settings):
    return lambda config: Asks(**settings)


# -- registering ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["policy", "operator", "engine"])
def test_a_name_is_registered_once(kind):
    register = getattr(pgf_jax, f"register_{kind}")
    try:
        register("twice", Asks)
        with pytest.raises(
            BadInput, match=f"^{kind} 'twice' is registered already; .*replace=True"
        ):
            register("twice", Asks)
        register("twice", asks(), replace=True)
        assert registry.REGISTRIES[kind].make("twice") is not Asks
        assert registry.REGISTRIES[kind].plugin("twice") == Plugin(
            kind, "twice", __name__, None, registry.source_digest(__name__, None)
        )
    finally:
        registry.REGISTRIES[kind].unregister("twice")


def test_a_built_in_name_is_taken():
    with pytest.raises(BadInput, match=r"^policy 'pgf' is registered already"):
        pgf_jax.register_policy("pgf", asks())


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("a/b", Asks, "register_policy: expected a name of printable text without /, got 'a/b'"),
        ("", Asks, "register_policy: expected a name"),
        (5, Asks, "register_policy: expected a name of printable text without /, got 5"),
        ("mine", "Mine", "'mine': expected a class or a function that makes one, got 'Mine'"),
    ],
)
def test_what_cannot_be_registered(name, make, message):
    with pytest.raises(BadInput, match=message):
        pgf_jax.register_policy(name, make)


def test_what_has_no_source_needs_a_version(monkeypatch):
    monkeypatch.setattr(registry, "source_digest", lambda *_: None)
    with pytest.raises(BadInput, match=r"cannot see its source, .*expected version='1'"):
        pgf_jax.register_policy("unseen", asks())
    try:
        pgf_jax.register_policy("unseen", asks(), version="3")
        plugin = POLICIES.plugin("unseen")
        assert plugin is not None and plugin.version == "3"
    finally:
        POLICIES.unregister("unseen")


# -- what plugins get wrong ----------------------------------------------------------------------


def made(**settings):
    with registered(POLICIES, mine=asks(**settings)):
        return make_policy(FleetConfig(policy="mine"))


@pytest.mark.parametrize("given", ["window", "line", "refuse", WINDOW])
def test_a_discipline_may_be_text(given):
    policy = made(discipline=given)
    assert policy.discipline is Discipline(given)


@pytest.mark.parametrize("given", ["windows", "WINDOW", None, 3])
def test_a_misspelt_discipline_is_refused(given):
    with pytest.raises(BadInput, match=r"^policy 'mine': discipline: expected one of window, "):
        made(discipline=given)


@pytest.mark.parametrize("number", [math.nan, np.float32("nan"), (1.0, 2.0), "1", np.ones(2), True])
def test_a_bid_that_is_no_number_is_named(number):
    policy: Any = made(number=number)
    with pytest.raises(BadInput, match=r"^policy 'mine': bid: expected a number or None, got "):
        policy.bid(None, None)


def test_bids_of_numpy_are_numbers():
    policy: Any = made(number=np.float32(2.5))
    assert policy.bid(None, None) == 2.5 and type(policy.bid(None, None)) is float
    assert policy.first_bid(None) is None


def test_what_is_no_policy_is_named():
    with (
        registered(POLICIES, mine=lambda config: (1, 2)),
        pytest.raises(BadInput, match=r"^policy 'mine': \(1, 2\) has no method first_bid"),
    ):
        make_policy(FleetConfig(policy="mine"))


def test_what_is_no_operator_is_named():
    with (
        registered(OPERATORS, mine=lambda: "somebody"),
        pytest.raises(BadInput, match=r"^operator 'mine': 'somebody' has no method decide\(view\)"),
    ):
        make_operator("mine")


VIEW: View = View(
    np.zeros((3, 2)),
    0,
    np.zeros(3),
    0.0,
    *(np.zeros(1) for _ in range(5)),  # pyright: ignore[reportArgumentType]
    request=0,
    dropped=0,
)


@pytest.mark.parametrize(
    "given",
    [None, UNANSWERED, Push(2, 0.20, -0.38), Push(np.int64(0), np.float32(0.5), 0)],  # pyright: ignore
)
def test_inputs_that_are_taken(given):
    taken = check_input("mine", given, VIEW)
    assert taken == given
    if isinstance(taken, Push):
        assert [type(value) for value in dataclasses.astuple(taken)] == [int, float, float]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((1, 0.3, 0.0), r"expected a Push\(object, x, y\), or None to go on reaching, got \(1, 0"),
        (math.nan, "expected a Push"),
        (Push(3, 0.3, 0.0), r"push of object 3, expected one of 0\.\.2"),
        (Push(-1, 0.3, 0.0), "push of object -1"),
        (Push(1.0, 0.3, 0.0), "push of object 1.0"),  # pyright: ignore[reportArgumentType]
        (Push(1, 0.19, 0.0), r"push to \(0.19, 0.0\) m, which is off the shelf; expected x within"),
        (Push(1, 0.59, 0.0), ".* off the shelf"),
        (Push(1, 0.3, 0.39), ".* off the shelf"),
        (Push(1, math.nan, 0.0), ".* off the shelf"),
        (Push(1, "left", 0.0), ".* off the shelf"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_inputs_that_are_refused(given, message):
    with pytest.raises(BadInput, match=rf"^operator 'mine': {message}"):
        check_input("mine", given, VIEW)


class Aimless:
    name = "aimless"

    def decide(self, view):
        return Push(0, 0.7, 0.0)


def test_an_operator_that_misses_the_shelf_ends_a_sweep_in_one_line(tmp_path):
    with (
        registered(OPERATORS, aimless=Aimless),
        pytest.raises(BadInput, match=r"^operator 'aimless': push to .* off the shelf"),
    ):
        sweep(ghost(tmp_path, operator="aimless", policies=("queue",)), quiet=True)


# -- results -------------------------------------------------------------------------------------


def test_a_changed_policy_computes_its_cells_again_and_no_others(tmp_path, capsys):
    with registered(POLICIES, mine=asks()):
        config = ghost(tmp_path, policies=("mine", "autonomous"), robots=(2,), seeds=(0, 1))
        first = sweep(config, quiet=True)
        assert len(first.computed) == 4
        kept = {cell: path.stat().st_mtime_ns for cell, path in first.files.items()}
        again = dataclasses.replace(config, resume=True)
        assert sweep(again, quiet=True).computed == ()
    with registered(POLICIES, mine=asks(number=2.0)):
        second = sweep(again)
    assert second.computed == ("mine_R2_seed0", "mine_R2_seed1")
    said = capsys.readouterr().err
    assert "computed again, as a plugin has changed since: mine_R2_seed" in said
    for cell, path in second.files.items():
        old = first.files[cell]
        assert (path == old and path.stat().st_mtime_ns == kept[cell]) == (cell.policy != "mine")
        assert path.exists() and (path == old or not old.exists())
    bids = second.events().filter(pl.col("kind") == "bid")
    assert set(bids["gain"]) == {2.0}


def test_results_say_what_plugins_they_were_made_with(tmp_path):
    with registered(POLICIES, mine=asks()):
        found = sweep(ghost(tmp_path, policies=("mine", "autonomous"), robots=(1,)), quiet=True)
    loaded = pgf_jax.load_sweep(tmp_path)
    record = loaded.manifest["plugins"]
    assert set(record) == {"policy mine", "engine ghost"}
    assert record["engine ghost"]["module"] == "sweep_toys"
    digests = dict(loaded.tasks.select("policy", "plugins_sha256").unique().iter_rows())
    engine = f"engine:{record['engine ghost']['sha256']}"
    assert digests["autonomous"] == engine
    assert digests["mine"] == f"policy:{record['policy mine']['sha256']} {engine}"
    assert found.origins == 1


def test_what_is_built_in_is_named_by_its_revision_from_two_on(tmp_path, monkeypatch):
    from pgf_jax.sweeping.resolve import resolve

    config = pgf_jax.SweepConfig(
        robots=(1,),
        policies=("or-hitl",),
        tasks=1,
        out=tmp_path,
        engine="native",
        operator="oracle",
    )
    (before,) = resolve(config).cells
    assert not {"plugins", "revisions"} & set(before.identity)
    monkeypatch.setitem(ENGINES._revisions, "native", 2)
    (after,) = resolve(config).cells
    assert after.identity == {**before.identity, "revisions": {"engine": 2}}


# -- loading -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("module", "message"),
    [
        ("no_such_module_here", "plugin: no module no_such_module_here, expected one that is"),
        ("mine.py", "expected the name of a module, .* got 'mine.py'; did you mean mine?"),
        ("my policies", "expected the name of a module"),
        ("", "expected the name of a module"),
        (5, "expected the name of a module"),
    ],
)
def test_what_is_no_plugin(module, message):
    with pytest.raises(BadInput, match=message):
        loading.load_plugin(module)


def test_a_plugin_that_cannot_be_imported_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name, text in (("broken_one", "1 / 0"), ("broken_two", "import no_such_package_at_all")):
        Path(f"{name}.py").write_text(text)
        with pytest.raises(BadInput, match=rf"^plugin {name} cannot be imported \(\w+Error: "):
            loading.load_plugin(name)
    Path("broken_three.py").write_text("import pgf_jax; pgf_jax.register_policy('pgf', dict)")
    with pytest.raises(BadInput, match=r"^plugin broken_three: policy 'pgf' is registered already"):
        loading.load_plugin("broken_three")


class Entry:
    def __init__(self, load, attr=""):
        self.load, self.attr, self.value = load, attr, "somewhere:there"
        self.dist = importlib.metadata.distribution("pgf_jax")


def test_plugins_of_installed_packages_are_found(monkeypatch):
    called = []

    def register():
        called.append(True)
        POLICIES.register(
            "installed", asks(), caller=Caller(__name__, None), version="1", replace=True
        )

    monkeypatch.setattr(loading, "entry_points", lambda group: [Entry(lambda: register, "there")])
    monkeypatch.setitem(loading._state, "installed", False)
    try:
        assert FleetConfig(policy="installed").policy == "installed"
        assert "installed" in POLICIES.names() and called == [True]
    finally:
        POLICIES.unregister("installed")


def test_a_broken_installed_plugin_is_named_with_its_package(monkeypatch):
    def broken():
        raise ImportError("no such thing")

    monkeypatch.setattr(loading, "entry_points", lambda group: [Entry(broken)])
    monkeypatch.setitem(loading._state, "installed", False)
    with pytest.raises(BadInput, match="somewhere:there of the installed package pgf_jax"):
        FleetConfig(policy="pgf")


# -- worker processes ----------------------------------------------------------------------------


def test_what_workers_cannot_import(monkeypatch):
    there = Plugin("policy", "mine", "__main__", None, "abc")
    monkeypatch.setattr(registry, "is_interactive", lambda module: True)
    for workers in ("here", "elsewhere"):
        with pytest.raises(BadInput, match=r"^policy 'mine' is defined in a notebook .*workers=1"):
            check_importable(there, workers)
    monkeypatch.setattr(registry, "is_interactive", lambda module: False)
    check_importable(there, "here")  # local processes run the main script
    with pytest.raises(BadInput, match=r"^policy 'mine' is defined in the main script"):
        check_importable(there, "elsewhere")
    check_importable(dataclasses.replace(there, module="somewhere"), "elsewhere")


def test_a_worker_with_another_source_is_refused():
    with registered(POLICIES, mine=asks()):
        ours = POLICIES.plugin("mine")
        assert ours is not None
        require(ours, "worker")
        with pytest.raises(BadInput, match=r"^worker: has another source of policy 'mine'"):
            require(dataclasses.replace(ours, version="2"), "worker")
    with pytest.raises(BadInput, match="has no policy 'mine': importing math does not register it"):
        require(dataclasses.replace(ours, module="math"), "worker")


SCRIPT = """
import sys
import pgf_jax
import sweep_toys

class Mine(pgf_jax.PolicyBase):
    discipline = "line"
    def bid(self, result, progress):
        return 1.0

if {outside} or __name__ == "__main__":
    pgf_jax.register_policy("of the script", lambda config: Mine())

if __name__ == "__main__":
    config = sweep_toys.ghost(sys.argv[1], policies=("of the script", "autonomous"), workers=2)
    print(pgf_jax.sweep(config, quiet=True).computed)
"""


@pytest.mark.parametrize("outside", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_main_script_may_register_with_several_workers(tmp_path, outside):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(outside=outside))
    path = ":".join(entry for entry in sys.path if entry)
    result = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "out")],
        capture_output=True,
        text=True,
        env={"PYTHONPATH": path, "PATH": "/usr/bin:/bin", "HOME": str(Path.home())},
    )
    if outside:
        assert "of the script_R2" in result.stdout, result.stderr
    else:
        last = result.stderr.splitlines()[-1]
        assert "has no policy 'of the script': the main script registers it under" in last
        assert "or compute with workers=1" in last


def test_the_command_line_loads_plugins(tmp_path):
    (tmp_path / "of_the_folder.py").write_text(
        "import pgf_jax\n"
        "from pgf_jax.guidance.operators.base import NoOperator\n"
        "pgf_jax.register_operator('of the folder', NoOperator)\n"
    )
    command = "plan --scene-class wide --engine native --operator nobody"
    result = subprocess.run(
        [sys.executable, "-m", "pgf_jax", *command.split(), "--plugin", "of_the_folder"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert result.returncode == 2
    assert "--operator: expected one of none, heuristic, " in result.stderr
    assert "of the folder" in result.stderr and result.stderr.count("\n") == 1


# -- interactive processes decide for one worker --------------------------------------------------


def test_a_policy_of_a_notebook_is_computed_in_this_process(tmp_path, monkeypatch):
    """Without a number of workers; with one, a line says what to do."""
    from pgf_jax.sweeping import sweep as sweeping

    monkeypatch.setattr(sweeping, "is_interactive", lambda module: True)
    monkeypatch.setattr(registry, "is_interactive", lambda module: True)
    monkeypatch.setattr(sweeping, "TASKS_A_PROCESS", 1)
    with registered(POLICIES, mine=ask_once):
        config = ghost(tmp_path, policies=("mine",), engine="ghost")
        result = sweep(config, quiet=True)
        assert len(result.computed) == 2
        two = dataclasses.replace(config, out=tmp_path / "two", workers=2)
        with pytest.raises(BadInput, match="is defined in a notebook"):
            sweep(two, quiet=True)


def ask_once(config):
    return AskWhenStuck(Discipline.LINE)
