"""Cells of sweeps, computed in this process."""

import dataclasses
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from pgf_jax.study.cells import Content
from pgf_jax.study.computer import computer as make_computer
from pgf_jax.study.computer import warm_up
from pgf_jax.study.crew import Crew, drive
from pgf_jax.study.processes import Stopped
from pgf_jax.study.results import events_frame, tasks_frame
from pgf_jax.study.sweep_config import Cell
from pgf_jax.study.sweep_setup import Setup, provenance
from pgf_jax.study.trees import Trees


class Job(NamedTuple):
    """A cell of one of the sweeps that are run together."""

    sweep: int  # number of its setup
    cell: Cell


@dataclasses.dataclass(frozen=True)
class Effort:
    """What a batch of cells took: of the wall clock, so not for the results.

    Attributes:
      wall_s: in all, compilation included, s.
      compile_s: time of the first call of each program, compilation included, s; 0 where the
        process has made one before.
      engine_s: time spent in calls of the engine, the planner and the networks, s.
      answering_s: that, and what is thought around it (an operator's candidates, say), s.
      iterations: that robots asked for.
      steps: iterations computed, those of the operators' trials included; fewer where fleets go
        the same way.
      calls: of the engine, one an iteration of up to L robots.
      used: work whose result was used, in the engine's units (see `Computer.occupancy`).
      computed: work done, empty lanes included.
    """

    wall_s: float = 0.0
    compile_s: float = 0.0
    engine_s: float = 0.0
    answering_s: float = 0.0
    iterations: int = 0
    steps: int = 0
    calls: int = 0
    used: int = 0
    computed: int = 0

    def __add__(self, other: "Effort") -> "Effort":
        mine, theirs = dataclasses.astuple(self), dataclasses.astuple(other)
        return Effort(*(a + b for a, b in zip(mine, theirs, strict=True)))


class Listener(Protocol):
    """Hears how cells proceed."""

    def progress(self, job: Job, tasks: int, time_ns: int) -> None:
        """So many tasks of a cell have ended; its fleet's clock stands at `time_ns`."""
        ...

    def finished(self, job: Job, content: Content) -> None:
        """A cell is finished: this is to be its file."""
        ...


def run_cells(
    setups: Mapping[int, Setup],
    jobs: Sequence[Job],
    listener: Listener,
    *,
    stop: Callable[[], bool] = lambda: False,
) -> Effort:
    """Compute cells in this process.

    Cells whose planners are alike share a queue, and those whose tasks are, their trees.

    Args:
      setups: of the sweeps, by number.
      jobs: in any company: no cell's results depend on the others.
      listener: told after every call of the engine.
      stop: asked after every call whether to give up.

    Raises:
      Stopped: `stop` said so; the listener has been given the finished cells.
    """
    effort = Effort()
    for alike in grouped(jobs, lambda job: setups[job.sweep].programs()):
        effort += _run_alike(setups, alike, listener, stop)
    return effort


def _run_alike(
    setups: Mapping[int, Setup], jobs: Sequence[Job], listener: Listener, stop: Callable[[], bool]
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
                listener.finished(job, Content(tasks, events, provenance(setup, job.cell)))
                del running[job]
        if running and stop():
            raise Stopped

    iterations = drive(zip(fleets, crews, strict=True), computer, on_round=after_round)
    after_round()  # the last ones end without another call
    steps, calls = computer.steps, computer.calls
    return Effort(
        time.perf_counter() - start,
        compile_s,
        computer.seconds,
        computer.answering_s,
        iterations,
        steps,
        calls,
        *computer.occupancy(),
    )


def grouped(items: Iterable[Any], key: Callable[[Any], Hashable]) -> list[list[Any]]:
    """Items of one key together, in the order of their first ones."""
    groups: dict[Hashable, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
