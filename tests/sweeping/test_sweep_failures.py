"""Sweeps that are killed, or run out of disk, and go on: nothing is lost, and nothing is twice."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweep_processes import (
    CELLS,
    HERE,
    Cluster,
    cells,
    children,
    cluster,
    command,
    content,
    finish,
    kill_group,
    start,
    wait_for,
    worker_processes,
)

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")

GHOSTS = HERE / "ghost_sweep.py"


def ghosts(out: Path, *arguments: str) -> subprocess.Popen:
    """A sweep of the toy engine, of twelve cells and two processes."""
    return subprocess.Popen(
        [sys.executable, str(GHOSTS), str(out), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ended(process: subprocess.Popen) -> tuple[int, str]:
    _, err = process.communicate(timeout=300)
    return process.returncode, err


def resumed(out: Path) -> tuple[int, str]:
    """The end of a sweep that is resumed, in one process: what it finds is the same, and sooner."""
    return ended(ghosts(out, "--resume", "--workers", "1"))


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """The toy sweep, undisturbed."""
    out = tmp_path_factory.mktemp("toy") / "whole"
    code, err = ended(ghosts(out))
    assert code == 0, err
    assert len(cells(out)) == 12
    return content(out)


# -- a few, with the toy engine ----------------------------------------------------------------


def test_a_worker_that_is_killed_is_replaced(toy, tmp_path):
    out = tmp_path / "out"
    process = ghosts(out, "--slow")
    wait_for(lambda: cells(out))
    victim = children(process.pid)[0]
    os.kill(victim, signal.SIGKILL)
    code, err = ended(process)
    assert code == 0, err
    assert "a process ended early" in err and "computed again" in err
    assert content(out) == toy


def test_a_worker_that_dies_again_and_again_is_given_up(toy, tmp_path):
    out = tmp_path / "out"
    process = ghosts(out, "--deadly")
    code, err = ended(process)
    assert code == 1 and err.splitlines()[-1].startswith("pgf-jax: a worker has died 3 times")
    assert "_R3" in err.splitlines()[-1] and "--resume" in err.splitlines()[-1]
    kept = {path.name: path.stat().st_ino for path in cells(out)}
    code, err = resumed(out)
    assert code == 0, err
    assert content(out) == toy
    assert {name: (out / "cells" / name).stat().st_ino for name in kept} == kept


def test_a_sweep_that_is_killed_goes_on(toy, tmp_path):
    out = tmp_path / "out"
    process = ghosts(out, "--slow")
    wait_for(lambda: cells(out))
    started = children(process.pid)
    os.kill(process.pid, signal.SIGKILL)  # its processes are not told
    process.communicate(timeout=60)
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in started))
    kept = {path.name: path.stat().st_ino for path in cells(out)}
    assert 0 < len(kept) < 12
    code, err = ended(ghosts(out, "--resume"))
    assert code == 0, err
    assert content(out) == toy
    assert {name: (out / "cells" / name).stat().st_ino for name in kept} == kept


def test_one_that_is_killed_after_its_cells_goes_on(toy, tmp_path):
    """While it makes the tables: there is nothing left to compute, but something to tidy up."""
    out = tmp_path / "out"
    process = ghosts(out)
    wait_for(lambda: len(cells(out)) == 12)
    kill_group(process)
    (out / "cells" / ".session-of-it").touch()
    (out / ".tasks.parquet.1.tmp").touch()
    code, err = resumed(out)
    assert code == 0, err
    assert content(out) == toy


def test_two_sweeps_do_not_share_a_folder(tmp_path):
    out = tmp_path / "out"
    first = ghosts(out, "--slow")
    wait_for(lambda: (out / "cells").is_dir() and any((out / "cells").iterdir()))
    code, err = ended(ghosts(out, "--resume"))
    assert code == 2 and err.endswith(f"out: {out} is in use by another sweep\n")
    kill_group(first)


def test_workers_of_dask_find_the_same(toy, tmp_path):
    """One is killed in the midst of it; then the scheduler is."""
    with cluster(tmp_path / "dask") as running:
        process = ghosts(tmp_path / "out", "--scheduler", running.address)
        wait_for(lambda: cells(tmp_path / "out"))
        os.kill(worker_processes(running)[0], signal.SIGKILL)
        code, err = ended(process)
        assert code == 0, err
        assert content(tmp_path / "out") == toy

        process = ghosts(tmp_path / "gone", "--scheduler", running.address)
        wait_for(lambda: cells(tmp_path / "gone"))
        running.scheduler.kill()
        code, err = ended(process)
        assert code in (0, 1), err
        if code:
            assert len(err.splitlines()[-1:]) == 1 and "Traceback" not in err
            assert f"the scheduler {running.address} has gone" in err
    code, err = resumed(tmp_path / "gone")
    assert code == 0, err
    assert content(tmp_path / "gone") == toy


@pytest.fixture
def small_disk(tmp_path):
    """Makes a folder on a file system of so many KiB."""
    if os.geteuid() != 0:
        pytest.skip("only root mounts")
    mounted = []

    def mount(kib: int) -> Path:
        folder = tmp_path / "disk"
        folder.mkdir()
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)],
            capture_output=True,
            check=False,
        )
        if done.returncode:
            pytest.skip("nothing can be mounted here")
        mounted.append(folder)
        return folder

    yield mount
    for folder in mounted:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize("kib", [0, pytest.param(64, marks=pytest.mark.slow), 150, 300])
def test_a_full_disk(toy, tmp_path, small_disk, kib):
    """One line, whatever is full when; with more room the same sweep goes on."""
    disk = small_disk(max(kib, 4))
    if not kib:
        (disk / "filler").write_bytes(bytes(4096))
    out = disk / "out"
    code, err = ended(ghosts(out))
    assert code == 2 and "Traceback" not in err
    assert "No space left on device" in err.splitlines()[-1]
    assert not [path for path in disk.rglob("*.tmp")]
    kept = {path.name: path.read_bytes() for path in cells(out)}
    subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
    code, err = resumed(out)
    assert code == 0, err
    whole = content(out)
    assert whole == toy and all(whole[f"cells/{name}"] == data for name, data in kept.items())


def test_a_folder_that_is_read_only(toy, tmp_path, small_disk):
    """From the start, and from one moment to the next."""
    disk = small_disk(20_000)
    out = disk / "out"
    process = ghosts(out, "--slow")
    wait_for(lambda: cells(out))
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=False)
    code, err = ended(process)
    if code == 0:
        pytest.skip("files were open: it could not be made read-only")
    assert code == 2 and "Read-only file system" in err.splitlines()[-1]
    before = {p: p.read_bytes() for p in disk.rglob("*") if p.is_file()}
    code, err = resumed(out)
    assert code == 2 and len(err.splitlines()) <= 2
    assert f"out: {out} cannot be written to" in err
    assert {p: p.read_bytes() for p in disk.rglob("*") if p.is_file()} == before
    subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
    code, err = resumed(out)
    assert code == 0, err
    assert content(out) == toy


# -- forty cells and real physics --------------------------------------------------------------


@pytest.fixture(scope="module")
def forty(tmp_path_factory):
    """The sweep of forty cells, undisturbed: its files, and how long it takes."""
    folder = tmp_path_factory.mktemp("forty")
    finish(folder / "first", "--workers", "2")
    begin = time.monotonic()
    finish(folder / "whole", "--workers", "2")
    seconds = time.monotonic() - begin
    whole = content(folder / "whole")
    assert len(whole) == 6 + CELLS
    assert content(folder / "first") == whole
    return whole, seconds


VICTIMS = ["a worker", "the whole sweep", "a worker of Dask", "the scheduler of Dask"]


@pytest.mark.slow
@pytest.mark.parametrize("victim", VICTIMS)
@pytest.mark.parametrize("trial", range(5))
def test_killed_at_a_random_moment(forty, tmp_path, victim, trial):
    whole, seconds = forty
    moment = random.Random(f"{victim} {trial}").uniform(0.0, 1.1) * seconds
    out = tmp_path / "out"
    if "Dask" in victim:
        _killed_with_dask(out, tmp_path / "dask", victim, moment)
    else:
        process = start(out, "--workers", "2")
        time.sleep(moment)
        if victim == "the whole sweep":
            kill_group(process)
        else:
            victims = children(process.pid)
            for pid in victims[:1]:
                os.kill(pid, signal.SIGKILL)
            code, err = ended(process)
            assert code == 0, err
    kept = {path.name: path.stat().st_ino for path in cells(out)}
    print(f"{victim} after {moment:.1f} s: {len(kept)} cells kept")
    finish(out, "--workers", "2", "--resume")
    assert content(out) == whole
    assert {name: (out / "cells" / name).stat().st_ino for name in kept} == kept


def _killed_with_dask(out: Path, folder: Path, victim: str, moment: float) -> None:
    with cluster(folder) as running:
        process = start(out, "--scheduler", running.address)
        time.sleep(moment)
        if victim == "a worker of Dask":
            os.kill(worker_processes(running)[0], signal.SIGKILL)
            code, err = ended(process)
            assert code == 0, err
        else:
            running.scheduler.kill()
            code, err = ended(process)
            # It may have been done before.
            assert code == 0 or (code in (1, 2) and "Traceback" not in err), err


# -- the same numbers everywhere ---------------------------------------------------------------


@pytest.mark.slow
def test_workers_here_and_there_find_the_same(forty, tmp_path):
    whole, _ = forty
    finish(tmp_path / "one", "--workers", "1")
    assert content(tmp_path / "one") == whole
    with cluster(tmp_path / "dask") as running:
        finish(tmp_path / "two", "--scheduler", running.address)
    assert content(tmp_path / "two") == whole


@pytest.mark.slow
def test_workers_in_other_networks_without_the_folder(forty, tmp_path):
    """Two network namespaces, each with a worker that does not see the folder of the results."""
    whole, _ = forty
    with networks() as (host, names):
        running = Cluster(tmp_path / "dask", host)
        hidden = tmp_path / "results"
        hidden.mkdir()
        hide = f'mount -t tmpfs tmpfs {hidden} && exec "$@"'
        try:
            for name in names:
                running.add_worker(
                    "ip", "netns", "exec", name, "unshare", "-m", "sh", "-c", hide, "sh"
                )
            running.wait()
            finish(hidden / "out", "--scheduler", running.address)
        finally:
            running.close()
        hosts = {_worker_of(path) for path in cells(hidden / "out")}
    assert len(hosts) == 2  # both have computed
    assert content(hidden / "out") == whole


@pytest.mark.slow
def test_workers_that_slurm_starts(forty, tmp_path, monkeypatch):
    """On a Slurm that runs here, and has two cores to spare."""
    states = shutil.which("sinfo") and subprocess.run(
        ["sinfo", "-h", "-o", "%T"], capture_output=True, text=True, check=False
    )
    if not states or "idle" not in states.stdout:
        pytest.skip("no Slurm with an idle node here")
    monkeypatch.chdir(tmp_path)  # where its logs lie
    finish(tmp_path / "out", "--scheduler", "slurm:2")
    assert content(tmp_path / "out") == forty[0]
    assert len({_worker_of(path) for path in cells(tmp_path / "out")}) == 2


def _worker_of(cell: Path) -> int:
    return json.loads(cell.with_suffix(".json").read_text())["host"]["pid"]


class networks:
    """Two network namespaces that reach this one, and each other through it."""

    host = "10.213.7.1"

    def __enter__(self):
        if os.geteuid() != 0 or shutil.which("ip") is None:
            pytest.skip("only root makes networks")
        self.names = [f"pgf{i}" for i in range(2)]
        self.__exit__()
        try:
            self._ip("link add pgfbr type bridge")
            self._ip(f"addr add {self.host}/24 dev pgfbr")
            self._ip("link set pgfbr up")
            for i, name in enumerate(self.names):
                self._ip(f"netns add {name}")
                self._ip(f"link add v{name} type veth peer name eth0 netns {name}")
                self._ip(f"link set v{name} master pgfbr up")
                self._ip(f"-n {name} addr add 10.213.7.{10 + i}/24 dev eth0")
                self._ip(f"-n {name} link set eth0 up")
                self._ip(f"-n {name} link set lo up")
        except subprocess.CalledProcessError as error:
            self.__exit__()
            pytest.skip(f"no networks can be made here ({error})")
        return self.host, self.names

    def __exit__(self, *_):
        for name in self.names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
        subprocess.run(["ip", "link", "del", "pgfbr"], capture_output=True, check=False)

    @staticmethod
    def _ip(words: str) -> None:
        subprocess.run(["ip", *words.split()], capture_output=True, check=True)


def test_a_scheduler_that_is_not_there(tmp_path):
    process = subprocess.run(
        command("sweep", "--scheduler", "tcp://127.0.0.1:9", "--out", str(tmp_path / "out")),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert process.returncode == 2
    assert "scheduler: tcp://127.0.0.1:9 does not answer" in process.stderr.splitlines()[-1]
    assert "Traceback" not in process.stderr
