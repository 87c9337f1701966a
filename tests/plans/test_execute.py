"""Plans executed in a world: what a check called solved is grasped, from the file alone."""

import json
import subprocess
import sys

import numpy as np
import polars as pl
import pytest
from render_plans import plan as short_plan

import pgf_jax
from pgf_jax.cli import main
from pgf_jax.errors import BadInput
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.plans.config import ExecuteConfig, PlanConfig
from pgf_jax.plans.execute import execute, segments_executed
from pgf_jax.plans.execute_command import EXECUTION_SCHEMA
from pgf_jax.plans.file import load_plan, save_plan
from pgf_jax.plans.plan import plan_scenes
from pgf_jax.scene import sample_scene
from pgf_jax.simulation.robot import Segment


@pytest.fixture(scope="module")
def plans():
    """Tight scenes, some of which need a push."""
    config = PlanConfig(operator="heuristic", ask="after:2", lanes=8, task_limit=120.0)
    return plan_scenes([(sample_scene(seed, "tight"), seed) for seed in range(8)], config)


@pytest.fixture(scope="module")
def folder(plans, tmp_path_factory):
    out = tmp_path_factory.mktemp("plans")
    for one in plans:
        save_plan(out, one)
    return out


def test_what_was_checked_grasps_and_bit_for_bit_from_the_file(plans, folder):
    solved = [one for one in plans if one.solved]
    assert len(solved) >= 5 and any(one.pushes for one in solved)
    paths = [str(folder / f"{one.scene.name}.plan.json") for one in solved]
    script = "import sys; from pgf_jax.cli import main; sys.exit(main(sys.argv[1:]))"
    fresh = subprocess.run(
        [sys.executable, "-c", script, "execute", *paths, "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    rows = json.loads(fresh.stdout)["executions"]
    for one, row in zip(solved, rows, strict=True):
        (here,) = execute(one)
        assert here.distance_m is not None and here.distance_m < 0.06
        assert here.grasped and row["grasped"]
        assert row["distance_m"].hex() == here.distance_m.hex()
        assert row["world"] == "solid" and 0 <= row["tilt_deg"] < 20


def test_a_plan_of_the_engine_alone_may_miss():
    scenes = [(sample_scene(seed, "tight"), seed) for seed in range(12)]
    config = PlanConfig(world="none", physics="authors", lanes=8, task_limit=60.0)
    believed = [one for one in plan_scenes(scenes, config) if one.solved]
    grasped = [execute(one)[0].grasped for one in believed]
    assert 0 < sum(grasped) < len(grasped)


def test_its_segments_are_pushes_retreats_and_a_reach(plans):
    one = next(p for p in plans if p.pushes)
    world = SolidWorld(20)
    done = list(segments_executed(one, world, world.start(one.scene)))
    kinds = [kind for kind, _ in done]
    assert kinds == ["push", "retreat"] * one.pushes + ["reach"]
    pushed, retreated = done[0][1], done[1][1]
    back = retreated.rollout.hand[-1, :2] - pushed.rollout.hand[-1, :2]
    assert np.linalg.norm(back) == pytest.approx(0.07, abs=1e-3)


def test_the_error_of_a_world_is_drawn_for_each_repeat(plans):
    one = next(p for p in plans if p.solved)
    many = execute(one, ExecuteConfig(world_error=("default",), repeats=4))
    again = execute(one, ExecuteConfig(world_error=("default",), repeats=2))
    assert [e.repeat for e in many] == [0, 1, 2, 3]
    assert len({e.distance_m for e in many}) == 4
    assert [e.distance_m for e in again] == [e.distance_m for e in many[:2]]


def test_the_table_is_written(plans, folder, tmp_path, capsys):
    paths = [str(path) for path in sorted(folder.glob("*.json"))]
    assert main(["execute", *paths, "--out", str(tmp_path / "out")]) == 0
    assert f"of {len(plans)} executions grasp" in capsys.readouterr().out
    table = pl.read_parquet(tmp_path / "out" / "executions.parquet")
    assert table.schema == EXECUTION_SCHEMA and len(table) == len(plans)
    claimed = table.filter(pl.col("claimed") == "solved")
    assert claimed["grasped"].all() and table["repeat"].unique().to_list() == [0]


def test_a_plan_from_before_there_were_worlds_is_executed_in_the_solid_one(folder, tmp_path):
    path = next(iter(sorted(folder.glob("*.json"))))
    content = json.loads(path.read_text())
    content["settings"].pop("world")
    old = tmp_path / path.name
    old.write_text(json.dumps(content))
    loaded = load_plan(old)
    assert loaded.settings["world"] == "none" and loaded.physics == "authors"
    assert execute(loaded)[0].world == "solid"
    assert load_plan(path).settings["world"] == "solid" and load_plan(path).physics == "default"


def test_other_numbers_of_objects(tmp_path):
    made = short_plan()
    (done,) = execute(made)
    assert done.scene == "short" and not done.grasped


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "plans: expected one or more files of plans, got none"),
        (("none.plan.json",), "none.plan.json"),
        (("PLAN", "--world", "flat"), "--world: expected"),
        (("PLAN", "--world", "scene"), "expected --scenes with the folder of that"),
        (("PLAN", "--world", "scene", "--scenes", "/nowhere"), "/nowhere"),
        (("PLAN", "--repeats", "3"), "repeats: expected with world_error only, got 3"),
        (("PLAN", "--repeats", "0"), "repeats"),
        (("PLAN", "--world-error", "mass=2"), "mass"),
        (("PLAN", "--world", "scene", "--world-error", "default"), "with world solid only"),
        (("PLAN", "--out", "/dev/null/x"), "--out /dev/null/x"),
    ],
)
def test_wrong_arguments_are_one_line(folder, arguments, message, capsys):
    path = str(next(iter(sorted(folder.glob("*.json")))))
    assert main(["execute", *(path if a == "PLAN" else a for a in arguments)]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def strict_json(text: str):
    """JSON as its standard has it: without NaN and Infinity."""

    def refuse(word: str):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def test_a_plan_that_diverges_has_no_distance_and_no_tilt(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes what it warns of to a file where it runs
    wild = np.tile([1e30, 0.0, 0.0], (8, 1))
    one = short_plan(segments=(Segment("reach", 3.0, wild, np.zeros(8)),), pushes=0)
    path = str(save_plan(tmp_path, one))
    assert main(["execute", path, "--json", "--out", "out"]) == 0
    (row,) = strict_json(capsys.readouterr().out)["executions"]
    assert (row["distance_m"], row["tilt_deg"], row["grasped"]) == (None, None, False)
    table = pl.read_parquet(tmp_path / "out" / "executions.parquet")
    assert table["distance_m"].to_list() == table["tilt_deg"].to_list() == [None]
    assert main(["execute", path]) == 0
    assert "diverged" in capsys.readouterr().out
    with pytest.raises(BadInput, match="plan short: diverges in the world"):
        one.motion(ExecuteConfig())


def test_it_is_public():
    assert pgf_jax.execute is execute
    with pytest.raises(BadInput, match="plan: expected a Plan"):
        pgf_jax.execute("tight_0")  # pyright: ignore[reportArgumentType]


def test_the_motion_of_a_plan_is_that_very_execution(plans):
    """With somebody watching it is the same to the last bit, and ends where the world says."""
    one = next(p for p in plans if p.solved and p.pushes)
    world = SolidWorld(20)
    seen, leans = [], []

    def watch(share, state):
        seen.append((share, world.seen(state)))
        leans.append((share, world.leaning(state)))

    watched = list(segments_executed(one, world, world.start(one.scene), watch))
    plain = list(segments_executed(one, world, world.start(one.scene)))
    for (kind, a), (other, b) in zip(watched, plain, strict=True):
        assert (kind == other and a.distance == b.distance) or np.isnan(a.distance)
        for x, y in zip(a.rollout, b.rollout, strict=True):
            assert np.array_equal(x, y)
    assert len(seen) == sum(6 * len(executed.rollout.hand) for _, executed in plain)
    motion = one.motion()
    ends = plain[-1][1].rollout
    assert np.array_equal(motion.objects[-1], ends.objects[-1].astype(np.float32))
    assert motion.duration_s == pytest.approx(3.0 * len(one.segments) + 1.0 * one.pushes)
    assert motion.at(2.0).push is not None and motion.at(motion.duration_s).push is None
    assert (np.diff(motion.times) > 0).all()
    # Objects lean as the world has them at the same times, and are drawn so.
    poses = np.array([state for _, state in leans])
    assert motion.leaning.shape == (len(motion.times), 20, 4)
    assert np.array_equal(motion.leaning[1:], poses)
    assert np.allclose(motion.at(motion.duration_s).leaning, motion.leaning[-1], atol=1e-12)
    assert np.allclose(np.linalg.norm(motion.leaning[..., 1:], axis=-1), 1)
    assert 0 < np.degrees(np.arccos(motion.leaning[..., 3].min())) < 25
    # The hand's end-effector point is within reach of the goal where it ends.
    point = motion.end_effector_paths()[-1][-1]
    assert np.linalg.norm(point - motion.objects[-1][one.scene.goal]) < 0.06


def test_a_motion_is_that_of_the_world_that_is_asked_for(plans):
    one = next(p for p in plans if p.solved and not p.pushes)
    config = ExecuteConfig(world_error=("default",), repeats=2)
    runs = execute(one, config)
    ends = []
    for repeat, run in enumerate(runs):
        motion = one.motion(config, repeat)
        ends.append(motion.objects)
        goal = motion.objects[-1][one.scene.goal]
        away = np.linalg.norm(motion.end_effector_paths()[-1][-1] - goal)
        assert run.distance_m is not None
        assert away < run.distance_m + 1e-6  # which counts the bearing in
    starts = np.array([objects[0] for objects in ends])
    assert not np.array_equal(starts[0], starts[1])
    engine = short_plan()
    assert engine.motion().leaning.shape == (len(engine.motion().times), 0, 4)
    assert engine.motion(ExecuteConfig()).leaning.shape[1:] == (3, 4)
