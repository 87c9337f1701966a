"""A worker's door: what is called in a process that computes a batch of a sweep's cells.

Importing this imports neither JAX nor MuJoCo, so that a process can be prepared before they look at
its cores and its environment.
"""

import contextlib
import os
import pickle
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from pgf_jax import cores

if TYPE_CHECKING:
    from pgf_jax.sweeping.worker import Result


class WorkerCall(NamedTuple):
    """What a worker is sent.

    Attributes:
      batch: a pickled `Batch`; unpickling it imports JAX.
      jax: settings of JAX, see `processes.jax_settings`.
      environment: variables to be set unless they are.
      claim: whether the worker has to find itself a core.
    """

    batch: bytes
    jax: Mapping[str, Any]
    environment: Mapping[str, str]
    claim: bool


_one_at_a_time = threading.Lock()  # whatever the process's owner thinks it can do at once


def compute(order: WorkerCall) -> "Result":
    """Compute a batch.

    Raises:
      BadInput: something it was given cannot be used, or a file cannot be written; or this machine
        is another kind than that which asked.
      Stopped: the sweep has ended before.
    """
    with _one_at_a_time:
        if order.claim:
            cores.claim()
        if "jax" not in sys.modules:
            for name, value in order.environment.items():
                os.environ.setdefault(name, value)
        from pgf_jax.parallel.processes import take_over

        take_over(order.jax)
        from pgf_jax.sweeping.worker import run_batch

        with _unsampled():
            return run_batch(pickle.loads(order.batch))


@contextlib.contextmanager
def _unsampled() -> Iterator[None]:
    """Keep Dask from sampling the stack a hundred times a second, which slows our Python down."""
    try:
        distributed = sys.modules["distributed"]
        worker = distributed.get_worker()
        sampling = worker.periodic_callbacks["profile"]
    except (KeyError, ValueError, AttributeError):  # no worker of Dask's, or one that does not
        yield
        return
    worker.loop.add_callback(sampling.stop)
    try:
        yield
    finally:
        worker.loop.add_callback(sampling.start)
