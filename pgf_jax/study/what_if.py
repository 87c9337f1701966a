"""What if: the blocks of a study again under another policy, with the inputs that people gave.

An input carries over only while robot, task and shelf are the same to the bit as when it was given:
the objects where they stood, and in a world in three dimensions its whole state. What is asked
beyond that is answered by the fitted operator: lengths of services of the fitted distribution, and
the inputs of the operator `heuristic`. Both are counted, so that it is clear which is which.
"""

import dataclasses
import hashlib
import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from pgf_jax.batching.places import Place
from pgf_jax.batching.requests import Coroutine
from pgf_jax.errors import BadInput
from pgf_jax.fleet.service import LogNormal, ServiceTimes
from pgf_jax.guidance.operators.base import ask_operator
from pgf_jax.guidance.operators.registry import make_operator
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.metrics.summary import Interval, mean_interval
from pgf_jax.operator_fit.command import read_services
from pgf_jax.operator_fit.lognormal import fit
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import NoInput, Push
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.recorded_operator import Recording
from pgf_jax.study.design import Design
from pgf_jax.study.records import Person, SessionRecord
from pgf_jax.study.simulated import SOMEBODY, Outcome, Simulated, run_blocks
from pgf_jax.sweeping.replay import replay

_SHOWN = ("task_time_s", "success", "solved_per_hour")
_Service = tuple[int, int, int]  # robot, task, request
_Shelf = tuple[int, int, str]  # robot, task, digest of the shelf


class Given(NamedTuple):
    """An input as it was recorded.

    Attributes:
      seconds: length of its service.
      given: the input.
    """

    seconds: float
    given: Push | NoInput | None


def shelf_digest(search: Search, place: Place | None) -> str:
    """Digest of a shelf as it stands: the same only if it is the same to the bit."""
    digest = hashlib.sha256(np.asarray(search.start.objects)[: search.objects].tobytes())
    if place is not None:
        digest.update(np.asarray(place.state.data.qpos).tobytes())
    return digest.hexdigest()


class _Watched:
    """The recorded operator, whose every input is noted with the shelf for which it was given."""

    name, checked = "watched", True

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.given: dict[_Shelf, list[Given]] = {}

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        _, robot, task, _ = decision_key
        service = self._recording.inputs.get((robot, task, view.request))
        if service is not None:
            length_ns, given = service
            shelf = robot, task, shelf_digest(search, view.place)
            self.given.setdefault(shelf, []).append(Given(length_ns / 1e9, given))
        return self._recording.deliberate(view, search, planner, decision_key)


def inputs_by_shelf(block: SessionRecord) -> dict[_Shelf, list[Given]]:
    """The inputs of a block, by robot, task and shelf; found by replaying it."""
    watched: list[_Watched] = []

    def watch(recording: Recording) -> _Watched:
        watched.append(_Watched(recording))
        return watched[-1]

    runner, log = replay(block.folder, operator=watch)
    runner.run_until(log.events[-1].time_ns if log.events else 0)
    return watched[-1].given


class CarriedOver:
    """An operator who gives recorded inputs on the shelves for which they were given, once each.

    Satisfies `ServiceTimes` and `RolloutOperator`. On other shelves `beyond` says how long a
    service lasts, and the operator `heuristic` what is given.

    Args:
      given: the recorded inputs.
      beyond: lengths of the other services.

    Attributes:
      carried: the services whose input was carried over.
      others: those whose input was not.
    """

    name, checked = "carried over", True

    def __init__(self, given: dict[_Shelf, list[Given]], beyond: ServiceTimes) -> None:
        self._left = {shelf: list(inputs) for shelf, inputs in given.items()}
        self._beyond, self._somebody = beyond, make_operator(SOMEBODY)
        self._robots: weakref.ref[PlannedRobots] | None = None
        self.carried: dict[_Service, Given] = {}
        self.others: set[_Service] = set()

    def bind(self, robots: PlannedRobots) -> None:
        """Learn where the robots stand; does not keep them when their fleet has ended."""
        self._robots = weakref.ref(robots)

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        """See `ServiceTimes.seconds`; called when a service begins, which decides on its input."""
        robots = self._robots and self._robots()
        assert robots is not None
        service, one = (robot, task, request), robots.robots[robot]
        left = self._left.get((robot, task, shelf_digest(one.search, one.checked_at(one.node))))
        if left:
            self.carried[service] = left.pop(0)
            return self.carried[service].seconds
        self.others.add(service)
        return self._beyond.seconds(robot, task, request)

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        """See `RolloutOperator.deliberate`."""
        _, robot, task, _ = decision_key
        found = self.carried.get((robot, task, view.request))
        if found is not None:
            return found.given
        return (yield from ask_operator(self._somebody, view, search, planner, decision_key))


@dataclasses.dataclass(frozen=True, eq=False)
class WhatIf:
    """A block as it would have gone under another policy.

    Attributes:
      participant: number, from 1.
      block: as recorded.
      policy: the other one.
      outcome: what came of it.
      operator: who gave the inputs.
    """

    participant: int
    block: SessionRecord
    policy: str
    outcome: Outcome
    operator: CarriedOver

    @property
    def carried_tasks(self) -> int:
        """Tasks that ended with no other help than recorded inputs."""
        helped = {(robot, task) for robot, task, _ in self.operator.others}
        return sum((one.robot, one.task) not in helped for one in self.outcome.records)


def what_if(
    design: Design,
    people: Sequence[Person],
    policies: Sequence[str],
    said: Callable[[str], None] = lambda text: None,
) -> list[WhatIf]:
    """Run the blocks that have ended again, under each of some policies.

    Raises:
      BadInput: no block has ended, or nobody has answered a request.
    """
    blocks = [(person, block) for person in people for block in person.blocks]
    if not blocks:
        raise BadInput(f"{design.folder}: no block has ended yet")
    fitted = fit(read_services(block.folder for _, block in blocks))
    runs: list[Simulated] = []
    for number, (person, block) in enumerate(blocks):
        said(f"{number} of {len(blocks)} blocks are replayed")
        given = inputs_by_shelf(block)
        own = person.progress.blocks[(block.block or 1) - 1]
        config = design.session(own, block.folder)
        beyond = LogNormal(person.number, fitted.mean_s * config.speed, fitted.sd_s * config.speed)
        for policy in policies:
            operator = CarriedOver(given, beyond)
            runs.append(
                Simulated(
                    dataclasses.replace(config, policy=policy),
                    operator,
                    operator,
                    (person.number, block, policy, operator),
                    operator.bind,
                )
            )
    outcomes = run_blocks(runs, lambda count: said(f"{count} of {len(runs)} fleets have ended"))
    found = []
    for outcome in outcomes:
        who, block, policy, operator = outcome.block.label
        found.append(WhatIf(who, block, policy, outcome, operator))
    return found


def show(found: Sequence[WhatIf]) -> None:
    """Print what each policy would have come to, and whose inputs it rests on."""
    table = Table(
        "recorded", "if it were", "carried", "fitted", "whole", "time (s)", "success", "solved/h",
        box=None,
    )  # fmt: skip
    groups: dict[tuple[str, str], list[WhatIf]] = {}
    for one in found:
        groups.setdefault((one.block.condition, one.policy), []).append(one)
    for (condition, policy), ones in groups.items():
        tasks = sum(len(one.outcome.records) for one in ones)
        cells: list[Any] = [
            sum(len(one.operator.carried) for one in ones),
            sum(len(one.operator.others) for one in ones),
            f"{sum(one.carried_tasks for one in ones)} of {tasks}",
        ]
        cells += [_words(mean_interval([one.outcome.measures[m] for one in ones])) for m in _SHOWN]
        table.add_row(condition, policy, *map(str, cells))
    Console().print(table)
    print("carried: inputs of the person, each to the same shelf to the bit; fitted: services")
    print("beyond that, of the fitted operator; whole: tasks that ended without any of these;")
    print("time: in the task")


def _words(value: Interval) -> str:
    half = (value.high - value.low) / 2
    return f"{value.mean:.2f}" + (f" ± {half:.2f}" if half == half else "")
