"""Files that may be anything: read whole, within limits, or not at all."""

import contextlib
import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from pgf_jax.errors import BadInput

MIB = 1 << 20


def open_file(path: Path | str, expected: str, most: int) -> BinaryIO:
    """Open a regular file to be read.

    Args:
      path: the file.
      expected: what it should be, for the message.
      most: bytes that it may have.

    Raises:
      BadInput: one line that names the file: missing, larger, or none that has an end: reading from
        a device or a pipe would wait, or go on, for ever.
    """
    try:
        # Opening a pipe waits for somebody to write into it, unless told not to.
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(f"{path}: no such file, expected {expected}") from None
    except (OSError, ValueError) as error:  # a name that no file can have is a ValueError
        raise _unreadable(path, error, expected) from None
    try:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise BadInput(f"{path}: cannot be read (not a regular file), expected {expected}")
        if about.st_size > most:
            raise _too_large(path, about.st_size, most, expected)
    except BaseException:
        file.close()
        raise
    return file


def read_file(path: Path | str, expected: str, most: int) -> bytes:
    """The content of a regular file; see `open_file`."""
    with open_file(path, expected, most) as file:
        try:
            # It may grow, some do not know their size, and of a log of the system's there is None.
            data = file.read(most + 1) or b""
        except OSError as error:
            raise _unreadable(path, error, expected) from None
    if len(data) > most:
        raise _too_large(path, len(data), most, expected)
    return data


def is_folder(path: Any) -> bool:
    """Whether there is such a folder; of a name that none can have, there is not."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def is_file(path: Path) -> bool:
    """Whether there is such a file; of a name that none can have, there is not."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def sync_folder(folder: Path) -> None:
    """Have the names of a folder's files on the disk, as their content is after `os.fsync`."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some file systems cannot, and need not
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def parse_json(data: bytes | str) -> Any:
    """What JSON says.

    Raises:
      ValueError: it is not JSON, or nested too deeply to be anything of ours.
    """
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _unreadable(path: Path | str, error: Exception, expected: str) -> BadInput:
    reason = getattr(error, "strerror", None) or error
    return BadInput(f"{path}: cannot be read ({reason}), expected {expected}")


def _too_large(path: Path | str, size: int, most: int, expected: str) -> BadInput:
    return BadInput(
        f"{path}: too large ({size} bytes), expected {expected} of at most {most // MIB} MiB"
    )
