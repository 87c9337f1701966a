"""A process that reads hostile files, so that one that crashes it, or never ends, is found out."""

import collections
import dataclasses
import multiprocessing
import os
import resource
import shutil
import tempfile
import time
import traceback
import warnings
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

SECONDS = 10.0  # for one file, at most; less for nearly all
MEMORY = 6 << 30  # address space beyond what the process begins with

Item = tuple[str, int | str]  # reader, and number of the case or path of a file


@dataclasses.dataclass
class Tally:
    """What came of the files.

    Attributes:
      counts: (reader, "read" or "refused") -> files.
      failures: what went wrong, with the case, and the file's bytes.
      slowest: seconds, and which.
    """

    counts: collections.Counter
    failures: list[tuple[Item, str]]
    slowest: tuple[float, Item | None] = (0.0, None)
    said: str = ""  # on standard error

    @property
    def total(self) -> int:
        return sum(self.counts.values())


def fuzz(items: Sequence[Item]) -> Tally:
    """Read all of them, in one process as long as it lives."""
    tally = Tally(collections.Counter(), [])
    rest = list(items)
    with tempfile.TemporaryDirectory(prefix="fuzz") as folder:
        errors = Path(folder) / "stderr"
        while rest:
            rest = _some(rest, tally, Path(folder), errors)
        tally.said = errors.read_text(errors="replace")
    return tally


def _some(items: list[Item], tally: Tally, folder: Path, errors: Path) -> list[Item]:
    """Those that one process comes to; the others are returned."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, items, folder, errors), daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(120) or ours.recv() != "ready":
            raise RuntimeError("the process does not start")
        for number, item in enumerate(items):
            began = time.monotonic()
            if not ours.poll(SECONDS):
                said = f"takes longer than {SECONDS:g} s"
            else:
                try:
                    said = ours.recv()
                except EOFError:
                    process.join()
                    said = f"crashed, exit code {process.exitcode}"
            took = time.monotonic() - began
            if took > tally.slowest[0]:
                tally.slowest = took, item
            if said in ("read", "refused"):
                tally.counts[item[0], said] += 1
            else:
                tally.counts[item[0], "failed"] += 1
                tally.failures.append((item, said))
            if said.startswith(("takes longer", "crashed")):
                return items[number + 1 :]
        return []
    finally:
        process.kill()
        process.join()


def _work(theirs: Connection, items: list[Item], folder: Path, errors: Path) -> None:
    os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
    import fuzz_cases

    warnings.simplefilter("error")  # a warning is a line that nobody asked for
    fuzz_cases.fewer_resamples()
    fuzz_cases.once_for_good_files()
    for name in {name for name, _ in items}:  # what is imported late is no file's fault
        _outcome(fuzz_cases, (name, -1), folder)
    _limit()
    theirs.send("ready")
    for item in items:
        try:
            said = _outcome(fuzz_cases, item, folder)
        except Exception:
            said = "the harness: " + traceback.format_exc()
        theirs.send(said)


def _outcome(cases, item: Item, folder: Path) -> str:
    name, which = item
    data = cases.case(name, which) if isinstance(which, int) else Path(which).read_bytes()
    place = folder / "case"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    return cases.outcome(name, data, place)


def _limit() -> None:
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
