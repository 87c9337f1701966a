"""Scripted robots and a readable form of the event log, for cases worked out by hand."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import Any

from pgf_jax.fleet import CheckResult, Fleet, FleetConfig, IterationResult, ReachResult, Work
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.planning.types import Push

PUSH = Push(object=3, x=0.4, y=0.1)

# One token an iteration of a task, pushes' included; the last one repeats.
TOKENS = {
    ".": outcome(),  # nothing to say
    "s": outcome(stuck=True),
    "f": outcome(feasible=True, cost=10.0),
    "x": outcome(cost=math.inf, non_finite=True),
    "w": outcome(saturated=3),
}


def token(text: str) -> IterationResult:
    return TOKENS[text] if text in TOKENS else outcome(gain=float(text))


def scripted(
    script: Mapping[int | tuple[int, int], str],
    inputs: Mapping[tuple[int, int, int], Push | None] | None = None,
    checks: Mapping[tuple[int, int], str] | None = None,
    missed: Collection[tuple[int, int]] | None = None,
) -> StubRobots:
    """Robots whose tasks follow `script[robot, task]`, else `script[robot]`, else 'f'.

    Inputs by (robot, task, request); those not given are "go on reaching". Checks by (robot,
    iteration), a token each: 'p' passes, any other misses and leaves the robot with that outcome;
    those not given pass, and without `checks` they have no outcome. A reach misses where (robot,
    iterations before it) is in `missed`; without `missed` none can.
    """

    def iterate(work: Work) -> IterationResult:
        text = script.get((work.robot, work.task), script.get(work.robot, "f")).split()
        return token(text[min(work.iteration, len(text) - 1)])

    def decide(work: Work) -> Push | None:
        assert work.request is not None
        return (inputs or {}).get((work.robot, work.task, work.request))

    def check(work: Work) -> CheckResult:
        assert checks is not None and work.check is not None
        text = checks.get((work.robot, work.iteration), "p").split()
        word = text[work.check]
        if word == "p":
            return CheckResult(passed=True, more=False, result=TOKENS["f"])
        return CheckResult(passed=False, more=work.check + 1 < len(text), result=token(word))

    def reach(work: Work) -> ReachResult:
        assert missed is not None
        misses = (work.robot, work.iteration) in missed
        return ReachResult(grasped=not misses, distance_m=0.05 if misses else 0.0)

    return StubRobots(
        iterate,
        decide,
        check=None if checks is None else check,
        reach=None if missed is None else reach,
    )


@dataclasses.dataclass(frozen=True)
class Constant:
    """The same service time for every request."""

    value: float

    def seconds(self, robot: int, task: int, request: int) -> float:
        return self.value


@dataclasses.dataclass(frozen=True)
class Speeds:
    """A slowdown of its own for each robot, so that robots come out of step."""

    factors: tuple[float, ...]

    def slowdown(self, robot: int, task: int, iteration: int, planning: int) -> float:
        return self.factors[robot]


def run(
    script: Mapping[int | tuple[int, int], str],
    *,
    inputs: Mapping[tuple[int, int, int], Push | None] | None = None,
    checks: Mapping[tuple[int, int], str] | None = None,
    missed: Collection[tuple[int, int]] | None = None,
    service: float = 8.0,
    speeds: tuple[float, ...] | None = None,
    **config: Any,
) -> tuple[Fleet, StubRobots]:
    """Run one fleet of scripted robots to its end; one task a robot unless said."""
    robots = scripted(script, inputs, checks, missed)
    config.setdefault("tasks", 1)
    fleet = Fleet(
        FleetConfig(**config),
        robots,
        service=Constant(service),
        compute=None if speeds is None else Speeds(speeds),
    )
    drive([(fleet, robots)])
    return fleet, robots


def log(fleet: Fleet, *leave_out: str) -> list[str]:
    """The whole event log, a line an event, without the kinds to leave out."""
    lines = []
    for event in fleet.events:
        if event.kind in leave_out:
            continue
        words = [f"{event.time_ns / 1e9:g}", str(event.kind)]
        if event.robot is not None:
            words.append(f"r{event.robot}.{event.task}")
        for letter, value in (
            ("q", event.request),
            ("o", event.operator),
            ("i", event.iteration),
        ):
            words += [] if value is None else [f"{letter}{value}"]
        if event.gain is not None and not math.isnan(event.gain):
            words.append(f"gain={event.gain:g}")
        if event.object is not None:
            words.append(f"object={event.object}")
        if event.x is not None:
            words.append(f"to=({event.x:g},{event.y:g})")
        words += [event.outcome] if event.outcome else []
        lines.append(" ".join(words))
    return lines
