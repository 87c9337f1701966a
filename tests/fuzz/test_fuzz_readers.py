"""Hostile files: each is read or refused in one line; nothing crashes, hangs, or is written.

A case is made of its reader's name and its number alone (`fuzz_cases.case`), so a failure comes
back with `outcome(NAME, case(NAME, NUMBER), FOLDER)`.
"""

import io
import os
import re
import socket
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import fuzz_cases
import numpy as np
import polars as pl
import pytest
from fuzz_cases import READERS
from fuzz_worker import Tally, fuzz

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import read_file, read_json, write_atomically
from pgf_jax.guidance.predictors.registry import predictor_spec
from pgf_jax.plans.file import load_plan, plan_path
from pgf_jax.scene import load_scene, load_scenes
from pgf_jax.tables import decoder, event_log, results
from pgf_jax.tables.forks import forks_of, read_forks
from pgf_jax.tables.parquet import read_provenance, read_table

FEW = 60  # cases of a reader: seconds
MANY = 1300  # 30 readers: 39 000 files


def passed(tally: Tally, count: int) -> None:
    worst = "\n".join(f"{item}: {said}" for item, said in tally.failures[:20])
    assert not tally.failures, f"{len(tally.failures)} of {count} failed:\n{worst}"
    assert tally.total == count
    assert tally.said == "", tally.said  # no traces of calls, no warnings
    print(f"{count} files, slowest {tally.slowest}: {dict(tally.counts)}")


def test_a_good_file_is_read_by_each():
    items = [(name, -1) for name in READERS]
    tally = fuzz(items)
    passed(tally, len(items))
    assert tally.counts == {(name, "read"): 1 for name in READERS}


def test_few_of_each():
    items = [(name, number) for name in READERS for number in range(FEW)]
    tally = fuzz(items)
    passed(tally, len(items))
    for name in READERS:  # the mutators are neither too rough nor too gentle
        assert tally.counts[name, "refused"] > FEW / 4
        assert tally.counts[name, "read"] > 0 or READERS[name].sealed


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_many(name):
    items = [(name, number) for number in range(FEW, FEW + MANY)]
    passed(fuzz(items), len(items))


def test_the_corpus():
    items = [(name, str(path)) for name in READERS for path in fuzz_cases.corpus(name)]
    assert len(items) > 30
    assert all(Path(path).stat().st_size < 4096 for _, path in items)
    passed(fuzz(items), len(items))


def test_every_folder_of_the_corpus_has_a_reader():
    assert {path.name for path in fuzz_cases.CORPUS.iterdir()} <= set(READERS)


# -- what is no file -------------------------------------------------------------------------------


def _table(path: Path) -> object:
    return read_table(path, {}, "a table")


ANY = {
    "scene": load_scene,
    "scenes": load_scenes,
    "plan": load_plan,
    "log": event_log.read_log,
    "results": lambda path: results.read_results(path, {}),
    "json": read_json,
    "table": _table,
    "provenance": read_provenance,
    "checkpoint": lambda path: predictor_spec(str(path)).load(),
}
PLACES = [
    "nothing",
    "",
    "x" * 300,
    "x/" * 3000,
    "a\0b",
    "a\nb",
    "\x1b[2J",
    "\udcff",
    "../../..",
    "ä",
]


@pytest.mark.parametrize("reader", ANY)
def test_places_that_hold_no_file(reader, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop.jsonl").symlink_to(tmp_path / "loop.jsonl")
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "pipe")
    os.mkfifo(tmp_path / "pipe.jsonl")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        inside = ["folder", "loop.jsonl", "gone", "pipe", "pipe.jsonl", "socket", *PLACES]
        devices = ["/dev/zero", "/dev/random", "/dev/full", "/proc/self/mem"]
        for place in [*(tmp_path / name for name in inside), *map(Path, devices), Path()]:
            with pytest.raises(BadInput) as caught:
                ANY[reader](place)
            message = str(caught.value)
            assert message.isprintable() and len(message) <= fuzz_cases.LONGEST


def test_a_large_file_is_not_read(tmp_path):
    path = tmp_path / "large.jsonl"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # a hole
    for reader in ("scene", "plan", "log", "results", "json", "table", "provenance"):
        with pytest.raises(BadInput, match=r"large\.jsonl: too large \(1099511627776 bytes\)"):
            ANY[reader](path)


def test_a_file_that_grows_while_it_is_read():
    # /proc says that its files are empty.
    with pytest.raises(BadInput, match="too large"):
        read_file("/proc/self/smaps", "little", 100)
    assert read_file("/proc/self/comm", "a name", 100)


@pytest.mark.parametrize("name", PLACES[2:6])
def test_what_cannot_be_written_is_refused(tmp_path, name):
    if name in ("a\nb",):
        return  # a file may be called so
    with pytest.raises(BadInput, match="cannot be written"):
        write_atomically(tmp_path / name, b"x")
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


@pytest.mark.parametrize("name", ["../x", "/etc/x", "", ".", "..", "a/b", "a\0b"])
def test_a_plan_is_not_written_outside_its_folder(name):
    with pytest.raises(BadInput, match="scene: expected a name"):
        plan_path("plans", name)


def test_scene_files_of_any_name_are_in_some_order(tmp_path):
    for name in ("²", "1²3", "٣", "a1", "a02", "1", "\udcff", " ", "1" * 200):
        (tmp_path / f"{name}.xml").write_bytes(fuzz_cases.scene_files()[-1])
    assert len(load_scenes(tmp_path)) == 9


def test_a_scene_of_too_many_objects_is_refused_before_they_are_compared(tmp_path):
    path = tmp_path / "s.xml"
    path.write_bytes(fuzz_cases.mjcf([(0.4, 0.0)] * 15_000, plain=True))
    with pytest.raises(BadInput, match="has 15000 objects; expected at most 120"):
        load_scene(path)


# -- messages --------------------------------------------------------------------------------------


def test_a_message_is_one_line_whatever_it_quotes():
    assert str(BadInput("x.xml: a\nb\r\nc\x1b[2J\udcff\0")) == "x.xml: a b c\\x1b[2J\\udcff\\x00"
    long = str(BadInput("file: " + "y" * 10**7 + ", expected less"))
    assert len(long) == 500 and long.startswith("file: yy") and long.endswith("y, expected less")
    assert str(BadInput(str(BadInput("a\nb")))) == "a b"


def test_any_value_can_be_shown():
    deep: list = []
    for _ in range(100_000):
        deep = [deep]
    assert short_repr(deep) == "a list" and short_repr(10**5000) == "a int"
    assert short_repr("a\nb") == r"'a\nb'" and short_repr("z" * 100) == "'" + "z" * 56 + "..."
    while deep:  # unnested by hand: its end must not be a recursion either
        deep = deep[0]


# -- the decoder's process -------------------------------------------------------------------------


def test_a_decoder_that_dies_is_started_again():
    good = fuzz_cases.run_tables()[0]
    frame, metadata = decoder.decode(good)
    assert decoder._process is not None and "pgf_jax" in metadata
    decoder._process._popen.kill()
    with pytest.raises(decoder.Undecodable, match="its decoder died, exit code -9"):
        decoder.decode(good)
    assert decoder.decode(good)[0].equals(frame)


def test_a_decoder_that_takes_too_long_is_ended(monkeypatch):
    good = fuzz_cases.run_tables()[0]
    decoder.decode(good)
    assert decoder._process is not None
    os.kill(decoder._process._popen.pid, 19)  # stopped
    with monkeypatch.context() as patch:
        patch.setattr(decoder, "SECONDS", 0.2)
        with pytest.raises(decoder.Undecodable, match="takes longer than"):
            decoder.decode(good)
    assert len(decoder.decode(good)[0])


def test_a_table_that_would_fill_the_memory_is_refused(tmp_path):
    """Half a MB that is 6e8 equal numbers: 5 GB."""
    path = tmp_path / "bomb.parquet"
    path.write_bytes(_bomb(5000))
    assert path.stat().st_size < 600_000
    with pytest.raises(BadInput, match=r"bomb\.parquet: .*\(its decoder died, exit code -6\)"):
        _table(path)
    path.write_bytes(_bomb(5))
    assert len(decoder.decode(path.read_bytes())[0]) == 5 * _EACH


_EACH = 120_000


def _bomb(times: int) -> bytes:
    """A row group of equal numbers, many times over: by a footer that lists it so often."""
    buffer = io.BytesIO()
    frame = pl.select(pl.repeat(7, _EACH, dtype=pl.Int64).alias("a"))
    frame.write_parquet(buffer, statistics=False)
    data = buffer.getvalue()
    (size,) = struct.unpack("<I", data[-8:-4])
    footer = data[-8 - size : -8]
    # Thrift: the number of rows, and a list of one group, which ends with its own number, 0.
    found = re.search(
        rb"\x16(...)\x19\x1c(\x19\x1c&.*?\x14\x00\x00)\x19\x1c\x18", footer, re.DOTALL
    )
    assert found is not None and found[1] == _varint(2 * _EACH)
    new = footer[: found.start()] + b"\x16" + _varint(2 * _EACH * times)
    new += b"\x19\xfc" + _varint(times) + found[2] * times + footer[found.end(2) :]
    return data[: -8 - size] + new + struct.pack("<I", len(new)) + b"PAR1"


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def test_an_end_of_this_process_ends_the_decoder(tmp_path):
    path = tmp_path / "runs.parquet"
    path.write_bytes(fuzz_cases.run_tables()[0])
    code = (
        "import sys, os; from pgf_jax.tables import decoder\n"
        f"decoder.decode(open({str(path)!r}, 'rb').read())\n"
        "print(decoder._process._popen.pid, flush=True); os._exit(0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stderr == ""
    pid = int(done.stdout)
    for _ in range(100):
        if not _alive(pid):
            return
        subprocess.run(["sleep", "0.1"], check=True)
    raise AssertionError("it lives on")


def _alive(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


def test_costs_near_the_largest_float_are_left_out(tmp_path):
    path = tmp_path / "forks.parquet"
    path.write_bytes(fuzz_cases.fork_tables()[0])
    frame = read_forks(path)
    huge = pl.when(pl.col("seed") == 1).then(1e308).otherwise(pl.col("alone")).alias("alone")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        forks = forks_of(frame.with_columns(huge))
    assert len(forks.gain) == 2 and np.isfinite(forks.gain).all()
