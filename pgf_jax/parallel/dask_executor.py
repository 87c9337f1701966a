"""The workers of a Dask scheduler as an executor; Slurm may start them."""

import contextlib
import logging
import warnings
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from typing import Any

import dask.config
from distributed import Client, KilledWorker

from pgf_jax.errors import BadInput, WorkersLost

_ANSWER_S = 20.0  # for a scheduler to answer
_WORKERS_S = 120.0  # for the first worker of one that runs
_JOB = {"cores": 1, "processes": 1, "memory": "3GiB"}  # a worker of Slurm; jobqueue.yaml has more


class DaskExecutor(Executor):
    """The workers of a Dask scheduler.

    Dask replaces a worker that dies: its batch is computed by another one. Where the
    scheduler is gone, futures are cancelled.

    Args:
      address: tcp://HOST:PORT or tls://HOST:PORT; or slurm:N, to have Slurm run N workers as long
        as this is open, as Dask's jobqueue.yaml says.

    Raises:
      BadInput: no scheduler answers there, or Slurm's commands are not there.
      ModuleNotFoundError: slurm needs dask-jobqueue.
    """

    claim = True  # each worker has to find a core for itself

    def __init__(self, address: str) -> None:
        self._address, self._slurm, self._asked = address, None, None
        # A scheduler that is gone is reported here, in one line, and not by its client in fifty.
        self._log = logging.getLogger("distributed.client")
        self._level = self._log.level
        self._log.setLevel(logging.CRITICAL)
        if address.startswith("slurm:"):
            self._asked = int(address.removeprefix("slurm:"))
            self._slurm = _slurm(self._asked)
        try:
            # Not the default client: the user's program may have one.
            self._client = Client(self._slurm or address, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            self._close_slurm()
            self._log.setLevel(self._level)
            raise BadInput(
                f"scheduler: {address} does not answer, expected a Dask scheduler there "
                f"({str(error) or type(error).__name__})"
            ) from None
        # Not pure: Dask would compute two calls with the same arguments once.
        self._executor = self._client.get_executor(pure=False)

    def count(self) -> int:
        """How many workers there are, or there will be.

        Raises:
          BadInput: none, or one that computes several things at once.
        """
        try:
            self._client.wait_for_workers(1, timeout=None if self._slurm else _WORKERS_S)
        except TimeoutError:
            raise BadInput(f"scheduler: {self._address} has no workers") from None
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        for name, worker in workers.items():
            if worker["nthreads"] != 1:
                raise BadInput(
                    f"scheduler: the worker {name} has {worker['nthreads']} threads, expected one "
                    "process a core: dask worker ADDRESS --nworkers CORES --nthreads 1"
                )
        return self._asked or len(workers)

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """See `Executor.submit`; the future raises `Lost` where one worker after the other died.

        And `BrokenExecutor` where the scheduler is gone.
        """
        ours: Future = Future()
        ours.set_running_or_notify_cancel()

        def done(theirs: Future) -> None:
            try:
                ours.set_result(theirs.result())
            except KilledWorker as error:
                ours.set_exception(
                    WorkersLost(f"one worker after the other has died of the same cells ({error})")
                )
            except CancelledError:
                gone = f"the scheduler {self._address} has gone"
                ours.set_exception(BrokenExecutor(gone))
            except BaseException as error:
                ours.set_exception(error)

        self._executor.submit(fn, *args, **kwargs).add_done_callback(done)
        return ours

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `Executor.shutdown`; what runs on machines with other disks is not waited for."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self._executor.shutdown(wait=False)
        with contextlib.suppress(Exception):
            self._client.close(timeout=5)
        self._close_slurm()
        self._log.setLevel(self._level)

    def _close_slurm(self) -> None:
        if self._slurm is not None:
            self._slurm.close()


def _slurm(workers: int) -> Any:
    from dask_jobqueue.slurm import SLURMCluster

    # What the user has configured stays; the rest is a worker of one core.
    configured = dask.config.get("jobqueue.slurm", {})
    missing = {name: value for name, value in _JOB.items() if configured.get(name) is None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        cluster = SLURMCluster(**missing)
    cluster.scale(n=workers)
    return cluster
