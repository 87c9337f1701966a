"""Collected forks: what they hold, and that neither interruptions nor processes change them."""

import dataclasses
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from coroutines import native, run, stepped, traced
from registered import registered

import pgf_jax.guidance.operators.registry as operators
from pgf_jax.batching.requests import Step, robot_key_path, trial_key_path
from pgf_jax.collection import fork as forks_module
from pgf_jax.collection.collect import collect
from pgf_jax.collection.config import CollectConfig
from pgf_jax.collection.fork import fork
from pgf_jax.collection.scenes import scene_of
from pgf_jax.guidance.predictors.features import STATE, state_features
from pgf_jax.guidance.trials import simulate_input
from pgf_jax.guidance.view import View
from pgf_jax.planning.search import start_world
from pgf_jax.planning.types import LOOK_AHEAD, Push
from pgf_jax.scene import sample_scene
from pgf_jax.tables.forks import FUTURE_COLUMNS, read_forks, read_futures
from pgf_jax.tables.runs import Mode, read_runs, runs_path

pytestmark = pytest.mark.usefixtures("remembered_rollouts")

KEYS, SCENES, SHORT = 2, 4, 3


class Aside:
    """Pushes object_1 3 cm outwards."""

    name = "aside"

    def decide(self, view: View) -> Push:
        x, y = view.objects[0]
        return Push(0, float(x), float(y + (0.03 if y > 0 else -0.03)))


class Quiet:
    """Is asked, and always says "go on"."""

    name = "quiet"

    def decide(self, view: View) -> None:
        return None


@pytest.fixture(autouse=True, scope="module")
def toys():
    """The operators of these tests; and in this process futures are short, to save time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forks_module, "LOOK_AHEAD", SHORT)
        with registered(operators.OPERATORS, aside=Aside, quiet=Quiet):
            yield


def settings(out: Path, **changes) -> CollectConfig:
    config = CollectConfig(
        mode="forks",
        scenes=SCENES,
        out=out,
        classes=("tight",),
        engine="native",
        world="none",
        physics="authors",
        operator="aside",
        keys=KEYS,
        ask_from=3,
        ask_to=4,
        chunk=1,
    )
    return dataclasses.replace(config, **changes)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, toys) -> Path:
    out = tmp_path_factory.mktemp("forks")
    done = collect(settings(out))
    forks = read_forks(done.path)
    assert (done.path, done.scenes) == (runs_path(out, Mode.FORKS), SCENES)
    assert done.runs == done.inputs == forks.n_unique("scene") == len(forks) // KEYS
    assert (
        done.iterations
        == forks.select("alone_iterations", "helped_iterations").sum().row(0)[0]
        + forks["helped_iterations"].sum()
    )
    return done.path


def course(config: CollectConfig, index: int) -> list:
    """A scene planned by hand, with the robot's own keys: its searches while it is unsolved."""
    scene, planner = scene_of(config, index), native().planner
    search = planner.begin_reach(start_world(scene.positions), scene.goal)
    searches = []
    for i in range(config.ask_to + 1):
        search = stepped(search, (config.seed + index, 0, 0, i, 0))
        if planner.terminate(search):
            break
        searches.append(search)
    return searches


def test_a_fork_is_two_futures_of_one_state_under_the_same_keys(whole, tmp_path):
    config, forks, planner = settings(tmp_path), read_forks(whole), native().planner
    states = 0
    for index in range(SCENES):
        searches = course(config, index)
        rows = forks.filter(pl.col("seed") == index).rows(named=True)
        if len(searches) <= config.ask_from:  # solved too soon
            assert rows == []
            continue
        assert len(rows) == KEYS
        states += 1
        at = rows[0]["iteration"]
        assert at in range(config.ask_from, len(searches))
        search = searches[at]
        assert [rows[0][f"state:{name}"] for name in STATE] == state_features(search).tolist()
        assert (rows[0]["scene"], rows[0]["class"]) == (scene_of(config, index).name, "tight")
        push = Aside().decide(View.of(search))
        for row in rows:
            key_paths = trial_key_path(index, 0, 0, at + 1, row["key"])
            for name, given in (("alone", None), ("helped", push)):
                trial = run(simulate_input(planner, search, given, key_paths, reach_limit=SHORT))
                assert row[name] == trial.cost
                assert row[f"{name}_solved"] == trial.solved
                assert row[f"{name}_iterations"] == trial.iterations
            assert (row["input"], row["pushed"]) == ("push", trial.pushed)
    assert 0 < states < SCENES
    assert forks["alone"].n_unique() == states * KEYS  # the keys are different noise


def test_go_on_changes_nothing(whole, tmp_path):
    done = collect(settings(tmp_path, operator="quiet"))
    forks = read_forks(done.path)
    assert done.inputs == 0 and set(forks["input"]) == {"go_on"} and not forks["pushed"].any()
    for column in ("", "_solved", "_iterations"):
        assert forks[f"alone{column}"].equals(forks[f"helped{column}"], check_names=False)
    # Nor does what the operator says change the state, or the future without it.
    pushed = read_forks(whole)
    same = [c for c in forks.columns if c.startswith(("state:", "alone")) or c in ("scene", "key")]
    assert forks.select(same).equals(pushed.select(same))


def test_every_unsolved_iteration_may_be_forked(tmp_path):
    """Drawn by (seed, scene) from those that there are; the runs themselves stay as they are."""
    planner, drawn = native().planner, set()
    for seed in (0, 2):
        for first, last in ((3, 3), (3, 6), (4, 6)):
            scene = sample_scene(seed, "tight")
            coroutine = fork(planner, scene, seed, Quiet(), keys=1, first=first, last=last)
            frame, asked = traced(coroutine)
            assert frame["iteration"][0] in range(first, last + 1)
            drawn.add((seed, frame["iteration"][0]))
            own = [r.key_path for r in asked if isinstance(r, Step) and r.key_path[4] == 0]
            assert own == [robot_key_path(seed, 0, 0, i)(0) for i in range(len(own))]
            assert len(own) <= last + 1
    assert len(drawn) > 2


def test_an_operator_that_tries_has_not_seen_the_futures():
    operator = operators.make_operator("oracle")
    operator._ranked, operator._others, operator._again = 1, 0, 1  # pyright: ignore
    coroutine = fork(
        native().planner, sample_scene(2, "tight"), 2, operator, keys=2, first=3, last=3
    )
    _, asked = traced(coroutine)
    tried = [(r.key_path, r.search.controls.tobytes()) for r in asked if isinstance(r, Step)]
    assert len(set(tried)) == len(tried)  # alone and helped differ in what they begin with


class Interrupter:
    """Stands in for the user who presses Ctrl-C after so many scenes."""

    def __init__(self, after: int) -> None:
        self.after = after

    def __call__(self, done: int, wanted: int) -> None:
        if done == self.after:
            raise KeyboardInterrupt


@pytest.mark.parametrize("after", [1, 3])
@pytest.mark.parametrize("chunk", [1, 3])
def test_an_interrupted_collection_resumes_to_the_same_bytes(tmp_path, whole, after, chunk):
    config = settings(tmp_path, chunk=chunk)
    with pytest.raises(KeyboardInterrupt):
        collect(config, on_progress=Interrupter(after))
    assert not runs_path(tmp_path, Mode.FORKS).exists()
    collect(dataclasses.replace(config, resume=True))
    assert runs_path(tmp_path, Mode.FORKS).read_bytes() == whole.read_bytes()
    assert not (tmp_path / "forks" / "parts").exists()


def test_a_finished_collection_computes_nothing_again(tmp_path, whole):
    """Nor the scenes that gave no fork."""
    path = runs_path(tmp_path, Mode.FORKS)
    collect(settings(tmp_path))
    seen = []
    collect(settings(tmp_path, resume=True), on_progress=lambda *count: seen.append(count))
    assert seen == [(SCENES, SCENES)]
    assert path.read_bytes() == whole.read_bytes()


def test_scenes_can_be_added(tmp_path, whole):
    collect(settings(tmp_path, scenes=1))
    collect(settings(tmp_path, scenes=SCENES, resume=True, lanes=1))
    assert runs_path(tmp_path, Mode.FORKS).read_bytes() == whole.read_bytes()


# -- processes -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "scenes"), [("autonomous", 3), ("forks", 2)])
def test_processes_change_nothing(tmp_path, monkeypatch, mode, scenes):
    """Bit for bit; what the processes know by name only (no operator of these tests')."""
    written, seen = [], []
    monkeypatch.setattr(forks_module, "LOOK_AHEAD", LOOK_AHEAD)  # as the processes have it
    for workers in (1, 2):
        config = settings(
            tmp_path / str(workers),
            mode=mode,
            scenes=scenes,
            workers=workers,
            operator="heuristic",
            keys=1,
            ask_to=3,
            task_limit=20.0,
            chunk=2,
        )
        done = collect(config, on_progress=lambda *count: seen.append(count))
        written.append(done.path.read_bytes())
        assert not (done.path.parent / "parts").exists()
    assert written[0] == written[1]
    assert seen == [(done, scenes) for done in range(scenes + 1)] * 2


def test_a_killed_collection_resumes_to_the_same_bytes(tmp_path):
    """SIGKILL leaves no time for anything: what was written counts, and no run counts twice."""
    config = CollectConfig(
        mode="autonomous",
        scenes=10,
        out=tmp_path / "killed",
        engine="native",
        task_limit=30.0,
        workers=1,
        chunk=1,
    )
    words = (
        f"collect autonomous --engine native --workers 1 --chunk 1 --scenes {config.scenes} "
        f"--task-limit 30 --out {config.out}"
    )
    parts = config.out / "autonomous" / "parts"
    process = subprocess.Popen(
        [sys.executable, "-m", "pgf_jax", *words.split()],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + 120
        while not list(parts.glob("part_*.parquet")):
            assert process.poll() is None and time.monotonic() < until
            time.sleep(0.005)
    finally:
        os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    path = runs_path(config.out, Mode.AUTONOMOUS)
    assert not path.exists()
    kept = len(list(parts.glob("part_*.parquet")))
    assert config.scenes is not None and 1 <= kept < config.scenes
    (parts / ".part_0000099.parquet.1.tmp").write_bytes(b"PAR1")  # killed while writing
    todo = []
    collect(
        dataclasses.replace(config, resume=True),
        on_progress=lambda done, wanted: todo.append(done),
    )
    assert todo == list(range(kept, config.scenes + 1))
    runs = read_runs(path)
    assert runs.select("scene", "seed", "iteration").is_duplicated().sum() == 0
    assert runs.n_unique("scene") == config.scenes
    assert not parts.exists()
    whole = collect(dataclasses.replace(config, out=tmp_path / "whole"))
    assert path.read_bytes() == whole.path.read_bytes()
    assert np.isfinite(runs["c_d"].to_numpy()).any()


def test_futures_go_on_until_it_is_solved_or_time_is_up(tmp_path):
    """Of two states of a scene; 24 s are 16 rollouts, of which those before a state are spent.

    The first future without help is what the robot itself does.
    """
    config = settings(
        tmp_path, mode="futures", states=2, keys=2, task_limit=24.0, scenes=3, ask_to=5
    )
    frame = read_futures(collect(config).path)
    assert frame.columns == [*FUTURE_COLUMNS] and len(frame) > 1
    assert frame.group_by("scene").len()["len"].max() == 4
    planner, ends = native().planner, set()
    for row in frame.rows(named=True):
        at = row["iteration"]
        search = course(config, row["seed"])[at]
        left = 16 - (1 + 2 * at)
        push = Aside().decide(View.of(search))
        turn = (row["seed"], 0, 0, at + 1)
        for name, given in (("alone", None), ("helped", push)):
            own = name == "alone" and row["key"] == 0
            key_paths = robot_key_path(*turn) if own else trial_key_path(*turn, row["key"])
            coroutine = simulate_input(
                planner,
                search,
                given,
                key_paths,
                reach_limit=math.inf,
                rollout_limit=left,
                keep=True,
            )
            trial = run(coroutine)
            assert row[f"{name}_s"] == 1.5 * trial.rollouts <= 1.5 * left
            assert row[f"{name}_solved"] == trial.solved and row[name] == trial.cost
            assert row[f"{name}_iterations"] == trial.iterations
            assert trial.solved or left - trial.rollouts < 2
            ends.add(trial.solved)
    assert ends == {True, False}
