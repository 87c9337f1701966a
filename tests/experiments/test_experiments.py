"""The stored data of the study, and what is made from them; the study itself is not run here."""

import importlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pgf_jax.sweeping.config import SweepConfig

STORED = Path(__file__).parents[2] / "experiments" / "results"
STUDIES = ("figure6", "open_questions")


@pytest.mark.parametrize("study", STUDIES)
def test_tables_and_figures_come_from_the_stored_rows(study, tmp_path):
    shutil.copy(STORED / f"{study}.csv", tmp_path)
    importlib.import_module(f"{study}_report").write(study, tmp_path)
    assert (tmp_path / f"{study}.md").read_bytes() == (STORED / f"{study}.md").read_bytes()
    made = {path.name for path in tmp_path.glob("*.png")}
    assert made == {path.name for path in STORED.glob(f"{study}*.png")} and len(made) == 2


@pytest.mark.parametrize("study", STUDIES)
def test_every_run_of_the_study_is_stored(study, tmp_path, monkeypatch):
    script = importlib.import_module(study)
    if study == "figure6":  # runs with pairs that are not there would be left out
        monkeypatch.setattr(script, "PAIRS", dict.fromkeys(script.PAIRS, tmp_path))
    runs = script.runs(quick=False)
    rows = pl.read_csv(STORED / f"{study}.csv", infer_schema_length=None)
    tasks = {
        (*run.labels.values(), cell.policy, cell.robots, run.config.seed): cell.tasks
        for run in runs
        for cell in run.config.cells()
    }
    assert len(tasks) == sum(len(run.config.cells()) for run in runs)
    keys = [*runs[0].labels, "policy", "robots", "seed"]
    stored = rows.with_columns(pl.col(pl.String).fill_null("")).select(keys).rows()
    assert sorted(stored) == sorted(tasks)
    for key, ended, robots in zip(stored, rows["tasks"], rows["robots"], strict=True):
        assert ended == robots * tasks[key]
    assert (rows["identities"] >= 18 + 3 * rows["robots"] + 2 * rows["tasks"]).all()


@pytest.mark.parametrize("number", [2, 4, 5])
def test_illustrations_are_drawn_from_the_stored_data(number):
    drawing = importlib.import_module("figures_2_4_5_drawing")
    content = json.loads((STORED / f"figure{number}.json").read_text())
    figure = drawing.FIGURES[number](content)
    panels = len(content["bidders"]) if number == 5 else 2
    assert sum(axes.get_aspect() == 1 for axes in figure.axes) == panels


def test_rows_come_from_the_cells_of_a_sweep(tmp_path, capsys):
    runs = importlib.import_module("study_runs")
    config = SweepConfig(
        world="none",
        physics="authors",
        engine="planar",
        policies=("autonomous", "or-hitl"),
        robots=(1, 2),
        tasks=1,
        operator="none",
        horizon=8.0,
    )
    some = [runs.Run({"what": f"seed {seed}"}, replace(config, seed=seed)) for seed in (3, 4)]
    for _ in range(2):  # the second time all is there
        runs.compute("x", some, tmp_path, tmp_path / "raw")
        rows = importlib.import_module("study_rows").read("x", tmp_path)
        assert rows.select("what", "seed", "policy", "robots").rows() == [
            (f"seed {seed}", seed, policy, robots)
            for seed in (3, 4)
            for policy in ("autonomous", "or-hitl")
            for robots in (1, 2)
        ]
        assert rows["robot_hours"].to_list() == pytest.approx([8 / 3600, 16 / 3600] * 4)
        assert (rows["identities"] == 19 + 3 * rows["robots"] + 2 * rows["robots"]).all()
    assert capsys.readouterr().err.count("kept: ") == 1


def test_intervals_are_over_seeds():
    rows = importlib.import_module("study_rows")
    ours = pl.DataFrame({"seed": [0, 1, 2], "time": [1.0, 2.0, 3.0], "success": [1.0, 1.0, 0.9]})
    theirs = pl.DataFrame({"seed": [2, 1, 0], "time": [5.0, 3.0, 1.5], "success": [1.0] * 3})
    found = rows.difference(ours, theirs, "time")
    assert found.mean == pytest.approx((-0.5 - 1.0 - 2.0) / 3) and found.n == 3
    # t(0.975, 2 dof) = 4.303
    half = 4.303 * (7 / 12) ** 0.5 / 3**0.5
    assert found.high - found.mean == pytest.approx(half, rel=1e-3)
    rate = rows.over_seeds(ours, "success")
    assert rate.high == 1.0 and 0.8 < rate.low < rate.mean == pytest.approx(2.9 / 3)
    with pytest.raises(AssertionError, match="one fleet a seed"):
        rows.over_seeds(pl.concat([ours, ours]), "time")


def test_measures_of_the_solid_world():
    script = importlib.import_module("solid_world")
    rng = np.random.default_rng(0)
    forward = np.array([0.13, 0.0, 0.0]) + rng.normal(0, [0.01, 0.02, 0.1], (3, 8, 3))
    cases = [
        script.Case(scene, controls, np.zeros(8), 3.0)
        for scene, controls in zip(script.scenes_of(5, 3), forward, strict=True)
    ]
    table = script.convergence({"some": cases, "none": cases[:0]}, halvings=1)
    columns = {str(column.header): list(column.cells) for column in table.columns}
    assert columns["step, ms"] == ["3.750", "1.875"]
    assert int(columns["moved objects"][0]) > 3 and float(columns["mean"][0]) > 0
    assert [columns[name][1] for name in ("verdicts changed", "mean")] == ["0", "0.00"]
    overlap, tilt = script.watch(cases)
    assert 0 < overlap < 3e-3 and 0 < tilt < 1
    ways, tilt = script.slides(script.Solid(), 0.4)
    formula = 0.4**2 / (2 * 0.5 * 9.81) - 0.4 * script.Solid().step_s / 2
    assert ways == pytest.approx([formula] * 8, rel=0.03) and tilt < 0.02
