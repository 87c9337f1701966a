import dataclasses
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.container import ErrorbarContainer
from rich.console import Console
from stub_fleets import mixed_fleet, run, solved_after

from pgf_jax.errors import BadInput
from pgf_jax.files import pdf, png
from pgf_jax.fleet import CheckResult, Fleet, FleetConfig, ReachResult, WorkKind
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.stub import StubRobots, drive, missed_checks, missed_grasps, outcome
from pgf_jax.metrics.summary import CellSummary, Interval, summarise
from pgf_jax.planning.types import Status
from pgf_jax.sweeping import columns
from pgf_jax.sweeping.cell_file import Content, decode
from pgf_jax.sweeping.figure6 import figure6
from pgf_jax.sweeping.report import BARS, Report, summary_tables
from pgf_jax.sweeping.resolve import CellSpec
from pgf_jax.sweeping.summary import (
    PAIRED,
    csv,
    fleets_frame,
    over_fleets,
    paired_differences,
    paired_frame,
    summary_frame,
)
from pgf_jax.tables import results
from pgf_jax.tables.parquet import encode_table


def test_summary_against_hand_computation():
    # Iteration 0 takes 1.5 s, each further one 3 s, the final check 1.5 s; then 3 s of execution.
    fleet = run(iterate=solved_after([0, 2, 0]), policy="autonomous")
    cell = Cell("autonomous", 1, 3)
    frame = results.tasks_frame(fleet.records, lambda robot, task: f"scene_{task}")
    summary = summarise(
        fleet.config, results.task_records(frame), results.event_log(frame_of(fleet))
    )
    row = summary_frame([summary]).row(0, named=True)
    assert (row["policy"], row["robots"], row["tasks"], row["solved"]) == ("autonomous", 1, 3, 3)
    times = [3.0, 9.0, 3.0]
    assert row["planning_time_s"] == pytest.approx(5.0)
    # t quantile with 2 degrees of freedom: 4.302653; standard deviation sqrt(12).
    half = 4.302653 * math.sqrt(12.0) / math.sqrt(3.0)
    assert row["planning_time_s_low"] == pytest.approx(5.0 - half)
    assert row["planning_time_s_high"] == pytest.approx(5.0 + half)
    # Wilson for 3 of 3: low = 1 / (1 + z^2 / n), high = 1.
    assert row["success"] == row["success_high"] == 1.0
    assert row["success_low"] == pytest.approx(1 / (1 + 1.959964**2 / 3))
    assert row["hours"] == pytest.approx((sum(times) + 3 * 3.0) / 3600)
    assert row["tasks_per_hour"] == pytest.approx(3 * 3600 / 24.0)
    assert row["utilisation"] == 0.0
    assert math.isnan(row["first_grant"]) and row["first_grant_n"] == 0
    merged = results.merge([(cell, frame)])
    assert merged.columns == list(results.MERGED_TASK_SCHEMA)
    assert merged["planning_time_s"].to_list() == times
    assert merged["scene"].to_list() == ["scene_0", "scene_1", "scene_2"]


def test_what_broke_by_hand(tmp_path):
    """Task 0 breaks at its iterations 1 and 3 of 0..4; rollouts of iteration i, i are saturated."""

    def iterate(work):
        return outcome(
            feasible=work.iteration == 4,
            non_finite=work.task == 0 and work.iteration in (1, 3),
            saturated=work.iteration,
        )

    fleet = run(iterate=iterate, tasks=2, policy="autonomous")
    frame = results.tasks_frame(fleet.records, lambda robot, task: "x")
    assert frame["non_finite"].to_list() == [2, 0]
    assert frame["non_finite_at"].to_list() == [[1, 3], []]
    assert frame["saturated"].to_list() == [10, 10]
    path = tmp_path / "tasks.parquet"
    path.write_bytes(encode_table(frame))
    again = results.task_records(results.read_results(path, results.TASK_SCHEMA))
    assert again == fleet.records
    row = summary_frame([summarise(fleet.config, again, fleet.events)]).row(0, named=True)
    assert (row["non_finite"], row["saturated"]) == (2, 20)
    # Of an iteration that broke it is known which.
    path.write_bytes(encode_table(frame.with_columns(non_finite_at=pl.Series([[1, None], []]))))
    with pytest.raises(BadInput, match="non_finite_at is missing in 1 rows"):
        results.read_results(path, results.TASK_SCHEMA)


def frame_of(fleet):
    return results.events_frame(fleet.events)


def test_paired_differences_against_hand_computation():
    ours = run("autonomous", iterate=solved_after([0, 1, None]))
    theirs = run("autonomous", iterate=solved_after([1, 3, 0]))
    cells = {Cell("a", 1, 3): ours.records, Cell("b", 1, 3): theirs.records}
    rows = {row.value: row for row in paired_differences(cells)}
    assert {(row.robots, row.policy, row.baseline) for row in rows.values()} == {(1, "a", "b")}
    # Iterations differ by -1, -2 and 59: the 180 s limit allows 1.5 s and then 59 times 3 s.
    assert rows["reach_iterations"].difference.mean == pytest.approx((-1 - 2 + 59) / 3)
    # Planning time: 3 - 6, 6 - 12 and 178.5 - 3.
    difference = rows["planning_time_s"].difference
    values = np.array([-3.0, -6.0, 175.5])
    assert difference.mean == pytest.approx(values.mean())
    half = 4.302653 * values.std(ddof=1) / math.sqrt(3)
    assert (difference.low, difference.high) == pytest.approx(
        (values.mean() - half, values.mean() + half)
    )
    assert rows["solved"].difference.mean == pytest.approx(-1 / 3)
    table = paired_frame(rows.values())
    assert table.columns == ["robots", "policy", "baseline", "value", "mean", "low", "high", "n"]
    assert table["n"].to_list() == [3] * len(PAIRED)


def test_policies_are_paired_within_a_fleet_size():
    fleets = {Cell(p, r, 3): run(robots=r).records for p in "abc" for r in (1, 2)}
    rows = [row for row in paired_differences(fleets) if row.value == "solved"]
    pairs = [("a", "b"), ("a", "c"), ("b", "c")]
    assert sorted((row.robots, row.policy, row.baseline) for row in rows) == [
        (robots, *pair) for robots in (1, 2) for pair in pairs
    ]
    assert paired_frame(paired_differences({Cell("a", 1, 3): []})).is_empty()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), horizon=st.none() | st.floats(1.0, 700.0))
def test_tables_hold_what_the_fleet_said(seed, horizon):
    fleet = mixed_fleet(seed=seed, horizon_s=horizon)
    tasks = results.tasks_frame(fleet.records, lambda robot, task: f"{robot}_{task}")
    assert dict(tasks.schema) == results.TASK_SCHEMA
    records = sorted(fleet.records, key=lambda r: (r.robot, r.task))
    # Representations, because nan is not equal to itself.
    assert repr(results.task_records(tasks)) == repr(records)
    events = frame_of(fleet)
    assert dict(events.schema) == results.EVENT_SCHEMA
    known = [
        e._replace(gain=None) if e.gain is not None and math.isnan(e.gain) else e
        for e in fleet.events
    ]
    assert results.event_log(events) == known
    for frame, schema in ((tasks, results.TASK_SCHEMA), (events, results.EVENT_SCHEMA)):
        again = results._decode(encode_table(frame), "x", schema)  # pyright: ignore[reportArgumentType]
        assert again.equals(frame)
        assert encode_table(again) == encode_table(frame)
    before = summarise(fleet.config, fleet.records, fleet.events)
    after = summarise(fleet.config, results.task_records(tasks), results.event_log(events))
    # Means are over records in another order.
    for key, value in before.row().items():
        assert after.row()[key] == (value if isinstance(value, str) else approx(value))


def approx(value):
    return pytest.approx(value, rel=1e-12, nan_ok=True)


def test_event_columns_are_exactly_the_documented_ones():
    documented = "time_ns kind robot task request operator iteration gain object x y outcome"
    assert list(results.EVENT_SCHEMA) == documented.split()
    events = frame_of(mixed_fleet())
    pushes = events.filter(pl.col("outcome") == "push", pl.col("kind") == "service_end")
    assert pushes["x"].unique().to_list() == [0.4] and (pushes["object"] == pushes["robot"]).all()
    assert events.filter(pl.col("kind") == "window_close")["robot"].null_count() > 0
    assert results.events_frame([]).is_empty()


# -- files -------------------------------------------------------------------------------------


def test_read_results_names_file_and_column(tmp_path):
    path = tmp_path / "tasks.parquet"
    with pytest.raises(BadInput, match=f"{path}: no such file"):
        results.read_results(path, results.MERGED_TASK_SCHEMA)
    whole = encode_table(results.tasks_frame(mixed_fleet().records, lambda robot, task: "x"))
    for size in [*range(0, len(whole), 997), len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(BadInput, match=f"{path}: truncated or corrupt") as caught:
            results.read_results(path, results.TASK_SCHEMA)
        assert "\n" not in str(caught.value)
    path.write_bytes(whole)
    with pytest.raises(BadInput, match=f"{path}: column policy must be String, got nothing"):
        results.read_results(path, results.MERGED_TASK_SCHEMA)
    pl.DataFrame({"robot": ["a"]}).write_parquet(path)
    with pytest.raises(BadInput, match="column robot must be Int64, got String"):
        results.read_results(path, results.TASK_SCHEMA)


def test_numbers_in_csv_are_whole(tmp_path):
    frame = pl.DataFrame({"x": [1 / 3, math.nan, 1e-17]})
    again = pl.read_csv(io.BytesIO(csv(frame)), schema={"x": pl.Float64()})
    assert again["x"][0] == 1 / 3 and again["x"][2] == 1e-17 and math.isnan(again["x"][1])


# -- figure and report -------------------------------------------------------------------------


def summaries():
    cells = [(policy, robots) for policy in ("pgf", "or-hitl", "always") for robots in (1, 4, 10)]
    return [
        summarise(fleet.config, fleet.records, fleet.events)
        for policy, robots in cells
        for fleet in [run(policy, robots=robots, iterate=solved_after([0, robots, None]))]
    ]


def test_figure_has_a_line_for_each_policy():
    cells = summaries()
    figure = figure6(cells)
    times, wholes, rates = figure.axes
    panels = ((times, "planning_time_s"), (wholes, "task_time_s"), (rates, "success"))
    for axes, value in panels:
        lines = axes.get_lines()
        assert [line.get_label() for line in axes.containers] == ["pgf", "or-hitl", "always"]
        assert len(lines) == 3
        for line, policy in zip(lines, ("pgf", "or-hitl", "always"), strict=True):
            expected = [getattr(c, value).mean for c in cells if c.policy == policy]
            np.testing.assert_array_equal(np.array(line.get_ydata(), float), expected)
            np.testing.assert_allclose(np.array(line.get_xdata(), float), [1, 4, 10], atol=0.25)
        assert axes.get_ylim()[0] == 0 and axes.get_xlabel() == "fleet size R (robots)"
        assert axes.get_legend() is None  # it is beside the axes
    assert figure.get_suptitle() == "135 tasks; one fleet for each point, so no intervals"
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words[1].startswith("or-hitl (OR-HITL): asks when stuck")
    picture = png(figure)
    assert picture.startswith(b"\x89PNG\r\n\x1a\n") and len(picture) > 10_000
    assert picture == png(figure6(cells))


def test_bars_are_intervals_over_fleets():
    cells = [
        summarise(fleet.config, fleet.records, fleet.events)
        for seed in range(3)
        for fleet in [run("pgf", robots=1, seed=seed, iterate=solved_after([0, seed, seed]))]
    ]
    figure = figure6(cells)
    assert len(figure.axes) == 2  # every task was solved
    (row,) = over_fleets(cells)
    for axes, interval in zip(figure.axes, (row.planning_time_s, row.task_time_s), strict=True):
        container = axes.containers[0]
        assert isinstance(container, ErrorbarContainer)
        ((low, high),) = container.lines[2][0].get_segments()
        assert (low[1], high[1]) == pytest.approx((interval.low, interval.high))
    assert figure.get_suptitle() == (
        "9 tasks, all of them solved; bars: 95 % intervals over 3 fleets"
    )
    assert pdf(figure).startswith(b"%PDF") and pdf(figure) == pdf(figure6(cells))


def test_intervals_are_over_fleets_and_cut_to_what_is_possible():
    cells = [summary(planning=planning, success=success) for planning, success in HAND]
    (row,) = over_fleets(cells)
    # Means 1, 2, 9: 4 with sd 4.36, and t(0.975, 2) = 4.3027 times sd / sqrt(3) is 10.83.
    assert (row.fleets, row.planning_time_s.mean, row.planning_time_s.n) == (3, 4.0, 3)
    assert row.planning_time_s.low == 0.0
    half = 4.302653 * np.std([1, 2, 9], ddof=1) / 3**0.5
    assert row.planning_time_s.high == pytest.approx(4 + half)
    assert (row.success.mean, row.success.high) == (pytest.approx(0.8), 1.0)
    (alone,) = over_fleets(cells[:1])
    assert alone.planning_time_s.mean == 1.0 and math.isnan(alone.planning_time_s.low)
    frame = fleets_frame([row])
    assert frame.columns[:6] == ["policy", "robots", "operators", "fleets", "tasks", "solved"]
    assert frame["planning_time_s_n"].to_list() == [3]


HAND = ((1.0, 0.5), (2.0, 0.9), (9.0, 1.0))


def summary(*, planning: float, success: float) -> CellSummary:
    """A fleet's, with these means; its own intervals do not count."""
    fleet = run("pgf", robots=1)
    found = summarise(fleet.config, fleet.records, fleet.events)
    return dataclasses.replace(
        found,
        planning_time_s=Interval(planning, -9.0, 99.0, 3),
        success=Interval(success, 0.0, 1.0, 3),
    )


def test_pairs_of_several_seeds_are_compared_by_fleet():
    fleets = {
        Cell(policy, 1, 3, seed): run(robots=1, seed=seed, iterate=solved_after(ways)).records
        for policy, seeds in (("a", ([0, 1, 2], [1, 1, 3])), ("b", ([2, 2, 2], [0, 0, 2])))
        for seed, ways in enumerate(seeds)
    }
    found = {p.value: p.difference for p in paired_differences(fleets)}["reach_iterations"]
    alone = [
        {
            p.value: p.difference
            for p in paired_differences({c: r for c, r in fleets.items() if c.seed == seed})
        }["reach_iterations"]
        for seed in (0, 1)
    ]
    assert [fleet.n for fleet in alone] == [3, 3] and found.n == 2
    assert found.mean == pytest.approx(np.mean([fleet.mean for fleet in alone]))


def test_figure_of_one_cell_without_an_outcome():
    fleet = run(horizon_s=1.0, tasks=1)
    assert fleet.records[0].status is Status.CENSORED
    figure = figure6([summarise(fleet.config, fleet.records, fleet.events)])
    assert png(figure).startswith(b"\x89PNG")
    assert figure.get_suptitle().startswith("0 tasks")


def test_summary_table_fits_a_terminal():
    file = io.StringIO()
    console = Console(width=80, file=file)
    console.print(summary_tables(summaries()))
    text = file.getvalue()
    assert "…" not in text
    assert text.count("or-hitl") == 6
    row = next(line for line in text.splitlines() if line.split()[:2] == ["or-hitl", "1"])
    # Solved in 3 and 6 s; the third task fails at the limit.
    assert row.split()[2:5] == ["1", "3", "0.67"]
    assert "one fleet: no interval (--seeds 0 1 2 makes several)" in text
    assert "all tasks solved" not in text
    solved = dataclasses.replace(summary(planning=1.0, success=1.0), solved=3, tasks=3)
    console.print(summary_tables([solved]))
    more = file.getvalue().removeprefix(text)
    assert "all tasks solved" in more and "success" not in more


def spec(sweep: int, *sizes) -> CellSpec:
    """A cell of a sweep, of which a report needs no more than policy and sizes."""
    fleet: Any = None
    cell = Cell(*sizes)
    return CellSpec(sweep, cell, cell.name, "", {}, fleet, {}, {}, Path("x"))


def test_progress_without_a_terminal_is_lines():
    file = io.StringIO()
    console = Console(file=file, width=30)
    cells = [spec(0, "pgf", 1, 4), spec(0, "pgf", 2, 4), spec(0, "always", 1, 4)]
    with Report(cells, [cells[2]], console) as report:
        report.progress(cells[0], 1, 1800 * 10**9)
        report.finished(cells[1], {})
        report.retried(2, "a process ended early")
        report.interrupted("there")
    assert report.retried_cells == 2
    lines = file.getvalue().splitlines()
    assert lines[0] == "kept: always_R1"
    assert lines[1].startswith("finished pgf_R2; 9/12 tasks, 1/2 cells, 0.50 h simulated, ")
    assert lines[2] == "a process ended early: 2 cells are computed again"
    assert lines[3].startswith("interrupted: 1 of 2 cells were finished and are kept in there; ")
    assert "--resume" in lines[3] and len(lines) == 4


def test_progress_of_several_sweeps_says_which():
    file = io.StringIO()
    cell, other = ("pgf", 2, 4), ("always", 1, 4)
    cells = [spec(0, *cell), spec(0, *other), spec(1, *cell), spec(1, *other)]
    with Report(cells, [cells[1], cells[3]], Console(file=file, width=30)) as report:
        report.progress(cells[0], 3, 1800 * 10**9)
        report.progress(cells[2], 1, 900 * 10**9)
        report.finished(cells[2], {})
        report.finished(cells[0], {})
        report.interrupted("here", "there", "elsewhere")
    lines = file.getvalue().splitlines()
    assert lines[0] == "kept: 0:always_R1, 1:always_R1"
    assert lines[1].startswith("finished 1:pgf_R2; 11/16 tasks, 1/2 cells, 0.75 h simulated, ")
    assert lines[2].startswith("finished 0:pgf_R2; 16/16 tasks, 2/2 cells, 0.75 h simulated, ")
    assert "2 of 2 cells were finished and are kept in here .. elsewhere; " in lines[3]
    assert len(lines) == 4


def test_progress_on_a_terminal_and_quiet():
    file, silence = io.StringIO(), io.StringIO()
    console = Console(file=file, force_terminal=True, width=100)
    cell = spec(0, "pgf", 2, 4)
    with Report([cell], [], console) as report:
        report.progress(cell, 3, 1800 * 10**9)
        report.finished(cell, {})
    text = file.getvalue()
    assert "pgf, R = 2" in text and "8/8" in text and "0.50 h simulated" in text
    quiet = Console(file=silence, force_terminal=True)
    with Report([cell], [cell], quiet, quiet=True) as report:
        report.interrupted("there")
    assert silence.getvalue() == ""


def test_many_cells_share_a_bar_and_a_line():
    cells = [spec(0, "pgf", robots, 1) for robots in range(1, 2 * BARS + 3)]
    for terminal in (False, True):
        file = io.StringIO()
        console = Console(file=file, force_terminal=terminal, width=100)
        with Report(cells, cells[: BARS + 1], console) as report:
            for cell in cells[BARS + 1 :]:
                report.finished(cell, {})
        text = file.getvalue()
        assert text.startswith("kept: 17 cells\n")
        assert "finished" not in text and "pgf" not in text
        tasks = sum(range(BARS + 2, 2 * BARS + 3))
        assert (f"{tasks}/{tasks}" in text) == terminal


def test_a_line_of_json_for_each_cell(capsys):
    cells = [spec(0, "pgf", 2, 4), spec(1, "always", 1, 4)]
    file = io.StringIO()
    with Report(cells, [], Console(file=file, width=30), json=True) as report:
        report.progress(cells[1], 1, 10**9)
        account = {"sha256": "ab", "wall_s": 1.5, "attempt": 2, "host": {"name": "here"}}
        report.finished(cells[0], account)
        report.finished(cells[1], {})
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert first.pop("tasks_per_s") > 0 and first.pop("left_s") >= 0
    assert first == account | {
        "host": "here",
        "sweep": 0,
        "cell": "pgf_R2",
        "tasks": 8,
        "cells_done": 1,
        "cells": 2,
        "tasks_done": 9,
        "tasks_in_all": 12,
    }
    assert (second["cell"], second["cells_done"], second["tasks_done"]) == ("always_R1", 2, 12)
    assert (second["host"], second["left_s"]) == (None, 0.0)
    assert len(file.getvalue().splitlines()) == 2  # as without
    with Report(cells, [], Console(file=file), json=True, quiet=True) as report:
        report.finished(cells[0], {})
    assert capsys.readouterr().out == ""


def test_schema_covers_every_field_of_a_record():
    names = {field.name for field in dataclasses.fields(mixed_fleet().records[0])}
    assert names - {"terms"} <= set(results.with_extra(results.TASK_SCHEMA))
    assert set(results.TASK_SCHEMA) & set(results.EXTRA_SCHEMA) == set()
    kinds = {"iteration", "retreat", "input", "check", "reach"}
    assert {kind.value for kind in WorkKind} == kinds


# -- checks and attempts -----------------------------------------------------------------------

COUNTS = ["checks", "check_misses", "attempts"]


def unsure(
    seed: int,
    check_miss: float | None = 0.4,
    grasp_miss: float | None = 0.3,
) -> Fleet:
    """A fleet whose checks and grasps miss at random; None: they cannot."""
    iterate = solved_after([1, 2, 3])
    stub = StubRobots(
        iterate,
        check=None if check_miss is None else missed_checks(iterate, check_miss, seed=seed),
        reach=None if grasp_miss is None else missed_grasps(grasp_miss, seed=seed),
    )
    config = FleetConfig(robots=3, tasks=3, policy="or-hitl", seed=seed)
    fleet = Fleet(config, stub)
    drive([(fleet, stub)])
    return fleet


def tasks_of(fleet):
    return results.tasks_frame(fleet.records, lambda robot, task: "x")


def about(fleet):
    """Where a cell comes from, as far as the merged tables need it."""
    fleet_config = dataclasses.asdict(fleet.config)
    return {"identity": {"fleet": fleet_config}, "config": {"seed": fleet.config.seed}}


@pytest.mark.parametrize(("check_miss", "grasp_miss"), [(0.4, None), (None, 0.3), (0.4, 0.3)])
def test_tables_of_fleets_with_checks_or_misses(tmp_path, check_miss, grasp_miss):
    fleet = unsure(1, check_miss, grasp_miss)
    tasks = tasks_of(fleet)
    assert tasks.columns == [*results.TASK_SCHEMA, *COUNTS]
    assert dict(tasks.schema) == results.with_extra(results.TASK_SCHEMA, COUNTS)
    assert tasks["attempts"].null_count() == 0
    assert tasks["checks"].null_count() == (len(tasks) if check_miss is None else 0)
    records = sorted(fleet.records, key=lambda r: (r.robot, r.task))
    assert repr(results.task_records(tasks)) == repr(records)
    path = tmp_path / "tasks.parquet"
    path.write_bytes(encode_table(tasks))
    assert results.read_results(path, results.TASK_SCHEMA).equals(tasks)
    content = Content(tasks, frame_of(fleet), about(fleet))
    again = decode(content.data(), path)
    assert again.tasks.equals(tasks) and repr(again.records) == repr(records)
    assert again.data() == content.data()
    merged = columns.merged([again], "tasks")
    assert merged.columns[-len(columns.SETTING_SCHEMA) - 1 :][0] == "task_time_s"
    assert list(merged.columns) == list(results.with_extra(columns.TASK_SCHEMA, COUNTS))
    path.write_bytes(encode_table(merged))
    assert results.read_results(path, columns.TASK_SCHEMA).equals(merged)
    with pytest.raises(BadInput, match="column check_misses must be Int64, got nothing"):
        results.conform(tasks.drop("check_misses"), path, results.TASK_SCHEMA)


def test_tables_of_other_fleets_have_no_such_columns(tmp_path):
    fleet = unsure(1, None, None)
    tasks = tasks_of(fleet)
    assert dict(tasks.schema) == results.TASK_SCHEMA
    # The same bytes as of a table that was made with these columns alone.
    plain = pl.DataFrame(tasks.rows(), schema=results.TASK_SCHEMA, orient="row")
    assert encode_table(tasks) == encode_table(plain)
    assert columns.merged([Content(tasks, frame_of(fleet), about(fleet))], "tasks").columns == (
        list(columns.TASK_SCHEMA)
    )
    summary = summarise(fleet.config, fleet.records, fleet.events)
    assert not {"checks", "check_misses", "first_attempt", "grasp_misses"} & set(summary.row())
    assert "first_attempt" not in fleets_frame(over_fleets([summary])).columns
    assert results.task_records(tasks)[0].attempts is None


def test_where_only_some_cells_have_them_the_others_are_null():
    fleets = [unsure(2, None, None), unsure(3), unsure(4, None, 0.3)]
    contents = [Content(tasks_of(f), frame_of(f), about(f)) for f in fleets]
    merged = columns.merged(contents, "tasks")
    assert merged.columns == list(results.with_extra(columns.TASK_SCHEMA, COUNTS))
    nulls = merged.group_by("seed", maintain_order=True).agg(pl.col(COUNTS).null_count())
    assert nulls.rows() == [(2, 9, 9, 9), (3, 0, 0, 0), (4, 9, 9, 0)]
    backwards = columns.merged(contents[::-1], "tasks")
    assert backwards.columns == merged.columns
    frame = summary_frame([summarise(f.config, f.records, f.events) for f in fleets])
    assert frame["first_attempt"].null_count() == 1 and frame["checks"].null_count() == 2
    assert csv(frame).decode().splitlines()[1].endswith("," * 16)  # four intervals


def test_metrics_of_checks_by_hand():
    """One robot, two tasks, every iteration feasible.

    Task 0: its first check misses and its second passes, and the reach grasps. Task 1: the check
    passes, the reach misses; then again, and it grasps.
    """
    iterate = lambda work: outcome(feasible=True)  # noqa: E731

    def check(work):
        passed = not (work.task == 0 and work.check == 0)
        return CheckResult(passed, not passed, outcome(feasible=passed))

    stub = StubRobots(
        iterate,
        check=check,
        reach=lambda work: ReachResult(not (work.task == 1 and work.iteration == 1), 0.0),
    )
    fleet = Fleet(FleetConfig(tasks=2, policy="autonomous"), stub)
    drive([(fleet, stub)])
    summary = summarise(fleet.config, fleet.records, fleet.events)
    row = summary.row()
    assert (row["first_attempt"], row["first_attempt_n"]) == (0.5, 2)
    assert (row["grasp_misses"], row["checks"], row["check_misses"]) == (0.5, 2.0, 0.5)
    # 1.5 + 2 * 1.5 + 3 s; then 3 + 3 + 1 s and 3 + 3 s.
    assert row["tasks_per_hour"] == pytest.approx(2 * 3600 / (7.5 + 13.0))
    assert list(row)[-16:] == [
        f"{name}{end}"
        for name in ("first_attempt", "grasp_misses", "checks", "check_misses")
        for end in ("", "_low", "_high", "_n")
    ]
    (over,) = over_fleets([summary])
    assert over.first_attempt is not None and over.first_attempt.mean == 0.5
    file = io.StringIO()
    Console(width=80, file=file).print(summary_tables([summary]))
    assert "1st attempt" in file.getvalue() and "…" not in file.getvalue()
    file = io.StringIO()
    Console(width=80, file=file).print(summary_tables(summaries()))
    assert "1st attempt" not in file.getvalue()


def test_a_setting_that_is_too_large_for_its_column_is_a_wrong_type():
    """Whoever reads a forged cell takes it as one that is not as written."""
    with pytest.raises(TypeError, match="lanes: too large for Int64"):
        columns._constant(10**200, pl.Int64(), "lanes")
    assert pl.select(columns._constant(3, pl.Int64(), "lanes")).item() == 3
