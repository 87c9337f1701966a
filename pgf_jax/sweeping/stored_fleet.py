"""Stored fleets, simulated again: a recorded session, or a cell of a sweep."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from pgf_jax.errors import BadInput
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.simulation.snapshot import FleetSnapshot
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.replay import replay, replay_difference
from pgf_jax.sweeping.resolve import config_of, resolve
from pgf_jax.tables.event_log import first_difference
from pgf_jax.tables.results import event_log


class CellChoice(NamedTuple):
    """Which cells of a sweep are meant; None: any.

    Attributes:
      policy: name of the policy.
      robots: fleet size.
      seed: of the fleet.
    """

    policy: str | None = None
    robots: int | None = None
    seed: int | None = None


def is_sweep(path: Path) -> bool:
    """Whether a path is a folder with cells of a sweep."""
    return (path / cell_file.FOLDER).is_dir()


def stored_cells(
    folder: Path, choice: CellChoice | None = None
) -> Iterator[tuple[Path, cell_file.Content]]:
    """The chosen cells of a sweep, finished or not: file and content.

    Raises:
      BadInput: the folder holds no results of a sweep; or a cell is not as it was written.
    """
    if not is_sweep(folder):
        raise BadInput(f"{folder}: holds no results of a sweep (no folder {cell_file.FOLDER})")
    for key in sorted(cell_file.finished(folder)):
        file = cell_file.path(folder, key)
        content = cell_file.read(file)
        wanted = choice or CellChoice()
        if all(want in (None, got) for want, got in zip(wanted, _fleet_of(content), strict=True)):
            yield file, content


def _fleet_of(content: cell_file.Content) -> CellChoice:
    fleet: Any = content.about["identity"].get("fleet")
    found = fleet if isinstance(fleet, dict) else {}
    return CellChoice(*(found.get(name) for name in CellChoice._fields))


class StoredFleet:
    """A stored fleet, simulated again.

    Args:
      path: the log of a session, its folder, or the folder of a sweep.
      choice: which cell of the sweep; it must be one.

    Attributes:
      path: as given.
      runner: of the fleet, before its first event.

    Raises:
      BadInput: it is none of these, or several cells are meant, or none; or its settings cannot be
        used here.
    """

    def __init__(self, path: Path | str, choice: CellChoice | None = None) -> None:
        self.path = Path(path)
        if is_sweep(self.path):
            file, content = _one_cell(self.path, choice)
            (cell,) = resolve(config_of(content.about, cell_file.inputs(file), self.path)).cells
            self.runner = FleetRunner.of(cell.fleet)
            self._events, self._log = event_log(content.events), None
        else:
            if choice is not None and any(value is not None for value in choice):
                raise BadInput(
                    f"{path}: expected a sweep's folder, with policy, robots or seed; a session "
                    "has one fleet"
                )
            self.runner, self._log = replay(path)

    def check(self) -> None:
        """BadInput where the fleet, which is done, has other events than those stored."""
        events = self.runner.fleet.events
        if self._log is not None:
            difference = replay_difference(events, self._log)
            if difference is not None:
                raise BadInput(difference)
            return
        number = first_difference(events, self._events)
        if number is not None or len(events) != len(self._events):
            number = len(self._events) if number is None else number
            raise BadInput(
                f"{self.path}: the fleet goes another way here from event {number + 1} on; it was "
                "computed by other code, or on another processor"
            )


def _one_cell(folder: Path, choice: CellChoice | None) -> tuple[Path, cell_file.Content]:
    found = list(stored_cells(folder, choice))
    if len(found) == 1:
        return found[0]
    listed = found or list(stored_cells(folder))
    names = sorted(
        f"{policy} with {robots} robots, seed {seed}"
        for policy, robots, seed in (_fleet_of(content) for _, content in listed)
    )
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    what = "several fleets" if found else "no such fleet"
    raise BadInput(
        f"{folder}: {what}; choose by policy, robots and seed one of: {'; '.join(names[:6])}{more}"
    )


def snapshots(
    path: Path | str,
    *,
    every_ns: int,
    start_ns: int = 0,
    stop_ns: int | None = None,
    choice: CellChoice | None = None,
) -> Iterator[FleetSnapshot]:
    """Simulate a stored fleet again, and yield what a person may see of it at regular times.

    Args:
      path: see `StoredFleet`.
      every_ns: simulated time from one snapshot to the next, ns.
      start_ns, stop_ns: simulated times of the first, and of the last at most; None: the end.
      choice: see `StoredFleet`.

    Raises:
      BadInput: as `StoredFleet`; or, at the end, its events differ from those stored.
    """
    stored = StoredFleet(path, choice)
    runner, time_ns = stored.runner, start_ns
    while stop_ns is None or time_ns <= stop_ns:
        runner.run_until(time_ns)
        yield runner.observer.snapshot(time_ns)
        if runner.fleet.done:
            break
        time_ns += every_ns
    if runner.fleet.done:
        stored.check()
