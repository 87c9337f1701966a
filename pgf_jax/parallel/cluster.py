"""Opens the workers of a cluster as an executor."""

import contextlib
from concurrent.futures import Executor

from pgf_jax.errors import BadInput


def open_cluster(address: str) -> tuple[Executor, int]:
    """Open the workers of a Dask scheduler, or those that Slurm starts.

    Args:
      address: tcp://HOST:PORT, tls://HOST:PORT, or slurm:N.

    Returns:
      The executor, and the number of its workers.

    Raises:
      BadInput: Dask is not installed; no scheduler answers there, or it has no workers, or some of
        several threads.
    """
    try:
        from pgf_jax.parallel.dask_executor import DaskExecutor
    except ModuleNotFoundError as error:
        raise BadInput(
            f"scheduler: needs {error.name}, expected an installation with it: "
            "pip install 'pgf_jax[cluster]'"
        ) from None
    executor = DaskExecutor(address)
    try:
        return executor, executor.count()
    except BaseException:
        with contextlib.suppress(Exception):
            executor.shutdown(wait=False)
        raise
