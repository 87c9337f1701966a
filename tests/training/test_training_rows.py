"""Training rows of runs: worked by hand, and against a plain oracle."""

import subprocess
import sys

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from run_logs import helped_run, log, push, reach

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.features import FEATURES
from pgf_jax.tables.runs import RUN_SCHEMA
from pgf_jax.training.rows import (
    PUBLISHED,
    Rule,
    autonomous_rows,
    failure_rows,
    human_rows,
    split_by_scene,
)


def features_of_costs(*costs):
    return [20.0, *(x for cost in costs for x in (cost, 0.0, 0.0))]


def test_autonomous_rows_of_a_run_that_times_out():
    run = log()
    run.begin_segment("reach")
    for t in range(15):  # cost 1450 - 9 t
        run.add((1000.0 - 10 * t, float(t), 450.0), feasible=False)
    rows = autonomous_rows(run.frame())
    assert rows.iteration.tolist() == list(range(3, 15))
    assert rows.features[0].tolist() == [20, 990, 1, 450, 980, 2, 450, 970, 3, 450]
    assert rows.features[-1].tolist() == [20, 880, 12, 450, 870, 13, 450, 860, 14, 450]
    # Iterations 13 and 14 are ten on from 3 and 4; then the last cost is carried forward.
    assert rows.target.tolist() == [1450 - 9 * 13] + [1450 - 9 * 14] * 11
    assert rows.scene.tolist() == ["a"] * 12


def test_no_row_at_or_after_solving():
    run = log()
    run.begin_segment("reach")
    reach(run, [900, 800, 700, 600, 500, 10], solved_last=True)
    reach(run, [9, 8, 7])  # a collector that did not stop
    rows = autonomous_rows(run.frame())
    assert rows.iteration.tolist() == [3, 4]
    assert rows.target.tolist() == [10, 10]
    assert rows.features.tolist() == [
        features_of_costs(800, 700, 600),
        features_of_costs(700, 600, 500),
    ]


@pytest.mark.parametrize("costs", [[10], [900, 10], [900, 800, 700, 10]])
def test_runs_solved_within_three_iterations_have_no_rows(costs):
    run = log()
    run.begin_segment("reach")
    reach(run, costs, solved_last=True)
    rows = autonomous_rows(run.frame())
    assert rows.features.shape == (0, 10)
    assert len(rows.target) == len(rows.scene) == 0


def test_history_restarts_with_each_segment():
    run = log()
    run.begin_segment("reach")
    reach(run, [900, 890, 880, 870])
    run.begin_segment("reach")
    reach(run, [800, 790, 780, 770, 760])
    rows = autonomous_rows(run.frame())
    assert rows.iteration.tolist() == [3, 7, 8]
    assert rows.features.tolist() == [
        features_of_costs(890, 880, 870),
        features_of_costs(790, 780, 770),
        features_of_costs(780, 770, 760),
    ]
    assert rows.target.tolist() == [760, 760, 760]


def test_human_rows_by_hand():
    rows = human_rows(helped_run().frame())
    assert rows.iteration.tolist() == [4, 11, 14]
    assert rows.features.tolist() == [
        features_of_costs(880, 870, 860),
        features_of_costs(780, 770, 760),
        features_of_costs(750, 740, 730),
    ]
    # From the 4th counted iteration to the 14th; from the 8th and the 11th past the end.
    assert rows.target.tolist() == [680, 15, 15]
    assert (rows.short, rows.non_finite) == (0, 0)


def test_go_on_continues_in_the_same_segment():
    run = log()
    run.begin_segment("reach")
    reach(run, [900, 890, 880, 870])
    run.input_given()
    reach(run, [860 - 10 * i for i in range(12)])
    rows = human_rows(run.frame())
    assert rows.target.tolist() == [860 - 10 * 9]


@pytest.mark.parametrize(
    ("after", "target"),
    [
        ([], 870),  # out of time while pushing: the last reach cost there is
        ([300], 300),  # only the new segment's iteration 0
        ([300, *range(290, 180, -10)], 200),  # ten on; its iteration 0 does not count
    ],
)
def test_target_after_a_push(after, target):
    run = log()
    run.begin_segment("reach")
    reach(run, [900, 890, 880, 870])
    push(run, 5, feasible=True)
    run.begin_segment("reach")
    reach(run, after)
    assert human_rows(run.frame()).target.tolist() == [target]


def test_input_without_history_is_counted_but_has_no_row():
    run = log()
    push(run, 1, feasible=True)  # before any iteration
    run.begin_segment("reach")
    reach(run, [900, 890, 880])
    run.input_given()  # after two
    reach(run, [870])
    run.input_given()  # after three
    reach(run, [860])
    rows = human_rows(run.frame())
    assert rows.iteration.tolist() == [4]
    assert rows.features.tolist() == [features_of_costs(890, 880, 870)]
    assert rows.short == 2


def test_rows_that_need_a_non_finite_cost_are_left_out_and_counted():
    run = log()
    run.begin_segment("reach")
    run.add((np.nan, np.inf, 0.0), feasible=False)  # iteration 0 is in no feature
    run.add((np.inf, 0.0, 0.0), feasible=False)
    reach(run, [800, 700, 600])
    rows = autonomous_rows(run.frame())
    assert rows.iteration.tolist() == [4]
    assert rows.non_finite == 1


def test_autonomous_rows_refuse_help():
    with pytest.raises(BadInput, match="scene a has human input at iteration 5"):
        autonomous_rows(helped_run().frame())


# Random runs: segments of (kind, iterations, go-on inputs at these local iterations).
segments = st.lists(
    st.tuples(st.booleans(), st.integers(1, 14), st.sets(st.integers(1, 13), max_size=3)),
    min_size=1,
    max_size=5,
)


def random_run(scene, plan, solved):
    run, cost, pushing = log(scene), 5000.0, False
    for wants_push, length, asks in plan:
        pushing = wants_push and not pushing
        if pushing:
            push(run, length, feasible=False)
            continue
        run.begin_segment("reach")
        for i in range(length):
            if i in asks:
                run.input_given()
            cost -= 7
            run.add((cost, 1.0, 2.0), feasible=False)
    if solved and not pushing:
        run.add((0.05, 0.0, 0.0), feasible=True)
    return run.frame()


def oracle(frame):
    """Human rows by walking forward from each input, one iteration at a time."""
    rows = frame.to_dicts()
    found = []
    for q, row in enumerate(rows):
        if not row["asked_before"] or q == 0:
            continue
        segment = [r for r in rows[:q] if r["segment"] == rows[q - 1]["segment"]]
        if len(segment) < 4 or rows[q - 1]["kind"] == "push":
            continue
        features = [20.0]
        for r in segment[-3:]:
            features += [r["c_d"], r["c_f"], r["c_b"]]
        left, target, last_segment = 10, sum(features[-3:]), rows[q - 1]["segment"]
        for r in rows[q:]:
            if r["kind"] == "reach" and left:
                target = r["c_d"] + r["c_f"] + r["c_b"]
                left -= r["segment"] == last_segment  # not a segment's first
            last_segment = r["segment"]
        found.append((features, target))
    return found


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(segments, st.booleans()), min_size=1, max_size=3), st.randoms())
def test_human_rows_match_the_oracle_in_any_order_of_the_file(plans, random):
    frames = [random_run(f"s{i}", *plan) for i, plan in enumerate(plans)]
    expected = [row for frame in frames for row in oracle(frame)]
    lines = [line for frame in frames for line in frame.rows()]
    random.shuffle(lines)
    rows = human_rows(pl.DataFrame(lines, schema=RUN_SCHEMA, orient="row"))
    assert rows.features.tolist() == [features for features, _ in expected]
    assert rows.target.tolist() == [target for _, target in expected]


def test_split_is_by_scene():
    scene = np.array([f"s{i % 23}" for i in range(200)])
    train, val = split_by_scene(scene, fraction=0.2, seed=0)
    assert sorted([*train, *val]) == list(range(200))
    assert set(scene[train]).isdisjoint(scene[val])
    assert len(set(scene[val])) == 5  # of 23
    again = split_by_scene(scene[::-1], fraction=0.2, seed=0)
    assert set(scene[::-1][again[1]]) == set(scene[val])
    assert set(scene[split_by_scene(scene, fraction=0.2, seed=1)[1]]) != set(scene[val])


def test_split_keeps_a_scene_on_both_sides_of_two_scenes_and_refuses_one():
    train, val = split_by_scene(np.array(["a", "b", "b"]), fraction=0.01, seed=0)
    assert len(train) and len(val)
    train, val = split_by_scene(np.array(["a", "b", "b"]), fraction=0.99, seed=0)
    assert len(train) and len(val)
    with pytest.raises(BadInput, match="at least 2 scenes, got 1"):
        split_by_scene(np.array(["a", "a"]), fraction=0.2, seed=0)


# -- other rules, and other targets --------------------------------------------------------------


def counting_run(iterations, *, solved=False, scene="a"):
    """Cost 1000 - t after iteration t; a solving iteration comes on top, at a cost of 3."""
    run = log(scene)
    run.begin_segment("reach")
    reach(run, [1000 - t for t in range(iterations + 1)])
    if solved:
        run.add((3.0, 0.0, 0.0), feasible=True)
    return run.frame()


def test_the_published_rule_by_hand():
    rows = autonomous_rows(counting_run(17), PUBLISHED)
    # 11 on from 3 is 14; from 6 it is the last one; from 7 the run is too short.
    assert rows.iteration.tolist() == [3, 4, 5, 6]
    assert rows.target.tolist() == [986, 985, 984, 983]
    # Places 0, 1, 2, 0, ...: iteration 1 lies at place 0, and 4 takes its place.
    assert rows.features.tolist() == [
        features_of_costs(999, 998, 997),
        features_of_costs(996, 998, 997),
        features_of_costs(996, 995, 997),
        features_of_costs(996, 995, 994),
    ]
    # What was solved sooner teaches nothing, however well it went.
    assert len(autonomous_rows(counting_run(10, solved=True), PUBLISHED).target) == 0
    solved = autonomous_rows(counting_run(13, solved=True), PUBLISHED)
    assert (solved.iteration.tolist(), solved.target.tolist()) == ([3], [3])


def test_each_part_of_the_published_rule_by_itself():
    frame = counting_run(15)
    paper = autonomous_rows(frame)
    ahead = autonomous_rows(frame, Rule(look_ahead=11))
    assert ahead.features.tolist() == paper.features.tolist()
    assert ahead.target.tolist() == [986, *[985] * 12] != paper.target.tolist()
    dropped = autonomous_rows(frame, Rule(carried=False))
    assert dropped.iteration.tolist() == [3, 4, 5]
    assert dropped.target.tolist() == paper.target[:3].tolist()
    ring = autonomous_rows(frame, Rule(ring=True))
    assert ring.target.tolist() == paper.target.tolist()
    same = (ring.features == paper.features).all(axis=1)
    assert same.tolist() == [t % 3 == 0 for t in range(3, 16)]


def test_the_published_rule_of_human_runs():
    """Iterations of pushes, and iteration 0s, are no more counted than by the paper's."""
    run = log()
    run.begin_segment("reach")
    reach(run, [900, 890, 880, 870, 860])  # 0..4; counted 1..4
    push(run, 2, feasible=True)  # 5, 6
    run.begin_segment("reach")
    reach(run, list(range(800, 800 - 12 * 10, -10)))  # 7..18; counted 5..15
    rows = human_rows(run.frame(), PUBLISHED)
    assert (rows.iteration.tolist(), rows.target.tolist()) == ([4], [690])
    assert rows.features.tolist() == [features_of_costs(860, 880, 870)]
    run.input_given()
    reach(run, [600])
    assert human_rows(run.frame(), PUBLISHED).iteration.tolist() == [4]
    assert human_rows(run.frame()).target.tolist() == [700, 600]


def test_failure_rows_by_hand():
    frames = [counting_run(13, solved=True), counting_run(12, scene="b")]
    rows = failure_rows(pl.concat(frames))
    # Solved by iteration 14: from 3, the tenth on is 13, and from 4 it is 14.
    assert rows.iteration.tolist() == [*range(3, 14), *range(3, 13)]
    assert rows.target.tolist() == [1] + [0] * 10 + [1] * 10
    assert rows.unsolved.tolist() == rows.target.astype(bool).tolist()
    paper = autonomous_rows(pl.concat(frames))
    assert rows.features.tolist() == paper.features.tolist()
    assert paper.unsolved.tolist() == rows.unsolved.tolist()
    with pytest.raises(BadInput, match="has human input"):
        failure_rows(helped_run().frame())


def test_rows_with_some_of_the_features():
    rows = autonomous_rows(counting_run(8))
    assert rows.names == FEATURES
    some = rows.only(("c_d[t-0]", "n_objects"))
    assert some.names == ("c_d[t-0]", "n_objects")
    assert some.features.tolist() == [[1000.0 - t, 20.0] for t in range(3, 9)]
    assert some.target is rows.target and some.only(some.names).names == some.names


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(1, 30), st.integers(0, 30))
def test_row_count_of_autonomous_runs(iterations, solved_at):
    run = log()
    run.begin_segment("reach")
    costs = [1000.0 - t for t in range(iterations + 1)]
    solved = solved_at <= iterations
    reach(run, costs[: solved_at + 1] if solved else costs, solved_last=solved)
    end = solved_at - 1 if solved else iterations
    assert len(autonomous_rows(run.frame()).target) == max(end - 2, 0)


def test_data_and_config_modules_do_not_import_jax():
    code = (
        "import sys, pgf_jax.training.config, pgf_jax.training.rows;sys.exit('jax' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
