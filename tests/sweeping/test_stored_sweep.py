"""Results that an earlier version stored can still be verified, resumed, replayed and loaded."""

import json
import shutil
from pathlib import Path

import pytest
from sweep_toys import ghost

import pgf_jax
from pgf_jax.inspection.folder_check import check_files
from pgf_jax.provenance import environment
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.replay import replay, replay_difference
from pgf_jax.sweeping.resolve import config_of, resolve
from pgf_jax.sweeping.sweep import sweep

STORED = Path(__file__).parents[1] / "stored"


@pytest.fixture
def stored(tmp_path) -> Path:
    return Path(shutil.copytree(STORED / "sweep", tmp_path / "sweep"))


def test_its_files_are_as_they_were_written(stored):
    checked = check_files(stored)
    assert checked.complete and len(checked.sound) == 4 and checked.findings == ()


@pytest.mark.parametrize("name", ["tasks.parquet", "events.parquet", "summary.csv", "paired.csv"])
def test_what_is_edited_is_found(stored, name):
    path, manifest = stored / name, json.loads((stored / "manifest.json").read_text())
    other = stored / {"tasks.parquet": "events.parquet"}.get(name, "tasks.parquet")
    data = (
        other.read_bytes() if path.suffix == ".parquet" else path.read_bytes().replace(b"0", b"1")
    )
    path.write_bytes(data)
    manifest["files"][name] = cell_file.sha256(data)  # by somebody who signs it again
    (stored / "manifest.json").write_text(json.dumps(manifest))
    assert [finding.path.name for finding in check_files(stored).findings] == [name]


def test_its_cells_are_those_of_the_same_sweep_today_but_for_revisions(stored):
    """So that --resume keeps none; versions and device apart, which are those of the computer."""
    for key in cell_file.finished(stored):
        about = cell_file.read(cell_file.path(stored, key)).about
        (cell,) = resolve(config_of(about, {}, stored)).cells
        theirs = {**about["identity"], "versions": cell.identity["versions"]}
        assert "revisions" not in theirs  # planar 1, heuristic 1
        today = {"device": cell.identity["device"], "revisions": {"engine": 2, "operator": 2}}
        assert {**theirs, **today} == cell.identity


def test_it_is_loaded_with_the_settings_it_had(stored):
    old = pgf_jax.load_sweep(stored)
    assert old.tasks.select("policy", "robots").rows() == [
        ("pgf", 1),
        *[("pgf", 2)] * 2,
        ("or-hitl", 1),
        *[("or-hitl", 2)] * 2,
    ]
    assert set(old.tasks["seed"]) == {0} and set(old.tasks["task_limit"]) == {180.0}
    new = sweep(ghost(stored.parent / "new", robots=(1,)), quiet=True)
    loaded = pgf_jax.load_sweep(new.out)
    for name in ("tasks", "events"):  # they stack
        assert getattr(old, name).schema == getattr(loaded, name).schema


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: folder / "none", "no such folder, expected results of a sweep"),
        (lambda folder: folder / "cells", r"holds no finished sweep \(no manifest.json\)$"),
        (lambda folder: (folder / "manifest.json").unlink() or folder, "--resume goes on"),
    ],
)
def test_what_cannot_be_loaded(stored, make, message):
    with pytest.raises(pgf_jax.BadInput, match=message):
        pgf_jax.load_sweep(make(stored))


def test_a_stored_session_is_replayed():
    runner, log = replay(STORED / "session")
    assert sum(event.outcome == "push" for event in log.events) == 4
    runner.run_until()
    assert runner.fleet.done
    # It was recorded with planar 1, whose rollouts end elsewhere in their last digits.
    then, now = (dict(about) for about in (log.about["environment"], environment()))
    if (then["processor"], then["versions"]) == (now["processor"], now["versions"]):
        difference = replay_difference(runner.fleet.events, log)
        assert difference is not None
        assert "from event 18 on; it was recorded with engine planar 1, jax" in difference


def test_a_stored_plan_is_loaded():
    (path,) = (STORED / "plans").iterdir()
    plan = pgf_jax.load_plan(path)
    assert plan.solved and plan.cost["total"] < 20
