"""Collects the requests of many coroutines into calls of fixed shape."""

import contextlib
import functools
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.requests import (
    Coroutine,
    External,
    Memoised,
    Request,
    Step,
)


class _Job:
    """A deliberation under way, and the results it still waits for."""

    def __init__(self, deliberation: Coroutine, done: Callable[[Any], None]) -> None:
        self.deliberation, self.done = deliberation, done
        self.answers: list[Any] = []
        self.missing = 0


Asked = tuple[_Job, int, Request]  # a request, who asks, and as which of theirs


class _Shared:
    """The result of a `Once`, and who waits for it."""

    def __init__(self) -> None:
        self.there, self.value = False, None
        self.waiting: list[tuple[_Job, int]] = []


class BatchScheduler:
    """Deliberations, all their requests in one line: first come, first served."""

    def __init__(self, planner_service: PlannerService) -> None:
        self._computer = planner_service
        self._steps: deque[Asked] = deque()
        self._others: list[Asked] = []
        self.seconds = 0.0  # of the wall clock spent in it, what is thought between requests too
        self._clocking = False

    def __len__(self) -> int:
        """Requests in line."""
        return len(self._steps) + len(self._others)

    def submit(self, deliberation: Coroutine, done: Callable[[Any], None]) -> None:
        """Start a deliberation; `done` is called with its result, perhaps at once."""
        with self._clocked():
            self._resume(_Job(deliberation, done), None)

    def run_batch(self) -> None:
        """One call's worth of iterations, and what else is asked meanwhile."""
        with self._clocked():
            self._answer(self.take_steps())
            while self._others:  # gains of the iterations just made, say
                self._answer(self.take_others())

    @contextlib.contextmanager
    def _clocked(self) -> Iterator[None]:
        """Counts towards `seconds`; deliberations start others, which counts once."""
        start = None if self._clocking else time.perf_counter()
        self._clocking = True
        try:
            yield
        finally:
            if start is not None:
                self.seconds += time.perf_counter() - start
                self._clocking = False

    def take_steps(self) -> list[Asked]:
        """Take one call's worth of iterations off the line, for `tell`."""
        lanes = self._computer.engine.lanes
        return [self._steps.popleft() for _ in range(min(lanes, len(self._steps)))]

    def take_others(self) -> list[Asked]:
        """Take all that is no iteration off the line, for `tell`."""
        others, self._others = self._others, []
        return others

    def resolve(self, batch: Sequence[Asked], results: Sequence[Any]) -> None:
        """Pass results on to who asked, whose further requests join the line."""
        for (job, place, _), result in zip(batch, results, strict=True):
            self._tell(job, place, result)

    def _answer(self, batch: Sequence[Asked]) -> None:
        self.resolve(batch, self._computer.compute([request for *_, request in batch]))

    def _tell(self, job: _Job, place: int, result: Any) -> None:
        job.answers[place] = result
        job.missing -= 1
        if not job.missing:
            self._resume(job, job.answers)

    def _resume(self, job: _Job, answers: list[Any] | None) -> None:
        while True:
            try:
                requests = job.deliberation.send(answers)  # pyright: ignore[reportArgumentType]
            except StopIteration as end:
                job.done(end.value)
                return
            # One more is missing until all are asked, so that none goes on from within the loop.
            job.answers, job.missing = [None] * len(requests), len(requests) + 1
            for place, request in enumerate(requests):
                self._ask(job, place, request)
            job.missing -= 1
            if job.missing:
                return
            answers = job.answers

    def _ask(self, job: _Job, place: int, request: Request) -> None:
        if isinstance(request, Memoised):
            self._ask_once(job, place, request)
        elif isinstance(request, External):
            request.subscribe(functools.partial(self._tell, job, place))
        else:
            line = self._steps if isinstance(request, Step) else self._others
            line.append((job, place, request))

    def _ask_once(self, job: _Job, place: int, request: Memoised) -> None:
        shared = request.cache.get(request.key)
        if shared is None:
            shared = request.cache[request.key] = _Shared()
            shared.waiting.append((job, place))
            self.submit(request.make(), functools.partial(self._keep, shared))
        elif shared.there:
            self._tell(job, place, shared.value)
        else:
            shared.waiting.append((job, place))

    def _keep(self, shared: _Shared, result: Any) -> None:
        shared.there, shared.value = True, result
        waiting, shared.waiting = shared.waiting, []
        for job, place in waiting:
            self._tell(job, place, result)
