"""Several processes that share work out among themselves, each on cores of its own."""

import contextlib
import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

import jax

from pgf_jax.cores import pin, usable
from pgf_jax.errors import BadInput

# JAX's settings that a new process takes over: those of numbers, or results would depend on which
# process computed them, and those of the compilation cache.
_JAX_SETTINGS = (
    "jax_platforms",
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
_STOP_S = 60.0  # a process that is told to stop finishes its round first

Say = Callable[[Any], None]
Target = Callable[[Any, Say, Callable[[], bool]], Any]


class Stopped(Exception):
    """The process was told to stop."""


def run_in_processes(
    target: Target, parts: Sequence[Any], on_message: Callable[[Any], None]
) -> list[Any]:
    """`target(part, say, stop)` for each part, each in a process of its own.

    Engines, policies and operators of the user's own are found there if they are registered where
    the processes come by: in the main script outside its `if __name__ == "__main__"`.

    Args:
      target: importable by name. It may `say(message)`, and raises `Stopped` soon after `stop()`
        is true.
      parts: what each is given; can be pickled, like messages and results.
      on_message: called here with each message.

    Returns:
      What each returned, in the order of their ends.

    Raises:
      BadInput: as it was raised in a process.
      RuntimeError: a process failed, or ended before it was done.
    """
    context = multiprocessing.get_context("spawn")  # JAX's threads do not survive a fork
    stop = context.Event()
    settings = jax_settings()
    available = usable()
    processes, pending, results = [], {}, []
    try:
        for number, part in enumerate(parts):
            # Cores of its own: the threads of several processes would only wait for each other.
            pinned = available[number :: len(parts)] or [available[number % len(available)]]
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(
                target=_work, args=(target, part, theirs, stop, settings, pinned), daemon=True
            )
            with uninterruptible():
                process.start()
            theirs.close()  # so that its end is seen here as the end of the file
            processes.append(process)
            pending[ours] = process
        while pending:
            for connection in wait(list(pending)):
                assert isinstance(connection, Connection)
                kind, content = _receive(connection, pending[connection])
                if kind == "said":
                    on_message(content)
                else:
                    results.append(content)
                    del pending[connection]
    finally:
        stop.set()
        for process in processes:
            process.join(_STOP_S)
            if process.is_alive():
                process.terminate()
                process.join()
    return results


def jax_settings() -> dict[str, Any]:
    """JAX's settings here that a new process takes over."""
    return {name: getattr(jax.config, name) for name in _JAX_SETTINGS}


def take_over(settings: Mapping[str, Any]) -> None:
    """Have the settings of another process."""
    for name, value in settings.items():
        if getattr(jax.config, name) != value:
            jax.config.update(name, value)


@contextlib.contextmanager
def uninterruptible() -> Iterator[None]:
    """Processes started in here never see Ctrl-C, which goes to all of them: the parent decides."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _receive(connection: Connection, process: BaseProcess) -> tuple[str, Any]:
    """One message of a process: ("said", ...) or, the last one, ("done", ...)."""
    try:
        kind, content = connection.recv()
    except (EOFError, OSError):  # between two messages, or within one
        process.join(_STOP_S)
        raise RuntimeError(
            f"a process ended early (exit code {process.exitcode}); what it had finished is kept"
        ) from None
    if kind == "bad input":
        raise BadInput(content)
    if kind == "failed":
        raise RuntimeError("a process failed:\n" + content)
    return kind, content


def _work(
    target: Target,
    part: Any,
    connection: Connection,
    stop: Any,
    settings: dict[str, Any],
    cores: Sequence[int],
) -> None:
    """The main function of a process."""
    pin(cores)
    take_over(settings)
    parent = multiprocessing.parent_process()

    def stopping() -> bool:
        return stop.is_set() or (parent is not None and not parent.is_alive())

    with contextlib.suppress(BrokenPipeError, Stopped):
        try:
            result = target(part, lambda message: connection.send(("said", message)), stopping)
            connection.send(("done", result))
        except (Stopped, BrokenPipeError):
            raise
        except BadInput as error:
            connection.send(("bad input", str(error)))
        except Exception:
            connection.send(("failed", traceback.format_exc()))
