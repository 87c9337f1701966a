"""Cells of sweeps, computed: in this process, or in several that each take whole cells."""

import dataclasses
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

from pgf_jax.study.computer import computer as make_computer
from pgf_jax.study.computer import warm_up
from pgf_jax.study.crew import Crew, drive
from pgf_jax.study.processes import Say, Stopped, run_in_processes
from pgf_jax.study.results import events_frame, tasks_frame, write_cell
from pgf_jax.study.sweep_config import Cell
from pgf_jax.study.sweep_setup import Setup, identity
from pgf_jax.study.trees import Trees


class Job(NamedTuple):
    """A cell of one of the sweeps that are run together."""

    sweep: int  # number of its setup
    cell: Cell


@dataclasses.dataclass(frozen=True)
class Effort:
    """What a process took: of the wall clock, so for the manifest only.

    Attributes:
      wall_s: in all, compilation included, s.
      compile_s: time of the first call of each program, compilation included, s.
      iterations: that robots asked for.
      steps: iterations computed, those of the operators' trials included; fewer where fleets go
        the same way.
      calls: of the engine, one an iteration of up to L robots.
      used: work whose result was used, in the engine's units (see `Computer.occupancy`).
      computed: work done, empty lanes included.
      saturated: rollouts with a knot end at which every contact slot was in use.
    """

    wall_s: float = 0.0
    compile_s: float = 0.0
    iterations: int = 0
    steps: int = 0
    calls: int = 0
    used: int = 0
    computed: int = 0
    saturated: int = 0

    def __add__(self, other: "Effort") -> "Effort":
        mine, theirs = dataclasses.astuple(self), dataclasses.astuple(other)
        return Effort(*(a + b for a, b in zip(mine, theirs, strict=True)))


class Listener(Protocol):
    """Hears how cells proceed."""

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """So many tasks of a cell have ended; its fleet's clock stands at `time_ns`."""
        ...

    def finished(self, job: Job) -> None:
        """Its files are written."""
        ...


def run_cells(
    setups: Sequence[Setup],
    jobs: Sequence[Job],
    listener: Listener,
    *,
    stop: Callable[[], bool] = lambda: False,
) -> Effort:
    """Compute cells in this process; each is written when it is finished.

    Cells whose planners are alike share a queue, and those whose tasks are, their trees.

    Args:
      setups: of the sweeps.
      jobs: in any company: no cell's results depend on the others.
      listener: told after every call of the engine.
      stop: asked after every call whether to give up.

    Raises:
      Stopped: `stop` said so; finished cells have been written.
    """
    effort = Effort()
    for alike in _grouped(jobs, lambda job: setups[job.sweep].programs()):
        effort += _run_alike(setups, alike, listener, stop)
    return effort


def _run_alike(
    setups: Sequence[Setup], jobs: Sequence[Job], listener: Listener, stop: Callable[[], bool]
) -> Effort:
    start = time.perf_counter()
    computer = make_computer(*setups[jobs[0].sweep].programs())
    trees: dict[Hashable, Trees] = {}
    for job in jobs:
        setup = setups[job.sweep]
        if setup.lineage() not in trees:
            trees[setup.lineage()] = Trees(
                computer,
                scenes=setup.scene,
                operator=setup.operator(),
                seed=setup.config.seed,
            )
    setup = setups[jobs[0].sweep]
    compile_s = warm_up(computer, trees[setup.lineage()].tree(0, 0).root.search, setup.config.seed)
    crews, fleets = [], []
    for number, cell in jobs:
        setup = setups[number]
        crew = Crew(
            trees[setup.lineage()],
            robots=cell.robots,
            tasks=cell.tasks,
            predictor=setup.bidder_of(cell),
        )
        crews.append(crew)
        fleets.append(setup.new_fleet(cell, crew))
    running = dict(zip(jobs, fleets, strict=True))

    def after_round() -> None:
        for job, fleet in list(running.items()):
            listener.progress(job, len(fleet.records), fleet.now_ns)
            if fleet.done:
                setup = setups[job.sweep]
                tasks = tasks_frame(fleet.records, setup.scene_name)
                events = events_frame(fleet.events)
                about = identity(setup, job.cell)
                write_cell(setup.config.out, job.cell, about, tasks, events)
                listener.finished(job)
                del running[job]
        if running and stop():
            raise Stopped

    iterations = drive(zip(fleets, crews, strict=True), computer, on_round=after_round)
    after_round()  # the last ones end without another call
    steps, calls = computer.steps, computer.calls
    return Effort(
        time.perf_counter() - start,
        compile_s,
        iterations,
        steps,
        calls,
        *computer.occupancy(),
        computer.saturated,
    )


def _grouped(items: Iterable[Any], key: Callable[[Any], Hashable]) -> list[list[Any]]:
    """Items of one key together, in the order of their first ones."""
    groups: dict[Hashable, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())


# -- several processes -------------------------------------------------------------------------


def shares(setups: Sequence[Setup], jobs: Sequence[Job], workers: int) -> list[list[Job]]:
    """Whole cells to each process: the largest first, to whoever has the fewest tasks so far.

    Cells that share trees stay together where there are enough such families to go round.
    """
    families = _grouped(jobs, lambda job: setups[job.sweep].lineage())
    if len(families) < workers:
        families = [[job] for job in jobs]

    def tasks(family: list[Job]) -> int:
        return sum(cell.robots * cell.tasks for _, cell in family)

    parts: list[list[Job]] = [[] for _ in range(min(workers, len(families)))]
    load = [0] * len(parts)
    for family in sorted(families, key=tasks, reverse=True):
        least = load.index(min(load))
        parts[least] += family
        load[least] += tasks(family)
    return parts


def run_cells_in_processes(
    setups: Sequence[Setup], jobs: Sequence[Job], workers: int, listener: Listener
) -> list[Effort]:
    """Compute cells in processes of their own; see `run_cells` and `run_in_processes`."""

    def hear(message: tuple[str, tuple[Any, ...]]) -> None:
        kind, content = message
        (listener.progress if kind == "progress" else listener.finished)(*content)

    parts = [(setups, part) for part in shares(setups, jobs, workers)]
    return run_in_processes(_cells_of_a_process, parts, hear)


class _Sender:
    """A `Listener` that passes on to the parent process."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._told: dict[Job, int] = {}

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        if self._told.get(job) != tasks:
            self._told[job] = tasks
            self._say(("progress", (job, tasks, time_ns)))

    def finished(self, job: Job) -> None:
        self._say(("finished", (job,)))


def _cells_of_a_process(
    part: tuple[Sequence[Setup], Sequence[Job]], say: Say, stop: Callable[[], bool]
) -> Effort:
    setups, jobs = part
    return run_cells(setups, jobs, _Sender(say), stop=stop)
