"""The READMEs: their examples run, their lists are those of the code, their links lead on."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import pgf_jax
from pgf_jax.scene.file import scene_to_json

ROOT = Path(__file__).resolve().parents[1]
READMES = [
    "README.md",
    "pgf_jax/README.md",
    "pgf_jax/physics/planar/README.md",
    "experiments/README.md",
    "experiments/BENCHMARKS.md",
    "experiments/REPRODUCTION.md",
    "checkpoints/README.md",
]


def text(name: str) -> str:
    return (ROOT / name).read_text()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the examples of the first README have been run."""
    folder = tmp_path_factory.mktemp("readme")
    run(folder, text("README.md"))
    return folder


def run(folder: Path, readme: str) -> str:
    """Run the Python examples of a README as one script; what it printed."""
    script = folder / "examples.py"
    script.write_text("\n".join(re.findall(r"^```python\n(.*?)^```", readme, re.M | re.S)))
    result = subprocess.run(
        [sys.executable, script], cwd=folder, capture_output=True, text=True, timeout=600
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_the_first_readmes_example_runs(folder):
    assert (folder / "results" / "plans" / "wide_7.plan.json").is_file()
    assert (folder / "results" / "sweep" / "summary.csv").is_file()


def test_the_examples_of_extension_run(tmp_path):
    printed = run(tmp_path, text("pgf_jax/README.md"))
    success, events = printed.splitlines()[-1].split()
    assert 0.0 <= float(success) <= 1.0 and int(events) > 8
    manifest = json.loads((tmp_path / "results" / "own" / "manifest.json").read_text())
    assert (manifest["engine"], manifest["config"]["operator"]) == ("counting", "nearest")
    assert {cell["policy"] for cell in manifest["cells"]} == {"when-costly", "or-hitl"}


def test_file_formats_are_those_of_the_schemas():
    from pgf_jax.inspection.file_formats import markdown

    begin, end = "<!-- file formats: begin -->\n", "<!-- file formats: end -->"
    readme = text("pgf_jax/README.md")
    written = readme[readme.index(begin) + len(begin) : readme.index(end)]
    assert written.strip() == markdown().strip()


def test_keys_of_json_files_are_those_that_are_written(folder):
    from pgf_jax.inspection.file_formats import json_formats

    keys = {file.name: set(file.keys) for file in json_formats()}
    results = folder / "results"
    (cell, *_) = (results / "sweep" / "cells").glob("*.json")
    for name, path in {
        "NAME.plan.json": results / "plans" / "wide_7.plan.json",
        "manifest.json": results / "sweep" / "manifest.json",
        "run.json": results / "sweep" / "run.json",
        "cells/KEY.json": cell,
    }.items():
        only_sometimes = {"scene_file"} if name == "NAME.plan.json" else set()
        assert keys[name] - only_sometimes == set(json.loads(path.read_text())), name
    scene = pgf_jax.sample_scene(0, "mixed")
    assert keys["NAME.json"] == set(scene_to_json(scene))


def test_the_diagram_of_rooms_is_the_contract():
    contract = tomllib.loads(text("pyproject.toml"))["tool"]["importlinter"]["contracts"][0]
    layers = [layer.replace(" ", "").split("|") for layer in contract["layers"]]
    diagram = re.search(r"```\n(cli .*?)```", text("pgf_jax/README.md"), re.S)
    assert diagram is not None
    drawn = [re.split(r"\s{3,}", line)[0].split() for line in diagram[1].splitlines()]
    *rooms, helpers = drawn
    assert rooms == layers[: len(rooms)]
    assert [[name] for name in helpers] == layers[len(rooms) :]


def test_every_room_says_what_it_does():
    for path in sorted((ROOT / "pgf_jax").rglob("__init__.py")):
        lines = path.read_text().split('"""')[1].splitlines()
        assert len(lines[0]) > 20 and lines[0].endswith((".", ":")), path
        assert path.parent.name == "pgf_jax" or len(lines) <= 11, path


def test_the_first_readme_is_short():
    assert len(text("README.md").splitlines()) <= 150


def test_the_glossary_has_every_policy():
    from pgf_jax.sweeping.config import GAINLESS

    glossary = text("experiments/README.md").partition("## Glossary\n")[2]
    explained = re.findall(r"^\| `([a-z+-]+)` \| \w", glossary, re.M)
    assert sorted(explained) == sorted({"pgf", "pgf+plan", *GAINLESS})


@pytest.mark.parametrize("name", READMES)
def test_links_lead_somewhere(name):
    for target in re.findall(r"\]\(([^)\s]+)\)", text(name)):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        file = ((ROOT / name).parent / path).resolve() if path else ROOT / name
        assert file.exists(), f"{name}: {target}"
        if anchor:
            titles = re.findall(r"^#+ (.*)$", file.read_text(), re.M)
            headings = {re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles}
            assert anchor in headings, f"{name}: {target}"
