"""Tracks work items from request to result."""

from pgf_jax.fleet.robots import (
    CheckResult,
    IterationResult,
    ReachResult,
    Result,
    Work,
    WorkKind,
)
from pgf_jax.planning.types import NoInput, Push

_RESULT_TYPES = {
    WorkKind.ITERATION: IterationResult,
    WorkKind.RETREAT: type(None),
    WorkKind.INPUT: Push | NoInput | None,
    WorkKind.CHECK: CheckResult,
    WorkKind.REACH: ReachResult,
}


class WorkTracker:
    """The work items of one fleet: requested, dispatched, delivered, and consumed by an event."""

    def __init__(self) -> None:
        self._pending: list[Work] = []  # requested, not dispatched yet
        self._outstanding: set[Work] = set()  # dispatched, not delivered yet
        self._results: dict[Work, Result] = {}  # delivered, not consumed yet
        self._open: set[Work] = set()  # inputs of open services that may still come
        self._discarded: set[Work] = set()  # outstanding, but nobody wants the result any more

    def request(self, work: Work, *, is_open: bool = False) -> None:
        """Request work.

        Args:
          work: the item.
          is_open: the work is the input of an open service: no scheduled event needs its result,
            and its delivery ends the service.
        """
        self._pending.append(work)
        if is_open:
            self._open.add(work)

    def dispatch(self) -> list[Work]:
        """All work requested since the last call, by robot."""
        work = sorted(self._pending, key=lambda work: work.robot)
        self._pending = []
        self._outstanding.update(work)
        return work

    def deliver(self, work: Work, result: Result) -> bool:
        """Store the result of dispatched work.

        Returns:
          Whether it is the input of an open service.

        Raises:
          ValueError: the work was not dispatched, or has been delivered before.
          TypeError: the result has not the type that this kind of work has.
        """
        if work in self._discarded:
            self._discarded.remove(work)
            return False
        if work not in self._outstanding:
            raise ValueError(f"not outstanding: {work}")
        if not isinstance(result, _RESULT_TYPES[work.kind]):
            raise TypeError(f"{work.kind} cannot result in {result!r}")
        self._outstanding.remove(work)
        self._results[work] = result
        is_open = work in self._open
        self._open.discard(work)
        return is_open

    def is_missing(self, work: Work | None) -> bool:
        """Whether the result of `work` has not been delivered yet; False for None."""
        return work is not None and work not in self._results

    def consume(self, work: Work | None) -> Result:
        """Remove and return the result of `work`; None for None."""
        return None if work is None else self._results.pop(work)

    def discard(self, work: Work) -> None:
        """Forget work: its result is not wanted any more, if it has one."""
        self._results.pop(work, None)
        if work in self._pending:
            self._pending.remove(work)
        elif work in self._outstanding:
            self._outstanding.remove(work)
            self._discarded.add(work)

    def cancel_open_input(self, robot: int) -> None:
        """Cancel the input of the robot's open service: it can no longer be delivered."""
        for work in [work for work in self._open if work.robot == robot]:
            self._open.remove(work)
            self._outstanding.discard(work)
            if work in self._pending:
                self._pending.remove(work)

    def clear(self) -> None:
        """Drop all requests that were not dispatched, and all results."""
        self._pending.clear()
        self._results.clear()
