"""Event logs as files: round trips, and one line of error for files that are no logs."""

import contextlib
import json
import math
import os
import re

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from write_log import write_log

from pgf_jax.errors import BadInput
from pgf_jax.fleet import Event, EventKind
from pgf_jax.fleet.config import Cell
from pgf_jax.tables import results
from pgf_jax.tables.event_log import (
    FORMAT,
    JOURNAL,
    TABLE,
    EventLog,
    Journal,
    digest,
    first_difference,
    line,
    read_log,
)
from pgf_jax.tables.parquet import encode_table, write_table

ABOUT = {"settings": {"seed": 3}, "identity": {"versions": {"pgf_jax": "0"}}, "more": [1, "ä"]}
HEAD = json.dumps({"what": "pgf_jax session", "format": FORMAT, **ABOUT}) + "\n"
NUMBERS = st.none() | st.integers(0, 2**62 - 1)
PLACES = st.none() | st.floats(allow_nan=False, allow_infinity=False)
EVENTS = st.lists(
    st.builds(
        Event,
        time_ns=st.integers(0, 2**62 - 1),
        kind=st.sampled_from(EventKind),
        robot=NUMBERS,
        task=NUMBERS,
        request=NUMBERS,
        operator=NUMBERS,
        iteration=NUMBERS,
        gain=st.none() | st.just(math.inf) | st.floats(allow_infinity=False),
        object=NUMBERS,
        x=PLACES,
        y=PLACES,
        outcome=st.none() | st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
    ),
    max_size=12,
).map(lambda events: sorted(events, key=lambda event: event.time_ns))
FEW = [
    Event(0, EventKind.TASK_START, 0, 0),
    Event(1500, EventKind.ITERATION, 0, 0, iteration=0, gain=math.nan, outcome="stuck"),
    Event(1500, EventKind.BID, 0, 0, 0, iteration=0, gain=math.inf),
    Event(1500, EventKind.GRANT, 0, 0, 0, 0),
    Event(2501, EventKind.SERVICE_END, 0, 0, 0, 0, object=5, x=0.25, y=-0.1, outcome="push"),
    Event(2502, EventKind.OPERATOR_AWAY, operator=0),
]


def known(events):
    """The events as a log has them, without unknown gains."""
    return [
        event._replace(gain=None) if event.gain is not None and math.isnan(event.gain) else event
        for event in events
    ]


def journal(path, events=FEW, about=ABOUT):
    writer = Journal(path, about)
    writer.append(events)
    writer.close()
    return path


def bad(path, words=""):
    """The one line of error that reading the file gives."""
    with pytest.raises(BadInput) as caught:
        read_log(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message and len(message) < len(str(path)) + 200
    assert re.search(words, message), message
    return message


def with_line(path, text, number=3):
    """A journal in which one line is replaced."""
    lines = journal(path).read_bytes().splitlines(keepends=True)
    text = text if isinstance(text, bytes) else text.encode()
    path.write_bytes(b"".join([*lines[: number - 1], text + b"\n", *lines[number:]]))
    return path


# -- round trips -----------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(events=EVENTS)
def test_a_log_comes_back_from_lines_and_tables(events, tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    log = read_log(journal(folder / JOURNAL, events))
    assert log.events == known(events)
    assert log.size == (folder / JOURNAL).stat().st_size
    assert log.about == {"what": "pgf_jax session", "format": FORMAT, **ABOUT}
    assert log.settings == ABOUT["settings"]
    write_log(folder / TABLE, events, ABOUT)
    table = read_log(folder / TABLE)
    assert table.events == known(events)
    assert table.about == ABOUT
    # Every bit is there: what was read writes the same again.
    assert [line(e) for e in log.events] == [line(e) for e in table.events] == [*map(line, events)]
    assert digest(log.events) == digest(table.events) == digest(events)


def test_a_line_is_json_that_others_can_read():
    lines = [line(event) for event in FEW]
    assert all(text.endswith("\n") and text.count("\n") == 1 for text in lines)

    def never(word):
        raise AssertionError(f"{word} is not JSON")

    columns = [json.loads(text, parse_constant=never) for text in lines]
    assert columns[1] == {
        "time_ns": 1500, "kind": "iteration", "robot": 0, "task": 0, "iteration": 0,
        "outcome": "stuck",
    }  # fmt: skip
    assert columns[2]["gain"] == "inf"
    assert columns[5] == {"time_ns": 2502, "kind": "operator_away", "operator": 0}


def test_a_session_writes_what_can_be_read_at_any_time(tmp_path):
    writer = Journal(tmp_path / "new" / "folder" / JOURNAL, ABOUT)
    assert read_log(writer.path).events == []
    for number in range(len(FEW)):
        writer.append(FEW[number : number + 1])
        assert read_log(tmp_path / "new" / "folder").events == known(FEW[: number + 1])
    writer.append([])
    writer.close()
    assert len(writer.path.read_text().splitlines()) == 1 + len(FEW)


def test_whole_numbers_stand_for_floats(tmp_path):
    path = with_line(
        tmp_path / JOURNAL, '{"time_ns": 0, "kind": "bid", "gain": 2, "x": -1, "y": 3}', 2
    )
    event = read_log(path).events[0]
    assert (event.gain, event.x, event.y) == (2.0, -1.0, 3.0)
    assert all(isinstance(value, float) for value in (event.gain, event.x, event.y))


@settings(max_examples=100, deadline=None)
@given(events=EVENTS, data=st.data())
def test_the_first_difference(events, data):
    assert first_difference(events, known(events)) is None
    assert first_difference(known(events), events) is None
    assert first_difference([*events, FEW[0]], events) is None  # a log may end before its replay
    if not events:
        assert first_difference([], FEW) == 0
        return
    number = data.draw(st.integers(0, len(events) - 1))
    assert first_difference(events[:number], events) == number
    other = [*events]
    other[number] = events[number]._replace(request=(events[number].request or 0) + 1)
    assert first_difference(other, events) == first_difference(events, other) == number
    assert digest(other) != digest(events)


# -- journals that were cut off --------------------------------------------------------------------


def test_a_journal_cut_off_anywhere(tmp_path):
    path = journal(tmp_path / JOURNAL)
    data = path.read_bytes()
    head = len(data.splitlines(keepends=True)[0])
    for size in range(head, len(data) + 1):
        path.write_bytes(data[:size])
        log = read_log(path)
        whole = data[:size].count(b"\n") - 1
        assert log.events == known(FEW[:whole])
        assert log.size == data.rindex(b"\n", 0, size) + 1 if size < len(data) else len(data)
    for size in range(head):
        path.write_bytes(data[:size])
        bad(path, "is empty, expected an event log")


def test_a_journal_goes_on_after_the_last_whole_line(tmp_path):
    path = journal(tmp_path / JOURNAL)
    data = path.read_bytes()
    start = data.index(b"\n", len(data) // 2)
    for size in range(start, len(data) + 1):
        path.write_bytes(data[:size])
        log = read_log(path)
        writer = Journal(path, None, keep=log.size)
        assert path.read_bytes() == data[: log.size]
        writer.append(FEW[len(log.events) :])
        writer.close()
        assert path.read_bytes() == data


def test_what_follows_a_cut_line_is_not_lost_on_a_longer_file(tmp_path):
    path = journal(tmp_path / JOURNAL)
    with path.open("ab") as file:
        file.write(b'{"time_ns": 3000, "ki' + 500 * b"\0")
    log = read_log(path)
    writer = Journal(path, None, keep=log.size)
    writer.append([Event(3000, EventKind.OPERATOR_BACK, operator=0)])
    writer.close()
    assert read_log(path).events == [
        *known(FEW), Event(3000, EventKind.OPERATOR_BACK, operator=0)
    ]  # fmt: skip


# -- bad files ------------------------------------------------------------------------------------

GARBAGE = {
    "empty line": (b"", "expected JSON"),
    "words": (b"no event", "expected JSON"),
    "cut off, and another line after it": (b'{"time_ns": 7, "kind": "b', "expected JSON"),
    "not utf-8": (b'{"time_ns": 7, "kind": "bid", "outcome": "\xff\xfe"}', "expected JSON"),
    "zeros": (64 * b"\0", "expected JSON"),
    "deep": (100_000 * b"[", "expected JSON"),
    "deep objects": (50_000 * b'{"a":', "expected JSON"),
    "long number": (b'{"time_ns": 1' + 5000 * b"0" + b"}", "expected JSON"),
    "list": (b"[1, 2]", r"expected an event \(a JSON object\), got \[1, 2\]"),
    "number": (b"7", r"expected an event"),
    "null": (b"null", r"expected an event"),
    "nothing in it": (b"{}", "expected an event with time_ns"),
    "no time": (b'{"kind": "bid"}', "expected an event with time_ns"),
    "no kind": (b'{"time_ns": 1500}', "expected an event with kind"),
    "unknown kind": (b'{"time_ns": 1500, "kind": "bribe"}', "unknown kind of event 'bribe'"),
    "kind of no text": (b'{"time_ns": 1500, "kind": 4}', "unknown kind of event 4"),
    "unknown column": (b'{"time_ns": 1500, "kind": "bid", "robots": 1}', "'robots' is no column"),
    "odd column": (b'{"time_ns": 1500, "kind": "bid", "a\\nb": 1}', "is no column"),
    "half a character": (b'{"time_ns": 1500, "kind": "bid", "\\ud800": 1}', "is no column"),
    "time in s": (b'{"time_ns": 1500.0, "kind": "bid"}', "time_ns must be Int64, got 1500.0"),
    "time as text": (b'{"time_ns": "1500", "kind": "bid"}', "time_ns must be Int64"),
    "time of null": (b'{"time_ns": null, "kind": "bid"}', "time_ns must be Int64, got None"),
    "time of true": (b'{"time_ns": true, "kind": "bid"}', "time_ns must be Int64, got True"),
    "negative time": (b'{"time_ns": -1, "kind": "bid"}', "time_ns must be 0 or more, got -1"),
    "late time": (b'{"time_ns": 9223372036854775808, "kind": "bid"}', "time_ns must be 0 or more"),
    "time goes back": (b'{"time_ns": 1400, "kind": "bid"}', "time_ns 1400 is before the "),
    "negative robot": (b'{"time_ns": 1500, "kind": "bid", "robot": -1}', "robot must be 0 or"),
    "robot as text": (b'{"time_ns": 1500, "kind": "bid", "robot": "0"}', "robot must be Int64"),
    "half an object": (b'{"time_ns": 1500, "kind": "bid", "object": 0.5}', "object must be Int64"),
    "gain as text": (b'{"time_ns": 1500, "kind": "bid", "gain": "much"}', "gain must be Float64"),
    "gain as list": (b'{"time_ns": 1500, "kind": "bid", "gain": [1]}', "gain must be Float64"),
    "x of true": (b'{"time_ns": 1500, "kind": "bid", "x": true}', "x must be Float64"),
    "x in words": (b'{"time_ns": 1500, "kind": "bid", "x": "inf"}', "x must be Float64"),
    "x is infinite": (b'{"time_ns": 1500, "kind": "bid", "x": Infinity}', "x must be a finite"),
    "y is none": (b'{"time_ns": 1500, "kind": "bid", "y": NaN}', "y must be a finite"),
    "outcome of 3": (b'{"time_ns": 1500, "kind": "bid", "outcome": 3}', "outcome must be String"),
    "two events": (b'{"time_ns": 1500, "kind": "bid"}{}', "expected JSON"),
    "huge value": (b'{"time_ns": 1500, "kind": "' + 3000 * b"x" + b'"}', "unknown kind"),
    "huge column": (b'{"time_ns": 1500, "kind": "bid", "' + 3000 * b"x" + b'": 1}', "no column"),
}


@pytest.mark.parametrize("what", GARBAGE)
def test_a_line_that_is_no_event(what, tmp_path):
    text, words = GARBAGE[what]
    # In the middle of the log, and at its end: only a line without an end was cut off.
    for number in (4, 5, 1 + len(FEW)):
        path = tmp_path / f"{number}.jsonl"
        assert f": line {number}: " in bad(with_line(path, text, number), words)


@pytest.mark.parametrize(
    "text",
    [
        b'{"time_ns": 1500, "kind": []}',
        b'{"time_ns": 1500, "kind": {}}',
        b'{"time_ns": 1500, "kind": "bid", "gain": 1' + 400 * b"0" + b"}",
        b'{"time_ns": 1500, "kind": "bid", "x": -1' + 400 * b"0" + b"}",
    ],
    ids=["list", "object", "gain", "x"],
)
def test_a_line_of_values_that_python_stumbles_over(text, tmp_path):
    assert ": line 3: " in bad(with_line(tmp_path / JOURNAL, text))


def test_a_line_that_never_ends(tmp_path):
    path = journal(tmp_path / JOURNAL)
    with path.open("ab") as file:
        file.write(b'{"time_ns": 3000, "kind": "' + (1 << 21) * b"x")
    assert f"line {2 + len(FEW)}: is longer" in bad(path)


HEADS = {
    "an event": (line(FEW[0]), "expected the head of an event log"),
    "a list": ("[]\n", "expected the head"),
    "of something else": ('{"what": "pgf_jax sweep"}\n', "expected the head"),
    "another format": (HEAD.replace(f'"format": {FORMAT}', '"format": 2'), "format 2, expected 1"),
    "no format": (HEAD.replace(f'"format": {FORMAT}', '"f": 1'), "format None, expected 1"),
    "no settings": (HEAD.replace("settings", "setting"), "expected settings of the session"),
    "settings of a list": (HEAD.replace('{"seed": 3}', "[3]"), "expected settings"),
    "no identity": (HEAD.replace("identity", "id"), "expected identity of the session"),
    "words": ("# events\n", "expected JSON"),
    "a picture": ("\x89PNG\r\n", "expected JSON"),
}


@pytest.mark.parametrize("what", HEADS)
def test_a_head_that_is_none(what, tmp_path):
    text, words = HEADS[what]
    path = tmp_path / JOURNAL
    path.write_text(text + line(FEW[0]), "latin-1")
    assert ": line 1: " in bad(path, words)


def test_files_that_are_not_there(tmp_path):
    bad(tmp_path / JOURNAL, "no such file")
    bad(tmp_path / TABLE, "no such file")
    bad(tmp_path / "nothing", "no such file")
    bad(tmp_path, f"expected a folder with {TABLE} or {JOURNAL}")
    (tmp_path / JOURNAL).mkdir()
    bad(tmp_path, "expected a folder with")
    (tmp_path / "empty.jsonl").touch()
    bad(tmp_path / "empty.jsonl", "is empty")
    (tmp_path / "empty.parquet").touch()
    bad(tmp_path / "empty.parquet", "truncated or corrupt")


def test_a_table_that_is_none(tmp_path):
    path = tmp_path / TABLE
    write_log(path, FEW, ABOUT)
    data = path.read_bytes()
    for size in [*range(0, len(data), 97), len(data) - 1]:
        path.write_bytes(data[:size])
        bad(path, "truncated or corrupt")
    frame = results.events_frame(FEW)

    def table(changed):
        write_table(path, changed, ABOUT)
        return path

    for name in frame.columns:
        bad(table(frame.drop(name)), f"column {name} must be")
        other = pl.String if frame.schema[name] != pl.String else pl.Int32
        bad(table(frame.with_columns(pl.lit(None, other).alias(name))), f"column {name} must be")
    bad(table(frame.with_columns(kind=pl.lit("bribe"))), "unknown kind of event 'bribe'")
    bad(table(frame.with_columns(kind=pl.lit(None, pl.String))), "kind is missing in 6 rows")
    bad(table(frame.with_columns(time_ns=pl.lit(None, pl.Int64))), "time_ns is missing in 6 rows")
    bad(table(frame.with_columns(time_ns=-pl.col("time_ns"))), "row 2: time_ns must be 0 or more")
    bad(table(frame.reverse()), "row 2: time_ns 2501 is before the 2502")
    for name in ("robot", "task", "request", "operator", "iteration", "object"):
        negative = frame.with_columns(pl.lit(-3, pl.Int64).alias(name))
        bad(table(negative), f"row 1: {name} must be 0 or more, got -3")
    for name in ("x", "y"):
        infinite = frame.with_columns(pl.lit(-math.inf).alias(name))
        bad(table(infinite), f"row 1: {name} must be a finite number")


# -- tables ----------------------------------------------------------------------------------------


def test_a_sweeps_log_is_split_in_its_fleets(tmp_path):
    others = [Event(0, EventKind.TASK_START, 4, 0), FEW[-1]]
    fleets = {Cell("pgf", 1, 2): FEW, Cell("pgf", 10, 2): others, Cell("or-hitl", 1, 2): FEW[:1]}
    merged = results.merge([(cell, results.events_frame(e)) for cell, e in fleets.items()])
    (tmp_path / TABLE).write_bytes(encode_table(merged))
    log = read_log(tmp_path)
    assert log.path == tmp_path / TABLE
    assert log.fleets == [known(events) for events in fleets.values()]
    assert log.settings is None and log.about == {}
    with pytest.raises(BadInput, match="expected the log of one fleet, got 3") as caught:
        _ = log.events
    assert str(caught.value).startswith(str(log.path))
    # The log of a cell is of one, and says nothing of itself either.
    (tmp_path / TABLE).write_bytes(encode_table(results.events_frame(FEW)))
    assert read_log(tmp_path).events == known(FEW)
    assert read_log(tmp_path).settings is None
    # Their order is checked in each fleet by itself.
    back = results.merge(
        [(Cell("pgf", 1, 2), results.events_frame(FEW[::-1])), (Cell("pgf", 2, 2), merged[:0, 2:])]
    )
    (tmp_path / TABLE).write_bytes(encode_table(back))
    bad(tmp_path / TABLE, "row 2: time_ns 2501 is before")


def test_the_table_of_a_folder_comes_before_its_journal(tmp_path):
    journal(tmp_path / JOURNAL, FEW[:2])
    assert read_log(tmp_path).path == tmp_path / JOURNAL
    assert read_log(tmp_path).events == known(FEW[:2])
    write_log(tmp_path / TABLE, FEW, ABOUT)
    assert read_log(tmp_path).path == tmp_path / TABLE
    assert read_log(str(tmp_path)).events == known(FEW)
    assert read_log(tmp_path / JOURNAL).events == known(FEW[:2])
    (tmp_path / TABLE).write_bytes(b"PAR1")  # nor is a bad one passed over in silence
    bad(tmp_path / TABLE, "truncated or corrupt")
    with pytest.raises(BadInput, match="truncated or corrupt"):
        read_log(tmp_path)


def test_the_log_of_no_fleet(tmp_path):
    empty = EventLog(tmp_path, [], {})
    with pytest.raises(BadInput, match="one fleet, got 0"):
        _ = empty.events


@pytest.mark.parametrize("about", [{"settings": 5, "identity": {}}, {"settings": {}}])
def test_what_a_table_says_of_itself_is_checked_like_a_head(about, tmp_path):
    write_log(tmp_path / TABLE, FEW, about)
    try:
        log = read_log(tmp_path)
    except BadInput:
        return
    # Either nothing is taken over, or what a head must have is there.
    assert log.settings is None or (
        isinstance(log.settings, dict) and isinstance(log.about.get("identity"), dict)
    )


# -- the journal -----------------------------------------------------------------------------------


def test_a_journal_is_on_the_disk_when_append_returns(tmp_path, monkeypatch):
    synced = []
    fsync = os.fsync

    def spy(fd):
        fsync(fd)
        synced.append(path.read_bytes() if path.exists() else None)

    path = tmp_path / JOURNAL
    monkeypatch.setattr(os, "fsync", spy)
    writer = Journal(path, ABOUT)
    assert len(synced) == 3  # the file and its folder, and its length
    for number, event in enumerate(FEW):
        writer.append([event])
        # All of it had left this process when the last fsync returned.
        assert synced[-1] == path.read_bytes()
        assert synced[-1].count(b"\n") == number + 2
    before = len(synced)
    writer.append([])
    assert len(synced) == before
    writer.append(FEW[-1:] * 5000)
    assert synced[-1] == path.read_bytes()
    writer.close()


def test_a_new_journal_takes_nobodys_place(tmp_path):
    path = journal(tmp_path / JOURNAL)
    data = path.read_bytes()
    with pytest.raises(BadInput, match="exists; expected a new folder, or --resume") as caught:
        Journal(path, ABOUT)
    assert str(caught.value).startswith(str(path))
    assert path.read_bytes() == data


def test_journals_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    for path, about in (
        (tmp_path / "file" / JOURNAL, ABOUT),
        (tmp_path / "file" / "folder" / JOURNAL, ABOUT),
        (tmp_path / "nothing" / JOURNAL, None),
        (tmp_path, None),
        (tmp_path / ("x" * 300) / JOURNAL, ABOUT),
    ):
        with pytest.raises(BadInput) as caught:
            Journal(path, about)
        assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert not (tmp_path / "nothing").exists()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full disk here")
@pytest.mark.parametrize(
    "count",
    [
        1,
        5000,
    ],
)
def test_a_full_disk_is_said(count, tmp_path):
    writer = Journal(tmp_path / JOURNAL, ABOUT)
    writer.close()
    full = writer._file = open("/dev/full", "wb")  # noqa: SIM115
    with pytest.raises(BadInput, match="cannot be written") as caught:
        writer.append(FEW[:1] * count)
    assert str(caught.value).startswith(str(tmp_path / JOURNAL))
    with contextlib.suppress(OSError):  # what is left in its buffer
        full.close()
