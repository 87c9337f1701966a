"""The layers contract: it holds, and it fails where it should."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LINT = Path(sys.executable).with_name("lint-imports")


def lint(folder: Path) -> subprocess.CompletedProcess:
    """The linter's run on the package in a folder; not on the one that is installed."""
    return subprocess.run(
        [LINT, "--no-logo", "--no-cache", "--config", str(folder / "pyproject.toml")],
        cwd=folder,
        env={"PYTHONPATH": str(folder), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "pgf_jax", tmp_path / "pgf_jax", ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_each_layer_imports_only_the_layers_below_it(copy):
    result = lint(copy)
    assert result.returncode == 0, result.stdout
    assert "2 kept, 0 broken" in result.stdout


@pytest.mark.parametrize(
    ("room", "line", "words"),
    [
        ("fleet/config.py", "from pgf_jax.sweeping import config", "pgf_jax.fleet is not allowed"),
        ("planning/cost.py", "import pgf_jax.fleet.simulator", "pgf_jax.planning is not allowed"),
        ("render/top.py", "from pgf_jax.console import page", "pgf_jax.render is not allowed"),
        ("fleet/events.py", "from pgf_jax.fleet import simulator", "No cycles are allowed"),
        ("newroom/__init__.py", "", "newroom"),
    ],
    ids=["upward", "far upward", "sideways", "circle", "room of no layer"],
)
def test_an_import_against_the_layers_breaks_the_contract(copy, room, line, words):
    file = copy / "pgf_jax" / room
    file.parent.mkdir(exist_ok=True)
    file.write_text((file.read_text() if file.exists() else "") + f"\n{line}\n")
    result = lint(copy)
    assert result.returncode != 0
    assert words in " ".join((result.stdout + result.stderr).split())


def test_rooms_and_modules_are_of_a_size_to_be_read():
    modules = list((ROOT / "pgf_jax").rglob("*.py"))
    long = {str(p): n for p in modules if (n := len(p.read_text().splitlines())) > 400}
    assert not long
    rooms: dict[Path, int] = {}
    for path in modules:
        rooms[path.parent] = rooms.get(path.parent, 0) + 1
    assert max(rooms.values()) <= 20
