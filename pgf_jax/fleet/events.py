"""The fleet's event log: one row of `events.parquet` (D11) for everything that happens."""

import enum
from typing import NamedTuple


class EventKind(enum.StrEnum):
    """What happened. `outcome` refines it where a list is given.

    Every bid ends in exactly one of: REFUSED, EXPIRED, SERVICE_END.
    """

    TASK_START = "task_start"
    ITERATION = "iteration"  # ended; outcome feasible, stuck or None; pushing: `object` is set
    BID = "bid"  # an ask, under any policy; `gain` is the bid
    WINDOW_OPEN = "window_open"  # by `robot`, whose bid follows
    WINDOW_CLOSE = "window_close"  # no robot; its grants and refusals follow
    GRANT = "grant"  # the service starts
    REFUSED = "refused"  # outcome busy (no operator free), lost (outbid in a window)
    EXPIRED = "expired"  # while waiting; outcome limit (of the task), censored (the horizon)
    SERVICE_END = "service_end"  # outcome push, go_on; no input: unanswered, expired, censored
    PUSH_DROPPED = "push_dropped"  # no feasible push within the limit
    EXECUTION_END = "execution_end"  # outcome push, reach
    RETREAT_END = "retreat_end"
    TASK_END = "task_end"  # outcome: the Status
    OPERATOR_AWAY = "operator_away"  # no robot; serves nobody else from now on
    OPERATOR_BACK = "operator_back"


# What ends the waiting that a BID begins (a grant goes on to its SERVICE_END).
ENDS_OF_WAITING = frozenset({EventKind.GRANT, EventKind.REFUSED, EventKind.EXPIRED})


class Event(NamedTuple):
    """One row. What does not apply is None.

    Attributes:
      time_ns: simulated time, ns.
      kind: what happened.
      robot, task: whose; 0-based.
      request: which service of the task is asked for or given, 0-based. An ask that was refused is
        repeated under the same number: it is the number that the service time is drawn by.
      operator: who serves, 0-based.
      iteration: the last iteration that has ended, counted over the task as in `Work`.
      gain: an iteration's gain; a bid's value.
      object: the object to push, 0-based.
      x, y: where its centre is to come, m.
      outcome: see `EventKind`.
    """

    time_ns: int
    kind: EventKind
    robot: int | None = None
    task: int | None = None
    request: int | None = None
    operator: int | None = None
    iteration: int | None = None
    gain: float | None = None
    object: int | None = None
    x: float | None = None
    y: float | None = None
    outcome: str | None = None
