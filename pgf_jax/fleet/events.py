"""The fleet's event log: each event is one row of `events.parquet`."""

import enum
from typing import NamedTuple


class EventKind(enum.StrEnum):
    """The kind of an event. The comments list the outcomes of a kind, where it has any.

    Every bid ends in exactly one of: REFUSED, EXPIRED, SERVICE_END.
    """

    TASK_START = "task_start"
    ITERATION = "iteration"  # ended; outcome feasible, stuck or None; pushing: `object` is set
    CHECK = "check"  # of a feasible reach; outcome passed, missed; only where checks are real
    BID = "bid"  # an ask, under any policy; `gain` is the bid
    WINDOW_OPEN = "window_open"  # by `robot`, whose bid follows
    WINDOW_CLOSE = "window_close"  # no robot; its grants and refusals follow
    GRANT = "grant"  # the service starts
    REFUSED = "refused"  # outcome busy (no operator free), lost (outbid in a window)
    # While waiting; outcome limit (of the task), censored (the horizon), solved_meanwhile.
    EXPIRED = "expired"
    # Outcome push, go_on; no input: unanswered, expired, censored, solved_meanwhile.
    SERVICE_END = "service_end"
    PUSH_DROPPED = "push_dropped"  # no feasible push within the limit
    EXECUTION_END = "execution_end"  # outcome push, reach; missed: a reach that did not grasp
    RETREAT_END = "retreat_end"  # after a push, whose `object` is set, or after a missed reach
    TASK_END = "task_end"  # outcome: the Status
    OPERATOR_AWAY = "operator_away"  # no robot; serves nobody else from now on
    OPERATOR_BACK = "operator_back"


# Each ends the waiting that a BID begins. After a GRANT the ask itself ends with SERVICE_END.
ENDS_OF_WAITING = frozenset({EventKind.GRANT, EventKind.REFUSED, EventKind.EXPIRED})


class Event(NamedTuple):
    """One row of the event log. A column that does not apply is None.

    Attributes:
      time_ns: simulated time, ns.
      kind: what happened; see `EventKind`. `check` is there only in fleets whose final checks are
        real rollouts.
      robot: the robot, 0-based.
      task: the robot's task, 0-based.
      request: the service of the task that is asked for or given, 0-based. An ask that was refused
        is repeated under the same number, because the service time is drawn by this number.
      operator: the operator, 0-based.
      iteration: the last iteration that has ended, counted over the task as in `Work`.
      gain: an iteration's gain, or what it is after a check that missed; a bid's value.
      object: the object to push, 0-based.
      x, y: the target of the object's centre, m.
      outcome: see `EventKind`. `missed` is there only in fleets whose checks or reaches may miss,
        `solved_meanwhile` only where robots plan while they ask or are served.
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
