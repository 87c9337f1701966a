"""What the study computes and says, from rows made up by hand; the study itself is not run here."""

import itertools
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import polars as pl
import pytest
import study
import study_claims
import study_figures
import study_numbers
import study_report
import study_served
import study_tables
import study_times
from study_points import EACH, NAMED, POINTS, Point, scenes_of

from pgf_jax.errors import BadInput

STORED = Path(__file__).parents[2] / "experiments" / "results"
Fleet = tuple[str, int, str]  # policy, robots, setting


def frame(times: Mapping[Fleet, Sequence[float]], success: float = 0.5) -> pl.DataFrame:
    """Rows of fleets on `packed`, whose mean times in the task are given by seed."""
    return pl.DataFrame(
        [
            {
                "set": "packed",
                "setting": setting,
                "robots": robots,
                "policy": policy,
                "seed": seed,
                "task_time_s": seconds,
                "planning_time_s": seconds,
                "success": success,
                "utilisation": 0.5,
                "fairness_throughput": 0.9,
                "return_on_effort": 2.0,
                "fan_out": 3.0,
                "solved": 5 * robots,
                "robot_hours": 5 * robots * seconds / 3600,
                "hours": 1.0,
                "operators": 1,
                "grants": 10,
            }
            for (policy, robots, setting), per_seed in times.items()
            for seed, seconds in enumerate(per_seed)
        ]
    )


# -- what is computed ----------------------------------------------------------------------------


def keys(points) -> list[study.Key]:
    return [
        key
        for point in points
        for name, seed in itertools.product(point.sets, point.seeds)
        for key in study.Fleets(name, seed, point).named()
    ]


def test_no_two_fleets_have_one_name():
    """But where they are the same fleet."""
    of: dict[study.Key, set] = {}
    for point in POINTS:
        for key in keys([point]):
            of.setdefault(key, set()).add((point.tasks, *sorted(map(str, point.changes.items()))))
    assert all(len(fleets) == 1 for fleets in of.values())


def test_settings_are_of_sweeps():
    """And each has a folder of its own; those of `difficulty` take minutes to draw."""
    config, points = study.Config(), [p for p in POINTS if p.part != "difficulty"]
    for point in points:
        for name in point.sets:
            run = study.run_of(study.Fleets(name, point.seeds[0], point), config)
            assert {cell.robots for cell in run.config.cells()} == set(point.robots)
            assert {cell.policy for cell in run.config.cells()} == set(point.policies)
    fleets = list(itertools.chain(*study.batches(points, config, set())))
    assert len({study.run_of(one, config).config.out for one in fleets}) == len(fleets)


def test_scenes_of_a_number_of_objects():
    scenes = scenes_of("28 objects")["scenes"]
    assert len(scenes) == 100 and {len(scene.objects) for scene in scenes} == {28}
    assert scenes_of("packed") == {"scene_class": "packed"}


def test_what_has_no_row_is_computed_once_and_together():
    points = [
        Point("a", "", ("packed", "all"), ("pgf", "or-hitl"), (1, 2), range(2)),
        Point("b", "", ("packed",), ("pgf",), (2, 3), range(1)),
        Point("b", "two", ("packed",), ("pgf",), (2,), range(1), changes={"operators": 2}),
    ]
    there = {("packed", "", 2, "pgf", 0), ("all", "", 1, "pgf", 1), ("all", "", 1, "or-hitl", 1)}
    found = study.batches(points, study.Config(), set(there))
    named = [[key for one in batch for key in one.named()] for batch in found]
    assert sorted(itertools.chain(*named)) == sorted(set(keys(points)) - there)
    assert [{(name, seed) for name, *_, seed in batch} for batch in named] == [
        {("packed", 0)}, {("all", 0)}, {("packed", 1)}, {("all", 1)}
    ]  # fmt: skip
    some = study.batches(points, study.Config(sets=("all",), seeds=(0,)), set())
    assert [{(one.name, one.seed) for one in batch} for batch in some] == [{("all", 0)}]
    some = study.batches(points, study.Config(policies=("or-hitl",)), set())
    assert {key[3] for batch in some for one in batch for key in one.named()} == {"or-hitl"}


def test_a_named_difference_gets_seeds_until_it_is_decided(tmp_path, monkeypatch):
    one = NAMED[0]
    fleets = {(one.ours, one.robots, ""): [40.0, 41.0], (one.theirs, one.robots, ""): [60.0, 75.0]}
    rows = study.Rows(tmp_path / "none.csv")
    rows.rows = frame(fleets).to_dicts()
    assert study.undecided(pl.DataFrame(rows.rows), one)
    (more,) = study.more_seeds(rows)
    assert (more.name, more.seed, more.point.robots) == (one.set, 2, (one.robots,))
    assert set(more.point.policies) == {one.ours, one.theirs}
    monkeypatch.setattr(study, "NAMED", (one,))
    fleets[one.theirs, one.robots, ""] = [60.0, 60.9]
    rows.rows = frame(fleets).to_dicts()
    assert study.more_seeds(rows) == []


def test_rows_are_kept_and_not_computed_again(tmp_path, monkeypatch, capsys):
    """A fleet of robots that nobody helps, which is quickly computed."""
    point = Point("a", "", ("tight",), ("autonomous",), (1, 2), range(1), 1,
                  {"horizon": 8.0, "world": "none", "operator": "none"})  # fmt: skip
    monkeypatch.setattr(study, "POINTS", (point,))
    config = study.Config(parts=("a",), raw=tmp_path / "raw")
    study.compute(config, tmp_path)
    stored = (tmp_path / "study.csv").read_bytes()
    rows = study.Rows(tmp_path / "study.csv")
    assert rows.keys == set(keys([point])) and rows.rows[0]["robot_hours"] == 8 / 3600
    assert "left: 1 batches, 3 tasks" in capsys.readouterr().err
    (times,) = pl.read_csv(tmp_path / "study_times.csv").to_dicts()
    assert times.pop("core_s") > 0
    assert times == {"part": "a", "set": "tight", "seed": 0, "tasks": 3}
    study.compute(config, tmp_path)
    assert (tmp_path / "study.csv").read_bytes() == stored and capsys.readouterr().err == ""


# -- what is said --------------------------------------------------------------------------------


def test_the_way_to_the_oracle():
    rows = frame(
        {
            ("or-hitl", 10, ""): [50, 60, 90],  # one seed more than the oracle
            ("gain-rate", 10, ""): [40, 52, 30],
            ("oracle-time", 10, ""): [38, 48],
        }
    )
    line = study_tables.way_to_oracle(rows, "packed")
    # 9 s of 12.
    assert line.startswith("With 10 robots `oracle-time` saves 12.0 (12.0..12.0) s")
    assert line.endswith("75 % of it (seeds: 2).")
    assert study_tables.way_to_oracle(rows.filter(policy="gain-rate"), "packed") == ""


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([30, 40, 60], "serves 15 robots at the 50.0 s"),
        ([30, 40, 50], "serves 20 robots or more at"),
        ([30, 55, 90], "serves 8 robots at"),
        ([51, 55, 90], ""),
    ],
)
def test_the_fleet_that_is_served_like_the_base(times, says):
    sizes = {("gain-rate", robots, ""): [s] for robots, s in zip((1, 10, 20), times, strict=True)}
    found = study_tables.served_like_base(frame({("or-hitl", 10, ""): [50], **sizes}), "packed")
    assert says in found and bool(says) == bool(found)


def test_the_tables_pair_fleets_by_seed():
    rows = frame({("or-hitl", 10, ""): [50, 60], ("gain-rate", 10, ""): [40, 52]})
    text = study_tables.ranking(rows)
    assert "| 10 | `or-hitl` | 2 |" in text
    assert "| -9.0 (-21.7..3.7) | 0.0 (0.0..0.0) |" in text
    assert "| packed | 10 | `gain-rate` less `or-hitl` | 2 | -9.0 (-21.7..3.7) | undecided |" in (
        study_tables.decided(rows)
    )
    # Seeds by which options are chosen judge nothing.
    more = pl.concat([rows, rows.with_columns(seed=pl.col("seed") + 100)])
    assert study_tables.ranking(more) == text


def test_a_fleet_is_served_where_it_is_as_good_as_one_with_an_operator_each():
    one = {5: [41, 41.5, 42], 10: [41, 42, 42.5], 20: [55, 56, 70], 30: [40, 41, 42]}
    full = {robots: [40, 41, 42] for robots in one}
    rows = study_served.with_rate(
        frame(
            {("gain-rate", r, ""): times for r, times in one.items()}
            | {("gain-rate", r, EACH): times for r, times in full.items()}
        )
    )

    def largest(of: pl.DataFrame, measure: str = "time in the task") -> str:
        return study_served.largest(of, "packed", "gain-rate", ("", EACH), measure)

    # With 10 the mean is 2 % longer, and its interval ends 4 % longer; 30 are better than 20.
    assert largest(rows) == "10" and largest(rows, "success") == "30+"
    assert largest(rows.filter(pl.col("robots") > 10)) == "under 20"
    assert largest(rows.filter(pl.col("robots") < 20)) == "10+"
    assert largest(rows.filter(policy="pgf")) == ""
    # Beside it, how busy the operator is there, and how fair to the robots.
    assert "| 10 | 10 | 10 | 30+ | 0.50 (0.50..0.50) | 0.90 (0.90..0.90) |" in (
        study_served.served(rows)
    )


@pytest.mark.parametrize(
    ("claim", "or_hitl", "pgf", "holds"),
    [
        ("planning time, 10 robots", {10: [50, 60]}, {10: [40, 51]}, "yes"),
        ("planning time, 10 robots", {10: [50, 60]}, {10: [40, 60]}, "not decided"),
        ("planning time, 10 robots", {10: [40, 51]}, {10: [50, 60]}, "no"),
        ("planning time, 30 robots", {30: [50, 60]}, {30: [51, 61]}, "yes"),
        ("planning time, 30 robots", {30: [50, 60]}, {30: [53, 63]}, "no"),
        ("PGF's planning time, 30 robots less 1", {1: [50, 60]},
         {1: [40, 50], 30: [41, 51.01]}, "yes"),
        ("PGF's lead, 30 robots less 1", {1: [50, 60], 30: [50, 60]},
         {1: [40, 50], 30: [45, 55.01]}, "yes"),
        ("PGF's lead, 30 robots less 1", {1: [50, 60], 30: [50, 60]},
         {1: [40, 50], 30: [35, 45.01]}, "no"),
    ],
)  # fmt: skip
def test_what_became_of_a_claim(claim, or_hitl, pgf, holds):
    fleets = {("or-hitl", robots, ""): times for robots, times in or_hitl.items()}
    rows = frame(fleets | {("pgf", robots, ""): times for robots, times in pgf.items()})
    measure = {one.words: one.measure for one in study_claims.claims()}[claim]
    assert measure(rows, "packed").holds == holds


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("time: packed, 10, or-hitl", "55.0 (-8.5..118.5)"),
        ("time: packed, 10, gain-rate less or-hitl", "-9.0 (-21.7..3.7)"),
        ("success: packed, 10, or-hitl", "50.0 (50.0..50.0)"),
        ("time: packed (2 operators), 10, or-hitl", "20.0"),
        ("grasps: packed (2 operators), 10, or-hitl", "180.0"),  # 5 tasks in 5 times 20 s
        ("seeds: packed, 10, gain-rate", "2"),
        ("served: packed, or-hitl, time in the task", "10+"),
        ("served: packed (operator noisy), or-hitl, success", "under 10"),
    ],
)
def test_numbers_in_the_text_are_looked_up(key, says, tmp_path):
    rows = frame(
        {
            ("or-hitl", 10, ""): [50, 60],
            ("or-hitl", 10, EACH): [50, 60],
            ("or-hitl", 10, "operator noisy"): [50, 60],
            ("gain-rate", 10, ""): [40, 52],
            ("or-hitl", 10, "2 operators"): [20],
        }
    )
    better = frame({("or-hitl", 10, f"operator noisy, {EACH}"): [50, 60]}, success=0.9)
    rows = pl.concat([rows, better])
    words = study_numbers.fill(rows, f"It takes {{{key}}} s.", tmp_path)
    assert words == f"It takes {says} s."


@pytest.mark.parametrize(
    "key",
    ["time: packed, 20, pgf", "time: packed", "tiem: packed, 10, pgf", "time: packed, 10, pgf (x)",
     "served: packed, pgf, success", "seeds: all, 10, pgf", "10"],
)  # fmt: skip
def test_a_number_that_is_not_there_is_a_fault(key, tmp_path):
    with pytest.raises(BadInput, match="which the rows do not have"):
        study_numbers.fill(frame({("pgf", 10, ""): [50]}), f"{{{key}}}", tmp_path)


def test_numbers_of_figures_are_looked_up(tmp_path):
    (tmp_path / "figure9.json").write_text('{"a": [{"cost": 7.125}, {"n": 4, "solved": true}]}')
    rows = frame({("pgf", 10, ""): [50]})
    words = study_numbers.fill(rows, "{figure9: a.0.cost} and {figure9: a.1.n}", tmp_path)
    assert words == "7.12 and 4"
    with pytest.raises(BadInput, match=r"figure8\.json: no such file"):
        study_numbers.fill(rows, "{figure8: a}", tmp_path)
    for key in ("figure9: b", "figure9: a.2.n", "figure9: a.1", "figure9: a.1.solved",
                "figure9: a.x", "figure9: a.1.n.more"):  # fmt: skip
        with pytest.raises(BadInput, match="no number there"):
            study_numbers.fill(rows, f"{{{key}}}", tmp_path)


def test_figures_are_drawn_of_what_there_is():
    fleets = {("or-hitl", 10, ""): [50, 60], ("gain-rate", 10, ""): [40], ("pgf", 5, EACH): [9, 8]}
    for name, draw in study_figures.FIGURES.items():
        figure = draw(frame(fleets))
        drawn = any(axes.has_data() for axes in figure.axes)
        assert drawn == (name != "difficulty"), name
        assert all("(s)" in y or "(%)" in y for ax in figure.axes if (y := ax.get_ylabel()))


def test_the_machine_repair_model():
    # One robot never waits; of two the second does while the first is served: by hand.
    assert study_served.waiting_s(1, 1, 30.0, 10.0) == 0
    x = 10 / 30
    weights = [1, 2 * x, 2 * x * x]
    wait = weights[2] / (2 * weights[0] + weights[1]) * 30
    assert study_served.waiting_s(2, 1, 30.0, 10.0) == pytest.approx(wait)
    assert study_served.waiting_s(4, 4, 30.0, 10.0) == 0
    # Far beyond saturation a round takes R services: waiting is R S - Z - S.
    assert study_served.waiting_s(60, 1, 30.0, 10.0) == pytest.approx(600 - 40)
    assert study_served.repairable(1, 30.0, 10.0) == 1
    few, many = (study_served.repairable(count, 300.0, 10.0) for count in (1, 4))
    assert few < 300 / 10 + 1 and many > 4 * few


def test_how_long_the_study_took(tmp_path):
    """Fleets that were computed together share their time by tasks; the others are estimated."""
    path = tmp_path / study_times.NAME
    rows = pl.DataFrame({"set": ["tight", "packed"], "tasks": [60, 60]})
    assert study_times.times(rows, path) == ""
    study_times.note(path, [("a", "tight", 0, 10), ("b", "tight", 0, 20)], 5400.0)
    study_times.note(path, [("a", "tight", 1, 10), ("a", "tight", 1, 20)], 5400.0)
    says = study_times.times(rows, path)
    assert "| a | 40 | 2.00 |" in says and "| b | 20 | 1.00 |" in says
    assert "| without a time | 60 | about 3.00 |" in says and "About 3.0 hours of 2 cores" in says
    assert "In all 1.5 hours of 2 cores" in study_times.times(rows[:1], path)
    study_times.note(path, [("a", "packed", 0, 30)], 3 * 5400.0)  # thrice as slow: its others too
    assert "| without a time | 30 | about 4.50 |" in study_times.times(rows, path)


def test_the_report_comes_from_the_stored_rows(tmp_path):
    """Its tables, its figures, and the numbers in the text of the README."""
    names = ("README.md", "study_text.md", "results/study.csv", "results/study_times.csv")
    for name in (*names, *(f"results/figure{n}.json" for n in (2, 4, 5))):
        shutil.copy(STORED.parent / name, tmp_path)
    study_report.write(tmp_path)
    study_report.write_text(tmp_path, tmp_path / "README.md")
    for name in ("results/study.md", "README.md"):
        assert (tmp_path / Path(name).name).read_text() == (STORED.parent / name).read_text()
    drawn = {path.name for path in tmp_path.glob("*.png")}
    assert drawn == {path.name for path in STORED.glob("study_*.png")} and drawn
