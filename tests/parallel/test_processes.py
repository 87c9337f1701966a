"""Processes that share work: what they return, and how they fail."""

import multiprocessing
import os
import time

import pytest

from pgf_jax.cores import usable
from pgf_jax.errors import BadInput
from pgf_jax.parallel.processes import Stopped, run_in_processes

# Targets are imported by name in the processes.


def doubled(part, say, stop):
    for i in range(part):
        say((part, i))
    return 2 * part


def cores(part, say, stop):
    return usable()


def troubled(part, say, stop):
    """Does what its part says."""
    if part == "bad input":
        raise BadInput("scene: expected another")
    if part == "fails":
        raise ZeroDivisionError("by zero")
    if part == "dies":
        os._exit(3)
    if part == "says":
        say(os.getpid())
    while not stop():
        time.sleep(0.01)
    raise Stopped


def unheard(message):
    raise AssertionError(message)


def test_results_and_messages_come_back():
    heard = []
    results = run_in_processes(doubled, [2, 3], heard.append)
    assert sorted(results) == [4, 6]
    for part in (2, 3):  # of each in its order
        assert [i for p, i in heard if p == part] == list(range(part))
    assert run_in_processes(doubled, [], unheard) == []


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system does not say")
def test_each_has_cores_of_its_own():
    taken = run_in_processes(cores, [0, 1], unheard)
    if len(usable()) > 1:
        assert sorted(core for part in taken for core in part) == usable()
    assert all(part and set(part) <= set(usable()) for part in taken)


@pytest.mark.parametrize(
    ("trouble", "error", "message"),
    [
        ("bad input", BadInput, r"^scene: expected another$"),
        ("fails", RuntimeError, r"a process failed:\n(.*\n)*ZeroDivisionError: by zero"),
        ("dies", RuntimeError, r"a process ended early \(exit code 3\); what it had finished is"),
    ],
)
def test_trouble_in_one_ends_all(trouble, error, message):
    """The other one would wait for ever."""
    before = time.monotonic()
    with pytest.raises(error, match=message):
        run_in_processes(troubled, ["waits", trouble], unheard)
    assert time.monotonic() - before < 50  # it was told, not ended after a minute
    assert multiprocessing.active_children() == []


def test_an_interruption_here_ends_them():
    def interrupted(message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_in_processes(troubled, ["says"], interrupted)
    assert multiprocessing.active_children() == []
