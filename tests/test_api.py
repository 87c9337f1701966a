"""The public names: found, and found late."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import pgf_jax

HEAVY = ("jax", "mujoco", "polars", "matplotlib", "flax", "optax", "tyro", "numpy")


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stderr == ""
    return done.stdout.strip()


def test_importing_imports_nothing_and_prints_nothing():
    code = f"import sys, pgf_jax; print([m for m in {HEAVY} if m in sys.modules])"
    assert python(code) == "[]"


def test_importing_changes_no_environment():
    code = "import os; before = dict(os.environ); import pgf_jax, pgf_jax.cli"
    assert python(f"{code}; print(before == dict(os.environ))") == "True"


@pytest.mark.parametrize("name", pgf_jax.__all__)
def test_every_name_is_its_modules(name):
    module = importlib.import_module(f"pgf_jax.{pgf_jax._MODULES[name]}")
    assert getattr(pgf_jax, name) is getattr(module, name)
    assert name in dir(pgf_jax)


def test_the_names_that_checkers_read_are_those_that_are_looked_up():
    (block,) = (
        node
        for node in ast.parse(Path(pgf_jax.__file__).read_text()).body
        if isinstance(node, ast.If)
    )
    read = {
        alias.asname: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    looked_up = {name: f"pgf_jax.{module}:{name}" for name, module in pgf_jax._MODULES.items()}
    assert read == looked_up and len(block.body) == len(looked_up)


@pytest.mark.parametrize("name", ["plan", "sample_scene", "load_scene", "make_engine", "sweep"])
def test_the_promised_functions_are_there(name):
    assert callable(getattr(pgf_jax, name))


@pytest.mark.parametrize(
    "name", ["PlanConfig", "SweepConfig", "CollectConfig", "TrainConfig", "FleetConfig", "Physics"]
)
def test_configs_need_no_jax(name):
    code = (
        f"import sys, pgf_jax; pgf_jax.{name}; print('jax' in sys.modules, 'mujoco' in sys.modules)"
    )
    assert python(code) == "False False"


SCENE = "pgf_jax.sample_scene(0)"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (f"plan({SCENE}, 0)", "plan(key, scene): the arguments are swapped, got a Scene first"),
        (
            "plan('7', 'x.xml')",
            "key: expected one JAX key (uint32 words) or a whole number, got",
        ),
        (
            "plan(0, 'x.xml')",
            "scene: expected a Scene (or several), got 'x.xml'; pgf_jax.load_scene reads a file",
        ),
        ("plan(0, [1])", "scene: expected a Scene (or several), got 1"),
        (
            f"plan(0, {SCENE}, pgf_jax.SweepConfig())",
            "config: expected a PlanConfig, got a SweepConfig",
        ),
        ("plan(0, [], 'native')", "config: expected a PlanConfig, got 'native'"),
        ("sweep(pgf_jax.PlanConfig())", "config: expected a SweepConfig, got a PlanConfig"),
        ("sweep([])", "config: expected a SweepConfig, got []; sweeps takes several"),
        (
            "sweep(pgf_jax.SweepConfig)",
            "config: expected a SweepConfig, got the class SweepConfig: did you mean "
            "SweepConfig(...)?",
        ),
        ("sweeps(pgf_jax.SweepConfig())", "configs: expected a list of SweepConfig, got a SweepC"),
        ("sweeps([pgf_jax.PlanConfig()])", "configs: expected a SweepConfig, got a PlanConfig"),
        ("train('x', 'y', pgf_jax.PlanConfig())", "config: expected a TrainConfig, got a PlanC"),
        ("collect(pgf_jax.TrainConfig())", "config: expected a CollectConfig, got a TrainConfig"),
        (
            "verify('x')",
            "config: expected a VerifyConfig, got 'x'; VerifyConfig(folder) names it",
        ),
        ("SweepConfig(robots=5)", "robots: expected a list of whole numbers, as in robots=(5,), g"),
        (
            "SweepConfig(policies='pgf')",
            "policies: expected a list of names, as in policies=('pgf'",
        ),
        (
            "sample_scene(7, 'Wide')",
            "preset: expected one of tight, medium, wide, crowded, ",
        ),
        (f"load_scene({SCENE})", "path: expected a path, got a Scene"),
        ("load_plan(None)", "path: expected a path, got None"),
    ],
)
def test_wrong_arguments_are_one_line(call, message):
    with pytest.raises(pgf_jax.BadInput) as error:
        eval(f"pgf_jax.{call}")
    assert str(error.value).startswith(message)


def test_what_is_not_there_is_named():
    with pytest.raises(AttributeError, match="'pgf_jax' has no attribute 'nothing'"):
        _ = pgf_jax.nothing


def test_it_has_a_version():
    assert pgf_jax.__version__.count(".") == 2
