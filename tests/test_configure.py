"""`pgf_jax.configure`: what it sets, what it leaves alone, what it says when it is too late."""

import importlib.metadata
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from sweep_toys import ghost

import pgf_jax
from pgf_jax import jax_setup, provenance
from pgf_jax.jax_setup import CACHE, OPTIONS, VARIABLES
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.resolve import resolve
from pgf_jax.sweeping.sweep import sweep

FLAG = "--xla_backend_extra_options=" + ",".join(f"{k}={v}" for k, v in OPTIONS.items())
THRESHOLD, UNROLLING = OPTIONS
OFF = f"--xla_backend_extra_options={THRESHOLD}=0,{UNROLLING}=false"
TAKEN = {"XLA_FLAGS": OFF, "NPROC": "2"}  # by the user
NAMES = [name.removeprefix("xla_cpu_") for name in OPTIONS]
ON = dict(zip(NAMES, OPTIONS.values(), strict=True))


@pytest.fixture
def untouched(monkeypatch):
    """A process that has set nothing and not imported JAX, as far as `configure` can see."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delitem(sys.modules, "jax")
    monkeypatch.setattr(jax_setup, "started", lambda: False)
    monkeypatch.setenv("HOME", "/home/somebody")
    return monkeypatch


def settings() -> dict[str, str]:
    return {name: os.environ[name] for name in VARIABLES if name in os.environ}


def python(code: str, environment: dict[str, str]) -> dict:
    """The line of JSON that a fresh interpreter prints, which has no other settings of JAX."""
    inherited = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**inherited, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def test_what_it_sets(untouched):
    pgf_jax.configure()
    cache = dict(zip(CACHE, ("/home/somebody/.cache/pgf_jax", "0.05"), strict=True))
    assert settings() == {"XLA_FLAGS": FLAG, "NPROC": "1", **cache}
    pgf_jax.configure()  # again: nothing is added
    assert settings()["XLA_FLAGS"] == FLAG


def test_other_engines_keep_their_threads(untouched):
    pgf_jax.configure("mjx")
    assert "NPROC" not in settings() and settings()["XLA_FLAGS"] == FLAG


def test_what_the_user_has_set_stays(untouched):
    mine = dict(zip(VARIABLES, (TAKEN["XLA_FLAGS"], "3", "elsewhere", "7"), strict=True))
    for name, value in mine.items():
        untouched.setenv(name, value)
    pgf_jax.configure()
    assert settings() == mine


@pytest.mark.parametrize(
    ("flags", "after"),
    [
        ("--xla_cpu_enable_fast_math=false", f"--xla_cpu_enable_fast_math=false {FLAG}"),
        ("--xla_backend_extra_options=other=1", f"--xla_backend_extra_options=other=1 {FLAG}"),
        (
            f"--xla_backend_extra_options={THRESHOLD}=9",
            f"--xla_backend_extra_options={THRESHOLD}=9 "
            f"--xla_backend_extra_options={UNROLLING}=true",
        ),
        ("flags.txt", "flags.txt"),  # a file of flags
    ],
)
def test_other_flags_are_kept(flags, after, untouched):
    untouched.setenv("XLA_FLAGS", flags)
    pgf_jax.configure()
    assert settings()["XLA_FLAGS"] == after


def test_another_release_of_jaxlib_runs_without_the_option_and_says_so_once(untouched):
    jax_setup._is_tested.cache_clear()
    untouched.setattr(importlib.metadata, "version", lambda name: "9.9")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        pgf_jax.configure()
        pgf_jax.configure()
    jax_setup._is_tested.cache_clear()
    assert "XLA_FLAGS" not in settings() and settings()["NPROC"] == "1"
    (line,) = (str(warning.message) for warning in said)
    assert line.startswith("pgf_jax: jaxlib 9.9 runs without") and "\n" not in line


def test_the_installed_jaxlib_is_a_tested_one():
    assert importlib.metadata.version("jaxlib") in jax_setup.TESTED


@pytest.mark.parametrize(
    ("force", "missing"),
    [
        ((None, None, 2), f"XLA_FLAGS={FLAG} and NPROC=1"),
        (("9", None, 1), f"XLA_FLAGS=--xla_backend_extra_options={UNROLLING}=true"),
        (("1000000000", "true", 2), "NPROC=1"),
        (("1000000000", "true", 1), None),
        (("0", "false", None), None),  # the user's; threads cannot be seen
    ],
)
def test_what_is_missing_when_jax_has_started_is_named(force, missing, untouched):
    untouched.setattr(jax_setup, "started", lambda: True)
    names = (*NAMES, "threads")
    untouched.setattr(jax_setup, "in_force", lambda: dict(zip(names, force, strict=True)))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        pgf_jax.configure()
        jax_setup.configure_early("planar")  # says nothing
    assert [str(warning.message) for warning in said] == (
        []
        if missing is None
        else [
            f"pgf_jax.configure(): JAX has started already: without {missing} computations are "
            "slower; call it before the first one"
        ]
    )
    assert settings().keys() == set(CACHE)  # programs are kept all the same


AFTER_IMPORT = """
import json, os, jax, pgf_jax
early = pgf_jax.jax_setup.started() if hasattr(pgf_jax, "jax_setup") else None
pgf_jax.configure()
import pgf_jax.jax_setup as setup
started = setup.started()
jax.devices()
print(json.dumps([early, started, setup.in_force(), jax.config.jax_compilation_cache_dir]))
"""


def test_it_is_in_time_after_the_import_of_jax(tmp_path):
    early, started, force, cache = python(AFTER_IMPORT, {"HOME": str(tmp_path)})
    assert early is None and started is False  # importing pgf_jax imports nothing
    assert force == {**ON, "threads": 1}
    assert cache == str(tmp_path / ".cache" / "pgf_jax")


TOO_LATE = """
import json, os, warnings, jax, pgf_jax
jax.jit(lambda x: x + 1)(1)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    pgf_jax.configure()
os.environ["XLA_FLAGS"] = "--xla_later=1"  # not what JAX was started with
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.jit(lambda x: x * 2)(1)
print(json.dumps([[str(w.message) for w in said], pgf_jax.jax_setup.in_force()]))
"""


def test_after_the_first_computation_it_says_so_and_keeps_programs(tmp_path):
    said, force = python(TOO_LATE, {"HOME": str(tmp_path), "NPROC": "2"})
    assert len(said) == 1 and f"without XLA_FLAGS={FLAG} computations" in said[0]
    assert force == {**dict.fromkeys(NAMES), "threads": 2}
    assert any((tmp_path / ".cache" / "pgf_jax").iterdir())


PLAN = """
import json, pgf_jax
xy = [(0.36, 0.0), (0.42, 0.05), (0.42, -0.05), (0.48, 0.08), (0.48, -0.08), (0.52, 0.0)]
objects = [(x, y, 0.03) for x, y in xy]
scene = pgf_jax.Scene("six", objects, 5)
never = ("feasible_cost=1e-6",)  # it goes on until its time is up
config = pgf_jax.PlanConfig(lanes=2, task_limit=15.0, cost_weights=never)
plans = pgf_jax.plan(0, [scene] * 2, config)
print(json.dumps([[plan.to_json() for plan in plans], pgf_jax.jax_setup.in_force()]))
"""


def test_a_plan_is_configured_and_nearly_the_same_without():
    cache = {name: os.environ[name] for name in CACHE}  # of the tests: to compile once
    fast, slow = python(PLAN, cache), python(PLAN, {**cache, **TAKEN})
    assert fast[1] == {**ON, "threads": 1}
    assert slow[1] == {NAMES[0]: "0", NAMES[1]: "false", "threads": 2}
    histories = [[plan["history"] for plan in plans] for plans, _ in (fast, slow)]
    assert len(histories[0][0]) > 3
    np.testing.assert_allclose(*histories, rtol=1e-3)


def test_planar_without_the_options_is_another_revision(monkeypatch):
    (cell,) = resolve(SweepConfig(robots=(1,), policies=("pgf",), tasks=1)).cells
    revisions = cell.identity["revisions"]
    assert revisions["engine"] == 2 and "xla options" not in revisions
    monkeypatch.setattr("pgf_jax.sweeping.resolve.has_options", lambda: False)
    (other,) = resolve(SweepConfig(robots=(1,), policies=("pgf",), tasks=1)).cells
    assert other.identity["revisions"] == {**revisions, "xla options": 2}
    assert other.key != cell.key


def test_workers_have_the_options_that_their_caller_has(tmp_path, monkeypatch):
    provenance.device()  # starts JAX here
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    done = sweep(ghost(tmp_path / "sweep", robots=(1,), tasks=1, workers=2), quiet=True)
    assert settings() == {}
    accounts = [json.loads(path.with_suffix(".json").read_text()) for path in done.files.values()]
    assert {account["host"]["pid"] for account in accounts}.isdisjoint({os.getpid()})
    for account in accounts:
        assert account["host"]["xla"].items() >= ON.items()
    manifest = json.loads((tmp_path / "sweep" / "manifest.json").read_text())
    assert "xla" not in manifest  # the same whoever computes


def test_what_is_in_force_is_part_of_the_environment_but_of_no_identity(tmp_path):
    here = provenance.environment()
    assert here["xla"] == jax_setup.in_force()
    assert here["xla"]["threads"] is None or here["xla"]["threads"] >= 1
    assert here.keys() - provenance.origin().keys() == {"xla"}
    assert "xla" not in provenance.kind()


def test_nothing_else_sets_the_variables():
    root = Path(__file__).parents[1]
    files = [*(root / "pgf_jax").rglob("*.py"), *(root / "experiments").glob("*.py")]
    found = {p.name for p in files if any(f'"{name}"' in p.read_text() for name in VARIABLES)}
    assert found == {"jax_setup.py"}
