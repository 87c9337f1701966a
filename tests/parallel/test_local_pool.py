"""Worker processes that share work: what they return, how they fail, and how they stop."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest

from pgf_jax.cores import usable
from pgf_jax.errors import BadInput
from pgf_jax.parallel.jax_settings import jax_settings
from pgf_jax.parallel.local import LocalPool, Stopped, WorkerDied, report, stop_requested

# Targets are imported by name in the processes.


def doubled(part):
    for i in range(part):
        report((part, i))
    return 2 * part


def cores(part):
    return usable()


def settings(part):
    return jax_settings()


def troubled(part):
    """Does what its part says."""
    if part == "bad input":
        raise BadInput("scene: expected another")
    if part == "fails":
        raise ZeroDivisionError("by zero")
    if part == "dies":
        os._exit(3)
    if part == "says":
        report(os.getpid())
    while not stop_requested():
        if part == "says much":
            report(bytes(1 << 20))
        time.sleep(0.01)
    raise Stopped


def stores(folder):
    """Says which process it is, and stores what it has when it is told to stop."""
    (folder / f"{os.getpid()}.began").touch()
    while not stop_requested():
        time.sleep(0.01)
    (folder / f"{os.getpid()}.stored").touch()
    raise Stopped


def never_stops(folder):
    (folder / f"{os.getpid()}.began").touch()
    time.sleep(600)


def unheard(message):
    raise AssertionError(message)


def run(target, parts, on_message):
    with LocalPool(max(len(parts), 1)) as pool:
        return pool.run(target, parts, on_message)


def test_results_and_messages_come_back():
    heard = []
    results = run(doubled, [3, 2], heard.append)
    assert results == [6, 4]  # in the order of the parts, whoever is done first
    assert len(heard) == 5
    for part in (2, 3):  # of each in its order
        assert [i for p, i in heard if p == part] == list(range(part))
    assert run(doubled, [], unheard) == []


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system does not say")
def test_each_has_cores_of_its_own():
    taken = run(cores, [0, 1], unheard)
    if len(usable()) > 1:
        assert sorted(core for part in taken for core in part) == usable()
    assert all(part and set(part) <= set(usable()) for part in taken)
    with LocalPool(1, cores=usable()[-1:]) as pool:
        assert pool.submit(usable).result() == usable()[-1:]


def test_they_adopt_the_settings_of_jax():
    name = "jax_default_matmul_precision"
    before = getattr(jax.config, name)
    jax.config.update(name, "float32")
    try:
        assert run(settings, [0], unheard) == [jax_settings()]
        assert jax_settings()[name] == "float32" != before
    finally:
        jax.config.update(name, before)


@pytest.mark.parametrize(
    ("trouble", "error", "message"),
    [
        ("bad input", BadInput, r"^scene: expected another$"),
        ("fails", ZeroDivisionError, r"^by zero$"),
        ("dies", WorkerDied, r"^a process ended early$"),
    ],
)
def test_trouble_in_one_ends_all(trouble, error, message):
    """The other one would wait for ever."""
    before = time.monotonic()
    with pytest.raises(error, match=message) as caught:
        run(troubled, ["waits", trouble], unheard)
    assert time.monotonic() - before < 50  # it was told, not ended after a minute
    assert multiprocessing.active_children() == []
    if trouble == "fails":  # where it happened is said
        assert 'raise ZeroDivisionError("by zero")' in str(caught.value.__cause__)


def test_one_that_nobody_listens_to_any_more_stops_too():
    """Its messages are longer than what fits between two processes."""

    def interrupted(message):
        time.sleep(0.3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(troubled, ["says much"], interrupted)
    assert multiprocessing.active_children() == []


def test_an_interruption_here_ends_them():
    def interrupted(message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(troubled, ["says"], interrupted)
    assert multiprocessing.active_children() == []


# -- a parent that is interrupted or killed --------------------------------------------------------


@contextlib.contextmanager
def parent(folder, grace_s, target="stores"):
    """A process that runs `target` in two others; in a process group of their own."""
    process = subprocess.Popen(
        [sys.executable, __file__, folder, str(grace_s), target],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: len(pids(folder)) == 2)
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=60)


def pids(folder: Path, ending: str = "began") -> list[int]:
    return sorted(int(path.stem) for path in folder.glob(f"*.{ending}"))


def wait_until(happened) -> None:
    end = time.monotonic() + 60
    while not happened():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.02)


def test_ctrl_c_is_the_parents_and_workers_store_what_they_have(tmp_path):
    with parent(tmp_path, 0) as process:
        os.killpg(process.pid, signal.SIGINT)  # to all of them, as a terminal does
        said, errors = process.communicate(timeout=60)
        assert said == "interrupted\n" and errors == ""  # no traces of the workers
        assert pids(tmp_path, "stored") == pids(tmp_path)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("grace_s", "target"), [(0.0, "stores"), (1.5, "stores"), (1.5, "never_stops")]
)
def test_workers_end_with_their_parent(tmp_path, grace_s, target):
    with parent(tmp_path, grace_s, target) as process:
        process.kill()
        began = time.monotonic()
        wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids(tmp_path)))
        assert time.monotonic() - began < 30
        # Where they are given a moment, they store what they have.
        stored = pids(tmp_path) if grace_s and target == "stores" else []
        assert pids(tmp_path, "stored") == stored


if __name__ == "__main__":
    with LocalPool(2, grace_s=float(sys.argv[2])) as workers:
        try:
            workers.run(globals()[sys.argv[3]], [Path(sys.argv[1])] * 2, print)
        except KeyboardInterrupt:
            print("interrupted")
