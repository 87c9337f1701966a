"""A sweep's cells on disk: they come back as they were, or are refused in one line."""

import dataclasses
import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stub_fleets import mixed_fleet

from pgf_jax.errors import BadInput
from pgf_jax.files import sha256, write_atomically
from pgf_jax.fleet.events import EventKind
from pgf_jax.planning.types import Status
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.cell_file import Content
from pgf_jax.sweeping.cell_store import only_writer
from pgf_jax.tables import results
from pgf_jax.tables.parquet import encode_table
from pgf_jax.tables.results import EVENT_SCHEMA, TASK_SCHEMA

IDENTITY = {"format": 3, "fleet": {"policy": "pgf", "robots": 3}, "scenes": None}
ABOUT = {"identity": IDENTITY, "config": {"seed": 2, "window": 0.1}, "device": "ä\n"}


def content(**changes) -> Content:
    fleet = mixed_fleet(**changes)
    tasks = results.tasks_frame(fleet.records, lambda robot, task: f"{robot}_{task}")
    costs = pl.Series([[None, 1.0], *tasks["asked_cost"].to_list()[1:]])  # one is not known
    tasks = tasks.with_columns(asked_cost=costs)
    return Content(tasks, results.events_frame(fleet.events), ABOUT)


def signed(file: Path, data: bytes) -> None:
    """Bytes in place of a cell's, with what stands beside them."""
    account = json.loads(cell_file.sidecar(file).read_bytes())
    file.write_bytes(data)
    cell_file.sidecar(file).write_text(json.dumps(account | {"sha256": sha256(data)}))


@pytest.fixture
def written(tmp_path):
    """A cell's file, and what it holds."""
    file = cell_file.path(tmp_path, cell_file.key(IDENTITY))
    cell_file.write(file, content().data(), {"host": {"name": "here"}})
    return file, content()


def refused(file: Path, message: str, named: Path | None = None) -> None:
    with pytest.raises(BadInput) as caught:
        cell_file.read(file)
    said = str(caught.value)
    assert said.startswith(f"{named or file}: ") and said.isprintable()
    assert message in said


# -- what comes back -----------------------------------------------------------------------------


def same(found: Content, expected: Content) -> None:
    for ours, theirs in ((found.tasks, expected.tasks), (found.events, expected.events)):
        assert ours.equals(theirs) and ours.schema == theirs.schema
    assert found.about == expected.about
    assert found.data() == expected.data()


def test_a_cell_comes_back(written):
    file, expected = written
    found = cell_file.read(file)
    same(found, expected)
    # Not of nothing: what is null, in lists and beside them, and what is not finite.
    assert found.tasks["first_grant"].null_count() > 0 and found.tasks["cost"].is_infinite().any()
    assert found.tasks["asked_cost"][0].to_list() == [None, 1.0]
    assert found.tasks["asked_cost"].list.len().min() == 0
    assert max(found.tasks["non_finite_at"].list.len()) > 1
    assert found.events["gain"].is_infinite().any() and found.events["gain"].null_count() > 0
    assert sorted(path.name for path in file.parent.iterdir()) == [
        f"{file.stem}.json",
        f"{file.stem}.parquet",
    ]
    assert cell_file.read_account(file) == {
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "bytes": file.stat().st_size,
        "host": {"name": "here"},
    }


def test_a_cell_is_one_row_that_others_can_read(written):
    file, expected = written
    frame = pl.read_parquet(file)
    assert len(frame) == 1 and frame.columns == ["tasks", "events"]
    tasks = frame["tasks"].explode().struct.unnest()
    assert tasks.equals(expected.tasks)
    assert json.loads(pl.read_parquet_metadata(file)["pgf_jax"]) == ABOUT


def test_empty_tables_come_back(tmp_path):
    file = cell_file.path(tmp_path, cell_file.key(IDENTITY))
    tables = (pl.DataFrame(schema=TASK_SCHEMA), pl.DataFrame(schema=EVENT_SCHEMA))
    for tasks, events in (tables, (tables[0], content().events), (content().tasks, tables[1])):
        expected = Content(tasks, events, ABOUT)
        cell_file.write(file, expected.data(), {})
        same(cell_file.read(file), expected)


def _column(name: str, dtype: pl.DataType) -> st.SearchStrategy:
    """Values that a cell may hold in a column."""
    if name in ("kind", "status"):
        return st.sampled_from([each.value for each in (EventKind if name == "kind" else Status)])
    if isinstance(dtype, pl.List):
        values = {
            pl.Int64(): st.integers(-(2**63), 2**63 - 1),
            pl.Float64(): st.none() | st.floats(),
        }
        return st.lists(values[dtype.inner], max_size=3)  # pyright: ignore[reportArgumentType]
    values = {
        pl.Int64(): st.integers(-(2**63), 2**63 - 1),
        pl.Float64(): st.floats(),
        pl.String(): st.text(max_size=5),
    }[dtype]
    optional = {"first_bid", "first_grant", "cost", "c_d", "c_f", "c_b", *EVENT_SCHEMA}
    needed = {"time_ns", "kind", *TASK_SCHEMA} - optional | {"time_ns", "kind", "robot", "task"}
    return values if name in needed else st.none() | values


def _frames(schema: dict[str, pl.DataType]) -> st.SearchStrategy[pl.DataFrame]:
    row = st.tuples(*(_column(name, dtype) for name, dtype in schema.items()))
    return st.lists(row, max_size=4).map(
        lambda rows: pl.DataFrame(rows, schema=schema, orient="row")
    )


_FINITE = st.floats(allow_nan=False, allow_infinity=False)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | _FINITE | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=8,
)
ABOUTS = st.dictionaries(st.text(max_size=5), JSON, max_size=4)


@settings(max_examples=60, deadline=None)
@given(_frames(TASK_SCHEMA), _frames(EVENT_SCHEMA), ABOUTS, ABOUTS)
def test_any_tables_come_back(tasks, events, identity, others):
    expected = Content(tasks, events, others | {"identity": identity})
    data = expected.data()
    found = cell_file.decode(data, Path("x"))
    assert found.tasks.equals(tasks) and found.events.equals(events)
    assert found.about == expected.about
    assert found.data() == data == expected.data()
    assert cell_file.key(found.about["identity"]) == cell_file.key(identity)


def test_the_same_content_is_the_same_bytes(tmp_path):
    backwards = dict(reversed(ABOUT.items()))
    backwards["identity"] = dict(reversed(IDENTITY.items()))
    assert content().data() == content().data()
    assert dataclasses.replace(content(), about=backwards).data() == content().data()
    assert content(seed=5).data() != content().data()
    # Another process makes them, too.
    path = tmp_path / "x"
    path.write_bytes(content().data())
    code = (
        "import sys; from pathlib import Path; from pgf_jax.sweeping import cell_file\n"
        "path = Path(sys.argv[1])\n"
        "print(path.read_bytes() == cell_file.decode(path.read_bytes(), path).data())"
    )
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
    assert done.stdout == "True\n", done.stderr


# -- keys ----------------------------------------------------------------------------------------


def test_a_key_by_hand():
    written = b'{"a":{"b":[2,null],"c":0.1},"z":"\\u00e4"}'
    identity = {"z": "ä", "a": {"c": 0.1, "b": [2, None]}}
    assert cell_file.key(identity) == hashlib.sha256(written).hexdigest()


def _shuffled(value: Any, random) -> Any:
    if isinstance(value, dict):
        items = [(key, _shuffled(inner, random)) for key, inner in value.items()]
        random.shuffle(items)
        return dict(items)
    return [_shuffled(inner, random) for inner in value] if isinstance(value, list) else value


@given(ABOUTS, st.randoms(use_true_random=False))
def test_a_key_is_not_of_an_order(identity, random):
    key = cell_file.key(identity)
    assert cell_file.key(_shuffled(identity, random)) == key and cell_file.is_key(key)
    assert cell_file.key(json.loads(json.dumps(identity))) == key
    assert cell_file.key(identity | {"one more": 1}) != key


def test_another_value_is_another_key():
    changes = ({"format": 4}, {"scenes": 0}, {"fleet": {"policy": "pgf", "robots": 4}}, {"x": None})
    keys = {cell_file.key(IDENTITY | change) for change in ({}, *changes)}
    assert len(keys) == len(changes) + 1


@pytest.mark.parametrize("name", ["", "a" * 63, "a" * 65, "A" * 64, "g" * 64, "a" * 64 + "\n"])
def test_what_is_no_key(name):
    assert not cell_file.is_key(name) and cell_file.is_key("0f" * 32)


# -- what is refused -----------------------------------------------------------------------------


def test_a_truncated_cell_is_named(written):
    file, _ = written
    whole = file.read_bytes()
    for size in [*range(0, len(whole), 1501), len(whole) - 1]:
        file.write_bytes(whole[:size])
        refused(file, "truncated or edited, its digest is not the one in")
    file.unlink()
    refused(file, "no such file")


def test_a_byte_is_enough(written):
    file, expected = written
    whole = file.read_bytes()
    for place in range(0, len(whole), 997):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        refused(file, "truncated or edited")
    file.write_bytes(whole + b"\0")
    refused(file, "truncated or edited")
    file.write_bytes(whole)
    same(cell_file.read(file), expected)


def test_a_cell_under_another_name_is_refused(written):
    file, _ = written
    other = cell_file.path(file.parent.parent, "0" * 64)
    file.rename(other)
    refused(other, f"edited, or of another name: by what it says it is {file.stem}")
    cell_file.sidecar(file).rename(cell_file.sidecar(other))
    refused(other, f"edited, or of another name: by what it says it is {file.stem}")


def test_an_edited_identity_is_refused_whoever_signed_it(written):
    file, whole = written
    edited = dataclasses.replace(whole, about=ABOUT | {"identity": IDENTITY | {"scenes": 1}})
    signed(file, edited.data())
    refused(file, "edited, or of another name")


@pytest.mark.parametrize("text", ["", "{", '{"sha256": ', "\xff\xfe", "[1]"])
def test_a_corrupt_account_is_named(written, text):
    file, _ = written
    beside = cell_file.sidecar(file)
    beside.write_bytes(text.encode("latin-1"))
    expected = "expected a JSON object" if text == "[1]" else "truncated or corrupt, not JSON"
    refused(file, expected, beside)


@pytest.mark.parametrize("record", [{}, {"sha256": None}, {"sha256": ["x"]}, {"sha256": {}}])
def test_an_account_without_the_digest_vouches_for_nothing(written, record):
    file, _ = written
    cell_file.sidecar(file).write_text(json.dumps(record))
    refused(file, "truncated or edited")


def test_a_file_alone_will_do_if_it_is_whole(written):
    """What varies from run to run may have been left behind; what is known of it then is less."""
    file, whole = written
    assert cell_file.inputs(file) == cell_file.read_account(file).get("inputs", {})
    cell_file.sidecar(file).unlink()
    same(cell_file.read(file), whole)
    assert cell_file.inputs(file) == {}
    data = file.read_bytes()
    file.write_bytes(data[:-9])
    refused(file, "truncated or corrupt, not a readable Parquet file")


def row(**changes) -> pl.DataFrame:
    """The file's table, with other columns."""
    tables = {"tasks": content().tasks, "events": content().events} | changes
    return pl.DataFrame(
        {name: frame.to_struct(name).implode() for name, frame in tables.items()}, strict=False
    )


def test_tables_behind_the_right_digest_are_looked_at(written):
    file, whole = written
    tasks, events = whole.tasks, whole.events
    lists = "expected one row with a list of structs, "
    cases = {
        lists + "tasks": [
            row().drop("tasks"),
            row().clear(),
            pl.concat([row(), row()]),
            row().with_columns(tasks=pl.lit(None, row().schema["tasks"])),
            row().with_columns(tasks=pl.lit(1)),
            row(tasks=tasks.drop("cost")),
            row(tasks=tasks.with_columns(pl.col("cost").cast(pl.Float32))),
        ],
        lists + "events": [row().drop("events"), row(events=events.drop("x"))],
        "tasks has 1 empty rows": [
            row().with_columns(tasks=pl.Series([[None]], dtype=row().schema["tasks"]))
        ],
        "planning_time_s is missing in 9 rows": [
            row(tasks=tasks.with_columns(planning_time_s=pl.lit(None, pl.Float64)))
        ],
        "unknown status 'x'": [row(tasks=tasks.with_columns(status=pl.lit("x")))],
        "unknown kind of event 'x'": [row(events=events.with_columns(kind=pl.lit("x")))],
    }
    for message, frames in cases.items():
        for frame in frames:
            signed(file, encode_table(frame, ABOUT))
            refused(file, message)
    signed(file, b"PAR1" + bytes(40) + b"PAR1")
    refused(file, "truncated or corrupt, not a readable Parquet file")
    signed(file, encode_table(row()))
    refused(file, "does not say where it comes from")
    for about in ({}, {"identity": None}, {"identity": ["x"]}, {"identity": "x"}):
        signed(file, encode_table(row(), about))
        refused(file, "it does not say what it was computed from")


# -- writing -------------------------------------------------------------------------------------


@pytest.mark.parametrize("killed_at", [".json", ".parquet"])
def test_an_older_cell_is_replaced_or_gone(written, monkeypatch, killed_at):
    """What stands beside a file must never be of another one."""
    file, _ = written
    write = write_atomically

    def killed(path, data):
        if path.suffix == killed_at:
            raise KeyboardInterrupt
        write(path, data)

    new = content(seed=5)
    with monkeypatch.context() as patch:
        patch.setattr(cell_file, "write_atomically", killed)
        with pytest.raises(KeyboardInterrupt):
            cell_file.write(file, new.data(), {"attempt": 2})
    assert cell_file.finished(file.parent.parent) == set()
    cell_file.write(file, new.data(), {"attempt": 3})
    same(cell_file.read(file), new)
    assert cell_file.read_account(file)["attempt"] == 3
    assert cell_file.finished(file.parent.parent) == {file.stem}


def test_what_cannot_be_written_is_named(tmp_path):
    (tmp_path / "cells").write_text("a file")
    file = cell_file.path(tmp_path, "0" * 64)
    with pytest.raises(BadInput, match=f"{file}: cannot be replaced"):
        cell_file.write(file, b"x", {})
    file = cell_file.path(tmp_path / "other", "0" * 64)
    file.mkdir(parents=True)
    with pytest.raises(BadInput, match=f"{file}: cannot be replaced"):
        cell_file.write(file, b"x", {})


def test_finished_cells_are_files_with_keys(written, tmp_path):
    file, _ = written
    for name in ("x.parquet", f".{file.stem}.parquet", f"{'1' * 64}.json", f"{'2' * 64}.tmp"):
        (file.parent / name).write_text("")
    cell_file.path(tmp_path, "3" * 64).mkdir()
    assert cell_file.finished(tmp_path) == {file.stem}
    assert cell_file.finished(tmp_path / "nowhere") == set()


# -- one writer ----------------------------------------------------------------------------------

HOLD = """
import sys
from pathlib import Path
from pgf_jax.errors import BadInput
from pgf_jax.sweeping.cell_store import only_writer
try:
    with only_writer(Path(sys.argv[1])):
        print("in", flush=True)
        sys.stdin.read()
    print("out")
except BadInput as error:
    print(error)
"""


def holder(out: Path) -> subprocess.Popen:
    """A process that writes a folder until its input ends; or says why not."""
    return subprocess.Popen(
        [sys.executable, "-c", HOLD, out],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def lines_of(process: subprocess.Popen) -> list[str]:
    """What it says after what has been read, until it ends."""
    return process.communicate(timeout=60)[0].splitlines()


def first_line(process: subprocess.Popen) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_two_processes_cannot_write_one_folder(tmp_path):
    out, message = tmp_path / "out", f"out: {tmp_path / 'out'} is in use by another sweep"
    other = holder(out)
    assert first_line(other) == "in"
    with pytest.raises(BadInput) as caught, only_writer(out):
        pass
    assert str(caught.value) == message
    with only_writer(tmp_path / "another"):
        pass
    assert lines_of(other) == ["out"]
    for _ in range(2):
        with only_writer(out):
            assert lines_of(holder(out)) == [message]
    with pytest.raises(ZeroDivisionError), only_writer(out):
        raise ZeroDivisionError
    assert lines_of(holder(out)) == ["in", "out"]


def test_who_was_killed_holds_nothing_and_leaves_nothing(tmp_path):
    out, folder = tmp_path, tmp_path / "cells"
    other = holder(out)
    assert first_line(other) == "in"
    half = [folder / f".{'0' * 64}.parquet.7.tmp", out / ".tasks.parquet.7.tmp"]
    half += [folder / ".session-0a", folder / ".session-0a.12"]
    own = [folder / f"{'0' * 64}.json", out / "notes.tmp", out / ".notes", folder / "x.tmp"]
    for path in (*half, *own):
        path.write_text("x")
    with pytest.raises(BadInput), only_writer(out):
        pass
    assert all(path.exists() for path in half)  # somebody's, as long as somebody is there
    other.kill()
    other.communicate(timeout=60)
    with only_writer(out):
        assert {path for path in out.rglob("*") if path.is_file()} == set(own)


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with (
            pytest.raises(BadInput, match=f"out: {out} cannot be made"),
            only_writer(out),
        ):
            pass
