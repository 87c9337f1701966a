"""Parquet of any origin, decoded in a process of its own.

Polars' decoder panics on many damaged files, each time with a trace of its calls on standard error,
and on some it ends the process: about one in 300 of files with a few changed bytes makes it ask for
2e18 bytes. That must not end a sweep that looks for finished cells, nor a server. So one process,
started at the first table and kept for the next ones, decodes them; where it dies, takes too long
or takes too much memory, the file is a bad one. It returns the table as Arrow's IPC stream.

The process runs this file alone: nothing of pgf_jax, so that it starts as soon as Polars does.
"""

import atexit
import contextlib
import io
import json
import os
import select
import struct
import subprocess
import sys
import threading
import time
from typing import IO

import polars as pl

MEMORY = 4 << 30  # bytes that the process may take: 5e6 events fit
SECONDS = 60.0  # for one table
_SLOWEST = 20e6  # bytes/s of a file: large ones may take longer
_HEAD = struct.Struct("<BQ")  # how it went, bytes that follow
_OK, _BAD, _LAST = 0, 1, 2  # last: bad, and who knows what a panic has left behind


class Undecodable(Exception):
    """The bytes are no Parquet file; says why in one line."""


def decode(data: bytes) -> tuple[pl.DataFrame, dict[str, str]]:
    """The table of a Parquet file, and the texts that its writer added to it.

    Raises:
      Undecodable: they are not a whole Parquet file, or one of no reasonable size.
    """
    global _process
    # Every Parquet file begins and ends so; of others the decoder has little to say.
    if len(data) < 12 or data[:4] != b"PAR1" or data[-4:] != b"PAR1":
        raise Undecodable("it does not begin and end as one")
    with _lock:
        if _process is None or _process.pid != os.getpid():  # of before a fork: not ours
            _process = _Process()
        status = _LAST  # at Ctrl-C, too: what it said next would be the answer to this
        try:
            status, answer = _process.ask(data)
        except _Died as error:
            raise Undecodable(str(error)) from None
        finally:
            if status == _LAST:
                _process.end()
                _process = None
    if status != _OK:
        raise Undecodable(answer.decode(errors="replace"))
    texts, table = _split(answer)
    return pl.read_ipc_stream(io.BytesIO(table)), json.loads(texts)


# -- here ------------------------------------------------------------------------------------------


class _Died(Exception):
    """The process has ended without an answer, or was ended."""


class _Process:
    """The process, seen from here."""

    def __init__(self) -> None:
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            "POLARS_MAX_THREADS": "1",
            "RUST_BACKTRACE": "0",
        }
        self.pid = os.getpid()
        self._popen = subprocess.Popen(
            [sys.executable, "-P", __file__],  # -P: our modules' names are not the library's
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # panics
            env=environment,
            start_new_session=True,  # Ctrl-C is for us: we end it
        )
        assert self._popen.stdin is not None and self._popen.stdout is not None
        self._to, self._from = self._popen.stdin.fileno(), self._popen.stdout.fileno()
        os.set_blocking(self._to, False)
        os.set_blocking(self._from, False)
        try:
            self._left(_HEAD.size, time.monotonic() + SECONDS)  # Polars is imported
        except BaseException as error:
            self.end()
            if isinstance(error, _Died):
                raise RuntimeError(f"Parquet's decoder does not start: {error}") from None
            raise

    def ask(self, data: bytes) -> tuple[int, bytes]:
        """How it went, and the answer, or why it could not be decoded."""
        until = time.monotonic() + SECONDS + len(data) / _SLOWEST
        self._give(_HEAD.pack(_OK, len(data)), until)
        self._give(data, until)
        status, size = _HEAD.unpack(self._left(_HEAD.size, until))
        return status, self._left(size, until)

    def end(self) -> None:
        """End it."""
        self._popen.kill()
        self._popen.communicate()

    def _give(self, data: bytes, until: float) -> None:
        view = memoryview(data)
        while view:
            self._wait(until, to=True)
            try:
                view = view[os.write(self._to, view[: 1 << 20]) :]
            except BlockingIOError:
                continue
            except BrokenPipeError:
                raise self._dead() from None

    def _left(self, size: int, until: float) -> bytes:
        data = bytearray()
        while len(data) < size:
            self._wait(until, to=False)
            try:
                part = os.read(self._from, min(size - len(data), 1 << 20))
            except BlockingIOError:
                continue
            if not part:
                raise self._dead()
            data += part
        return bytes(data)

    def _wait(self, until: float, *, to: bool) -> None:
        poll = select.poll()
        poll.register(self._to if to else self._from, select.POLLOUT if to else select.POLLIN)
        if not poll.poll(max(0.0, until - time.monotonic()) * 1000):
            raise _Died(f"it takes longer than {SECONDS:g} s to decode")

    def _dead(self) -> _Died:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(10)
        return _Died(f"its decoder died, exit code {self._popen.poll()}")


_lock = threading.Lock()
_process: _Process | None = None


@atexit.register
def _end() -> None:
    if _process is not None and _process.pid == os.getpid():
        _process.end()


# -- there -----------------------------------------------------------------------------------------


def _split(answer: bytes) -> tuple[bytes, bytes]:
    (size,) = struct.unpack_from("<Q", answer)
    return answer[8 : 8 + size], answer[8 + size :]


def _answer(data: bytes) -> list[bytes | memoryview]:
    """What is sent back: length of the texts, texts, table."""
    frame = pl.read_parquet(io.BytesIO(data))
    texts = json.dumps(pl.read_parquet_metadata(io.BytesIO(data))).encode()
    table = io.BytesIO()
    frame.write_ipc_stream(table)
    return [struct.pack("<Q", len(texts)), texts, table.getbuffer()]


def _serve(ours: IO[bytes], theirs: IO[bytes]) -> None:
    theirs.write(_HEAD.pack(_OK, 0))
    theirs.flush()
    while len(head := ours.read(_HEAD.size)) == _HEAD.size:
        data = ours.read(_HEAD.unpack(head)[1])
        try:
            status, answer = _OK, _answer(data)
        except (Exception, pl.exceptions.PanicException) as error:
            status = _BAD if isinstance(error, pl.exceptions.PolarsError) else _LAST
            reason = str(error).strip() or type(error).__name__
            answer = [reason.splitlines()[0][:200].encode(errors="replace")]
        theirs.write(_HEAD.pack(status, sum(map(len, answer))))
        for part in answer:
            theirs.write(part)
        theirs.flush()
        if status == _LAST:
            return
        del data, answer, part


def _limit() -> None:
    import resource

    with contextlib.suppress(OSError, ValueError):  # not everywhere
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    _limit()
    _serve(sys.stdin.buffer, sys.stdout.buffer)
