"""Tables of runs: what is written, read back, and refused."""

import polars as pl
import pytest
from run_logs import helped_run, log, reach

from pgf_jax.errors import BadInput
from pgf_jax.tables.runs import RUN_SCHEMA, Mode, read_runs, runs_path, write_runs


def test_log_writes_every_column():
    run = log("s1", 3, 5)
    run.begin_segment("reach")
    run.add((1, 2, 3), feasible=False)
    run.input_given()
    run.add((1, 2, 0), feasible=False)
    run.input_given()
    run.begin_segment("push")
    run.add((9, 0, 0), feasible=True)
    run.begin_segment("reach")
    run.add((0.05, 0, 0), feasible=True)
    frame = run.frame()
    assert dict(frame.schema) == RUN_SCHEMA
    assert frame.rows() == [
        ("s1", 3, "tight", 5, 0, "reach", 0, 1.0, 2.0, 3.0, False, False),
        ("s1", 3, "tight", 5, 0, "reach", 1, 1.0, 2.0, 0.0, False, True),
        ("s1", 3, "tight", 5, 1, "push", 2, 9.0, 0.0, 0.0, True, True),
        ("s1", 3, "tight", 5, 2, "reach", 3, 0.05, 0.0, 0.0, True, False),
    ]


def test_log_refuses_nonsense():
    with pytest.raises(RuntimeError, match="begin_segment"):
        log().add((1, 2, 3), feasible=False)
    with pytest.raises(BadInput, match="reach or a push, got 'pull'"):
        log().begin_segment("pull")


def two_runs():
    second = log("a", seed=-1)
    second.begin_segment("reach")
    reach(second, [5, 4, 3, 2, 1])
    return [helped_run().frame(), second.frame()]


def test_file_round_trip_is_exact_and_ordered(tmp_path):
    path = runs_path(tmp_path, Mode.HUMAN)
    assert path == tmp_path / "human" / "runs.parquet"
    frames = two_runs()
    write_runs(path, frames)
    assert read_runs(path).equals(pl.concat(frames[::-1]))  # by scene, then seed
    extra = tmp_path / "extra.parquet"
    pl.concat(frames).with_columns(note=pl.lit("x")).write_parquet(extra)
    assert read_runs(extra).equals(read_runs(path))
    assert [p.name for p in path.parent.iterdir()] == ["runs.parquet"]


def test_autonomous_file_refuses_help(tmp_path):
    write_runs(tmp_path / "runs.parquet", two_runs())
    with pytest.raises(BadInput, match=r"runs\.parquet: scene a has human input at iteration 5"):
        read_runs(tmp_path / "runs.parquet", mode=Mode.AUTONOMOUS)


@pytest.mark.parametrize("column", list(RUN_SCHEMA))
def test_each_column_is_needed(tmp_path, column):
    path = tmp_path / "runs.parquet"
    frame = pl.concat(two_runs())
    frame.drop(column).write_parquet(path)
    with pytest.raises(BadInput, match=f"runs.parquet: column {column} is missing"):
        read_runs(path)
    frame.with_columns(pl.lit(b"?").alias(column)).write_parquet(path)
    with pytest.raises(BadInput, match=f"column {column} has type Binary, expected"):
        read_runs(path)
    hole = pl.when(pl.int_range(pl.len()) == 2).then(None).otherwise(pl.col(column))
    frame.with_columns(hole.alias(column)).write_parquet(path)
    with pytest.raises(BadInput, match=f"column {column} has 1 nulls"):
        read_runs(path)


@pytest.mark.parametrize(
    ("column", "row", "value", "message"),
    [
        ("kind", 1, "pull", "kind must be reach or push; broken by scene a, seed 0, iteration 1"),
        ("n_objects", 3, 19, "n_objects must be the same in all of a run"),
        ("n_objects", slice(None), 0, "n_objects must be at least 1"),
        ("iteration", 23, 24, r"must be 0, 1, 2, \.\.\.; broken by scene a, seed 0, iteration 24"),
        ("iteration", 1, 0, "the iterations of a run"),
        ("segment", slice(18, 24), 5, "the segments of a run"),
        ("segment", slice(0, 5), 1, "the segments of a run"),
        ("kind", 6, "reach", "all reach or all push"),
        ("c_f", 2, -1.0, "cost terms must not be negative"),
        ("asked_before", 6, True, "human input is not given while pushing"),
        ("asked_before", 5, False, "a push must begin with human input"),
    ],
)
def test_files_that_are_not_runs(tmp_path, column, row, value, message):
    path = tmp_path / "runs.parquet"
    values = helped_run().frame()[column].to_list()
    for i in range(len(values))[row] if isinstance(row, slice) else [row]:
        values[i] = value
    helped_run().frame().with_columns(
        pl.Series(column, values, dtype=RUN_SCHEMA[column])
    ).write_parquet(path)
    with pytest.raises(BadInput, match=message) as error:
        read_runs(path)
    assert "\n" not in str(error.value)


def test_missing_empty_and_truncated_files(tmp_path):
    path = tmp_path / "runs.parquet"
    with pytest.raises(BadInput, match=r"runs\.parquet: no such file"):
        read_runs(path)
    pl.concat(two_runs()).clear().write_parquet(path)
    with pytest.raises(BadInput, match="holds no rows"):
        read_runs(path)
    with pytest.raises(BadInput, match="no runs to write"):
        write_runs(path, [])
    write_runs(path, two_runs())
    whole = path.read_bytes()
    for size in [*range(0, len(whole), 37), len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(BadInput, match=r"runs\.parquet: truncated or corrupt") as error:
            read_runs(path)
        assert "\n" not in str(error.value)


def test_a_flipped_bit_is_bad_input_or_read(tmp_path):
    path = tmp_path / "runs.parquet"
    write_runs(path, two_runs())
    whole = path.read_bytes()
    for at in range(0, len(whole), 41):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            read_runs(path)
        except BadInput as error:
            assert "\n" not in str(error)


def test_an_unwritable_place_is_bad_input(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadInput, match="cannot be written"):
        write_runs(tmp_path / "file" / "runs.parquet", two_runs())
