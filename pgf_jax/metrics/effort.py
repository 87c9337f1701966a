"""Metrics of human effort that the field of human-robot interaction uses, of one fleet.

All are of the operators' time: of services from their grant to their end, whether an input came of
them or not. They are computed from one fleet's records and events, as in `summary.py`.
"""

import dataclasses
import math
from collections.abc import Sequence

from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.metrics.attention import waits_s
from pgf_jax.metrics.summary import ratio
from pgf_jax.planning.types import Status

_NS_PER_MINUTE = 60 * 10**9


@dataclasses.dataclass(frozen=True)
class Effort:
    """What the operators of one fleet gave, and what came of it; nan where nobody was served.

    Attributes:
      operator_minutes: time of all services.
      services: number of services.
      switches: services of a robot other than the operator's last one.
      return_on_effort: tasks solved for each minute of an operator's time: return on human effort
        (Hoque et al. 2022, with minutes in place of actions). Those that were solved without help
        count; see `extra_solved_per_minute`.
      interaction_time_s: mean length of a service, IT (Olsen & Wood 2004).
      neglect_time_s: mean time that a robot worked on tasks for each service, but for services, NT:
        how long it is left alone.
      attention_demand: IT / (IT + NT), the share of a robot's time that it takes of an operator.
      fan_out: 1 / attention_demand: how many robots one operator could serve, if none waited.
      wait_in_queue_s: mean time from an ask to its end or its service; of all waiting for an
        operator that and `interaction_time_s` are the parts that an operator causes (Cummings &
        Mitchell 2008 have situation awareness besides, which is not simulated).
      longest_wait_s: the longest of these.
    """

    operator_minutes: float
    services: int
    switches: int
    return_on_effort: float
    interaction_time_s: float
    neglect_time_s: float
    attention_demand: float
    fan_out: float
    wait_in_queue_s: float
    longest_wait_s: float


def effort(config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]) -> Effort:
    """Compute what the operators gave in one fleet that is done.

    Args:
      config: the fleet's settings.
      records: its task records, in any order.
      events: its event log, in order.
    """
    begun: dict[int, int] = {}  # operator -> since when it serves, ns
    last: list[int | None] = [None] * config.operators
    busy_ns = services = switches = 0
    for event in events:
        if event.kind is EventKind.GRANT:
            assert event.operator is not None
            begun[event.operator] = event.time_ns
            switches += last[event.operator] not in (None, event.robot)
            last[event.operator] = event.robot
            services += 1
        elif event.kind is EventKind.SERVICE_END:
            assert event.operator is not None
            busy_ns += event.time_ns - begun.pop(event.operator)
    at_tasks_ns = sum(record.end_ns - record.start_ns for record in records)
    solved = sum(record.status is Status.SOLVED for record in records)
    waits = waits_s(events)
    demand = ratio(busy_ns, at_tasks_ns) if services else math.nan
    return Effort(
        operator_minutes=busy_ns / _NS_PER_MINUTE,
        services=services,
        switches=switches,
        return_on_effort=ratio(solved * _NS_PER_MINUTE, busy_ns),
        interaction_time_s=ratio(busy_ns / 1e9, services),
        neglect_time_s=ratio((at_tasks_ns - busy_ns) / 1e9, services),
        attention_demand=demand,
        fan_out=1 / demand if demand > 0 else math.nan,
        wait_in_queue_s=ratio(sum(waits), len(waits)),
        longest_wait_s=max(waits, default=math.nan),
    )


def extra_solved_per_minute(helped: Effort, solved: int, solved_alone: int) -> float:
    """Tasks solved more than without help, for each minute of an operator's time.

    Args:
      helped: of a fleet with help.
      solved: tasks that it solved.
      solved_alone: tasks that the same fleet solves under `autonomous`: same scenes, same noise.
    """
    return ratio(solved - solved_alone, helped.operator_minutes)
