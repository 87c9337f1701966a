"""The function that a worker process is called with, to compute a batch of cells.

Importing this imports neither JAX nor MuJoCo, so that a process can be prepared before they look at
its cores and its environment.
"""

import contextlib
import pickle
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from pgf_jax import cores
from pgf_jax.jax_setup import AS_CALLER, as_caller, configure_early

if TYPE_CHECKING:
    from pgf_jax.sweeping.worker import BatchResult


class WorkerCall(NamedTuple):
    """The argument of a worker's call.

    Attributes:
      batch: a pickled `Batch`; unpickling it imports JAX.
      jax: settings of JAX, see `parallel.jax_settings`.
      engine: of its cells; None where they have several.
      claim: whether the worker has to find a core for itself.
      threads: calls of the engine that the worker makes at a time.
    """

    batch: bytes
    jax: Mapping[str, Any]
    engine: str | None
    claim: bool
    threads: int


_one_at_a_time = threading.Lock()  # whatever the process's owner thinks it can do at once


def compute(call: WorkerCall) -> "BatchResult":
    """Compute a batch.

    Raises:
      BadInput, Stopped: see `worker.run_batch`.
    """
    with _one_at_a_time:
        if call.claim:
            cores.claim()
        as_caller(call.jax[AS_CALLER])
        configure_early(call.engine, call.threads)
        from pgf_jax.parallel.jax_settings import adopt

        adopt(call.jax)
        from pgf_jax.sweeping.worker import run_batch

        with _unsampled():
            return run_batch(pickle.loads(call.batch), threads=call.threads)


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
