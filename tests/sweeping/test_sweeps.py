"""Several sweeps as one: each finds what it finds alone, bit for bit, and less is computed."""

import dataclasses
import json
import os
import re
import shutil
from pathlib import Path

import polars as pl
import pytest
from sweep_toys import (
    cell_files,
    content,
    ghost,
    processes,
    tree,
    untouched,
    ways,
    write_checkpoints,
)

from pgf_jax.errors import BadInput
from pgf_jax.fleet.config import Cell
from pgf_jax.parallel.local import Stopped
from pgf_jax.scene.sampling import PUBLISHED_CLASSES
from pgf_jax.sweeping import cell_file, worker
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.resolve import resolve, task_scenes
from pgf_jax.sweeping.run_cells import run_cells
from pgf_jax.sweeping.sweep import sweep, sweeps

# Four families: the first five sweeps share their searches; no other does.
CHANGES = {
    "plain": {},
    "window": {"policies": ("pgf", "always"), "robots": (2,), "window": 5.0, "service_mean": 3.0},
    "another predictor": {"policies": ("pgf", "random"), "robots": (1,), "predictor": "best"},
    "true gain": {"policies": ("oracle-gain",), "robots": (1,), "compute": "shared:4"},
    "time": {"policies": ("time-saved", "oracle-time"), "robots": (2,), "reservation": -30.0},
    "seed": {"policies": ("or-hitl",), "robots": (2,), "seed": 1, "operators": 2},
    "classes": {"policies": ("queue",), "robots": (2,), "scene_class": "all", "horizon": 100.0},
    "winner": {"policies": ("or-hitl",), "robots": (1,), "random_winner": 0.5},
}


@pytest.fixture(scope="module")
def predictors(tmp_path_factory):
    return [write_checkpoints(tmp_path_factory.mktemp("p"), seed=seed) for seed in (9, 8)]


@pytest.fixture(scope="module")
def toys(predictors):
    """Configurations of toy sweeps, into a folder."""

    def make(folder, names=CHANGES, **more) -> list[SweepConfig]:
        found = []
        for name in names:
            settings = {"operator": "nudge", "predictor": str(predictors[0])} | CHANGES[name]
            if settings["predictor"] == "best":
                settings["predictor"] = f"best:{predictors[1]}"
            found.append(ghost(folder / name, **(settings | more)))
        return found

    return make


@pytest.fixture(scope="module")
def alone(toys, tmp_path_factory):
    """Each sweep by itself."""
    folder = tmp_path_factory.mktemp("alone")
    return {name: sweep(toys(folder, [name])[0], quiet=True) for name in CHANGES}


@pytest.fixture(scope="module")
def together(toys, tmp_path_factory):
    folder = tmp_path_factory.mktemp("together")
    return dict(zip(CHANGES, sweeps(toys(folder), quiet=True), strict=True))


def same(result, other) -> bool:
    ours, others = (cell_files(each.out) for each in (result, other))
    assert len(ours) == len(result.summaries)
    return content(result.out) == content(other.out) and ours == others


def about(result, name="iterations"):
    """How it was run."""
    return json.loads((result.out / "run.json").read_text())[name]


# -- exactness -----------------------------------------------------------------------------------


def test_together_each_finds_what_it_finds_alone(alone, together):
    for name, result in together.items():
        assert same(result, alone[name])
        assert (result.summaries, result.paired) == (alone[name].summaries, alone[name].paired)
        assert about(result, "wall_clock")["sweeps_run_together"] == len(CHANGES)
    # Not of nothing: robots bid, and asked, and were pushed for, and their ways parted.
    events = pl.concat([result.events() for result in alone.values()])
    bids = events.filter(pl.col("kind") == "bid", pl.col("gain").is_finite())["policy"]
    assert set(bids) >= {"pgf", "random", "time-saved", "oracle-time"}
    assert {"push_dropped", "retreat_end", "expired"} <= set(events["kind"])
    assert set(events["outcome"]) >= {"push", "go_on", "busy", "lost"}


def test_together_less_is_computed(alone, together):
    counts = [about(result) for result in together.values()]
    assert all(count == counts[0] for count in counts)  # it is of all of them
    apart = [about(result) for result in alone.values()]
    assert counts[0]["of_robots"] == sum(count["of_robots"] for count in apart)
    assert counts[0]["computed"] < sum(count["computed"] for count in apart)


def test_what_is_computed_is_what_differs(toys, tmp_path):
    """Of sweeps of one family whose inputs change what comes after them."""
    configs = toys(tmp_path, ["plain", "window"])
    configs[1] = dataclasses.replace(configs[1], policies=("always", "queue"))
    results = sweeps(configs, quiet=True)
    logs = [e for r in results for e in r.events().partition_by("policy", "robots")]
    count = about(results[0])
    assert count["of_robots"] == sum((log["kind"] == "iteration").sum() for log in logs)
    assert count["computed"] == len(ways(*logs).iterations) < count["of_robots"]
    assert about(results[1], "occupancy")["used"] == count["computed"]


def test_neither_order_nor_processes_change_anything(toys, alone, tmp_path):
    configs = toys(tmp_path)[::-1]
    configs[3] = dataclasses.replace(configs[3], workers=2)  # enough that one says so
    with processes(2) as executor:
        results = sweeps(configs, quiet=True, executor=executor)
        assert executor.submit(abs, -1).result() == 1  # it stays open
    assert [result.out for result in results] == [config.out for config in configs]
    hosts = set()
    for name, result in zip([*CHANGES][::-1], results, strict=True):
        assert same(result, alone[name])
        assert about(result, "batches") == len(about(result, "wall_clock")["compile_s"]) == 4
        hosts |= {cell_file.read_account(file)["host"]["pid"] for file in result.files.values()}
    assert len(hosts) == 2 and os.getpid() not in hosts


def test_any_few_cells_in_any_order(toys, alone, tmp_path):
    """Cells of several sweeps, without their neighbours."""
    resolved = [resolve(config, number=i) for i, config in enumerate(toys(tmp_path))]
    cells = [cell for each in resolved for cell in each.cells]
    for some in (cells[::-2], cells[3:6] + cells[:2]):
        heard = Heard()
        run_cells(some, heard)
        assert sorted(heard.done, key=cells.index) == sorted(some, key=cells.index)
        for spec, found in heard.done.items():
            own = [*alone.values()][spec.sweep]
            assert found.data() == own.files[spec.cell].read_bytes()
            assert cell_file.key(found.about["identity"]) == own.files[spec.cell].stem == spec.key
    assert not [*tmp_path.iterdir()]


class Heard:
    def __init__(self):
        self.done, self.tasks = {}, {}

    def progress(self, cell, tasks, time_ns):
        assert cell not in self.done and tasks >= self.tasks.get(cell, 0)
        self.tasks[cell] = tasks

    def finished(self, cell, content):
        assert cell not in self.done
        self.done[cell] = content


def test_whoever_stops_has_what_is_finished(toys, alone, tmp_path):
    """It is asked after each call, and as long as there is something to stop."""
    (config,) = toys(tmp_path, ["plain"])
    heard = Heard()
    with pytest.raises(Stopped):
        run_cells(resolve(config).cells, heard, stop=lambda: len(heard.done) >= 2)
    assert 2 <= len(heard.done) < 4 == len(heard.tasks)
    for spec, found in heard.done.items():
        assert found.data() == alone["plain"].files[spec.cell].read_bytes()


def test_native_physics_and_an_operator_who_imagines(tmp_path, predictors):
    """Cell by cell against all in one run."""

    def small(out, *policies, **changes) -> SweepConfig:
        return ghost(
            tmp_path / out,
            engine="native",
            operator="heuristic",
            policies=policies,
            robots=(2,),
            scene_class="wide",
            horizon=34.0,
            predictor=str(predictors[0]),
            lanes=2,
            **changes,
        )

    both = {"a": (("always", "oracle-gain"), {}), "b": (("or-hitl", "pgf"), {"service_mean": 5.0})}
    together = sweeps([small(out, *p, **changes) for out, (p, changes) in both.items()], quiet=True)
    counts = {}
    for out, (policies, changes) in both.items():
        for policy in policies:
            alone = sweep(small(policy, policy, **changes), quiet=True)
            counts[policy] = about(alone)
            ((name, data),) = cell_files(alone.out).items()
            assert cell_files(tmp_path / out)[name] == data
    count = about(together[0])
    assert count["of_robots"] == sum(each["of_robots"] for each in counts.values())
    assert count["computed"] < sum(each["computed"] for each in counts.values())
    assert counts["always"]["computed"] > counts["always"]["of_robots"]  # pushes are imagined
    # The true gain is bid where it is above 1, and only there.
    events = together[0].events().filter(pl.col("policy") == "oracle-gain")
    gains = events.filter(pl.col("kind") == "iteration")["gain"].drop_nulls()
    bids = events.filter(pl.col("kind") == "bid")["gain"]
    assert (bids > 1).all() and bids.is_finite().any() and bids.is_infinite().any()
    assert set(bids.filter(bids.is_finite())) == set(gains.filter(gains > 1))
    assert gains.is_between(-1, 1).any()
    assert (events["kind"] == "retreat_end").any()


# -- folders -------------------------------------------------------------------------------------


def test_no_sweeps_at_all():
    assert sweeps([], quiet=True) == []


def test_two_sweeps_cannot_have_one_folder(toys, tmp_path):
    first, second, third = toys(tmp_path, ["plain", "window", "seed"])
    (tmp_path / "link").symlink_to(tmp_path / "plain")
    for out in (first.out, tmp_path / "seed" / ".." / "plain", tmp_path / "link"):
        other = dataclasses.replace(third, out=out)
        with pytest.raises(BadInput, match=rf"^out: {re.escape(str(out))} is the folder of two"):
            sweeps([first, second, other], quiet=True)
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_bad_input_of_one_keeps_all_from_starting(toys, together, tmp_path):
    first, second = toys(tmp_path, ["plain", "window"])
    foreign = dataclasses.replace(second, out=together["plain"].out)
    before = tree(foreign.out)
    for bad, message in (
        (dataclasses.replace(second, operator="nobody"), "operator: .*got 'nobody'"),
        (dataclasses.replace(second, scenes=tmp_path / "x"), "x: expected a directory"),
        (foreign, "choose another folder"),
    ):
        with pytest.raises(BadInput, match=message):
            sweeps([first, bad], quiet=True)
    assert not [*tmp_path.iterdir()] and tree(foreign.out) == before


def copied(configs, results):
    for config, result in zip(configs, results, strict=True):
        shutil.copytree(result.out, config.out)


def files_of(config) -> dict[str, Path]:
    """The cells' files by the cells' names."""
    return {cell.name: cell_file.path(config.out, cell.key) for cell in resolve(config).cells}


def test_resume_keeps_the_finished_cells_of_each(toys, together, tmp_path, capsys):
    names = ["plain", "another predictor", "seed"]
    configs = toys(tmp_path, names, resume=True)
    copied(configs[:2], [together[name] for name in names[:2]])
    first, second = map(files_of, configs[:2])
    for file in (first["or-hitl_R2"], cell_file.sidecar(first["or-hitl_R2"])):
        file.unlink()
    second["pgf_R1"].unlink()  # interrupted before its last file
    kept = [first["or-hitl_R1"], first["autonomous_R2"], second["random_R1"]]
    kept += [cell_file.sidecar(file) for file in kept]
    before = untouched(*kept)
    results = sweeps(configs)
    assert [result.computed for result in results] == [
        ("or-hitl_R2",),
        ("pgf_R1",),
        ("or-hitl_R2",),
    ]
    assert untouched(*kept) == before and len(before) == 6
    for name, result in zip(names, results, strict=True):
        assert same(result, together[name])
    assert [about(result, "cells_kept") for result in results] == [
        ["or-hitl_R1", "autonomous_R1", "autonomous_R2"],
        ["random_R1"],
        [],
    ]
    # What it says: which sweep, then the tables in order.
    said = capsys.readouterr()
    lines = said.err.splitlines()
    assert lines[0] == "kept: 0:or-hitl_R1, 0:autonomous_R1, 0:autonomous_R2, 1:random_R1"
    finished = [line.split()[1] for line in lines if line.startswith("finished ")]
    assert sorted(finished) == ["0:or-hitl_R2;", "1:pgf_R1;", "2:or-hitl_R2;"]
    assert "10/10 tasks, 3/3 cells" in lines[-1] and len(lines) == 4
    shown = re.findall(r"results in (.*)", said.out)
    assert shown == [str(config.out) for config in configs]


def test_an_interruption_keeps_what_is_finished(toys, together, tmp_path, monkeypatch, capsys):
    names = ["window", "plain"]

    def interrupted(cells, listener, **more):
        class Impatient(Heard):
            def finished(self, cell, content):
                listener.finished(cell, content)
                raise KeyboardInterrupt

        return run_cells(cells, Impatient(), **more)

    monkeypatch.setattr(worker, "run_cells", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sweeps(toys(tmp_path, names))
    assert len([*tmp_path.rglob("*.parquet")]) == len([*tmp_path.rglob("*.json")]) == 1
    assert not [*tmp_path.rglob("manifest.json")]
    said = " ".join(capsys.readouterr().err.split())
    where = re.escape(f"{tmp_path / 'window'} .. {tmp_path / 'plain'}")
    assert re.search(f"interrupted: 1 of 6 cells were finished and are kept in {where}; ", said)
    monkeypatch.undo()
    results = sweeps(toys(tmp_path, names, resume=True), quiet=True)
    assert sum(len(result.computed) for result in results) == 5
    assert all(same(result, together[name]) for name, result in zip(names, results, strict=True))


# -- classes of scenes, and a random winner ------------------------------------------------------


def test_all_classes_come_in_turn():
    config = SweepConfig(scene_class="all", seed=3)
    for robot in range(4):
        names = [task_scenes(config).scene(robot, task).name for task in range(6)]
        turns = [PUBLISHED_CLASSES[(robot + task) % 3] for task in range(6)]
        assert names == [f"{turn}_3_{robot}_{task}" for task, turn in enumerate(turns)]
        assert sorted(turns) == sorted(PUBLISHED_CLASSES * 2)
    # At all times the classes are mixed over the fleet.
    for task in range(6):
        drawn = [task_scenes(config).scene(robot, task).name for robot in range(3)]
        assert {name.split("_")[0] for name in drawn} == {"tight", "medium", "wide"}


@pytest.mark.parametrize("seed", [0, 7])
def test_scenes_of_a_class_are_those_of_its_own_sweep(seed):
    for robot in range(3):
        for task in range(4):
            scene = task_scenes(SweepConfig(scene_class="all", seed=seed)).scene(robot, task)
            name = scene.name.split("_")[0]
            own = {
                each: task_scenes(
                    SweepConfig(scene_class=each, seed=seed)  # pyright: ignore[reportArgumentType]
                ).scene(robot, task)
                for each in PUBLISHED_CLASSES
            }
            assert scene.name == own[name].name and scene.goal == own[name].goal
            equal = {each for each in own if (own[each].objects == scene.objects).all()}
            assert equal == {name}


def test_all_classes_are_the_same_for_every_policy_and_size(toys, tmp_path):
    (config,) = toys(tmp_path, ["plain"], scene_class="all", robots=(1, 3), tasks=3)
    result = sweep(config, quiet=True)
    scenes = result.tasks().group_by("robot", "task").agg(pl.col("scene").unique()).sort(pl.all())
    assert scenes["scene"].list.len().to_list() == [1] * 9
    named = [f"{PUBLISHED_CLASSES[(r + t) % 3]}_0_{r}_{t}" for r in range(3) for t in range(3)]
    assert scenes["scene"].explode().to_list() == named
    manifest = json.loads((result.out / "manifest.json").read_text())
    assert manifest["scenes"] == {"class": "all", "objects": 20}
    drawn = resolve(config).scenes
    assert [drawn.scene(r, t).name for r in range(3) for t in range(3)] == named
    assert [drawn.name(r, t) for r in range(3) for t in range(3)] == named


def test_a_random_winner_is_another_sweep(toys, alone, tmp_path):
    cell, changes = Cell("or-hitl", 1, 2), CHANGES["winner"]
    configs = [
        config for q in (0.5, 0.25) for config in toys(tmp_path, ["winner"], random_winner=q)
    ]
    specs = [
        spec
        for config in (*configs, toys(tmp_path, ["plain"])[0])
        for spec in resolve(config).cells
        if spec.cell == cell
    ]
    identities = [spec.identity for spec in specs]
    assert [each["planner"]["random_winner"] for each in identities] == [0.5, 0.25, 0.0]
    assert changes["random_winner"] == specs[0].fleet.compile_key[2].random_winner
    # It is in the planner that computes: other trajectories win.
    winner, plain = (alone[name].cell(cell) for name in ("winner", "plain"))
    assert not winner.events.equals(plain.events)
