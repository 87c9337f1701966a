"""Plan files: their fields, and what is refused when one is read."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.planning.types import Status
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plans.file import Plan, load_plan, plan_path, save_plan
from pgf_jax.scene import Scene
from pgf_jax.simulation.robot import Segment


def a_plan() -> Plan:
    push = Segment("push", 3.0, np.full((2, 3), 0.1, np.float32), np.full(2, 255.0, np.float32))
    reach = Segment("reach", 3.0, np.zeros((2, 3), np.float32), np.zeros(2, np.float32))
    return Plan(
        scene=Scene("two", np.array([[0.4, 0.1, 0.03], [0.5, 0.0, 0.03]]), 1),
        status=Status.NON_FINITE,
        seed=3,
        engine="native",
        lanes=1,
        physics="authors",
        settings={"world": "none"},
        cost_variant="source",
        update="greedy",
        operator="heuristic",
        ask="after:3",
        segments=(push, reach),
        cost={"c_d": 1.0, "c_f": math.inf, "c_b": 0.0, "c_e": 0.0, "c_s": 0.0, "total": math.inf},
        history=np.array([[1.0, math.inf, 0.0]]),
        history_starts=(0,),
        iterations=5,
        reach_iterations=4,
        planning_time_s=16.5,
        waiting_s=0.0,
        interaction_s=8.0,
        execution_s=4.0,
        pushes=1,
        requests=1,
        grants=1,
        non_finite=2,
    )


@pytest.fixture
def content() -> dict:
    return a_plan().to_json()


def test_wrong_arguments_are_named(tmp_path):
    plan = a_plan()
    cases: list[tuple[Any, Any, str]] = [
        (plan, tmp_path, "save_plan(folder, plan): the arguments are swapped, got a Plan first"),
        (tmp_path, plan.scene, "plan: expected a Plan, got a Scene"),
        (None, plan, "folder: expected a path, got None"),
        ("x.plan.json", plan, "folder: expected a folder, got 'x.plan.json'; the file in it is "),
    ]
    for folder, given, message in cases:
        with pytest.raises(BadInput) as error:
            save_plan(folder, given)
        assert str(error.value).startswith(message)
    with pytest.raises(BadInput, match=r"^path: expected a path, got a Plan$"):
        load_plan(plan)  # pyright: ignore[reportArgumentType]


def test_a_plan_file_by_hand(tmp_path):
    path = save_plan(tmp_path / "new", a_plan())
    assert path == tmp_path / "new" / "two.plan.json" == plan_path(tmp_path / "new", "two")
    tenth = float(np.float32(0.1))
    content = json.loads(path.read_text())
    made_by = content.pop("made_by")
    assert made_by["versions"].keys() >= {"pgf_jax", "jax", "mujoco"}
    assert len(made_by["code"]["source_sha256"]) == 64
    assert content == {
        "scene": "two",
        "status": "non_finite",
        "seed": 3,
        "engine": "native",
        "lanes": 1,
        "physics": "authors",
        "cost_variant": "source",
        "update": "greedy",
        "operator": "heuristic",
        "ask": "after:3",
        "settings": {"world": "none"},
        "objects": [[0.4, 0.1, 0.03], [0.5, 0.0, 0.03]],
        "goal": 1,
        "segments": [
            {
                "kind": "push",
                "duration_s": 3.0,
                "controls": [[tenth] * 3] * 2,
                "gripper": [255.0, 255.0],
            },
            {"kind": "reach", "duration_s": 3.0, "controls": [[0.0] * 3] * 2, "gripper": [0.0] * 2},
        ],
        "cost": {"c_d": 1.0, "c_f": None, "c_b": 0.0, "c_e": 0.0, "c_s": 0.0, "total": None},
        "history": [[1.0, None, 0.0]],
        "history_starts": [0],
        "iterations": 5,
        "reach_iterations": 4,
        "planning_time_s": 16.5,
        "waiting_s": 0.0,
        "interaction_s": 8.0,
        "execution_s": 4.0,
        "pushes": 1,
        "requests": 1,
        "grants": 1,
        "non_finite": 2,
    }
    assert list(tmp_path.rglob("*")) == [path.parent, path]  # no temporary file is left


def test_a_plan_comes_back(tmp_path):
    plan = a_plan()
    again = load_plan(save_plan(tmp_path, plan))
    assert again.to_json() == plan.to_json()
    assert again.cost == plan.cost
    np.testing.assert_array_equal(again.history, plan.history)
    np.testing.assert_array_equal(again.segments[0].controls, plan.segments[0].controls)


def test_a_plan_without_an_iteration_comes_back(tmp_path, content):
    content |= {"history": [], "history_starts": []}
    assert load_plan(write(tmp_path, content)).history.shape == (0, 3)


def write(folder: Path, content: object) -> Path:
    path = folder / "x.plan.json"
    path.write_text(json.dumps(content))
    return path


WRONG = {
    "no status": ({"status": ...}, "status: missing"),
    "unknown status": ({"status": "won"}, "status: expected one of solved"),
    "status no text": ({"status": []}, "status: expected str"),
    "count as text": ({"iterations": "5"}, "iterations: expected int, got '5'"),
    "count as bool": ({"pushes": True}, "pushes: expected int, got True"),
    "negative count": ({"iterations": -1}, "iterations: expected 0 or more, got -1"),
    "negative time": ({"planning_time_s": -1.0}, "planning_time_s: expected seconds"),
    "overlap": ({"objects": [[0.4, 0.1, 0.03]] * 2}, "object_1 and object_2 overlap"),
    "no goal there": ({"goal": 2}, "goal index must be within 0..1, got 2"),
    "segments no list": ({"segments": {}}, "segments: expected list"),
    "no segment": ({"segments": []}, "segments: expected 1 pushes and a reach"),
    "cost without total": ({"cost": {"c_d": 1.0}}, "cost: expected c_d, c_f, c_b, c_e, c_s"),
    "cost as text": ({"cost": dict.fromkeys(a_plan().cost, "1x")}, "cost: expected numbers"),
    "flat history": ({"history": [1.0]}, "history: expected shape"),
    "ragged history": ({"history": [[1.0], [1.0, 2.0]]}, "history: expected numbers"),
    "starts beyond": ({"history_starts": [1]}, "history_starts: expected rows of history"),
}
WRONG_SEGMENT = {
    "kind": ({"kind": "pull"}, "segments[0] kind: expected push or reach, got 'pull'"),
    "duration": ({"duration_s": 0}, "segments[0] duration_s: expected a positive number"),
    "no knots": ({"controls": []}, "segments[0] controls: expected [T, 3]"),
    "narrow": ({"controls": [[1.0, 2.0]] * 2}, "segments[0] controls: expected shape [2, 3]"),
    "null": ({"controls": [[1.0, 2.0, None]] * 2}, "segments[0] controls: expected finite"),
    "gripper": ({"gripper": [0.0]}, "segments[0] gripper: expected shape [2], got [1]"),
    "gripper range": ({"gripper": [0.0, 256.0]}, "segments[0] gripper: expected 0 (open)"),
}


def refused(tmp_path: Path, content: object) -> str:
    path = write(tmp_path, content)
    with pytest.raises(BadInput) as error:
        load_plan(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    return message


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_field_is_named(tmp_path, content, case):
    change, expected = WRONG[case]
    content = {k: v for k, v in (content | change).items() if v is not ...}
    assert expected in refused(tmp_path, content)


@pytest.mark.parametrize("case", WRONG_SEGMENT)
def test_a_wrong_segment_is_named(tmp_path, content, case):
    change, expected = WRONG_SEGMENT[case]
    content["segments"][0] |= change
    assert expected in refused(tmp_path, content)


@pytest.mark.parametrize("wrong", [[], None, 3, "x", [{}]])
def test_what_is_no_mapping_is_refused(tmp_path, wrong):
    assert "expected a mapping" in refused(tmp_path, wrong)


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path):
    path = save_plan(tmp_path, a_plan())
    data = path.read_bytes().rstrip()
    for end in range(0, len(data), 97):
        path.write_bytes(data[:end])
        with pytest.raises(BadInput, match="truncated or malformed"):
            load_plan(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(BadInput, match=r"nothing\.plan\.json: no such file"):
        load_plan(tmp_path / "nothing.plan.json")


def test_a_folder_that_cannot_be_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot be written"):
        save_plan(tmp_path / "file", a_plan())


def test_a_plan_says_which_other_settings_it_was_made_with(tmp_path):
    from pgf_jax.plans.file import _other_settings

    assert _other_settings(PlanConfig(engine="native", lanes=3)) == {"world": "solid"}
    config = PlanConfig(sigma=(0.1, 0.1, 0.1), cost_weights=("w_d=1",), task_limit=90.0)
    settings = {
        "sigma": [0.1, 0.1, 0.1],
        "cost_weights": ["w_d=1"],
        "task_limit": 90.0,
        "world": "solid",
    }
    assert _other_settings(config) == settings
    made = dataclasses.replace(a_plan(), settings=settings)
    assert load_plan(save_plan(tmp_path, made)).settings == settings
