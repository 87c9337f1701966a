"""`verify`: what is wrong with a folder of results is found and named, and nothing else is."""

import dataclasses
import json
import shutil

import polars as pl
import pytest
from sweep_toys import ghost, tree, write_checkpoints, write_scene

from pgf_jax import provenance
from pgf_jax.cli import main
from pgf_jax.files import sha256
from pgf_jax.fleet.config import Cell
from pgf_jax.inspection.config import VerifyConfig
from pgf_jax.inspection.verify import distance, verify
from pgf_jax.sweeping import cell_file, worker
from pgf_jax.sweeping.load import load_sweep
from pgf_jax.sweeping.summary import csv
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.tables.parquet import encode_table


@pytest.fixture(scope="module")
def predictors(tmp_path_factory):
    return write_checkpoints(tmp_path_factory.mktemp("predictors"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory, predictors):
    """A finished sweep of four cells."""
    out = tmp_path_factory.mktemp("verify") / "whole"
    config = ghost(out, operator="nudge", policies=("or-hitl", "pgf"), predictor=str(predictors))
    return sweep(config, quiet=True)


@pytest.fixture
def out(whole, tmp_path):
    """A copy of it."""
    shutil.copytree(whole.out, tmp_path / "copy")
    return tmp_path / "copy"


@pytest.fixture
def one(whole, out):
    """A cell's file in the copy."""
    return out / "cells" / whole.files[Cell("pgf", 2, 2)].name


def found(out, count=0, **more):
    """(name, what) of each finding; looking changes nothing."""
    before = tree(out)
    outcome = verify(VerifyConfig(out, cells=count, **more), quiet=True)
    assert tree(out) == before
    return [(finding.path.name, finding.what) for finding in outcome.findings]


def sign(file, content):
    """Write a cell as if it had been computed so, and what stands beside it."""
    data = content.data()
    account = cell_file.read_account(file) | {"sha256": sha256(data), "bytes": len(data)}
    file.write_bytes(data)
    cell_file.sidecar(file).write_text(json.dumps(account))
    return sha256(data)


def forged(content):
    """A cell whose first task took a second longer."""
    later = pl.when(pl.int_range(pl.len()) == 0).then(1.0).otherwise(0.0)
    tasks = content.tasks.with_columns(pl.col("planning_time_s") + later)
    return dataclasses.replace(content, tasks=tasks)


# -- sound -------------------------------------------------------------------------------------


def test_a_sound_sweep_has_no_findings_and_comes_out_again(out):
    outcome = verify(VerifyConfig(out, cells=9), quiet=True)
    assert outcome.ok and outcome.complete and outcome.cells == 4
    assert [cell.same for cell in outcome.recomputed] == [True] * 4
    assert sorted(cell.name for cell in outcome.recomputed) == [
        "or-hitl_R1",
        "or-hitl_R2",
        "pgf_R1",
        "pgf_R2",
    ]


def test_a_sample_is_drawn_by_its_seed(out):
    def drawn(seed):
        outcome = verify(VerifyConfig(out, cells=2, seed=seed), quiet=True)
        assert outcome.seed == seed
        return tuple(cell.name for cell in outcome.recomputed)

    samples = [drawn(seed) for seed in range(8)]
    assert all(len(set(sample)) == 2 for sample in samples) and len(set(samples)) > 1
    assert drawn(3) == samples[3]


def test_an_unfinished_sweep(out, one):
    for name in ("manifest.json", "run.json", *RESULTS):
        (out / name).unlink()
    one.unlink()
    cell_file.sidecar(one).unlink()
    outcome = verify(VerifyConfig(out, cells=3), quiet=True)
    assert outcome.ok and not outcome.complete
    assert outcome.cells == 3 and all(cell.same for cell in outcome.recomputed)


def test_a_finished_sweep_that_is_added_to_is_unfinished_until_it_is_done(
    out, whole, predictors, monkeypatch
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    config = ghost(
        out,
        operator="nudge",
        policies=("or-hitl", "pgf", "queue"),
        predictor=str(predictors),
        resume=True,
    )
    with monkeypatch.context() as patch:
        patch.setattr(worker, "run_cells", interrupted)
        with pytest.raises(KeyboardInterrupt):
            sweep(config, quiet=True)
    assert [path.name for path in out.iterdir()] == ["cells"]
    outcome = verify(VerifyConfig(out, cells=0), quiet=True)
    assert outcome.ok and not outcome.complete and outcome.cells == 4
    assert len(sweep(config, quiet=True).computed) == 2
    assert found(out) == []


RESULTS = (
    *("tasks.parquet", "events.parquet", "summary.csv", "fleets.csv", "paired.csv"),
    "fig6.png",
)


# -- files that are not as they were written ---------------------------------------------------


def test_a_truncated_cell(out, one):
    length = one.stat().st_size
    one.write_bytes(one.read_bytes()[:-20])
    assert found(out) == [(one.name, f"truncated: {length - 20} of {length} bytes")]


def test_a_cell_with_a_flipped_bit(out, one):
    data = bytearray(one.read_bytes())
    data[len(data) // 2] ^= 1
    one.write_bytes(data)
    assert found(out) == [(one.name, "edited: its digest is not the one in the file beside it")]


def test_a_forger_has_much_to_do(out, one):
    """Each of the marks that an edit leaves is found; in the end the cell is computed again."""
    digest = sign(one, forged(cell_file.read(one)))
    follow = [
        (name, "edited: it does not follow from the cells")
        for name in ("tasks.parquet", "summary.csv", "fleets.csv", "paired.csv")
    ]
    listed = (one.name, "edited: its digest is not the one in manifest.json")
    assert found(out) == [listed, *follow]

    manifest = json.loads((out / "manifest.json").read_text())
    listed = next(cell for cell in manifest["cells"] if cell["file"].endswith(one.name))
    listed["sha256"] = digest
    (out / "manifest.json").write_text(json.dumps(manifest))
    assert found(out) == follow

    remade = _remade(out, manifest)
    for name, _ in follow:
        (out / name).write_bytes(remade[name])
        manifest["files"][name] = sha256(remade[name])
    (out / "manifest.json").write_text(json.dumps(manifest))
    assert found(out) == []

    ((name, what),) = found(out, count=9)
    assert name == one.name
    assert what == (
        "another one when computed again: 4 of 4 tasks end alike, planning times differ by up to "
        "1 s, costs by up to 0"
    )


def test_a_sweep_of_which_one_cell_counts_checks(out, one):
    content = cell_file.read(one)
    counts = {"checks": 3, "check_misses": 1, "attempts": 2}
    more = {name: pl.lit(n, pl.Int64()) for name, n in counts.items()}
    digest = sign(one, dataclasses.replace(content, tasks=content.tasks.with_columns(**more)))
    manifest = json.loads((out / "manifest.json").read_text())
    next(c for c in manifest["cells"] if c["file"].endswith(one.name))["sha256"] = digest

    def write(tables):
        for name, data in tables.items():
            (out / name).write_bytes(data)
            manifest["files"][name] = sha256(data)
        (out / "manifest.json").write_text(json.dumps(manifest))

    write(_remade(out, manifest))
    assert found(out) == []
    loaded = load_sweep(out)
    counted = loaded.tasks.filter(pl.col("attempts").is_not_null())
    assert counted.select(*counts).unique().rows(named=True) == [counts]
    assert 0 < len(counted) < len(loaded.tasks)
    assert loaded.summary["checks"].drop_nulls().to_list() == [3.0]
    # Without the columns the table is not what follows from the cells.
    write({"tasks.parquet": encode_table(loaded.tasks.drop(*counts))})
    assert found(out) == [("tasks.parquet", "edited: it does not follow from the cells")]


def _remade(out, manifest):
    from pgf_jax.inspection.folder_check import _remade as remade

    sound = {out / cell["file"]: cell_file.read(out / cell["file"]) for cell in manifest["cells"]}
    made = remade(out, manifest, sound)
    return {n: csv(m) if n.endswith(".csv") else encode_table(m) for n, m in made.items()}


def test_a_renamed_cell(out, one):
    other = one.with_name("0" * 64 + ".parquet")
    one.rename(other)
    cell_file.sidecar(one).rename(cell_file.sidecar(other))
    assert found(out) == [
        (other.name, f"edited or renamed: it says it is {one.stem}"),
        (one.name, "missing: manifest.json lists it"),
    ]


def test_a_duplicate(out, one):
    other = one.with_name("f" * 64 + ".parquet")
    shutil.copy(one, other)
    shutil.copy(cell_file.sidecar(one), cell_file.sidecar(other))
    assert found(out) == [(other.name, f"duplicate: it is the cell of {one.stem}.parquet")]


def test_foreign_files(out, whole, tmp_path, predictors):
    config = ghost(
        tmp_path / "other",
        operator="nudge",
        policies=("pgf",),
        robots=(1,),
        window=7.0,
        predictor=str(predictors),
    )
    (theirs,) = sweep(config, quiet=True).files.values()
    shutil.copy(theirs, out / "cells")
    shutil.copy(cell_file.sidecar(theirs), out / "cells")
    (out / "cells" / "notes.txt").write_text("mine")
    (out / "cells" / ("0" * 64 + ".json")).write_text("{}")
    (out / "extra.parquet").write_bytes(b"PAR1PAR1PAR1")
    assert sorted(found(out)) == sorted(
        [
            (theirs.name, "foreign: manifest.json does not list it"),
            ("notes.txt", "foreign: no finished sweep leaves it"),
            ("0" * 64 + ".json", "foreign: without the cell that it is about"),
            ("extra.parquet", "foreign: no sweep writes it"),
        ]
    )
    for name in ("manifest.json", *RESULTS):
        (out / name).unlink()
    # Without a manifest it is told by its settings.
    assert (theirs.name, "foreign: of another configuration than the others") in found(out)


def test_missing_files(out, one):
    cell_file.sidecar(one).unlink()
    (out / "summary.csv").unlink()
    (name, what), other = found(out)
    assert name == one.name and what.startswith("foreign: there is no file beside it that says")
    assert other[0] == "summary.csv" and other[1].startswith("missing: ")


@pytest.mark.parametrize("name", RESULTS)
def test_edited_results(out, name):
    data = bytearray((out / name).read_bytes())
    data[len(data) // 3] ^= 4
    (out / name).write_bytes(data)
    assert found(out) == [(name, "edited: its digest is not the one in manifest.json")]


def test_an_edited_manifest(out, one):
    path = out / "manifest.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps(manifest | {"seed": 5}))
    findings = found(out)
    assert len(findings) == 4  # one a cell
    assert findings[0][0] == "manifest.json" and "seed 0, now 5" in findings[0][1]
    config = manifest["config"] | {"window": 3.0, "horizon": 9.0}
    path.write_text(json.dumps(manifest | {"config": config}))
    findings = found(out)
    assert len(findings) == 4
    assert "config.window 2.0, now 3.0" in findings[0][1] and "None, now 9.0" in findings[0][1]
    path.write_text(json.dumps({"cells": []}))
    (first, *_) = found(out)
    assert first == ("manifest.json", "edited: it does not list cells and files")
    path.write_text("{")
    (first, *_) = found(out)
    assert first[0] == "manifest.json" and first[1].startswith("truncated or corrupt")


# -- computed again ----------------------------------------------------------------------------


def as_if_on(content, processor):
    return dataclasses.replace(content, about={**content.about, "processor": processor})


def test_another_processor_is_reported_not_refused(out, one):
    """Numbers that differ where the processor does are no mistake; how far they are off is said."""
    for name in ("manifest.json", *RESULTS):
        (out / name).unlink()
    sign(one, as_if_on(forged(cell_file.read(one)), "another one"))
    outcome = verify(VerifyConfig(out, cells=9), quiet=True)
    assert outcome.ok
    (off,) = [cell for cell in outcome.recomputed if not cell.same]
    assert off.path == one and not off.expected
    assert off.words == (
        "4 of 4 tasks end alike, planning times differ by up to 1 s, costs by up to 0; "
        f"processor another one, now {_short(provenance.processor())}"
    )


def _short(text):
    return text if len(text) <= 40 else text[:37] + "..."


def test_distance_by_hand(one):
    content = cell_file.read(one)
    statuses = pl.Series("status", ["stuck", *content.tasks["status"][1:]])
    events = content.events
    changed = pl.when(pl.int_range(pl.len()) == 2).then(7).otherwise(pl.col("robot"))
    other = dataclasses.replace(
        content,
        tasks=content.tasks.with_columns(statuses, pl.col("cost") + 0.25),
        events=events.with_columns(changed.alias("robot")),
    )
    alike = 4 if content.tasks["status"][0] == "stuck" else 3
    at = events["time_ns"][2] / 1e9
    assert distance(content, other) == (
        f"{alike} of 4 tasks end alike, planning times differ by up to 0 s, costs by up to 0.25, "
        f"the first 2 of {len(events)} events agree (until {at:g} s)"
    )


def test_inputs_that_have_moved_or_changed(tmp_path):
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    for name in ("a", "b"):
        write_scene(scenes / f"{name}.xml")
    out = tmp_path / "out"
    sweep(ghost(out, policies=("autonomous",), scenes=scenes), quiet=True)
    assert found(out, count=9) == []
    scenes.rename(tmp_path / "moved")
    findings = found(out, count=9)
    assert len(findings) == 2
    for _, what in findings:
        assert what.startswith("cannot be computed again: ")
        assert "expected a directory of scene files" in what
    assert found(out, count=9, scenes=tmp_path / "moved") == []
    write_scene(tmp_path / "moved" / "c.xml")
    findings = found(out, count=9, scenes=tmp_path / "moved")
    assert len(findings) == 2
    assert all("scenes " in what and "tasks end alike" in what for _, what in findings)


# -- the command -------------------------------------------------------------------------------


def test_the_command(out, one, capsys):
    assert main(["verify", str(out), "--cells", "1", "--seed", "4"]) == 0
    said = capsys.readouterr().out
    assert "bit for bit the same" in said
    assert said.splitlines()[-1] == (
        f"{out}: finished; 4 cells as they were written, 1 computed again (--seed 4); 0 problems"
    )
    one.write_bytes(b"")
    assert main(["verify", str(out), "--cells", "0"]) == 2
    printed = capsys.readouterr()
    assert f"{one}: truncated: 0 of" in printed.out
    assert printed.err.startswith(f"pgf-jax: {out}: 1 problems, the first: {one}: truncated")
    assert len(printed.err.splitlines()) == 1


@pytest.mark.parametrize("make", [lambda path: None, lambda path: path.mkdir()])
def test_no_results_at_all(tmp_path, make, capsys):
    make(tmp_path / "x")
    assert main(["verify", str(tmp_path / "x")]) == 2
    assert "x: holds no results of a sweep" in capsys.readouterr().err
