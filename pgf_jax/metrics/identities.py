"""Sample-path identities: equations of whole numbers that hold in every fleet that is done.

The two sides of an identity are computed in different ways, mostly one from the event log and one
from the task records, so that an error in either of them shows. Identities hold exactly, because
simulated time is in whole nanoseconds and what the horizon cuts off is a term of its own.
"""

from collections import Counter
from collections.abc import Collection, Sequence

from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.fleet.events import ENDS_OF_WAITING, Event, EventKind
from pgf_jax.fleet.policies import Discipline, make_policy
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.metrics.summary import window_sizes
from pgf_jax.planning.types import Status


def verify(config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]) -> int:
    """Check all identities of one fleet.

    Returns:
      The number of identities.

    Raises:
      ValueError: one line that names the first identity that fails, and its two sides.
    """
    identities = identity_sides(config, records, events)
    for name, (left, right) in identities.items():
        if left != right:
            raise ValueError(f"{config.policy}, R = {config.robots}: {name}: {left} is not {right}")
    return len(identities)


def identity_sides(
    config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """The two sides of every identity; they are equal unless there is an error.

    Records hold times as floats in s. Rounded to ns these are exact: the float nearest to a whole
    number of ns over 1e9, times 1e9, is off by less than half a ns as long as the time is below
    2^51 ns, 26 days of simulated time.

    Args:
      config: the fleet's settings; `Fleet` must have been given no other compute model than theirs.
      records: its task records, in any order.
      events: its event log, in order.

    Returns:
      name -> (left, right), in ns or as a count. Those of checks and attempts are there only where
      the records count them.
    """
    return (
        _ask_identities(records, events)
        | _window_identities(config, records, events)
        | _integral_identities(records, events)
        | _robot_identities(config, records, events)
        | _task_identities(records, events)
        | _attempt_identities(config, records, events)
        | _check_identities(config, records, events)
    )


# -- counts ------------------------------------------------------------------------------------

_ENDS_OF_ASKS = {EventKind.REFUSED, EventKind.EXPIRED, EventKind.SERVICE_END}
_OUTCOMES = {
    "busy": "refused",
    "lost": "refused",
    "limit": "expired",
    "expired": "expired",
    "unanswered": "expired",
    "push": "answered",
    "go_on": "answered",
    "solved_meanwhile": "withdrawn",
    "censored": "censored",
}


def _ask_identities(
    records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """Asks = answered + refused + expired + withdrawn + cut off, in events and in records."""
    kinds = Counter(event.kind for event in events)
    ends = Counter(_OUTCOMES[str(e.outcome)] for e in events if e.kind in _ENDS_OF_ASKS)
    answered, refused, expired = (
        sum(getattr(record, name) for record in records)
        for name in ("answered", "refusals", "expired")
    )
    withdrawn = sum(record.withdrawn or 0 for record in records)
    requests = sum(record.requests for record in records)
    asks = kinds[EventKind.BID]
    return {
        "asks = answered + refused + expired + withdrawn + cut off, of events": (
            asks,
            ends.total(),
        ),
        "asks, of events and of records": (asks, requests),
        "answered, of events and of records": (ends["answered"], answered),
        "refused, of events and of records": (ends["refused"], refused),
        "expired, of events and of records": (ends["expired"], expired),
        # Records do not count asks that were cut off: they are the rest of the asks.
        "asks cut off, of events and of records": (
            ends["censored"],
            requests - answered - refused - expired - withdrawn,
        ),
        "withdrawn, of events and of records": (ends["withdrawn"], withdrawn),
        "grants, of events and of records": (
            kinds[EventKind.GRANT],
            sum(record.grants for record in records),
        ),
        "grants = ends of services": (kinds[EventKind.GRANT], kinds[EventKind.SERVICE_END]),
        "starts of tasks = records": (kinds[EventKind.TASK_START], len(records)),
        "ends of tasks = records": (kinds[EventKind.TASK_END], len(records)),
    }


def _window_identities(
    config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """Every bid in a window wins, loses, expires, is withdrawn or is cut off by the horizon."""
    length_ns = nanoseconds(config.window_s)
    inside: set[int | None] = set()  # robots whose bid is in the window, until its end is logged
    is_open, opened_ns, lengths_ns, wait_ns = False, 0, 0, 0
    bids = closed = cut = 0
    for event in events:
        if event.kind is EventKind.WINDOW_OPEN:
            is_open, opened_ns = True, event.time_ns
            # A window that would close after the horizon is cut off; one that closes at it is not.
            end_ns = event.time_ns + length_ns
            cut += config.horizon_s is not None and end_ns > nanoseconds(config.horizon_s)
        elif event.kind is EventKind.WINDOW_CLOSE:
            is_open = False
            closed += 1
            lengths_ns += event.time_ns - opened_ns
        elif event.kind is EventKind.BID and is_open:
            bids += 1
            inside.add(event.robot)
            wait_ns -= event.time_ns
        elif event.kind in ENDS_OF_WAITING and event.robot in inside:
            inside.remove(event.robot)
            wait_ns += event.time_ns
    kinds = Counter(event.kind for event in events)
    lost = sum(event.outcome == "lost" for event in events)
    # Under a policy with windows, all grants are won in a window and all expired bids were in one.
    windows = make_policy(config).discipline is Discipline.WINDOW
    decided = kinds[EventKind.GRANT] + lost if windows else 0
    expired = kinds[EventKind.EXPIRED] if windows else 0
    return {
        "bids in windows = winners + losers + expired + withdrawn + cut off": (
            bids,
            decided + expired,
        ),
        "bids in windows at their close = winners + losers": (
            sum(window_sizes(events)),
            decided,
        ),
        "windows opened = closed + cut off": (kinds[EventKind.WINDOW_OPEN], closed + cut),
        "time of closed windows = their number times T_window": (
            lengths_ns,
            closed * length_ns,
        ),
        "waiting in windows, of events and of records": (
            wait_ns,
            sum(_in_windows_ns(record, windows=windows) for record in records),
        ),
    }


# -- times -------------------------------------------------------------------------------------


def _integral_identities(
    records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """L T = sum of waits (Little's law on the sample path), and busy time = sum of services."""
    waiting_ns = sum(_asking_ns(record) for record in records)
    served_ns = sum(_served_ns(record) for record in records)
    busy_ns = _integral(events, EventKind.GRANT, {EventKind.SERVICE_END})
    services_ns = sum(_durations(events, EventKind.GRANT, {EventKind.SERVICE_END}).values())
    return {
        "integral of the number waiting = waiting of records": (
            _integral(events, EventKind.BID, ENDS_OF_WAITING),
            waiting_ns,
        ),
        "integral of the number of busy operators = services": (busy_ns, services_ns),
        "integral of the number of busy operators = interaction of records": (busy_ns, served_ns),
    }


def _robot_identities(
    config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """Robot by robot: its tasks take all its time; its waits and services match its records."""
    makespan: Counter[int | None] = Counter()
    for event in events:
        if event.kind is EventKind.TASK_END:  # the last end counts; all robots start at 0
            makespan[event.robot] = event.time_ns
    waits = _durations(events, EventKind.BID, ENDS_OF_WAITING)
    services = _durations(events, EventKind.GRANT, {EventKind.SERVICE_END})
    spent, waited, served = Counter(), Counter(), Counter()
    for record in records:
        spent[record.robot] += _spent_ns(record)
        waited[record.robot] += _asking_ns(record)
        served[record.robot] += _served_ns(record)
    found = {}
    for robot in range(config.robots):
        found[f"time of robot {robot}'s tasks = its makespan"] = spent[robot], makespan[robot]
        found[f"waits of robot {robot} = waiting of its records"] = waits[robot], waited[robot]
        found[f"services of robot {robot} = interaction of its records"] = (
            services[robot],
            served[robot],
        )
    return found


def _task_identities(
    records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """Planning + waiting in line + interaction + execution = end - start, task by task."""
    lasted: Counter[tuple[int | None, int | None]] = Counter()
    for event in events:
        if event.kind is EventKind.TASK_START:
            lasted[event.robot, event.task] -= event.time_ns
        elif event.kind is EventKind.TASK_END:
            lasted[event.robot, event.task] += event.time_ns
    found = {}
    for record in sorted(records, key=lambda record: (record.robot, record.task)):
        name = f"task {record.robot}.{record.task}"
        duration = record.end_ns - record.start_ns
        found[f"planning + line + interaction + execution of {name} = its time"] = (
            _spent_ns(record),
            duration,
        )
        found[f"time of {name}, of events and of its record"] = (
            lasted[record.robot, record.task],
            duration,
        )
    return found


# -- checks and attempts -----------------------------------------------------------------------


def _attempt_identities(
    config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """Solved means grasped; planning and execution follow from the numbers of their parts.

    The times are of tasks that ended by themselves: the horizon cuts parts off in the middle.
    """
    if all(record.attempts is None for record in records):
        return {}
    ended = [record for record in records if record.status is not Status.CENSORED]
    tasks = {(record.robot, record.task) for record in ended}
    own = [event for event in events if (event.robot, event.task) in tasks]
    reaches = Counter(event.outcome for event in own if event.kind is EventKind.EXECUTION_END)
    iterations = sum(event.kind is EventKind.ITERATION for event in own)
    attempts = sum(record.attempts or 0 for record in ended)
    push_ns, reach_ns, retreat_ns, rollout_ns = map(
        nanoseconds,
        (
            config.push_execution_s,
            config.reach_execution_s,
            config.retreat_s,
            config.rollout_time_s,
        ),
    )
    pushes = sum(record.pushes_succeeded for record in ended)
    found = {
        "solved tasks = reaches that grasped": (
            sum(record.status is Status.SOLVED for record in ended),
            reaches["reach"],
        ),
        "reaches executed, of events and of records": (
            reaches["reach"] + reaches["missed"],
            attempts,
        ),
        "execution = pushes + reaches + retreats": (
            sum(nanoseconds(record.execution_s) for record in ended),
            pushes * push_ns + attempts * reach_ns + (pushes + reaches["missed"]) * retreat_ns,
        ),
    }
    if config.compute == "dedicated":
        # A check without an outcome is followed by the reach's execution.
        checks = (r.attempts if r.checks is None else r.checks for r in ended)
        # An iteration is two rollouts, an iteration 0 is one; records do not count the latter.
        rollouts = iterations + sum(r.iterations for r in ended) + sum(n or 0 for n in checks)
        planning_ns = sum(nanoseconds(r.planning_time_s) for r in ended)
        windows_ns = sum(nanoseconds(r.window_wait_s) for r in ended)
        lost_ns = sum(nanoseconds(r.lost_s or 0.0) for r in ended)  # broken off
        found["planning = windows + rollouts"] = (
            planning_ns,
            windows_ns + rollouts * rollout_ns + lost_ns,
        )
    return found


def _check_identities(
    config: FleetConfig, records: Sequence[TaskRecord], events: Sequence[Event]
) -> dict[str, tuple[int, int]]:
    """Every check passes or misses, and every reach is executed right after the one that passed."""
    if all(record.checks is None for record in records):
        return {}
    outcomes = Counter(event.outcome for event in events if event.kind is EventKind.CHECK)
    checks, misses, attempts = (
        sum(getattr(record, name) or 0 for record in records)
        for name in ("checks", "check_misses", "attempts")
    )
    found = {
        "checks, of events and of records": (outcomes["passed"] + outcomes["missed"], checks),
        "missed checks, of events and of records": (outcomes["missed"], misses),
        "passed checks of events = reaches executed of records": (outcomes["passed"], attempts),
    }
    executing, execution_ns, booked_ns = set(), Counter(), Counter()
    for event in events:
        if _begins_execution(event):
            executing.add(event.robot)
            execution_ns[event.robot] -= event.time_ns
        elif event.robot in executing and _ends_execution(event):
            executing.remove(event.robot)
            execution_ns[event.robot] += event.time_ns
    for record in records:
        booked_ns[record.robot] += nanoseconds(record.execution_s)
    for robot in range(config.robots):
        name = f"execution of robot {robot}, of events and of its records"
        found[name] = execution_ns[robot], booked_ns[robot]
    return found


def _begins_execution(event: Event) -> bool:
    if event.kind is EventKind.ITERATION:
        return event.object is not None and event.outcome == "feasible"
    return event.kind is EventKind.CHECK and event.outcome == "passed"


def _ends_execution(event: Event) -> bool:
    """After a push and after a miss the retreat is part of it."""
    return event.kind in (EventKind.RETREAT_END, EventKind.TASK_END)


# -- sums --------------------------------------------------------------------------------------


def _spent_ns(record: TaskRecord) -> int:
    """Sum of the times that a task's record holds, ns. Planning includes waiting in windows."""
    line_ns = nanoseconds(record.waiting_s) - nanoseconds(record.window_wait_s)
    others = (record.planning_time_s, record.interaction_s, record.execution_s)
    return line_ns + sum(map(nanoseconds, others))


def _asking_ns(record: TaskRecord) -> int:
    """Time that a task's requests waited, whatever the robot did meanwhile, ns."""
    return nanoseconds(record.waiting_s if record.asking_s is None else record.asking_s)


def _in_windows_ns(record: TaskRecord, *, windows: bool) -> int:
    if record.asking_s is None:
        return nanoseconds(record.window_wait_s)
    return nanoseconds(record.asking_s) if windows else 0


def _served_ns(record: TaskRecord) -> int:
    """Time that operators spent on a task, likewise, ns."""
    return nanoseconds(record.interaction_s if record.served_s is None else record.served_s)


def _integral(events: Sequence[Event], begin: EventKind, ends: Collection[EventKind]) -> int:
    """Integral over time of the number of robots between a `begin` and one of the `ends`, ns."""
    area = number = before_ns = 0
    for event in events:
        area += number * (event.time_ns - before_ns)
        before_ns = event.time_ns
        number += (event.kind is begin) - (event.kind in ends)
    return area


def _durations(
    events: Sequence[Event], begin: EventKind, ends: Collection[EventKind]
) -> Counter[int | None]:
    """Robot -> sum of its times from each `begin` to the following end, ns."""
    # Ends minus beginnings, so that a missing event gives a wrong sum and not an exception.
    sums: Counter[int | None] = Counter()
    for event in events:
        if event.kind is begin:
            sums[event.robot] -= event.time_ns
        elif event.kind in ends:
            sums[event.robot] += event.time_ns
    return sums
