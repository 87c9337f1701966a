"""One iteration of a fleet that is done, once more: what each of its rollouts did.

A task's search follows from its scene, the seed, and what has happened in it; the fleet's event log
says what has happened. So a task is walked again alone, a call an iteration instead of a whole
fleet, and its way is held against the log: where results depend on the processor, one that goes
another way must not pass for the one that was logged.
"""

import math
from collections.abc import Iterable
from typing import Any

from pgf_jax.errors import BadInput, shown
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.robots import IterationResult, Work, WorkKind
from pgf_jax.guidance.operators import NoOperator
from pgf_jax.guidance.trials import Step, own_words
from pgf_jax.guidance.true_gain import TrueGain
from pgf_jax.planning.planner import Search
from pgf_jax.planning.types import Push
from pgf_jax.study.computer import Queue
from pgf_jax.study.computer import computer as make_computer
from pgf_jax.study.crew import Crew
from pgf_jax.study.reproduction import Reproduction
from pgf_jax.study.sweep_config import Cell
from pgf_jax.study.sweep_setup import Setup
from pgf_jax.study.trees import Trees


def reproduce(
    setup: Setup, cell: Cell, events: Iterable[Event], *, robot: int, task: int, iteration: int
) -> Reproduction:
    """An iteration of a fleet that is done, computed again.

    Args:
      setup: of the sweep.
      cell: the fleet.
      events: its event log.
      robot, task: which; 0-based.
      iteration: its number in the log.

    Raises:
      BadInput: one line: there is no such iteration in the log, or the events are none of such a
        fleet; or the task goes another way here, as the log was written by other code, on another
        processor or with another predictor.
    """
    way = _way(cell, events, robot, task, iteration)
    walk = _Walk(setup, cell, robot, task)
    for event in way[:-1]:
        walk.follow(event)
    before = walk.search
    walk.follow(way[-1])
    step = Step(before, own_words(setup.config.seed, robot, task, iteration)(0))
    after, rolled = walk.computer.rolled(step)
    return Reproduction(robot, task, iteration, walk.scene, step.words, before, after, rolled)


def _way(cell: Cell, events: Iterable[Event], robot: int, task: int, iteration: int) -> list[Event]:
    """What happened in a task, up to the iteration."""
    if not 0 <= robot < cell.robots:
        raise BadInput(f"robot: expected 0..{cell.robots - 1} of cell {cell.name}, got {robot}")
    if not 0 <= task < cell.tasks:
        raise BadInput(f"task: expected 0..{cell.tasks - 1} of cell {cell.name}, got {task}")
    way: list[Event] = []
    ended = -1
    for event in events:
        if (event.robot, event.task) != (robot, task):
            continue
        way.append(event)
        if event.kind is EventKind.ITERATION and event.iteration is not None:
            ended = event.iteration
            if ended == iteration:
                return way
    whose = f"task {task} of robot {robot}"
    if not way:
        raise BadInput(f"task: {whose} is not in the log")
    there = "no iteration" if ended < 0 else f"iterations 0..{ended}"
    raise BadInput(f"iteration: {whose} has {there} in the log, got {iteration}")


class _Walk:
    """One task as its events tell it, computed again.

    Attributes:
      computer: with the lanes of the sweep: results are the same for the same lanes only.
      scene: its name.
    """

    def __init__(self, setup: Setup, cell: Cell, robot: int, task: int) -> None:
        self.computer = make_computer(*setup.programs())
        # Nobody is asked: the log says what was given.
        trees = Trees(
            self.computer, scenes=setup.scene, operator=NoOperator(), seed=setup.config.seed
        )
        predictor = setup.bidder_of(cell)
        # What help was worth was found out with the operator, by planning on; the other gains are
        # the one number in the log that follows from all there is of a search.
        self._gains = not isinstance(predictor, TrueGain)
        self._crew = Crew(
            trees,
            robots=robot + 1,
            tasks=task + 1,
            predictor=None if isinstance(predictor, TrueGain) else predictor,
        )
        self._crew.begin(robot, task)
        self.scene = self._crew.robots[robot].scene.name
        self._robot, self._task, self._iterations = robot, task, 0

    @property
    def search(self) -> Search:
        """As the task stands."""
        return self._crew.robots[self._robot].search

    def follow(self, event: Event) -> None:
        """Let an event of the task happen.

        Raises:
          BadInput: it cannot, or something else does.
        """
        pushing = bool(self.search.task.pushing)
        found = self.computer.planner.terminate(self.search)
        if event.kind is EventKind.ITERATION:
            if found:
                raise self._senseless("planning goes on with what is feasible")
            self._iterate(event)
        elif event.kind is EventKind.SERVICE_END and event.outcome not in ("expired", "censored"):
            if pushing:
                raise self._senseless("a service ends while a push is planned")
            self._give(event)
        elif event.kind is EventKind.PUSH_DROPPED:
            if not pushing or found:
                raise self._senseless("a push is dropped where none is planned")
            self._crew.drop_push(self._robot)
        elif event.kind is EventKind.RETREAT_END:
            if not (pushing and found):
                raise self._senseless("a retreat ends after no push")
            self._perform(WorkKind.RETREAT)

    def _iterate(self, event: Event) -> None:
        number = self._iterations
        if event.iteration != number:
            raise self._senseless(f"iteration {event.iteration} comes where {number} should")
        task = self.search.task
        self._hold("object", event.object, int(task.pushed) if task.pushing else None)
        result = self._perform(WorkKind.ITERATION)
        assert isinstance(result, IterationResult)
        outcome = "feasible" if result.feasible else "stuck" if result.stuck else None
        self._hold("outcome", event.outcome, outcome)
        if self._gains:
            self._hold("gain", _known(event.gain), _known(result.gain))
        self._iterations += 1

    def _give(self, event: Event) -> None:
        if event.outcome == "push":
            if event.object is None or event.x is None or event.y is None:
                raise self._senseless("a push without its object or place is given")
            self._crew.start_push(self._robot, Push(event.object, event.x, event.y))
        elif event.outcome not in ("go_on", "unanswered"):
            raise self._senseless(f"a service ends with {shown(event.outcome)}")
        elif self.search.iteration >= 0:  # otherwise there is nothing yet to go on with
            self._crew.go_on(self._robot)

    def _perform(self, kind: WorkKind) -> Any:
        results: list[Any] = []
        queue = Queue(self.computer)
        work = Work(self._robot, self._task, kind, self._iterations)
        queue.add(self._crew.perform(work), results.append)
        while len(queue):
            queue.round()
        return results[0]

    def _hold(self, what: str, logged: object, here: object) -> None:
        if logged != here:
            raise BadInput(
                f"robot {self._robot}, task {self._task}, iteration {self._iterations}: "
                f"{what} {shown(logged)} in the log, {shown(here)} here; the log was written by "
                "other code, on another processor or with another predictor"
            )

    def _senseless(self, what: str) -> BadInput:
        return BadInput(
            f"robot {self._robot}, task {self._task}, after {self._iterations} iterations: {what}; "
            "expected the log of the fleet"
        )


def _known(gain: float | None) -> float | None:
    return None if gain is None or math.isnan(gain) else gain
