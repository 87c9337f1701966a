"""Rows of hazards, and what networks trained on them predict."""

from typing import Any

import numpy as np
import polars as pl
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.checkpoint import load_network
from pgf_jax.guidance.predictors.features import AHEAD, STATE
from pgf_jax.guidance.predictors.registry import PredictorSpec
from pgf_jax.guidance.predictors.survival import HORIZON, survival
from pgf_jax.tables.forks import FUTURE_SCHEMA, check_futures, read_futures, write_futures
from pgf_jax.tables.runs import Mode, runs_path
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.rows import hazard_rows, stands_for
from pgf_jax.training.train import RECIPES, fit_network, report_of, save


def future(number, alone, helped, *, scene: Any = "tight_1", **changes: Any):
    """A state with one future; `alone` and `helped` are (seconds, solved)."""
    row = {
        "scene": scene,
        "seed": 1,
        "class": "tight",
        "iteration": number,
        "input": "push",
        "key": 0,
        "alone": 1.0,
        "helped": 1.0,
        "alone_solved": alone[1],
        "helped_solved": helped[1],
        "alone_iterations": 1,
        "helped_iterations": 1,
        "pushed": True,
        "alone_s": alone[0],
        "helped_s": helped[0],
        **{f"state:{name}": float(number) for name in STATE},
        **changes,
    }
    return pl.DataFrame([row], schema=FUTURE_SCHEMA)


def test_a_row_for_each_iteration_until_it_was_solved_or_cut_off():
    """7.5 s: solved in the third iteration. 7.5 s cut off: two whole ones, in neither solved."""
    frame = pl.concat(
        [
            future(4, alone=(7.5, True), helped=(3.0, True)),
            future(6, alone=(7.5, False), helped=(0.0, False)),
        ]
    )
    rows = hazard_rows(frame, "alone", drawn_to=4)
    assert rows.target.tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]
    assert rows.names == (*STATE, AHEAD)
    assert rows.features[:, -1].tolist() == [0.0, 1.0, np.log2(3), 0.0, 1.0]
    assert rows.features[:, 0].tolist() == rows.iteration.tolist() == [4, 4, 4, 6, 6]
    assert rows.unsolved.tolist() == [True, True, False, True, True]
    rows = hazard_rows(frame, "helped")
    assert (rows.target.tolist(), rows.iteration.tolist()) == ([1.0], [4])
    broken = future(4, alone=(7.5, True), helped=(3.0, True), **{"state:range": float("nan")})
    second = broken.with_columns(seed=pl.lit(2, pl.Int64()))
    rows = hazard_rows(pl.concat([frame, second]), "alone", drawn_to=3)
    assert (len(rows.target), rows.non_finite) == (5, 1)


def test_a_state_counts_as_often_as_its_run_had_others():
    """Solved in iteration 13: ten states (3..12), of which two are drawn. Solved in 4: one."""
    long = [future(n, alone=(3.0 * (13 - n), True), helped=(3.0, True), alone_iterations=13 - n)
            for n in (5, 11)]  # fmt: skip
    short = future(3, alone=(3.0, True), helped=(3.0, True), scene="tight_2")
    cut_off = future(9, alone=(90.0, False), helped=(3.0, True), alone_iterations=30,
                     scene="tight_3")  # fmt: skip
    frame = pl.concat([*long, short, cut_off])
    assert stands_for(frame).tolist() == [5, 5, 1, 37]
    assert stands_for(frame, 20).tolist() == [5, 5, 1, 18]
    rows = hazard_rows(frame, "alone")
    count = {name: int((rows.scene == name).sum()) for name in ("tight_1", "tight_2", "tight_3")}
    assert count == {"tight_1": 5 * 8 + 5 * 2, "tight_2": 1, "tight_3": 37 * 30}
    assert len(hazard_rows(frame, "helped").target) == 4  # their futures are nobody's own
    others = frame.with_columns(key=pl.lit(1, pl.Int64()), alone_iterations=pl.lit(1, pl.Int64()))
    both = pl.concat([frame, others])
    assert stands_for(both).tolist() == [5, 5, 1, 37] * 2


def test_a_file_of_futures_is_checked(tmp_path):
    path = runs_path(tmp_path, Mode.FUTURES)
    assert path == tmp_path / "futures" / "futures.parquet"
    parts = [future(n, alone=(3.0, True), helped=(3.0, True)) for n in (9, 4)]
    write_futures(path, parts, {"settings": {}})
    assert read_futures(path)["iteration"].to_list() == [4, 9]  # two states of one scene
    with pytest.raises(BadInput, match="times must not be negative"):
        check_futures(future(4, alone=(-1.0, True), helped=(3.0, True)), "futures")
    with pytest.raises(BadInput, match="the keys of a state must be 0, 1, 2"):
        check_futures(pl.concat([parts[0], parts[0]]), "futures")
    with pytest.raises(BadInput, match="alone_s"):
        check_futures(parts[0].drop("alone_s"), "futures")


def geometric_futures(scenes=400):
    """Solved with a chance of 0.1 an iteration where `range` is 0, of 0.4 where it is 1."""
    rng = np.random.default_rng(0)
    frames = []
    for i in range(scenes):
        kind = i % 2
        steps = int(rng.geometric(0.4 if kind else 0.1))
        solved = steps <= 40
        alone = (3.0 * min(steps, 40), solved)
        state = {f"state:{name}": 0.0 for name in STATE} | {"state:range": float(kind)}
        frames.append(future(3, alone, (3.0, True), scene=f"tight_{i}", **state))
    return pl.concat(frames)


@pytest.fixture(scope="module")
def trained():
    rows = hazard_rows(geometric_futures(), "alone")
    return rows, fit_network("time_alone", rows, TrainConfig(max_epochs=40))


def test_the_hazards_of_geometric_times_are_found(trained):
    states = np.zeros((2, len(STATE)))
    states[1, STATE.index("range")] = 1.0
    predicted = survival(trained[1].predictor, states)
    assert predicted.shape == (2, HORIZON)
    assert (np.diff(predicted, axis=1) <= 0).all()
    assert predicted[0, [0, 4, 9]] == pytest.approx([0.9, 0.9**5, 0.9**10], abs=0.07)
    assert predicted[1, [0, 4]] == pytest.approx([0.6, 0.6**5], abs=0.07)
    # A row does not depend on the others; a state without a feature gives nothing.
    states = np.vstack([states, np.full((1, len(STATE)), np.nan)])
    again = survival(trained[1].predictor, states)
    assert np.array_equal(again[:2], predicted) and np.isnan(again[2]).all()


def test_the_networks_of_a_folder_predict_both_times(trained, tmp_path):
    rows, done = trained
    about = {**report_of(done, rows), "data_sha256": "0" * 64}
    for network in ("time_alone", "time_helped"):
        save(tmp_path, network, done, about, TrainConfig())
        kept = load_network(tmp_path, network)
        assert kept.predictor.features == (*STATE, AHEAD)
        assert kept.config["loss"] == RECIPES[network].settings["loss"] == "logistic"
    predictor, checkpoints = PredictorSpec("time", tmp_path).load()
    assert [c.network for c in checkpoints] == ["time_alone", "time_helped"]
    both = predictor.survival(np.zeros((3, len(STATE))))
    assert both.shape == (3, 2, HORIZON) and np.array_equal(both[:, 0], both[:, 1])
