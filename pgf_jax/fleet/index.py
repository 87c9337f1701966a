"""The discipline `index`: whenever an operator is free, the robots that plan are ranked.

There is no window and no bid that waits. Decisions come once an instant, after all iterations and
services that end then; free operators take the robots of highest index. A fleet-wide policy says
how high each is (`IndexPolicy`); it sees all robots that may be helped. Three rank by time:
`time-saved`, `gain-rate` and `urgency`.
"""

import dataclasses
import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from pgf_jax.fleet.policies import POLICIES, Discipline, PolicyBase, PolicySettings, TaskProgress
from pgf_jax.fleet.robots import IterationResult
from pgf_jax.streams import stream

_PARTS = 8  # service times by which an expectation over them is computed, each as likely


class RobotState(NamedTuple):
    """What a fleet-wide policy sees of a robot that may be helped now.

    It plans a reach, and neither checks a solution nor waits; and it has iterated since it was
    served last.

    Attributes:
      progress: of its task.
      result: of its last iteration.
      unhelped_s: since its last service in the task ended, or else since the task began, s.
      switch_s: what the operator who is free would need to turn to it, s.
    """

    progress: TaskProgress
    result: IterationResult
    unhelped_s: float
    switch_s: float = 0.0


class IndexPolicy(Protocol):
    """Ranks robots; without a state, as every policy. See `policies.Policy` for the rest."""

    def index(self, robots: Sequence[RobotState]) -> Sequence[float | None]:
        """The index of each robot, a number in a unit of the policy's own.

        The highest are served. None: not to be served, for instance because its history is short.
        A policy with a reservation value gives None below it.
        """
        ...


def ranking(
    policy: IndexPolicy, robots: Sequence[RobotState], *, seed: int, decision: int
) -> list[tuple[int, float]]:
    """The robots that are to be served, best first: (robot, index).

    Args:
      policy: ranks them.
      robots: that may be helped.
      seed: of the fleet.
      decision: number of the decision. Ties are broken by a random key of (seed, decision, robot).
    """
    found = policy.index(robots)
    number = 1 + max((state.progress.robot for state in robots), default=0)
    keys = stream(seed, "index", decision).random(number)
    ranked = [
        (state.progress.robot, float(value))
        for state, value in zip(robots, found, strict=True)
        if value is not None
    ]
    return sorted(ranked, key=lambda one: (-one[1], keys[one[0]]))


# --- policies that rank by time -----------------------------------------------------------------


class _Curve:
    """How long a reach takes: S(t), the probability that it is not solved by t.

    Reaches are solved at the ends of iterations. Beyond the last iteration that is predicted, the
    chance to be solved in an iteration stays what it was there.

    Args:
      survival: after 1, 2, ... iterations.
      step_s: of an iteration, s.
      until_s: the longest time that will be asked for, s.
    """

    def __init__(self, survival: Sequence[float], step_s: float, until_s: float) -> None:
        steps = max(1, math.ceil(until_s / step_s) + 1)
        known = np.concatenate([[1.0], np.asarray(survival, float)])[: steps + 1]
        if len(known) <= steps:
            ratio = known[-1] / known[-2] if known[-2] > 0 else 0.0
            more = known[-1] * ratio ** np.arange(1, steps + 2 - len(known))
            known = np.concatenate([known, more])
        self._step_s = step_s
        self._survival = known
        self._times = step_s * np.arange(len(known) + 1)
        self._areas = np.concatenate([[0.0], np.cumsum(step_s * known)])

    def at(self, time_s: float) -> float:
        """S(t)."""
        # An iteration that ends at t has been seen.
        return float(self._survival[int(time_s / self._step_s * (1 + 1e-12))])

    def mean(self, from_s: float, until_s: float, failure_cost_s: float) -> float:
        """The time from `from_s` on that it takes until `until_s` at most, s.

        Where it is not solved by then, `failure_cost_s` is added.
        """
        area = np.interp([from_s, until_s], self._times, self._areas)
        return float(area[1] - area[0]) + failure_cost_s * self.at(until_s)


@dataclasses.dataclass(frozen=True)
class TimePolicy(PolicyBase):
    """Base of the policies that rank robots by the time that help is predicted to save.

    T is the time that a reach still takes alone, S the operator's time with switching, m1 the mean
    time from an answer on, and R what remains of the task's time: T and m1 are counted up to R, and
    where that runs out `failure_cost_s` is added. Robots whose index is not above the reservation
    value are not served.

    Attributes:
      step_s: time of an iteration, s.
      services_s: service times that stand for their distribution, each as likely, s.
      service_mean_s: E[S] without switching, s.
      reservation: index that a robot must exceed.
      failure_cost_s: what it costs beside the time that a task is not solved, s.
      discipline, plans_on: see `Policy`.
      plans: whether robots plan while they are served.
    """

    step_s: float
    services_s: tuple[float, ...]
    service_mean_s: float
    reservation: float
    failure_cost_s: float
    plans: bool
    discipline: Discipline = Discipline.INDEX
    plans_on: bool = True

    def index(self, robots: Sequence[RobotState]) -> list[float | None]:
        """See `IndexPolicy.index`."""
        values = (self._value(robot) for robot in robots)
        return [None if v is None or not v > self.reservation else v for v in values]

    def _value(self, robot: RobotState) -> float | None:
        left, remaining_s = robot.result.time_left, robot.progress.remaining_s
        if left is None or remaining_s <= 0:
            return None
        alone, helped = (_Curve(survival, self.step_s, remaining_s) for survival in left)
        return self.value(alone, helped, remaining_s, robot.switch_s)

    def value(self, alone: _Curve, helped: _Curve, remaining_s: float, switch_s: float) -> float:
        """The index of one robot.

        Args:
          alone: T.
          helped: the time from an answer on.
          remaining_s: R, s.
          switch_s: expected switching time, s.
        """
        raise NotImplementedError

    def _means(self, alone: _Curve, helped: _Curve, remaining_s: float) -> tuple[float, float]:
        """m and m1: the mean times without help, and from an answer on, s."""
        cost_s = self.failure_cost_s
        return alone.mean(0.0, remaining_s, cost_s), helped.mean(0.0, remaining_s, cost_s)


class TimeSaved(TimePolicy):
    """`time-saved`: the time in the task that help is expected to save, s.

    Robots that plan meanwhile: E[(T - S) - T1; T > S], where T1 is the time from the answer on, in
    what is left of R then. Robots that wait: m - m1 - E[S]. It takes the whole service for one
    decision, and does not see what the operator could do meanwhile.
    """

    def value(self, alone: _Curve, helped: _Curve, remaining_s: float, switch_s: float) -> float:
        """See `TimePolicy.value`; s."""
        if not self.plans:
            alone_s, helped_s = self._means(alone, helped, remaining_s)
            return alone_s - helped_s - self.service_mean_s - switch_s
        saved_s, cost_s = 0.0, self.failure_cost_s
        for service_s in self.services_s:
            end_s = service_s + switch_s
            if end_s < remaining_s:  # else the answer comes too late
                after_s = helped.mean(0.0, remaining_s - end_s, cost_s)
                saved_s += alone.mean(end_s, remaining_s, cost_s) - alone.at(end_s) * after_s
        return saved_s / len(self.services_s)


class GainRate(TimePolicy):
    """`gain-rate`: the time that an answer saves for each second of the operator's; no unit.

    Robots that plan meanwhile: (m - m1) / E[S], for exponential times and a continuous stream of
    robots the Whittle index (Whittle 1988; of faults that clear only under help: Dahiya et al.
    2022). Robots that wait: one less, as their own time is spent too.
    """

    def value(self, alone: _Curve, helped: _Curve, remaining_s: float, switch_s: float) -> float:
        """See `TimePolicy.value`; no unit."""
        alone_s, helped_s = self._means(alone, helped, remaining_s)
        service_s = max(self.service_mean_s + switch_s, 1e-9)
        return (alone_s - helped_s) / service_s - (not self.plans)


class Urgency(TimePolicy):
    """`urgency`: 1/E[S] - h, 1/s, with h the robot's own chance per second to be solved.

    From exchanging two robots that are served one after the other, in a batch that drains; it takes
    help to solve the task at once, and the next iteration to be like all others.
    """

    def value(self, alone: _Curve, helped: _Curve, remaining_s: float, switch_s: float) -> float:
        """See `TimePolicy.value`; 1/s."""
        service_s = max(self.service_mean_s + switch_s, 1e-9)
        return 1 / service_s - (1 - alone.at(self.step_s)) / self.step_s


def _services(mean_s: float, sd_s: float) -> tuple[float, ...]:
    """Log-normal service times at the middle of equally likely parts (see `service.LogNormal`)."""
    if sd_s == 0:
        return (mean_s,)
    variance = math.log1p((sd_s / mean_s) ** 2)
    normal = statistics.NormalDist(-variance / 2, math.sqrt(variance))
    return tuple(mean_s * math.exp(normal.inv_cdf((part + 0.5) / _PARTS)) for part in range(_PARTS))


def _ranks_by_time(kind: type[TimePolicy], reservation: float):
    """A factory of policies of a kind, with the reservation value that it has unless given."""

    def make(config: PolicySettings) -> TimePolicy:
        given = config.reservation
        return kind(
            step_s=2 * config.rollout_time_s,
            services_s=_services(config.service_mean_s, config.service_sd_s),
            service_mean_s=config.service_mean_s,
            reservation=reservation if given is None else given,
            failure_cost_s=config.failure_cost_s,
            plans=config.while_served != "wait",
        )

    return make


POLICIES.add_built_in("time-saved", _ranks_by_time(TimeSaved, 0.0))
POLICIES.add_built_in("gain-rate", _ranks_by_time(GainRate, 0.0))
POLICIES.add_built_in("urgency", _ranks_by_time(Urgency, 0.0))
# By the true values of the robot's own noise: greedy, a reference and no bound.
POLICIES.add_built_in("oracle-time", _ranks_by_time(TimeSaved, 0.0))
