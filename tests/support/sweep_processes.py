"""Sweeps as processes of their own, to be killed: started, watched, compared."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

HERE = Path(__file__).parent
RESULTS = (
    *("tasks.parquet", "events.parquet", "summary.csv", "fleets.csv", "paired.csv"),
    "fig6.png",
)
POLICIES = [
    "autonomous",
    "or-hitl",
    "or-hitl-window",
    "always",
    "random",
    "queue",
    "pgf",
    "classifier",
]
SIZES = ["1", "2", "3", "4", "5"]
CELLS = len(POLICIES) * len(SIZES)  # 40
# Sizes of a sweep that takes some ten seconds, compilation not included.
FORTY = ["--robots", *SIZES, "--policies", *POLICIES, "--tasks", "1", "--seed", "3"]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "pgf_jax", *arguments]


def start(out: Path, *arguments: str) -> subprocess.Popen:
    """A sweep of forty cells, in a process group of its own."""
    return subprocess.Popen(
        command("sweep", *FORTY, "--out", str(out), *arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(out: Path, *arguments: str) -> str:
    """The sweep to its end; what it said on standard error."""
    process = start(out, *arguments)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    return err


def cells(out: Path) -> list[Path]:
    """Cells that are finished."""
    return sorted((out / "cells").glob("*.parquet"))


def content(out: Path) -> dict[str, bytes]:
    """All that must be the same, and nothing else may be there but what varies from run to run."""
    names = [*RESULTS, "manifest.json"]
    files = {name: (out / name).read_bytes() for name in names}
    files |= {f"cells/{path.name}": path.read_bytes() for path in cells(out)}
    others = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} - set(files)
    beside = {name.replace(".parquet", ".json") for name in files if name.startswith("cells/")}
    assert others == beside | {"run.json"}
    return files


def wait_for(what: Callable[[], object], seconds: float = 120.0) -> object:
    """What is truthy at last."""
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.02)
    return found


def children(pid: int) -> list[int]:
    """Processes that a process has started by `spawn`, its resource tracker not among them."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid and b"spawn_main" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return sorted(found)


def kill_group(process: subprocess.Popen) -> None:
    """SIGKILL to a sweep and all its processes at once."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)


def _path() -> list[str]:
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


# -- Dask ----------------------------------------------------------------------------------------


class Cluster:
    """A Dask scheduler and workers, each a process to be killed."""

    def __init__(self, folder: Path, host: str = "127.0.0.1") -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        with socket.create_server((host, 0)) as free:
            port = free.getsockname()[1]
        self.address = f"tcp://{host}:{port}"
        self.scheduler = self._run(
            "scheduler", "--host", host, "--port", str(port), "--no-dashboard"
        )
        self.workers: list[subprocess.Popen] = []

    def add_worker(self, *before: str) -> None:
        """A worker of one thread, in whatever surroundings `before` makes."""
        words = ("--nthreads", "1", "--no-dashboard", "--local-directory", str(self.folder))
        words += ("--preload", "sweep_toys")
        self.workers.append(self._run("worker", self.address, *words, before=before))

    def _run(self, *words: str, before: tuple[str, ...] = ()) -> subprocess.Popen:
        number = len(list(self.folder.glob("*.log")))
        with open(self.folder / f"{words[0]}{number}.log", "wb") as log:
            return subprocess.Popen(
                [*before, sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]],
                stdout=log,
                stderr=log,
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), *_path()])},
            )

    def wait(self) -> None:
        """Until all workers are there: a sweep makes batches for those that it finds."""
        logs = [self.folder / f"worker{i + 1}.log" for i in range(len(self.workers))]
        wait_for(lambda: all(b"Registered to" in log.read_bytes() for log in logs))

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            kill_group(process)


@contextlib.contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[Cluster]:
    running = Cluster(folder)
    try:
        for _ in range(workers):
            running.add_worker()
        running.wait()
        yield running
    finally:
        running.close()


def worker_processes(running: Cluster) -> list[int]:
    """The processes that compute: each worker's is a child of its nanny."""
    return [pid for nanny in running.workers for pid in children(nanny.pid)]
