"""Worker processes of this computer, as an executor of `concurrent.futures`.

Importing this does not import JAX: a process is kept to its cores before JAX counts them.
"""

import concurrent.futures
import contextlib
import itertools
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from concurrent.futures import ThreadPoolExecutor as Threads
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection, wait
from typing import Any

from pgf_jax.cores import pin, usable
from pgf_jax.plugins.registry import Plugin, require

_POLL_S = 0.2


class WorkerDied(BrokenExecutor):
    """A worker has died; the executor starts another one for what is submitted next."""


class Stopped(Exception):
    """A worker was told to stop, and did."""


class LocalPool(Executor):
    """Processes of this computer, each on cores of its own, kept from call to call.

    Each is a `ProcessPoolExecutor` of one process, so that one that dies takes no other with it.
    Engines, policies and operators of the user's own are found there if they are registered when
    the main script is imported: outside its `if __name__ == "__main__"`.

    Args:
      count: of processes.
      grace_s: how long a process may go on after its parent's death, to store what it has; s.
      cores: numbers of the cores that they share out; None: all that this process may use.

    Attributes:
      cores_each: cores of each process, at least.
    """

    def __init__(
        self, count: int, *, grace_s: float = 0.0, cores: Sequence[int] | None = None
    ) -> None:
        self._count, self._grace_s = count, grace_s
        self._cores = usable() if cores is None else list(cores)
        self.cores_each = max(1, len(self._cores) // count)
        self._threads = Threads(count, thread_name_prefix="worker")
        self._numbers = itertools.count()
        self._own = threading.local()  # of each thread: its number, and its process
        self._pools: list[ProcessPoolExecutor] = []
        self._context = multiprocessing.get_context("spawn")  # JAX's threads do not survive a fork
        self._stop = self._context.Event()
        self._messages: list[Connection] = []

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """See `Executor.submit`; the future raises `WorkerDied` where the process did."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def run(
        self,
        target: Callable[[Any], Any],
        parts: Sequence[Any],
        on_message: Callable[[Any], None],
        *,
        plugins: Sequence[Plugin] = (),
    ) -> list[Any]:
        """Run `target(part)` for each part, and wait for all of them.

        Args:
          target: importable by name. It may call `report(message)`, and raises `Stopped` soon after
            `stop_requested()` is true.
          parts: arguments; can be pickled, like messages and results.
          on_message: called here with each message.
          plugins: what the target uses of plugins.

        Returns:
          The results, in the order of the parts.

        Raises:
          WorkerDied: a process did.
          Exception: as `target` raised it; the other parts are stopped.
        """
        from pgf_jax.parallel.jax_settings import jax_settings

        self._stop.clear()
        futures = [self.submit(_run_part, target, part, jax_settings(), plugins) for part in parts]
        try:
            while not all(future.done() for future in futures):
                self._receive(on_message, _POLL_S)
                for future in futures:
                    if future.done():
                        future.result()  # raises at once what it raised
            self._receive(on_message, 0.0)
            return [future.result() for future in futures]
        finally:
            self._stop.set()
            while concurrent.futures.wait(futures, _POLL_S).not_done:
                self._receive(lambda message: None, 0.0)  # or a worker could not send, and wait

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `Executor.shutdown`."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)

    def _call(self, fn: Callable, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
        try:
            if getattr(self._own, "pool", None) is None:
                future = self._start_pool(fn, args, kwargs)
            else:
                future = self._own.pool.submit(fn, *args, **kwargs)
            return future.result()
        except BrokenProcessPool:
            self._pools.remove(self._own.pool)
            self._own.pool = None
            raise WorkerDied("a process ended early") from None

    def _start_pool(self, fn: Callable, args: Sequence[Any], kwargs: dict[str, Any]) -> Future:
        """Start this thread's process, with its first call."""
        if not hasattr(self._own, "number"):
            self._own.number = next(self._numbers)
        number = self._own.number
        # Cores of its own: the threads of several processes would only wait for each other.
        cores = self._cores[number :: self._count] or [self._cores[number % len(self._cores)]]
        ours, theirs = self._context.Pipe(duplex=False)
        self._own.pool = ProcessPoolExecutor(
            1,
            mp_context=self._context,
            initializer=_prepare,
            initargs=(cores, theirs, self._stop, self._grace_s),
        )
        self._pools.append(self._own.pool)
        with uninterruptible():  # it is started by this
            future = self._own.pool.submit(fn, *args, **kwargs)
        theirs.close()  # so that its death is seen here as the end of the messages
        self._messages.append(ours)
        return future

    def _receive(self, on_message: Callable[[Any], None], timeout_s: float) -> None:
        """Pass on the messages that are there; wait for the first one at most `timeout_s`."""
        if not self._messages:
            time.sleep(timeout_s)
        while ready := wait(list(self._messages), timeout_s):
            timeout_s = 0.0
            for connection in ready:
                assert isinstance(connection, Connection)
                try:
                    on_message(connection.recv())
                except (EOFError, OSError):  # its process has ended
                    self._messages.remove(connection)


@contextlib.contextmanager
def uninterruptible() -> Iterator[None]:
    """Processes started in here never see Ctrl-C, which goes to all of them: the parent decides."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# -- in a worker ---------------------------------------------------------------------------------

_messages: Connection | None = None
_stop: Any = None


def report(message: Any) -> None:
    """Send a message to the parent."""
    if _messages is not None:
        with contextlib.suppress(BrokenPipeError):  # the parent has gone: `stop_requested` says so
            _messages.send(message)


def stop_requested() -> bool:
    """Whether the parent wants this process to stop, or has gone."""
    return _stop is not None and _stop.is_set()


def _prepare(cores: Sequence[int], messages: Connection, stop: Any, grace_s: float) -> None:
    global _messages, _stop
    _messages, _stop = messages, stop
    pin(cores)
    threading.Thread(target=_watch_parent, args=(grace_s,), daemon=True).start()


def _watch_parent(grace_s: float) -> None:
    """End with the process that started this one, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        if grace_s > 0:
            _stop.set()
            time.sleep(grace_s)
        os._exit(1)


def _run_part(
    target: Callable[[Any], Any],
    part: Any,
    settings: Mapping[str, Any],
    plugins: Sequence[Plugin],
) -> Any:
    from pgf_jax.parallel.jax_settings import adopt

    adopt(settings)
    for plugin in plugins:
        require(plugin, "worker process")
    return target(part)
