"""A batch in a worker: what it writes and what it returns, when it stops, what it refuses."""

import dataclasses
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from pathlib import Path

import pytest
from sweep_toys import ghost, tree

from pgf_jax import provenance
from pgf_jax.cores import usable
from pgf_jax.errors import BadInput
from pgf_jax.parallel.local import LocalPool, Stopped, WorkerDied
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.resolve import resolve
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.sweeping.worker import Batch, open_session, read_progress, run_batch


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return sweep(ghost(tmp_path_factory.mktemp("batch") / "whole"), quiet=True)


def batch_of(out: Path, **changes) -> Batch:
    batch = Batch(0, "s", resolve(ghost(out)).cells, provenance.kind())
    return dataclasses.replace(batch, **changes)


def begun(out: Path):
    (out / "cells").mkdir(parents=True)
    return open_session([out], "s")


# -- where cells go ----------------------------------------------------------------------------


def test_where_the_session_is_seen_cells_are_written(whole, tmp_path):
    batch = pickle.loads(pickle.dumps(batch_of(tmp_path)))  # as a worker gets it
    with begun(tmp_path):
        result = run_batch(batch)
        assert result.returned == () and result.stats.iterations > 0
        assert set(read_progress(batch).finished) == {0, 1, 2, 3}
        assert all(batch.is_finished(cell) for cell in batch.cells)
    files = {path.name: path.read_bytes() for path in whole.files.values()}
    found = tree(tmp_path / "cells")
    assert {name: data for name, data in found.items() if name.endswith(".parquet")} == files
    assert len(found) == 8  # the session has left nothing


def test_elsewhere_they_are_returned(whole, tmp_path):
    result = run_batch(batch_of(tmp_path / "not here"))
    assert not (tmp_path / "not here").exists()
    files = {path.stem: path.read_bytes() for path in whole.files.values()}
    batch = batch_of(tmp_path / "home")
    for index, data, account in pickle.loads(pickle.dumps(result.returned)):
        cell_file.write(batch.cells[index].path, data, account)
    assert {
        cell.key: cell_file.path(tmp_path / "home", cell.key).read_bytes() for cell in batch.cells
    } == files
    assert all(batch.is_finished(cell) for cell in batch.cells)


def test_a_batch_that_is_sent_twice_is_computed_once(whole, tmp_path):
    """As Dask does when a worker dies."""
    batch = batch_of(tmp_path)
    with begun(tmp_path):
        _, first, second, _ = batch.cells
        file = first.path
        for path in (whole.files[first.cell], whole.files[second.cell]):
            shutil.copy(path, tmp_path / "cells")
        account = {"session": "s"}
        cell_file.write(file, file.read_bytes(), account)
        cell_file.write(second.path, b"of an earlier session", {"session": "r"})
        before = file.stat().st_ino
        run_batch(batch)
        assert file.stat().st_ino == before
        assert second.path.read_bytes() == whole.files[second.cell].read_bytes()


def test_the_end_of_the_session_stops_it(tmp_path, monkeypatch):
    from pgf_jax.sweeping import worker as module

    monkeypatch.setattr(module, "REPORT_EVERY_S", 0.0)
    batch = batch_of(tmp_path)
    with begun(tmp_path) as end:
        running = module.run_cells

        def ended(*arguments, **more):
            end()
            return running(*arguments, **more)

        monkeypatch.setattr(module, "run_cells", ended)
        with pytest.raises(Stopped):
            run_batch(batch)


def test_a_rest_is_what_is_not_finished(tmp_path):
    batch = batch_of(tmp_path)
    assert batch.rest(3).attempt == 2 and batch.rest(3).number == 3  # nothing was finished
    cell_file.write(batch.cells[2].path, b"x", {"session": "s"})
    rest = batch.rest(4)
    assert rest.attempt == 1 and rest.cells == (*batch.cells[:2], batch.cells[3])


@pytest.mark.parametrize(
    ("name", "value"), [("jax", "0.0.1"), ("source", "0" * 64), ("device", "abacus: wood")]
)
def test_a_worker_of_another_kind_refuses(tmp_path, name, value):
    batch = batch_of(tmp_path, kind=provenance.kind() | {name: value})
    ours = provenance.kind()[name]
    with pytest.raises(BadInput, match=rf"^worker on .*: has {name} .*{ours}, expected {value} as"):
        run_batch(batch)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "said", [b"", b"[", b"[1]", b"[[[0]], [1, 2]]", b"[[[9, 1, 1]], []]", b"{}", b'"ab"', b"7"]
)
def test_progress_that_is_no_progress(tmp_path, said):
    """A file that is being replaced on somebody's network disk may be anything."""
    batch = batch_of(tmp_path)
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / ".session-s.0").write_bytes(said)
    assert read_progress(batch).running == ()


# -- processes ---------------------------------------------------------------------------------


def die(number):
    os.kill(os.getpid(), signal.SIGKILL)


def who(seconds=0.0):
    time.sleep(seconds)
    return os.getpid(), usable()


def bad():
    raise BadInput("scene: expected another")


def test_processes_are_kept_and_have_cores_of_their_own():
    with LocalPool(2) as executor:
        assert isinstance(executor, Executor)
        futures = [executor.submit(who, 0.5) for _ in range(2)]
        futures += [executor.submit(who) for _ in range(6)]
        found = [future.result() for future in futures]
    cores = dict(found)
    assert len(cores) == 2 and os.getpid() not in cores
    taken = sorted(core for own in cores.values() for core in own)
    assert taken == usable() if len(usable()) > 1 else set(taken) == set(usable())


def test_one_that_dies_takes_nobody_along():
    with LocalPool(2) as executor:
        long = executor.submit(who, 3.0)
        with pytest.raises(WorkerDied, match="a process ended early"):
            executor.submit(die, 9).result()
        again = executor.submit(who)
        assert again.result()[0] != long.result()[0]


def test_exceptions_come_through():
    with LocalPool(1) as executor, pytest.raises(BadInput, match=r"^scene: expected another$"):
        executor.submit(bad).result()


CLAIMS = "from pgf_jax.cores import claim; print(claim(), claim(), flush=True); input()"


def test_processes_that_do_not_know_of_each_other_claim_different_cores():
    running = [
        subprocess.Popen(
            [sys.executable, "-c", CLAIMS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(len(usable()) + 1)
    ]
    said = [process.stdout.readline().split() for process in running]  # pyright: ignore[reportOptionalMemberAccess]
    for process in running:
        process.communicate("\n")
    assert all(first == second for first, second in said)  # claimed once
    claimed = [first for first, _ in said if first != "None"]
    assert len(set(claimed)) == len(claimed) <= len(usable())
    # Others on this computer may have claimed some; ours have all let go of theirs.
    assert not claimed or len(claimed) >= 1


# -- other executors ---------------------------------------------------------------------------


class Here(Executor):
    """Computes when it is asked to."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def test_any_executor_will_do(whole, tmp_path):
    result = sweep(ghost(tmp_path, workers=3), quiet=True, executor=Here())
    assert [path.read_bytes() for path in result.files.values()] == [
        path.read_bytes() for path in whole.files.values()
    ]
    assert len(result.computed) == 4
