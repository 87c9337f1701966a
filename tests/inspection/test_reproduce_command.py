"""`pgf-jax reproduce`: an iteration is found in a folder of results, and computed again."""

import json
import shutil

import numpy as np
import pytest
from sweep_toys import Ghost, ghost, tree

from pgf_jax.cli import main
from pgf_jax.fleet.config import Cell
from pgf_jax.physics.engine import register_engine
from pgf_jax.sweeping.cell_file import sidecar
from pgf_jax.sweeping.sweep import sweep


class Cracked(Ghost):
    """Loses the fourth object of a shelf at the third knot of whatever reaches far enough."""

    name = "cracked"

    def rollout(self, start, controls, gripper, substeps, wanted=None):
        rollout = super().rollout(start, controls, gripper, substeps, wanted)
        far = np.asarray(rollout.hand)[:, -1, 1] > np.asarray(start.hand)[:, 1] + 0.02
        objects = np.array(rollout.objects)
        objects[far, 2:, 3] = np.nan
        return rollout._replace(objects=objects)


register_engine("cracked", Cracked)  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduce") / "out"
    config = ghost(out, engine="cracked", operator="nudge", policies=("or-hitl",))
    return sweep(config, quiet=True)


def test_the_first_that_is_not_finite(whole, tmp_path, capsys):
    tasks = whole.tasks()
    lost = tasks.filter(tasks["non_finite"] > 0)
    assert len(lost) > 0 and whole.summaries[-1].non_finite > 0
    before = tree(whole.out)
    assert main(["reproduce", str(whole.out), "--robots", "2"]) == 0
    first = lost.filter(lost["robots"] == 2).row(0, named=True)
    said = capsys.readouterr().out
    assert said.startswith(
        f"robot {first['robot']}, task {first['task']} of seed 0, scene {first['scene']}: "
        f"iteration {first['non_finite_at'][0]}, "
    )
    assert "object 3" in said and "knot 2" in said
    assert tree(whole.out) == before


def test_any_iteration_by_its_numbers(whole, tmp_path, capsys):
    place = tmp_path / "x.npz"
    words = [
        "--policy",
        "or-hitl",
        "--robots",
        "1",
        "--robot",
        "0",
        "--task",
        "1",
        "--iteration",
        "0",
    ]
    assert main(["reproduce", str(whole.out), *words, "--out", str(place)]) == 0
    assert f"arrays in {place}" in capsys.readouterr().out
    arrays = np.load(place)
    assert arrays["words"].tolist()[:4] == [0, 0, 1, 0]
    assert arrays["controls"].shape[0] == len(arrays["cost"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--iteration 3", "--policy: expected with --iteration 3, got none"),
        (
            "--policy pgf --robots 1 --robot 0 --task 0 --iteration 0",
            "holds no fleet of 1 robots under pgf",
        ),
        (
            "--policy or-hitl --robots 1 --robot 0 --task 9 --iteration 0",
            "task",
        ),
        ("--policy autonomous", "every rollout that was asked about was finite"),
        ("--out x.txt", "--out: expected a .npz file, got x.txt"),
    ],
)
def test_bad_input(whole, words, message, capsys):
    assert main(["reproduce", str(whole.out), *words.split()]) == 2
    err = capsys.readouterr().err
    assert message in err and len(err.splitlines()) == 1


def test_a_cell_that_was_tampered_with(whole, tmp_path, capsys):
    out = tmp_path / "copy"
    shutil.copytree(whole.out, out)
    file = out / "cells" / whole.files[Cell("or-hitl", 2, 2)].name
    account = json.loads(sidecar(file).read_text())
    sidecar(file).write_text(json.dumps(account | {"sha256": "0"}))
    assert main(["reproduce", str(out), "--robots", "2"]) == 2
    assert "truncated or edited" in capsys.readouterr().err
