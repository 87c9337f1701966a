"""What computes batches of cells: processes of this computer, or a cluster's workers.

Both are executors in the sense of `concurrent.futures`: anything that is one will do.
"""

import itertools
import multiprocessing
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from concurrent.futures import ThreadPoolExecutor as Threads
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any

from pgf_jax.cores import pin, usable
from pgf_jax.parallel.processes import uninterruptible


class WorkerDied(BrokenExecutor):
    """A worker has died; its executor has another one for what is submitted next."""


class LocalPool(Executor):
    """Processes of this computer, each on cores of its own, kept from call to call.

    A `ProcessPoolExecutor` of one process for each, so that one that dies takes nobody along.
    Engines, policies and operators of the user's own are found there if they are registered where
    the processes come by: in the main script outside its `if __name__ == "__main__"`.

    Args:
      count: how many.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._cores = usable()
        self._threads = Threads(count, thread_name_prefix="worker")
        self._numbers = itertools.count()
        self._own = threading.local()  # of each thread: its number, and its process
        self._pools: list[ProcessPoolExecutor] = []

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """See `Executor.submit`; the future raises `WorkerDied` where the process did."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `Executor.shutdown`."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)

    def _call(self, fn: Callable, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
        if getattr(self._own, "pool", None) is None:
            self._own.pool = self._new_pool()
        try:
            with uninterruptible():  # it is started by this
                future = self._own.pool.submit(fn, *args, **kwargs)
            return future.result()
        except BrokenProcessPool:
            self._pools.remove(self._own.pool)
            self._own.pool = None
            raise WorkerDied("a process ended early") from None

    def _new_pool(self) -> ProcessPoolExecutor:
        if not hasattr(self._own, "number"):
            self._own.number = next(self._numbers)
        number = self._own.number
        # Cores of its own: the threads of several processes would only wait for each other.
        cores = self._cores[number :: self._count] or [self._cores[number % len(self._cores)]]
        pool = ProcessPoolExecutor(
            1,
            mp_context=multiprocessing.get_context("spawn"),  # JAX's threads do not survive a fork
            initializer=_prepare,
            initargs=(cores,),
        )
        self._pools.append(pool)
        return pool


def _prepare(cores: Sequence[int]) -> None:
    pin(cores)
    threading.Thread(target=_watch, daemon=True).start()


def _watch() -> None:
    """End with the process that started this one, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
