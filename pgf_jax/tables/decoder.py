"""Decodes Parquet files of unknown origin in a separate process.

Polars' decoder panics on many damaged files, with a stack trace on standard error, and some files
end the process: of files with a few changed bytes, about one in 300 makes it request 2e18 bytes of
memory. This must not end a sweep that looks for finished cells, or a server. So a decoder process
is started at the first table and kept for later ones. If it dies, takes too long or needs too much
memory, the file is bad. It returns the table as an Arrow IPC stream.

The process runs this file alone and imports nothing of pgf_jax, so that it starts fast.
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

MEMORY = 4 << 30  # most bytes of memory of the process: 5e6 events fit
SECONDS = 60.0  # most time for one table
_SLOWEST = 20e6  # bytes/s of a file: large files may take longer
_HEAD = struct.Struct("<BQ")  # status, number of bytes that follow
_OK, _BAD, _LAST = 0, 1, 2  # last: bad, and the process ends because a panic may have broken it


class Undecodable(Exception):
    """The bytes are no readable Parquet file; the message says why in one line."""


def decode(data: bytes) -> tuple[pl.DataFrame, dict[str, str]]:
    """The table of a Parquet file, and the file's metadata.

    Raises:
      Undecodable: the bytes are not a whole Parquet file, or the table is too large.
    """
    global _process
    # Every Parquet file begins and ends like this; the decoder's message for others is unclear.
    if len(data) < 12 or data[:4] != b"PAR1" or data[-4:] != b"PAR1":
        raise Undecodable("it does not begin and end as one")
    with _lock:
        if _process is None or _process.pid != os.getpid():  # after a fork it is the parent's
            _process = _Process()
        status = _LAST  # also at Ctrl-C: the next answer would be the one to this request
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


# -- in this process -------------------------------------------------------------------------------


class _Died(Exception):
    """The decoder process has died, or takes too long."""


class _Process:
    """The decoder process: starts it, sends it files and takes its answers."""

    def __init__(self) -> None:
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            "POLARS_MAX_THREADS": "1",
            "RUST_BACKTRACE": "0",
        }
        self.pid = os.getpid()
        self._popen = subprocess.Popen(
            [sys.executable, "-P", __file__],  # -P: modules of this folder must not hide others
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # panics
            env=environment,
            start_new_session=True,  # Ctrl-C reaches only the parent, which ends the process
        )
        assert self._popen.stdin is not None and self._popen.stdout is not None
        self._to, self._from = self._popen.stdin.fileno(), self._popen.stdout.fileno()
        os.set_blocking(self._to, False)
        os.set_blocking(self._from, False)
        try:
            self._receive(_HEAD.size, time.monotonic() + SECONDS)  # sent once Polars is imported
        except BaseException as error:
            self.end()
            if isinstance(error, _Died):
                raise RuntimeError(f"Parquet's decoder does not start: {error}") from None
            raise

    def ask(self, data: bytes) -> tuple[int, bytes]:
        """Decode a file; returns the status, and the answer or the reason of the failure."""
        until = time.monotonic() + SECONDS + len(data) / _SLOWEST
        self._send(_HEAD.pack(_OK, len(data)), until)
        self._send(data, until)
        status, size = _HEAD.unpack(self._receive(_HEAD.size, until))
        return status, self._receive(size, until)

    def end(self) -> None:
        """Kill the process and wait for its end."""
        self._popen.kill()
        self._popen.communicate()

    def _send(self, data: bytes, until: float) -> None:
        view = memoryview(data)
        while view:
            self._wait(until, to=True)
            try:
                view = view[os.write(self._to, view[: 1 << 20]) :]
            except BlockingIOError:
                continue
            except BrokenPipeError:
                raise self._death() from None

    def _receive(self, size: int, until: float) -> bytes:
        data = bytearray()
        while len(data) < size:
            self._wait(until, to=False)
            try:
                part = os.read(self._from, min(size - len(data), 1 << 20))
            except BlockingIOError:
                continue
            if not part:
                raise self._death()
            data += part
        return bytes(data)

    def _wait(self, until: float, *, to: bool) -> None:
        poll = select.poll()
        poll.register(self._to if to else self._from, select.POLLOUT if to else select.POLLIN)
        if not poll.poll(max(0.0, until - time.monotonic()) * 1000):
            raise _Died(f"it takes longer than {SECONDS:g} s to decode")

    def _death(self) -> _Died:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(10)
        return _Died(f"its decoder died, exit code {self._popen.poll()}")


_lock = threading.Lock()
_process: _Process | None = None


@atexit.register
def _end() -> None:
    if _process is not None and _process.pid == os.getpid():
        _process.end()


# -- in the decoder process ------------------------------------------------------------------------


def _split(answer: bytes) -> tuple[bytes, bytes]:
    (size,) = struct.unpack_from("<Q", answer)
    return answer[8 : 8 + size], answer[8 + size :]


def _answer(data: bytes) -> list[bytes | memoryview]:
    """The parts of the answer: length of the metadata, metadata, table."""
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


def _limit_memory() -> None:
    import resource

    with contextlib.suppress(OSError, ValueError):  # not every system has it
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    _limit_memory()
    _serve(sys.stdin.buffer, sys.stdout.buffer)
