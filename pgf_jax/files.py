"""Files that may be anything: read whole, within limits, or not at all."""

import contextlib
import hashlib
import io
import json
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from pgf_jax.errors import BadInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MIB = 1 << 20
TEMPORARY = ".tmp"  # ends the names of files that are being written
_LARGEST_JSON = 16 * MIB


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


def write_atomically(path: Path | str, data: bytes) -> None:
    """Write a file whole or not at all, making its folder where needed.

    It is on the disk when this returns, and so is its name: neither a crash of the process nor one
    of the machine leaves a part of it.

    Raises:
      BadInput: it cannot be written there.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        sync_folder(path.parent)
    except (OSError, ValueError) as error:  # a name that no file can have is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"{path}: cannot be written ({reason})") from error


def png(figure: "Figure", about: Mapping[str, Any] | None = None) -> bytes:
    """The figure as a PNG file, with where it comes from; the same one gives the same bytes."""
    buffer = io.BytesIO()
    text = {} if about is None else {"Description": json.dumps(about, sort_keys=True)}
    figure.savefig(buffer, format="png", dpi=150, metadata=text)
    return buffer.getvalue()


def sha256(data: bytes) -> str:
    """Hex digest."""
    return hashlib.sha256(data).hexdigest()


def read_json(path: Path, expected: str = "results of a sweep") -> dict[str, Any]:
    """Read a JSON object.

    Args:
      path: the file.
      expected: what it should be, for the message.

    Raises:
      BadInput: one line that names the file: missing, truncated, corrupt or not an object.
    """
    data = read_file(path, expected, _LARGEST_JSON)  # its BadInput is a ValueError too
    try:
        content = parse_json(data)
    except ValueError as error:
        raise BadInput(f"{path}: truncated or corrupt, not JSON ({error})") from error
    if not isinstance(content, dict):
        raise BadInput(f"{path}: expected a JSON object, got a {type(content).__name__}")
    return content


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """A JSON file for people to read as well."""
    return (json.dumps(content, indent=2) + "\n").encode()
