"""Dynamic batching of the requests of many coroutines.

scheduler = BatchScheduler(planner_service)
scheduler.submit(coroutine, on_result)
while len(scheduler):
    scheduler.run_batch()
"""

import concurrent.futures
import contextlib
import functools
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from pgf_jax.batching.planner_service import PlannerService
from pgf_jax.batching.requests import Coroutine, Execute, External, Memoised, Request, Step


class _Running:
    """A coroutine under way, and the results that it still waits for."""

    def __init__(self, coroutine: Coroutine, on_result: Callable[[Any], None]) -> None:
        self.coroutine, self.on_result = coroutine, on_result
        self.answers: list[Any] = []
        self.missing = 0


Pending = tuple[_Running, int, Request]  # who asks, as which of its requests, and the request


class _Memo:
    """The result of a `Memoised` request, and who waits for it."""

    def __init__(self) -> None:
        self.known, self.value = False, None
        self.waiting: list[tuple[_Running, int]] = []


class BatchScheduler:
    """Runs coroutines, and computes their requests in batches: first come, first served.

    Args:
      planner_service: computes them.
      threads: calls of it at a time. With several, the coroutines go on here while calls are under
        way. No result depends on it.
    """

    def __init__(self, planner_service: PlannerService, threads: int = 1) -> None:
        self._planner_service = planner_service
        self._steps: deque[Pending] = deque()
        self._others: list[Pending] = []
        self.seconds = 0.0  # of the wall clock spent in it, in the coroutines too
        self._timing = False
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._under_way: dict[Future[list[Any]], list[Pending]] = {}

    def __len__(self) -> int:
        """Requests that wait to be computed, or are being computed."""
        under_way = sum(len(batch) for batch in self._under_way.values())
        return len(self._steps) + len(self._others) + under_way

    def submit(self, coroutine: Coroutine, on_result: Callable[[Any], None]) -> None:
        """Start a coroutine; `on_result` is called with its result, perhaps at once."""
        with self._timed():
            self._resume(_Running(coroutine, on_result), None)

    def run(self, coroutine: Coroutine) -> Any:
        """Run one coroutine to its end; returns its result."""
        results: list[Any] = []
        self.submit(coroutine, results.append)
        while len(self):
            self.run_batch()
        return results[0]

    def run_batch(self) -> None:
        """Compute one call's worth of iterations, and all other requests that wait by then.

        With several threads: have every thread compute something, and wait for the first result.
        """
        with self._timed():
            if self._pool is not None:
                self._start_calls(self._pool)
                self._wait_for_one()
                return
            self._compute(self.take_steps())
            while self._others:  # gains of the iterations just made, say
                self._compute(self.take_others())

    def _start_calls(self, pool: ThreadPoolExecutor) -> None:
        while (free := self._threads - len(self._under_way)) and (self._others or self._steps):
            batch = self._next_call(free)
            asked = [request for *_, request in batch]
            self._under_way[pool.submit(self._planner_service.compute, asked)] = batch

    def _next_call(self, free: int) -> list[Pending]:
        """What a thread computes next; `free` of them have nothing to do."""
        executions = [pending for pending in self._others if isinstance(pending[-1], Execute)]
        if len(executions) < len(self._others):
            others, self._others = self._others, executions
            return [pending for pending in others if not isinstance(pending[-1], Execute)]
        if executions:  # before iterations, of which a call takes more when more robots wait
            return [self._others.pop(0)]
        share = -(-len(self._steps) // free)
        return self.take_steps(share)

    def _wait_for_one(self) -> None:
        done, _ = concurrent.futures.wait(
            self._under_way, return_when=concurrent.futures.FIRST_COMPLETED
        )
        for future in done:
            self.resolve(self._under_way.pop(future), future.result())

    def take_steps(self, most: int | None = None) -> list[Pending]:
        """Take iterations out of the queue, for `resolve`: one call's worth, and at most `most`.

        All are of one program, that of the first, so that the call's lanes are full if they can be.
        """
        lanes = self._planner_service.engine.lanes
        count = lanes if most is None else min(lanes, most)
        taken: list[Pending] = []
        left: deque[Pending] = deque()
        while self._steps and len(taken) < count:
            pending = self._steps.popleft()
            same = not taken or _program(pending) == _program(taken[0])
            (taken if same else left).append(pending)
        self._steps.extendleft(reversed(left))
        return taken

    def take_others(self) -> list[Pending]:
        """Take all requests that are no iterations out of the queue, for `resolve`."""
        others, self._others = self._others, []
        return others

    def resolve(self, batch: Sequence[Pending], results: Sequence[Any]) -> None:
        """Send results to the coroutines that asked; their next requests join the queue."""
        for (running, place, _), result in zip(batch, results, strict=True):
            self._deliver(running, place, result)

    @contextlib.contextmanager
    def _timed(self) -> Iterator[None]:
        """Count towards `seconds`; coroutines start others, which counts once."""
        start = None if self._timing else time.perf_counter()
        self._timing = True
        try:
            yield
        finally:
            if start is not None:
                self.seconds += time.perf_counter() - start
                self._timing = False

    def _compute(self, batch: Sequence[Pending]) -> None:
        self.resolve(batch, self._planner_service.compute([request for *_, request in batch]))

    def _deliver(self, running: _Running, place: int, result: Any) -> None:
        running.answers[place] = result
        running.missing -= 1
        if not running.missing:
            self._resume(running, running.answers)

    def _resume(self, running: _Running, answers: list[Any] | None) -> None:
        while True:
            try:
                requests = running.coroutine.send(answers)  # pyright: ignore[reportArgumentType]
            except StopIteration as end:
                running.on_result(end.value)
                return
            # One more is missing until all are enqueued, so that none goes on from within the loop.
            running.answers, running.missing = [None] * len(requests), len(requests) + 1
            for place, request in enumerate(requests):
                self._enqueue(running, place, request)
            running.missing -= 1
            if running.missing:
                return
            answers = running.answers

    def _enqueue(self, running: _Running, place: int, request: Request) -> None:
        if isinstance(request, Memoised):
            self._enqueue_memoised(running, place, request)
        elif isinstance(request, External):
            request.subscribe(functools.partial(self._deliver, running, place))
        else:
            queue = self._steps if isinstance(request, Step) else self._others
            queue.append((running, place, request))

    def _enqueue_memoised(self, running: _Running, place: int, request: Memoised) -> None:
        memo = request.cache.get(request.key)
        if memo is None:
            memo = request.cache[request.key] = _Memo()
            memo.waiting.append((running, place))
            self.submit(request.make(), functools.partial(self._memoise, memo))
        elif memo.known:
            self._deliver(running, place, memo.value)
        else:
            memo.waiting.append((running, place))

    def _memoise(self, memo: _Memo, result: Any) -> None:
        memo.known, memo.value = True, result
        waiting, memo.waiting = memo.waiting, []
        for running, place in waiting:
            self._deliver(running, place, result)


def _program(pending: Pending) -> Hashable:
    step: Any = pending[-1]
    return step.program
