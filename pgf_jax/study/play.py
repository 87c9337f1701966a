"""One fleet, run step by step: as the wall clock goes, or as somebody wants to look at it."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from pathlib import Path

from pgf_jax.errors import BadInput
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.guidance.operators import AnyOperator
from pgf_jax.study.computer import Computer, Queue, computer
from pgf_jax.study.crew import Crew, Robot
from pgf_jax.study.event_log import EventLog, read_log
from pgf_jax.study.recording import REPLAY, compare, replaying
from pgf_jax.study.snapshot import FleetSnapshot
from pgf_jax.study.sweep_config import Cell, SweepConfig
from pgf_jax.study.sweep_setup import Setup, prepare
from pgf_jax.study.trees import Trees
from pgf_jax.study.watch import Watch


@dataclasses.dataclass(eq=False)
class Play:
    """A fleet with its robots, the queue of their work, and who watches.

    Attributes:
      fleet, crew, computer, queue, watch: these.
    """

    fleet: Fleet
    crew: Crew
    computer: Computer
    queue: Queue
    watch: Watch

    @classmethod
    def of(
        cls,
        setup: Setup,
        cell: Cell,
        *,
        new_fleet: Callable[[Crew], Fleet] | None = None,
        operator: AnyOperator | None = None,
        on_task_end: Callable[[int, Robot], None] | None = None,
    ) -> "Play":
        """The fleet of a cell.

        Args:
          setup: of the sweep that the cell is of.
          cell: policy and sizes.
          new_fleet: makes the fleet; None: as a sweep does.
          operator: gives the input; None: as in a sweep.
          on_task_end: see `Crew`.
        """
        machine = computer(*setup.programs())
        trees = Trees(
            machine,
            scenes=setup.scene,
            operator=operator or setup.operator(),
            seed=setup.config.seed,
        )
        crew = Crew(
            trees,
            robots=cell.robots,
            tasks=cell.tasks,
            predictor=setup.bidder_of(cell),
            on_task_end=on_task_end,
        )
        fleet = new_fleet(crew) if new_fleet is not None else setup.new_fleet(cell, crew)
        return cls(fleet, crew, machine, Queue(machine), Watch(fleet, crew))

    def step(self, until_ns: int | None = None) -> None:
        """Let happen what can, up to `until_ns`, without computing anything."""
        while pending := self.fleet.advance(until_ns):
            self.watch.update()
            for work in pending:
                self.queue.add(self.crew.perform(work), functools.partial(self.fleet.deliver, work))
        self.watch.update()

    def settle(self, until_ns: int | None = None) -> None:
        """Let everything happen up to `until_ns`."""
        self.step(until_ns)
        while self._lacks_a_result(until_ns):
            if not len(self.queue):
                raise RuntimeError("the fleet waits for something that nobody computes")
            self.queue.round()
            self.step(until_ns)

    def _lacks_a_result(self, until_ns: int | None) -> bool:
        waits_for_ns = self.fleet.waits_for_ns
        if self.fleet.done or waits_for_ns is None:
            return False
        return until_ns is None or waits_for_ns <= until_ns


def replay(
    path: Path | str, *, on_task_end: Callable[[int, Robot], None] | None = None
) -> tuple[Play, EventLog]:
    """A recorded session, at its beginning, and its log.

    Raises:
      BadInput: it is no session's log, or its settings cannot be used here.
    """
    log = read_log(path)
    config = replaying(SweepConfig(operator=REPLAY, log=Path(path)), log)
    setup = prepare(config)
    (cell,) = config.cells()
    return Play.of(setup, cell, on_task_end=on_task_end), log


def snapshots(
    path: Path | str, *, every_ns: int, start_ns: int = 0, stop_ns: int | None = None
) -> Iterator[FleetSnapshot]:
    """What there was to see in a recorded session, at regular times.

    Args:
      path: its log.
      every_ns: simulated time from one to the next, ns.
      start_ns, stop_ns: simulated times of the first, and of the last at most; None: the end.

    Raises:
      BadInput: as in `replay`; or, at the end, the session went another way here.
    """
    play, log = replay(path)
    time_ns = start_ns
    while stop_ns is None or time_ns <= stop_ns:
        play.settle(time_ns)
        yield play.watch.snapshot(time_ns)
        if play.fleet.done:
            break
        time_ns += every_ns
    if play.fleet.done:
        difference = compare(play.fleet.events, log)
        if difference is not None:
            raise BadInput(difference)
