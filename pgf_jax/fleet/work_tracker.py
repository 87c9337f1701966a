"""The fleet's work: asked for, handed out, handed in."""

from pgf_jax.fleet.robots import IterationResult, Result, Work, WorkKind
from pgf_jax.planning.types import NoInput, Push

_RESULTS = {
    WorkKind.ITERATION: IterationResult,
    WorkKind.RETREAT: type(None),
    WorkKind.INPUT: Push | NoInput | None,
}


class WorkTracker:
    """Each piece of work from its request to the use of its result."""

    def __init__(self) -> None:
        self._pending: list[Work] = []  # not handed out yet
        self._outstanding: set[Work] = set()  # handed out, not handed in yet
        self._results: dict[Work, Result] = {}  # handed in, not used yet
        self._open: set[Work] = set()  # inputs of open services that may still come

    def request(self, work: Work, *, is_open: bool = False) -> None:
        """Ask for work; `is_open`: nothing waits for it, its result ends a service."""
        self._pending.append(work)
        if is_open:
            self._open.add(work)

    def dispatch(self) -> list[Work]:
        """All that was asked for since the last call, by robot."""
        work = sorted(self._pending, key=lambda work: work.robot)
        self._pending = []
        self._outstanding.update(work)
        return work

    def deliver(self, work: Work, result: Result) -> bool:
        """Take a result; whether it is the input of an open service.

        Raises:
          ValueError: the work was not handed out, or has been handed in before.
          TypeError: the result is not of the type that the work's kind asks for.
        """
        if work not in self._outstanding:
            raise ValueError(f"not outstanding: {work}")
        if not isinstance(result, _RESULTS[work.kind]):
            raise TypeError(f"{work.kind} cannot result in {result!r}")
        self._outstanding.remove(work)
        self._results[work] = result
        is_open = work in self._open
        self._open.discard(work)
        return is_open

    def is_missing(self, work: Work | None) -> bool:
        """Whether it is work whose result is not there yet."""
        return work is not None and work not in self._results

    def consume(self, work: Work | None) -> Result:
        """The result of work, which is then forgotten; None of no work."""
        return None if work is None else self._results.pop(work)

    def close(self, robot: int) -> None:
        """The robot's open service has ended without its input: nobody can hand it in any more."""
        for work in [work for work in self._open if work.robot == robot]:
            self._open.remove(work)
            self._outstanding.discard(work)
            if work in self._pending:
                self._pending.remove(work)

    def clear(self) -> None:
        """Forget what was asked for, and all results."""
        self._pending.clear()
        self._results.clear()
