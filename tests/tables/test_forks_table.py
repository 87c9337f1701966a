"""Tables of forks: bad tables are refused, good ones become arrays."""

import re

import numpy as np
import polars as pl
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.tables.forks import FORK_SCHEMA, check_forks, forks_of, read_forks, write_forks
from pgf_jax.tables.runs import Mode, runs_path
from pgf_jax.training.rows import gain_rows


def fork(scene="tight_1", seed=1, *, alone=(10.0, 20.0), helped=(4.0, 6.0), **changes):
    """A state under as many keys as there are costs; its state is 0, 1, 2, ..."""
    rows = [
        {
            "scene": scene,
            "seed": seed,
            "class": "tight",
            "iteration": 4,
            "input": "push",
            "key": key,
            "alone": a,
            "helped": h,
            "alone_solved": False,
            "helped_solved": h < 5,
            "alone_iterations": 10,
            "helped_iterations": 3 + key,
            "pushed": True,
            **{f"state:{name}": float(i) for i, name in enumerate(STATE)},
            **changes,
        }
        for key, (a, h) in enumerate(zip(alone, helped, strict=True))
    ]
    return pl.DataFrame(rows, schema=FORK_SCHEMA)


def three():
    return [
        fork("wide_3", 3, alone=(7.0, 7.0), helped=(7.0, 7.0), input="go_on", pushed=False),
        fork(),
        fork("medium_2", 2, iteration=9, **{"class": "medium", "state:range": 0.5}),
    ]


def test_a_file_is_in_order_whatever_came_first(tmp_path):
    path = runs_path(tmp_path, Mode.FORKS)
    assert path == tmp_path / "forks" / "forks.parquet"
    write_forks(path, three(), {"settings": {}})
    frame = read_forks(path)
    assert frame.equals(pl.concat([three()[2], three()[1], three()[0]]))
    backwards = tmp_path / "backwards.parquet"
    write_forks(backwards, [part.reverse() for part in three()[::-1]], {"settings": {}})
    assert backwards.read_bytes() == path.read_bytes()
    pl.concat(three()).with_columns(note=pl.lit(1)).write_parquet(backwards)
    assert read_forks(backwards).equals(frame)


def refused(path, frame, message):
    frame.write_parquet(path)
    with pytest.raises(BadInput, match=message) as error:
        read_forks(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("input", ["push", "pull"], "input must be push or go_on; broken by scene tight_1, seed 1"),
        ("input", ["push", "go_on"], "a state must be the same under all its keys; broken by"),
        ("key", [0, 2], "the keys of a state must be 0, 1, 2, "),
        ("key", [1, 2], "the keys of a state must be 0, 1, 2, "),
        ("key", [0, 0], "the keys of a state must be 0, 1, 2, "),
        ("class", ["tight", "wide"], "a state must be the same under all its keys"),
        ("iteration", [4, 5], "the keys of a state must be 0, 1, 2, "),  # two states
        ("state:range", [0.0, 1e-9], "a state must be the same under all its keys"),
        ("state:n_objects", [np.nan, 0.0], "a state must be the same under all its keys"),
        ("alone", [1.0, None], "column alone has 1 nulls, expected none"),
        ("helped", ["x", "y"], "column helped has type String, expected Float64"),
    ],
)
def test_what_is_no_fork_is_refused(tmp_path, column, values, message):
    dtype = None if isinstance(values[0], str) else FORK_SCHEMA[column]
    broken = fork().with_columns(pl.Series(column, values, dtype=dtype))
    refused(tmp_path / "forks.parquet", broken, message)
    with pytest.raises(BadInput, match=message):
        write_forks(tmp_path / "again.parquet", [broken])
    assert not (tmp_path / "again.parquet").exists()


@pytest.mark.parametrize("column", list(FORK_SCHEMA))
def test_each_column_is_needed(tmp_path, column):
    refused(tmp_path / "forks.parquet", fork().drop(column), re.escape(f"column {column} is m"))


def test_missing_empty_and_truncated_files(tmp_path):
    path = tmp_path / "forks.parquet"
    with pytest.raises(BadInput, match=r"forks\.parquet: no such file, expected forks"):
        read_forks(path)
    refused(path, fork().clear(), "holds no rows")
    write_forks(path, three())
    whole = path.read_bytes()
    for size in (0, 4, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(BadInput, match="not a readable Parquet") as error:
            read_forks(path)
        assert "\n" not in str(error.value)


def test_two_forks_of_one_state_are_refused():
    with pytest.raises(BadInput, match="the keys of a state must be"):
        check_forks(pl.concat([fork(), fork()]), "forks")


def table(*parts):
    return check_forks(pl.concat(parts), "forks")


def test_arrays_by_hand():
    forks = forks_of(table(*three()))
    assert forks.scene.tolist() == ["medium_2", "tight_1", "wide_3"]
    assert forks.scene_class.tolist() == ["medium", "tight", "tight"]
    assert forks.iteration.tolist() == [9, 4, 4]
    assert forks.push.tolist() == [True, True, False]
    assert forks.alone.tolist() == [[10, 20], [10, 20], [7, 7]]
    assert forks.helped.tolist() == [[4, 6], [4, 6], [7, 7]]
    assert forks.gain.tolist() == [10, 10, 0]
    assert forks.state.shape == (3, len(STATE))
    assert forks.state[1].tolist() == list(range(len(STATE)))
    assert forks.state[0, STATE.index("range")] == 0.5
    some = forks.take(np.array([2, 0]))
    assert some.scene.tolist() == ["wide_3", "medium_2"] and some.gain.tolist() == [0, 10]


@pytest.mark.parametrize(
    "changes",
    [
        {"alone": (np.nan, 1.0)},
        {"helped": (1.0, np.inf)},
        {f"state:{STATE[0]}": np.nan},
        {f"state:{STATE[-1]}": -np.inf},
    ],
)
def test_states_that_blew_up_are_left_out(changes):
    bad = fork("wide_0", 0, **changes)  # legal in a file: it happened
    forks = forks_of(table(bad, *three()))
    assert forks.scene.tolist() == ["medium_2", "tight_1", "wide_3"]
    rows = gain_rows(table(bad, *three()))
    assert (len(rows.target), rows.non_finite) == (3, 1)
    with pytest.raises(BadInput, match="data: no state whose futures are all finite"):
        forks_of(table(bad), "data")


def test_states_need_the_same_number_of_keys():
    three_keys = fork("wide_0", 0, alone=(1.0, 1.0, 1.0), helped=(0.0, 0.0, 0.0))
    with pytest.raises(BadInput, match=r"forks: states have \[2, 3\] keys, expected the same"):
        forks_of(table(three_keys, fork()))


def test_gain_rows_by_hand():
    rows = gain_rows(table(*three()))
    assert rows.names == STATE
    assert rows.target.tolist() == [10, 10, 0]
    assert rows.scene.tolist() == ["medium_2", "tight_1", "wide_3"]
    assert rows.iteration.tolist() == [9, 4, 4]
    assert rows.features[2].tolist() == list(range(len(STATE)))
    assert (rows.non_finite, rows.short) == (0, 0)
    assert rows.only(("range",)).features[:, 0].tolist() == [0.5, *[STATE.index("range")] * 2]
