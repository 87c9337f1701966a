"""What came of a study: each condition, and differences within participants.

Every participant has had every condition, so conditions are compared within participants: the mean
of the participants' own differences, with Student's t interval. Only those count who have done all
blocks.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.metrics.summary import Interval, mean_interval, ratio
from pgf_jax.operator_fit.command import read_services
from pgf_jax.operator_fit.lognormal import Fit, fit
from pgf_jax.planning.types import Status
from pgf_jax.study.design import Design
from pgf_jax.study.records import Input, Person, SessionRecord

MEASURES: Mapping[str, str] = {  # name -> what it is, with its unit
    "task_time_s": "time in the task: planning, waiting and service (s)",
    "success": "share of tasks solved",
    "solved_per_hour": "tasks solved an hour",
    "services_per_minute": "services a minute",
    "wait_in_queue_s": "wait of a robot for the person (s)",
    "reorientation_s": "from seeing a request to the first click or key (s)",
    "interaction_s": "from there to the answer (s)",
    "service_s": "length of a service (s)",
}


@dataclasses.dataclass(frozen=True)
class Measured:
    """A measure of one participant's block.

    Attributes:
      participant: number, from 1.
      block: its place in the participant's order, from 1.
      condition: its name.
      measure: its name; of a questionnaire the questionnaire's.
      value: nan where there is none.
    """

    participant: int
    block: int
    condition: str
    measure: str
    value: float


@dataclasses.dataclass(frozen=True)
class Difference:
    """What one condition has more of than another, within participants.

    Attributes:
      measure: its name.
      condition, baseline: names.
      difference: mean of the participants' differences, 95 %.
      effect: the mean over the standard deviation of the differences (Cohen's d_z).
    """

    measure: str
    condition: str
    baseline: str
    difference: Interval
    effect: float


@dataclasses.dataclass(frozen=True, eq=False)
class Analysis:
    """What came of a study.

    Attributes:
      measures: name -> what it is, in the order of the tables.
      measured: of each participant who counts, block and measure.
      participants: who count, by number.
      unfinished: who have not done all blocks, by number.
      inattentive: who count, but have failed an attention check, by number.
      conditions: (measure, condition) -> mean over participants, 95 %.
      differences: of each two conditions.
      order: (measure, block) -> mean over participants, 95 %: the later, the more practised.
      operator: the log-normal distribution of the services' lengths; None: too few answers.
    """

    measures: Mapping[str, str]
    measured: tuple[Measured, ...]
    participants: tuple[int, ...]
    unfinished: tuple[int, ...]
    inattentive: tuple[int, ...]
    conditions: Mapping[tuple[str, str], Interval]
    differences: tuple[Difference, ...]
    order: Mapping[tuple[str, int], Interval]
    operator: Fit | None


def analyse(design: Design, people: Sequence[Person]) -> Analysis:
    """Analyse what participants have done so far."""
    whole = [one for one in people if len(one.blocks) == len(design.conditions)]
    asked = {name: f"{design.questionnaires[name].title} (score)"
             for name in design.questions.after_block
             if design.questionnaires[name].score != "none"}  # fmt: skip
    measures = {**MEASURES, **asked}
    measured = [one for person in whole for one in _measured(design, person)]
    names, blocks = list(design.conditions), range(1, len(design.conditions) + 1)

    def over(of: Callable[[Measured], bool]) -> Interval:
        found = [one.value for one in measured if of(one) and not math.isnan(one.value)]
        return mean_interval(found)

    return Analysis(
        measures=measures,
        measured=tuple(measured),
        participants=tuple(one.number for one in whole),
        unfinished=tuple(one.number for one in people if one not in whole),
        inattentive=tuple(one.number for one in whole if not one.attentive),
        conditions={
            (m, c): over(lambda one, m=m, c=c: (one.measure, one.condition) == (m, c))
            for m in measures
            for c in names
        },
        differences=tuple(
            difference_of(measured, m, condition, baseline)
            for m in measures
            for baseline, condition in itertools.combinations(names, 2)
        ),
        order={
            (m, b): over(lambda one, m=m, b=b: (one.measure, one.block) == (m, b))
            for m in measures
            for b in blocks
        },
        operator=_operator([block for one in whole for block in one.blocks]),
    )


def difference_of(
    measured: Sequence[Measured], measure: str, condition: str, baseline: str
) -> Difference:
    """The difference of two conditions, over the participants who have both values."""
    values: dict[str, dict[int, float]] = {condition: {}, baseline: {}}
    for one in measured:
        if one.measure == measure and one.condition in values and not math.isnan(one.value):
            values[one.condition][one.participant] = one.value
    both = sorted(values[condition].keys() & values[baseline].keys())
    found = [values[condition][who] - values[baseline][who] for who in both]
    spread = float(np.std(found, ddof=1)) if len(found) > 1 else math.nan
    interval = mean_interval(found)
    return Difference(measure, condition, baseline, interval, ratio(interval.mean, spread))


def _measured(design: Design, person: Person) -> list[Measured]:
    found = []
    for block in person.blocks:
        assert block.block is not None
        values = block_measures(block.task_records, block.inputs, block.seconds)
        for answered in person.answered:
            if answered.block == block.block:
                asked = design.questionnaires[answered.questionnaire]
                values[answered.questionnaire] = asked.scored(answered.answers)
        found += [
            Measured(person.number, block.block, block.condition, name, value)
            for name, value in values.items()
        ]
    return found


def block_measures(
    records: Sequence[TaskRecord], inputs: Sequence[Input], seconds: float
) -> dict[str, float]:
    """The measures of a block that has ended; nan where there is none.

    Args:
      records: of its tasks.
      inputs: its services.
      seconds: how long it lasted, in simulated time.
    """
    ended = [one for one in records if one.status is not Status.CENSORED]
    solved = sum(one.status is Status.SOLVED for one in ended)

    def mean(of: Callable[[Input], float | None]) -> float:
        values = [value for one in inputs if (value := of(one)) is not None]
        return float(np.mean(values)) if values else math.nan

    return {
        "task_time_s": float(np.mean([one.task_time_s for one in ended])) if ended else math.nan,
        "success": ratio(solved, len(ended)),
        "solved_per_hour": ratio(3600 * solved, seconds),
        "services_per_minute": ratio(60 * len(inputs), seconds),
        "wait_in_queue_s": mean(lambda one: one.granted_s - one.asked_s),
        "reorientation_s": mean(lambda one: one.reorientation_s),
        "interaction_s": mean(lambda one: one.interaction_s),
        "service_s": mean(lambda one: None if one.ended_s is None else one.ended_s - one.granted_s),
    }


def _operator(blocks: Sequence[SessionRecord]) -> Fit | None:
    try:
        return fit(read_services(block.folder for block in blocks))
    except BadInput:  # no answer, or too few to fit
        return None
