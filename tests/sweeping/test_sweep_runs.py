import dataclasses
import json
import os
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from registered import registered
from sweep_toys import (
    RESULTS,
    cell_files,
    content,
    ghost,
    tree,
    untouched,
    ways,
    write_checkpoints,
    write_scene,
)

from pgf_jax.errors import BadInput
from pgf_jax.files import sha256, write_atomically
from pgf_jax.fleet.config import Cell
from pgf_jax.guidance.predictors import registry
from pgf_jax.guidance.predictors.network import GainNetwork
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.metrics.summary import mean_interval, rate_interval
from pgf_jax.physics.engine import ENGINES
from pgf_jax.provenance import git_commit
from pgf_jax.sweeping import cell_file, columns
from pgf_jax.sweeping import resolve as resolve_module
from pgf_jax.sweeping import sweep as sweep_module
from pgf_jax.sweeping.cell_store import only_writer
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.dispatch import THREADS, TURNS, partition, share_out
from pgf_jax.sweeping.resolve import CellSpec, resolve, task_scenes
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.tables import results


@pytest.fixture(scope="module", autouse=True)
def shipped(tmp_path_factory):
    """Sweeps here are about sweeps, whatever the networks that ship have learned."""
    folder = write_checkpoints(tmp_path_factory.mktemp("shipped"), seed=9)
    with pytest.MonkeyPatch.context() as patch:
        for module in (registry, resolve_module):
            patch.setattr(module, "shipped_checkpoints", lambda: folder)
        yield folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished sweep, and its result."""
    out = tmp_path_factory.mktemp("sweep") / "whole"
    return out, sweep(ghost(out), quiet=True)


def read_json(out, name="manifest.json"):
    return json.loads((out / name).read_text())


def named(result) -> dict[str, Path]:
    """The cells' files by the cells' names."""
    return {cell.name: file for cell, file in result.files.items()}


# -- what comes out ----------------------------------------------------------------------------


def test_files_and_columns(whole):
    out, result = whole
    assert sorted(path.name for path in out.iterdir()) == sorted(
        [*RESULTS, "manifest.json", "run.json", "cells"]
    )
    beside = [str(file.with_suffix(".json")) for file in result.files.values()]
    assert sorted(map(str, (out / "cells").iterdir())) == sorted(
        [*map(str, result.files.values()), *beside]
    )
    tasks, events = result.tasks(), result.events()
    assert tasks.columns[:5] == ["policy", "robots", "robot", "task", "scene"]
    assert events.columns[:2] == ["policy", "robots"]
    assert events.columns == list(columns.EVENT_SCHEMA)
    assert events.columns[2:14] == list(results.EVENT_SCHEMA)
    assert {"seed", "scene_class", "window", "operator_name"} < set(events.columns)
    rows = tasks.group_by("policy", "robots", maintain_order=True).len().rows()
    assert rows == [
        ("or-hitl", 1, 2),
        ("or-hitl", 2, 4),
        ("autonomous", 1, 2),
        ("autonomous", 2, 4),
    ]
    assert result.computed == ("or-hitl_R1", "or-hitl_R2", "autonomous_R1", "autonomous_R2")
    assert (out / "fig6.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_cells_hold_what_was_merged(whole):
    out, result = whole
    tasks, events = result.tasks(), result.events()
    assert [cell.name for cell in result.files] == list(result.computed)
    for cell, file in result.files.items():
        found = result.cell(cell)
        own = (pl.col("policy") == cell.policy) & (pl.col("robots") == cell.robots)
        assert found.tasks.equals(tasks.filter(own).select(list(results.TASK_SCHEMA)))
        assert found.events.equals(events.filter(own).select(list(results.EVENT_SCHEMA)))
        assert found.about["identity"]["fleet"]["policy"] == cell.policy
        assert file == out / "cells" / f"{cell_file.key(found.about['identity'])}.parquet"
        assert file.read_bytes() == found.data()


def test_summary_says_what_the_tasks_say(whole):
    out, result = whole
    tasks, events = result.tasks(), result.events()
    rows = pl.read_csv(out / "summary.csv").rows(named=True)
    assert [row["policy"] for row in rows] == ["or-hitl"] * 2 + ["autonomous"] * 2
    for row in rows:
        cell = (pl.col("policy") == row["policy"]) & (pl.col("robots") == row["robots"])
        own = tasks.filter(cell)
        time = mean_interval(own["planning_time_s"].to_list())
        assert (row["planning_time_s"], row["planning_time_s_low"]) == pytest.approx(
            (time.mean, time.low), nan_ok=True
        )
        solved = int((own["status"] == "solved").sum())
        rate = rate_interval(solved, len(own))
        assert (row["success"], row["success_low"], row["success_high"]) == pytest.approx(
            (rate.mean, rate.low, rate.high)
        )
        hours = own["end_ns"].max() / 3.6e12
        assert row["tasks_per_hour"] == pytest.approx(solved / hours)
        assert row["helped"] == pytest.approx((own["grants"] > 0).mean())
        first = own["first_grant"].mean()
        assert row["first_grant"] == pytest.approx(np.nan if first is None else first, nan_ok=True)
        log = events.filter(cell)
        busy = sum(
            log.filter(pl.col("kind") == kind)["time_ns"].sum() * sign
            for kind, sign in (("service_end", 1), ("grant", -1))
        )
        assert row["utilisation"] == pytest.approx(busy / own["end_ns"].max())
    assert set(tasks["status"]) == {"solved", "timed_out", "stuck"} and tasks["grants"].sum() > 0


def test_tasks_are_the_same_for_every_policy_and_size(whole):
    _, result = whole
    scenes = result.tasks().group_by("robot", "task").agg(pl.col("scene").unique())
    assert scenes["scene"].list.len().to_list() == [1] * 4
    assert scenes["scene"].explode().n_unique() == 4


def test_same_seed_same_files_other_seed_others(whole, tmp_path):
    out, _ = whole
    sweep(ghost(tmp_path / "again"), quiet=True)
    assert content(tmp_path / "again") == content(out)
    assert cell_files(tmp_path / "again") == cell_files(out)
    sweep(ghost(tmp_path / "other", seed=1), quiet=True)
    assert content(tmp_path / "other")["tasks.parquet"] != content(out)["tasks.parquet"]


def test_cells_do_not_depend_on_their_company(whole, tmp_path):
    """Nor on the order in which they were asked for."""
    _, result = whole
    for policy in ("autonomous", "or-hitl"):
        config = ghost(tmp_path / policy, policies=(policy,), robots=(2,))
        ((cell, file),) = sweep(config, quiet=True).files.items()
        assert file.name == result.files[cell].name
        assert file.read_bytes() == result.files[cell].read_bytes()


def test_paired_file_compares_the_policies(whole):
    out, result = whole
    table = pl.read_csv(out / "paired.csv")
    assert set(table.select("policy", "baseline").rows()) == {("or-hitl", "autonomous")}
    tasks = result.tasks().filter(pl.col("robots") == 2).sort("robot", "task")
    values = {p: tasks.filter(pl.col("policy") == p)["grants"] for p in ("or-hitl", "autonomous")}
    row = table.filter(pl.col("robots") == 2, pl.col("value") == "grants").row(0, named=True)
    assert row["mean"] == pytest.approx((values["or-hitl"] - values["autonomous"]).mean())
    assert row["n"] == 4


def test_horizon_censors(tmp_path):
    config = ghost(tmp_path, tasks=50, horizon=60.0, robots=(2,))
    result = sweep(config, quiet=True)
    assert [s.censored for s in result.summaries] == [2, 2]
    assert all(s.hours == pytest.approx(60 / 3600) for s in result.summaries)
    assert result.events().select(pl.col("time_ns").max()).item() == 60 * 10**9


# -- manifest ----------------------------------------------------------------------------------


def test_manifest(whole):
    out, result = whole
    manifest, run = read_json(out), read_json(out, "run.json")
    for name in RESULTS:
        assert manifest["files"][name] == sha256((out / name).read_bytes())
    assert (manifest["engine"], manifest["lanes"], manifest["rollouts"]) == ("ghost", 4, 8)
    assert manifest["physics"]["substep_s"] == pytest.approx(3.0 / 8 / 36)
    assert manifest["config"]["robots"] == [1, 2] and run["out"] == str(out)
    assert not manifest["config"].keys() & {"out", "workers", "resume", "preset", "scheduler"}
    for cell, said in zip(result.files, manifest["cells"], strict=True):
        names = ("policy", "robots", "tasks", "seed")
        assert tuple(said[name] for name in names) == dataclasses.astuple(cell)
        assert out / said["file"] == result.files[cell]
        assert said["sha256"] == sha256(result.files[cell].read_bytes())
    assert manifest["scenes"] == {"class": "tight", "objects": 20}
    assert manifest["versions"].keys() >= {"python", "jax", "mujoco", "mujoco-mjx", "flax", "numpy"}
    assert manifest["code"]["source_sha256"] and "endian" in manifest["processor"]
    assert run["wall_clock"]["wall_s"] > 0 and len(run["wall_clock"]["compile_s"]) == 1
    # Without a horizon every iteration that was asked for ended; those of fleets that had gone the
    # same way were computed once, each in a lane of its own.
    iterations = run["iterations"]
    assert iterations["of_robots"] == (result.events()["kind"] == "iteration").sum()
    logs = result.events().partition_by("policy", "robots")
    assert iterations["computed"] == len(ways(*logs).iterations) < iterations["of_robots"]
    occupancy = run["occupancy"]
    assert occupancy["used"] == iterations["computed"]
    assert occupancy["computed"] == 4 * occupancy["calls"]
    assert occupancy["share"] == iterations["computed"] / occupancy["computed"]
    assert run["workers"] == run["batches"] == run["wall_clock"]["sweeps_run_together"] == 1
    assert run["cells_kept"] == [] and run["cells_sent_again"] == 0


def test_what_is_said_beside_a_cell(whole):
    _, result = whole
    accounts = [cell_file.read_account(file) for file in result.files.values()]
    for (cell, file), account in zip(result.files.items(), accounts, strict=True):
        assert account["cell"] == cell.name and account["bytes"] == file.stat().st_size
        assert account["host"]["pid"] == os.getpid() and account["attempt"] == 1
        assert account["began"] < account["ended"] and account["wall_s"] > 0
        assert account["inputs"] == {"scenes": None, "predictor": "paper", "log": None}
        assert account["computed_together"] == 4
    assert len({account["session"] for account in accounts}) == 1


def test_git_commit(tmp_path):
    assert git_commit(tmp_path) is None
    (tmp_path / ".git").mkdir()  # not a repository
    assert git_commit(tmp_path) is None


# -- predictors and scenes ---------------------------------------------------------------------


def test_pgf_bids_the_gains_of_the_checkpoints(tmp_path):
    folder = write_checkpoints(tmp_path / "predictors")
    out = tmp_path / "out"
    config = ghost(out, policies=("pgf", "autonomous"), robots=(2,), predictor=str(folder))
    result = sweep(config, quiet=True)
    events = result.events()
    reach = events.filter(pl.col("kind") == "iteration")
    # A gain needs three iterations after the nominal's; it is logged whoever may use it.
    assert reach.filter(pl.col("iteration") < 3)["gain"].null_count() == len(
        reach.filter(pl.col("iteration") < 3)
    )
    later = reach.filter(pl.col("iteration") >= 3, pl.col("policy") == "autonomous")
    assert len(later) > 0 and later["gain"].null_count() == 0
    bids = events.filter(pl.col("kind") == "bid")
    assert set(bids["policy"]) == {"pgf"} and (bids["gain"] > 1.0).all()
    trained = read_json(out)["predictors"]
    assert trained["phi_auto"]["data_sha256"] == "digest of phi_auto"
    assert trained["phi_human"]["scenes"] == 41
    digest = sha256((folder / "phi_auto.msgpack").read_bytes())
    assert trained["phi_auto"]["sha256"] == digest


def test_pgf_bids_the_best_predictor_s_gains(tmp_path, monkeypatch):
    folder = write_checkpoints(tmp_path / "predictors")
    for network in ("phi_auto", "phi_human", "failure"):
        (folder / f"{network}.msgpack").unlink()  # nobody asks for them
    seen = []
    gain = GainNetwork.gain

    def remembered(self, states):
        values = gain(self, states)
        seen.extend(zip(map(bytes, states), values.tolist(), strict=True))
        return values

    monkeypatch.setattr(GainNetwork, "gain", remembered)
    out = tmp_path / "out"
    config = ghost(out, policies=("pgf",), robots=(2,), predictor=f"best:{folder}")
    events = sweep(config, quiet=True).events()
    logged = events.filter(pl.col("kind") == "iteration")["gain"].drop_nulls()
    said = [value for _, value in seen if np.isfinite(value)]
    assert len(logged) > 0 and sorted(logged) == pytest.approx(sorted(said))
    bids = events.filter(pl.col("kind") == "bid")
    predicted = bids.filter(pl.col("gain").is_finite())["gain"]  # the stuck ones bid inf
    assert len(predicted) > 0 and set(predicted) <= set(logged) and (predicted > 1).all()
    trained = read_json(out)["predictors"]
    assert list(trained) == ["gain"] and trained["gain"]["data_sha256"] == "digest of gain"


def test_the_classifier_bids_where_failure_is_likely(tmp_path):
    folder = write_checkpoints(tmp_path / "predictors", seed=8)  # neither sure nor hopeless
    out = tmp_path / "out"
    config = ghost(out, policies=("classifier", "pgf"), robots=(2,), tasks=3, predictor=str(folder))
    events = sweep(config, quiet=True).events()
    reach = events.filter(pl.col("kind") == "iteration", pl.col("gain").is_not_null())
    own, other = (
        reach.filter(pl.col("policy") == policy)["gain"] for policy in ("classifier", "pgf")
    )
    assert own.is_between(0, 1).all() and (own > 0.5).any() and (own < 0.5).any()
    assert not other.is_between(0, 1).all()  # the paper's gains, in units of cost
    bids = events.filter(pl.col("kind") == "bid", pl.col("policy") == "classifier")
    assert len(bids) > 0 and set(bids["gain"]) == {1.0}
    logged = {
        (row["robot"], row["task"], row["iteration"]): row
        for row in events.filter(
            pl.col("kind") == "iteration", pl.col("policy") == "classifier"
        ).rows(named=True)
    }
    for bid in bids.rows(named=True):
        row = logged[bid["robot"], bid["task"], bid["iteration"]]
        assert row["outcome"] == "stuck" or row["gain"] > 0.5
    trained = read_json(out)["predictors"]
    assert sorted(trained) == ["failure", "phi_auto", "phi_human"]


def cell_of(config: SweepConfig, policy: str) -> CellSpec:
    """The cell of one robot under a policy."""
    (cell,) = (c for c in resolve(config).cells if (c.cell.policy, c.cell.robots) == (policy, 1))
    return cell


def test_a_cell_s_identity_names_the_predictor_that_it_used(tmp_path):
    first = write_checkpoints(tmp_path / "first")
    second = write_checkpoints(tmp_path / "second", seed=1)
    policies = ("pgf", "classifier", "autonomous", "gain-rate", "oracle-time")

    def used(predictor, policy):
        config = ghost(tmp_path / "out", policies=policies, predictor=predictor)
        return cell_of(config, policy).identity["predictors"]

    texts = [f"{name}:{folder}" for name in ("paper", "best") for folder in (first, second)]
    numbers = {"pgf": 4, "autonomous": 4, "classifier": 2, "gain-rate": 2, "oracle-time": 1}
    for policy, different in numbers.items():
        found = [used(text, policy) for text in texts]
        assert len({json.dumps(one, sort_keys=True) for one in found}) == different
    assert list(used(texts[2], "pgf")) == ["gain"]
    assert list(used(texts[2], "classifier")) == ["failure"]
    assert list(used(texts[2], "gain-rate")) == ["time_alone", "time_helped"]
    assert used(texts[2], "oracle-time") == {}
    digest = sha256((second / "failure.msgpack").read_bytes())
    assert used(texts[3], "classifier") == {"failure": digest}
    # Who else is in the sweep does not matter.
    alone = ghost(tmp_path / "out", policies=("pgf",), predictor=texts[2])
    assert cell_of(alone, "pgf").identity["predictors"] == used(texts[2], "pgf")
    assert list(resolve(alone).predictor_files) == ["gain"]


def test_the_true_gain_is_no_network_s(tmp_path):
    folders = [write_checkpoints(tmp_path / str(seed), seed=seed) for seed in (0, 1)]
    found: list[tuple[CellSpec, CellSpec]] = []
    for folder in folders:
        policies = ("oracle-gain", "pgf", "or-hitl")
        config = ghost(tmp_path / "out", robots=(1,), policies=policies, predictor=str(folder))
        cell, other, third = resolve(config).cells
        assert cell.fleet.predictor == TrueGain()
        assert other.fleet.predictor is third.fleet.predictor is not None
        found.append((cell, other))
    (first, other_first), (second, other_second) = found
    assert first.identity == second.identity and first.key == second.key
    assert first.identity["predictors"] == {}
    assert other_first.identity != other_second.identity


def test_another_kind_of_predictor_is_another_configuration(tmp_path):
    folder = write_checkpoints(tmp_path / "predictors")
    config = ghost(tmp_path / "out", policies=("pgf",), robots=(1,), tasks=1, predictor=str(folder))
    sweep(config, quiet=True)
    best = dataclasses.replace(config, predictor=f"best:{folder}")
    refused(best, "results of other settings", config.out)
    same = dataclasses.replace(config, predictor=f"paper:{folder}", resume=True)
    assert sweep(same, quiet=True).computed == ()


@pytest.mark.parametrize(
    ("policies", "predictor", "missing"),
    [
        (("classifier",), "{}", "failure"),
        (("pgf",), "best:{}", "gain"),
        (("autonomous",), "best:{}", "gain"),
        (("classifier",), "best:{}", "gain"),
        (None, "{}", "time_alone"),
    ],
)
def test_a_missing_network_is_named(tmp_path, policies, predictor, missing):
    folder = write_checkpoints(tmp_path / "predictors")
    (folder / f"{missing}.msgpack").unlink()
    config = ghost(tmp_path / "out", policies=policies, predictor=predictor.format(folder))
    refused(config, rf"{folder}/{missing}\.msgpack: no such file", tmp_path)
    if policies is None:  # of which the user has named none
        refused(config, "policy gain-rate needs it", tmp_path)


def test_scenes_of_a_folder(tmp_path):
    folder = tmp_path / "scenes"
    folder.mkdir()
    for i in (1, 2, 10):
        write_scene(folder / f"shelf_{i}.xml", n_objects=4)
    out = tmp_path / "out"
    result = sweep(
        ghost(out, scenes=folder, tasks=3, policies=("autonomous",), robots=(2,)), quiet=True
    )
    names = {"shelf_1", "shelf_2", "shelf_10"}
    for robot in (0, 1):
        assert set(result.tasks().filter(pl.col("robot") == robot)["scene"]) == names
    about = read_json(out)["scenes"]
    assert (about["files"], about["objects"]) == (3, 4)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), robot=st.integers(0, 40), turn=st.integers(0, 5))
def test_each_robot_sees_every_file_before_any_twice(scene_files, seed, robot, turn):
    config = SweepConfig(seed=seed)
    tasks = range(turn * 5, turn * 5 + 5)
    drawn = [task_scenes(config, scene_files).scene(robot, task).name for task in tasks]
    assert sorted(drawn) == sorted(scene.name for scene in scene_files)
    assert drawn == [task_scenes(config, scene_files).scene(robot, task).name for task in tasks]
    assert drawn == [task_scenes(config, scene_files).name(robot, task) for task in tasks]


@pytest.fixture(scope="module")
def scene_files():
    return tuple(task_scenes(SweepConfig()).scene(9, task) for task in range(5))


def test_sampled_scenes_differ_by_seed_robot_and_task():
    scenes = [
        task_scenes(SweepConfig(seed=seed, scene_class=name)).scene(robot, task)
        for name in ("tight", "wide")
        for seed in (0, 1)
        for robot in (0, 1)
        for task in (0, 1)
    ]
    assert len({scene.objects.tobytes() for scene in scenes}) == len(scenes)
    assert scenes[3].name == "tight_0_1_1"
    found = resolve(ghost(Path("x"))).scenes
    assert found.name(1, 1) == found.scene(1, 1).name == "tight_0_1_1"


# -- resuming ----------------------------------------------------------------------------------


def test_resume_computes_only_what_is_missing(whole, tmp_path, monkeypatch):
    out = tmp_path / "out"
    config = ghost(out)
    files = named(sweep(config, quiet=True))
    for path in (files["or-hitl_R2"], cell_file.sidecar(files["or-hitl_R2"])):
        path.unlink()
    files["autonomous_R1"].unlink()  # interrupted before its last file
    kept = [files[name] for name in ("or-hitl_R1", "autonomous_R2")]
    kept += [cell_file.sidecar(file) for file in kept]
    before = untouched(*kept)
    result = sweep(dataclasses.replace(config, resume=True), quiet=True)
    assert result.computed == ("or-hitl_R2", "autonomous_R1")
    assert untouched(*kept) == before and len(before) == 4
    assert content(out) == content(whole[0]) and cell_files(out) == cell_files(whole[0])
    assert read_json(out, "run.json")["cells_kept"] == ["or-hitl_R1", "autonomous_R2"]

    monkeypatch.setattr(sweep_module, "dispatch", None)  # nothing is left to compute
    for name in RESULTS:
        (out / name).unlink()
    assert sweep(dataclasses.replace(config, resume=True), quiet=True).computed == ()
    assert content(out) == content(whole[0])


def test_resume_may_add_policies_and_sizes(whole, tmp_path):
    out = tmp_path / "out"
    sweep(ghost(out, policies=("autonomous",), robots=(2,)), quiet=True)
    result = sweep(ghost(out, resume=True), quiet=True)
    assert result.computed == ("or-hitl_R1", "or-hitl_R2", "autonomous_R1")
    assert content(out) == content(whole[0])


def test_resume_of_nothing_starts(whole, tmp_path):
    sweep(ghost(tmp_path / "new" / "folder", resume=True), quiet=True)
    assert content(tmp_path / "new" / "folder") == content(whole[0])


def test_resume_without_what_stands_beside_the_cells(whole, tmp_path):
    """Cells that were brought from elsewhere, say."""
    out = tmp_path / "out"
    files = named(sweep(ghost(out), quiet=True))
    for file in files.values():
        cell_file.sidecar(file).unlink()
    file = files["or-hitl_R2"]
    data = file.read_bytes()
    file.write_bytes(data[:-20])
    refused(ghost(out, resume=True), f"{file}: truncated or corrupt", out)
    file.write_bytes(data)
    assert sweep(ghost(out, resume=True), quiet=True).computed == ()
    assert content(out) == content(whole[0])


def test_again_without_resume_computes_again(whole, tmp_path):
    out = tmp_path / "out"
    config = ghost(out, policies=("autonomous",))
    files = named(sweep(config, quiet=True))
    before, written = cell_files(out), untouched(out / "cells")
    assert sweep(config, quiet=True).computed == ("autonomous_R1", "autonomous_R2")
    assert cell_files(out) == before
    assert all(written[path] != now for path, now in untouched(out / "cells").items())
    # Whatever has become of them.
    files["autonomous_R1"].write_bytes(b"PAR1")
    cell_file.sidecar(files["autonomous_R2"]).unlink()
    assert sweep(config, quiet=True).computed == ("autonomous_R1", "autonomous_R2")
    assert cell_files(out) == before and len(before) == 2


@pytest.mark.parametrize("at", ["after the first", "in the second"])
def test_interruption_keeps_finished_cells(whole, tmp_path, monkeypatch, capsys, at):
    """Ctrl-C right after the first cell, or in the middle of writing the second."""
    out = tmp_path / "out"
    write, written = write_atomically, []

    def interrupted(path, data):
        is_cell = path.suffix == ".parquet"
        if at == "in the second" and is_cell and written:
            raise KeyboardInterrupt
        write(path, data)
        if is_cell:
            written.append(path)
        if at == "after the first" and is_cell:
            raise KeyboardInterrupt

    monkeypatch.setattr(cell_file, "write_atomically", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sweep(ghost(out))
    assert [*out.rglob("*.parquet")] == written
    (finished,) = [cell.name for cell in resolve(ghost(out)).cells if cell.path == written[0]]
    assert len([*out.rglob("*.json")]) == 1 + (at == "in the second")
    assert {p.name for p in out.iterdir()} == {"cells"}
    assert not [p for p in out.rglob("*") if p.name.startswith(".")]
    said = " ".join(capsys.readouterr().err.split())
    # The interruption after the file of the first cell comes before it is counted.
    counted = int(at == "in the second")
    assert re.search(f"interrupted: {counted} of 4 cells .* kept in {out}; .* --resume", said)
    monkeypatch.undo()
    result = sweep(ghost(out, resume=True), quiet=True)
    assert finished not in result.computed and len(result.computed) == 3
    assert content(out) == content(whole[0]) and cell_files(out) == cell_files(whole[0])


# -- bad input ---------------------------------------------------------------------------------


def refused(config, message, *folders):
    """The sweep is refused in one line, and changes nothing."""
    before = [tree(folder) for folder in folders]
    with pytest.raises(BadInput, match=message) as caught:
        sweep(config, quiet=True)
    assert "\n" not in str(caught.value)
    assert [tree(folder) for folder in folders] == before


@pytest.fixture
def broken(tmp_path):
    """A folder of things that cannot be used."""
    for name in ("empty", "malformed", "truncated"):
        (tmp_path / name).mkdir()
    (tmp_path / "malformed" / "a.xml").write_text("<mujoco")
    write_checkpoints(tmp_path / "truncated")
    file = tmp_path / "truncated" / "phi_human.msgpack"
    file.write_bytes(file.read_bytes()[:-7])
    (tmp_path / "file").write_text("")
    return tmp_path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"operator": "nobody"}, "operator: expected one of .*none.*, got 'nobody'"),
        ({"scenes": "missing"}, "missing: expected a directory of scene files"),
        ({"scenes": "empty"}, "empty: holds no scene file"),
        ({"scenes": "malformed"}, "a.xml: not well-formed XML"),
        ({"policies": ("pgf",), "predictor": "missing"}, "missing: no such folder"),
        ({"predictor": "empty"}, "phi_auto.msgpack: no such file"),
        ({"predictor": "truncated"}, "phi_human.msgpack: .*(truncated|corrupt)"),
        ({"out": "file"}, "out: .*file is a file, expected a folder"),
        ({"out": "file/below"}, "out: .*file/below cannot be made"),
    ],
)
def test_bad_files_and_folders(broken, changes, message):
    paths = {
        name: broken / value
        for name, value in changes.items()
        if name not in ("operator", "policies")
    }
    if "predictor" in paths:
        paths["predictor"] = str(paths["predictor"])
    config = ghost(broken / "out") if "out" not in paths else ghost(paths.pop("out"))
    refused(dataclasses.replace(config, **(changes | paths | {"out": config.out})), message, broken)
    assert not (broken / "out").exists()


def test_pgf_without_shipped_checkpoints(tmp_path, monkeypatch):
    def none():
        raise BadInput("no shipped checkpoints")

    monkeypatch.setattr(resolve_module, "shipped_checkpoints", none)
    monkeypatch.setattr(registry, "shipped_checkpoints", none)
    refused(ghost(tmp_path / "out", policies=("pgf",)), "no shipped checkpoints", tmp_path)
    for policies in (("or-hitl", "autonomous"), ("oracle-gain",)):  # nobody needs them
        found = resolve(ghost(tmp_path / "out", policies=policies))
        assert found.predictor_files == {}
        expected = TrueGain() if policies == ("oracle-gain",) else None
        assert [cell.fleet.predictor for cell in found.cells] == [expected] * len(found.cells)


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"window": 3.0}, "window 2.0, now 3.0"),
        ({"seed": 1}, "seed 0, now 1"),
        ({"tasks": 3}, "tasks 2, now 3"),
        ({"lanes": 2}, "lanes 4, now 2"),
        ({"physics": "paper"}, "substeps 36, now 250; solref_timeconst .*"),
        ({"cost": "paper"}, "variant source, now paper"),
        ({"scene_class": "wide"}, "scene_class tight, now wide"),
        ({"scene_class": "all"}, "scene_class tight, now all"),
        ({"random_winner": 0.5}, "random_winner 0.0, now 0.5"),
        (
            {"robots": (1,)},
            "'(autonomous|or-hitl)' with 2 robots, which this sweep has not",
        ),
        ({"policies": ("autonomous",)}, "'or-hitl' with [12] robots, which this sweep has not"),
    ],
)
def test_results_of_another_configuration(whole, resume, changes, message):
    out, _ = whole
    config = ghost(out, resume=resume, **changes)
    where = rf"{out} holds results of other settings \([0-9a-f]{{64}}\.parquet\)"
    refused(config, f"^{message}: {where}; choose another folder with --out", out)


def test_another_predictor_is_another_configuration(tmp_path):
    folder = write_checkpoints(tmp_path / "predictors")
    out = tmp_path / "out"
    config = ghost(out, policies=("autonomous",), robots=(1,))
    sweep(dataclasses.replace(config, predictor=str(folder)), quiet=True)
    refused(config, "results of other settings", out)


@pytest.fixture
def copy_of_whole(whole, tmp_path):
    out = tmp_path / "copy"
    for name, data in tree(whole[0]).items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(data)
    return out


@pytest.mark.parametrize("ending", [".parquet", ".json"])
def test_resume_refuses_corrupt_cells(whole, copy_of_whole, ending):
    path = copy_of_whole / "cells" / named(whole[1])["autonomous_R2"].with_suffix(ending).name
    path.write_bytes(path.read_bytes()[:-20])
    refused(
        ghost(copy_of_whole, resume=True), f"{path}: truncated or (corrupt|edited)", copy_of_whole
    )


def test_results_without_their_cells(copy_of_whole):
    for path in copy_of_whole.glob("cells/*.parquet"):
        path.unlink()
    for resume in (False, True):
        config = ghost(copy_of_whole, resume=resume)
        refused(config, "tasks.parquet: results without the cells", copy_of_whole)


def test_results_of_an_older_version(tmp_path):
    old = tmp_path / "cells" / "or-hitl_R1" / "cell.json"
    old.parent.mkdir(parents=True)
    old.write_text("{}")
    for resume in (False, True):
        refused(ghost(tmp_path, resume=resume), f"{old}: results of an older version", tmp_path)


def test_a_folder_in_use(tmp_path):
    with only_writer(tmp_path):
        refused(ghost(tmp_path), f"out: {tmp_path} is in use by another sweep", tmp_path)
    assert len(sweep(ghost(tmp_path, policies=("autonomous",)), quiet=True).computed) == 2


def test_other_files_in_the_folder_are_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    sweep(ghost(tmp_path, policies=("autonomous",), robots=(1,)), quiet=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is closed to root")
def test_folder_that_cannot_be_written(tmp_path):
    for closed, message in ((tmp_path, "cannot be made"), (tmp_path / "cells", "be written to")):
        closed.chmod(0o500)
        refused(ghost(tmp_path), message, tmp_path)
        closed.chmod(0o700)
        (tmp_path / "cells").mkdir(exist_ok=True)


# -- processes, and a real engine --------------------------------------------------------------


def names(parts):
    return [[f"{cell.sweep}:{cell.name}" for cell in part] for part in parts]


def cell_like(config: SweepConfig, sweep: int, *sizes) -> CellSpec:
    """A cell of these sizes, whose searches are those of the sweep's cells."""
    cell = Cell(*sizes)
    return dataclasses.replace(resolve(config).cells[0], sweep=sweep, cell=cell, name=cell.name)


def test_partition_by_hand(tmp_path):
    """Of one sweep: all its cells share their searches, so there are not enough families."""
    config = ghost(tmp_path)
    cells = [cell_like(config, 0, policy, r, 10) for policy in "ab" for r in (1, 10, 30)]
    assert names(partition(cells, 3)) == [
        ["0:a_R30"],
        ["0:b_R30"],
        ["0:a_R10", "0:b_R10", "0:a_R1", "0:b_R1"],
    ]
    assert partition(cells[:1], 4) == [cells[:1]]
    parts = partition(cells, 2)
    assert sorted([cell for part in parts for cell in part], key=cells.index) == cells
    assert [sum(cell.cell.robots for cell in part) for part in parts] == [41, 41]
    assert partition(cells, 1) == [cells]
    assert partition([], 2) == []


def test_cells_that_share_searches_share_a_process(tmp_path):
    """Where there are enough such families: here the sweeps 0 and 2, 1, and 3."""
    changes = [{}, {"seed": 1}, {"window": 9.0}, {"scene_class": "wide"}]
    configs = [ghost(tmp_path / str(i), **each) for i, each in enumerate(changes)]
    small, large = ("a", 1, 10), ("a", 3, 10)
    order = [(1, large), (0, small), (3, small), (2, large)]
    cells = [cell_like(configs[i], i, *sizes) for i, sizes in order]
    one, two, three = ["0:a_R1", "2:a_R3"], ["1:a_R3"], ["3:a_R1"]
    for workers in (1, 2, 3):
        assert names(partition(cells, workers)) == [one, two, three]
    # A fourth process would be idle: families are torn apart.
    assert names(partition(cells, 4)) == [two, ["2:a_R3"], ["0:a_R1"], three]


def test_cores_go_to_processes_with_searches_of_their_own(tmp_path):
    """One sweep is one process with all the cores, of which a process has `THREADS` at most."""
    config = ghost(tmp_path)
    cells = [cell_like(config, 0, policy, r, 10) for policy in "ab" for r in (1, 10, 30)]

    def as_engine(name: str, cells: list[CellSpec]) -> list[CellSpec]:
        fleets = [dataclasses.replace(cell.fleet, engine=name) for cell in cells]
        pairs = zip(cells, fleets, strict=True)
        return [dataclasses.replace(cell, fleet=fleet) for cell, fleet in pairs]

    planar = as_engine("planar", cells)
    assert THREADS == 4
    shares = {workers: share_out(planar, workers) for workers in (1, 2, 4, 5, 8, 96)}
    assert shares == {1: (1, 1), 2: (1, 2), 4: (1, 4), 5: (2, 2), 8: (2, 4), 96: (6, 4)}
    other = as_engine("planar", [cell_like(ghost(tmp_path, seed=1), 1, "a", 1, 10)])
    assert share_out(planar + other, 2) == (2, 1) and share_out(planar + other, 4) == (2, 2)
    # Calls of other engines use all cores of their process already.
    native = as_engine("native", cells)
    assert share_out(native, 2) == (2, None) and share_out(native[:1], 2) == (1, None)
    assert share_out(native + planar, 2) == (2, None)


def test_a_worker_has_a_few_turns(tmp_path):
    """Of more families, as here six, it is not one each: the large ones are each alone."""
    sizes = [1, 9, 2, 8, 3, 7]
    cells = [
        cell_like(ghost(tmp_path / str(seed), seed=seed), seed, "a", robots, 10)
        for seed, robots in enumerate(sizes)
    ]
    parts = partition(cells, 1)
    assert TURNS == len(parts) == 4
    assert names(parts) == [["1:a_R9"], ["3:a_R8"], ["5:a_R7"], ["4:a_R3", "2:a_R2", "0:a_R1"]]
    assert [len(part) for part in partition(cells, 2)] == [1] * 6


@pytest.mark.parametrize(
    ("changes", "shared"),
    [
        ({"policies": ("always",)}, True),
        ({"robots": (7,), "tasks": 9}, True),
        ({"window": 9.0, "service_mean": 1.0, "service_sd": 0.0, "context_switch": 2.0}, True),
        ({"operators": 2, "rollout_time": 1.0, "compute": "shared:8", "horizon": 9.0}, True),
        ({"predictor": "best"}, True),
        ({"seed": 1}, False),
        ({"scene_class": "all"}, False),
        ({"scene_class": "tight"}, True),  # as when none is given
        ({"operator": "heuristic"}, False),
        ({"lanes": 3}, False),
        ({"engine": "native"}, False),
        ({"physics": "paper"}, False),
        ({"cost": "paper"}, False),
        ({"update": "stomp"}, False),
        ({"random_winner": 0.5}, False),
    ],
)
def test_what_searches_depend_on(tmp_path, changes, shared):
    ours = cache_key(ghost(tmp_path / "a"))
    assert (ours == cache_key(ghost(tmp_path / "b", **changes))) == shared
    assert ours == cache_key(ghost(tmp_path / "c"))


def cache_key(config: SweepConfig):
    """What the searches of all its cells depend on."""
    (key,) = {cell.fleet.cache_key for cell in resolve(config).cells}
    return key


def test_searches_depend_on_what_is_in_the_scene_files(tmp_path):
    """Not on where they lie."""
    for folder, name in (("a", "shelf"), ("b", "shelf"), ("c", "other")):
        (tmp_path / folder).mkdir()
        write_scene(tmp_path / folder / f"{name}.xml")
    a, b, c = (cache_key(ghost(tmp_path / "x", scenes=tmp_path / each)) for each in "abc")
    assert a == b != c


def native(out, **changes):
    return ghost(out, engine="native", tasks=1, policies=("autonomous",), lanes=2, **changes)


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """Native physics: two fleets with one scheduler, R = 1 and R = 2."""
    out = tmp_path_factory.mktemp("native") / "all"
    return out, sweep(native(out), quiet=True)


def test_robots_do_not_change_each_other_bit_for_bit(real):
    _, result = real
    tasks = result.tasks().filter(pl.col("robot") == 0)
    alone, together = (tasks.filter(pl.col("robots") == r).drop("robots") for r in (1, 2))
    assert len(alone) == 1 and alone.equals(together)
    events = result.events().filter(pl.col("robot") == 0)
    alone, together = (events.filter(pl.col("robots") == r).drop("robots") for r in (1, 2))
    assert len(alone) > 3 and alone.equals(together)


def test_processes_change_nothing_bit_for_bit(real, tmp_path):
    out, _ = real
    config = native(tmp_path, workers=2)
    result = sweep(config, quiet=True)
    assert content(tmp_path) == content(out)
    assert cell_files(tmp_path) == cell_files(out)
    assert len(result.computed) == 2
    run = read_json(tmp_path, "run.json")
    assert len(run["wall_clock"]["compile_s"]) == run["batches"] == run["workers"] == 2
    hosts = [cell_file.read_account(file)["host"]["pid"] for file in result.files.values()]
    assert len({*hosts, os.getpid()}) == 3


def test_bad_input_comes_out_of_a_process(tmp_path):
    # It is registered here, not there.
    with (
        registered(ENGINES, here=ENGINES.make("ghost")),
        pytest.raises(BadInput, match="has no engine 'here': importing registered does not"),
    ):
        sweep(ghost(tmp_path, engine="here", workers=2), quiet=True)
    assert [*tmp_path.rglob("*")] == [tmp_path / "cells"]


@pytest.mark.slow
def test_quick_preset(tmp_path):
    folder = write_checkpoints(tmp_path / "predictors")
    out = tmp_path / "out"
    config = SweepConfig(preset="quick", operator="none", predictor=str(folder), out=out, workers=2)
    result = sweep(config)
    assert len(result.tasks()) == 40
    assert [s.robots for s in result.summaries] == [1, 4, 1, 4]
    again = dataclasses.replace(config, out=tmp_path / "again", workers=1)
    sweep(again, quiet=True)
    assert content(out) == content(tmp_path / "again")
