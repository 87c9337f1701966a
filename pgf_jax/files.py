"""Reading and writing of files: with limits on size, and whole or not at all."""

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
TEMPORARY = ".tmp"  # suffix of files that are being written
_LARGEST_JSON = 16 * MIB


# -- reading -------------------------------------------------------------------------------------


def open_file(path: Path | str, expected: str, most: int) -> BinaryIO:
    """Open a regular file for reading.

    Args:
      path: the file.
      expected: what it should be, for the message.
      most: its largest size, bytes.

    Raises:
      BadInput: one line that names the file: missing, too large, or not a regular file, because
        reading from a device or a pipe might never end.
    """
    try:
        # Without O_NONBLOCK, opening a pipe waits until another process writes into it.
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(f"{path}: no such file, expected {expected}") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
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
    """Read a regular file; for arguments and errors see `open_file`."""
    with open_file(path, expected, most) as file:
        try:
            # The size may be unknown or grow. Some files of the system return None.
            data = file.read(most + 1) or b""
        except OSError as error:
            raise _unreadable(path, error, expected) from None
    if len(data) > most:
        raise _too_large(path, len(data), most, expected)
    return data


def read_json(path: Path, expected: str = "results of a sweep") -> dict[str, Any]:
    """Read a JSON object.

    Args:
      path: the file.
      expected: what it should be, for the message.

    Raises:
      BadInput: one line that names the file: missing, truncated, corrupt or not an object.
    """
    data = read_file(path, expected, _LARGEST_JSON)  # not inside try: a BadInput is a ValueError
    try:
        content = parse_json(data)
    except ValueError as error:
        raise BadInput(f"{path}: truncated or corrupt, not JSON ({error})") from error
    if not isinstance(content, dict):
        raise BadInput(f"{path}: expected a JSON object, got a {type(content).__name__}")
    return content


def parse_json(data: bytes | str) -> Any:
    """Parse JSON.

    Raises:
      ValueError: the text is not JSON, or nested too deeply.
    """
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def is_folder(path: Any) -> bool:
    """Whether there is such a folder; False for a name that no folder can have."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def is_file(path: Path) -> bool:
    """Whether there is such a file; False for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _unreadable(path: Path | str, error: Exception, expected: str) -> BadInput:
    reason = getattr(error, "strerror", None) or error
    return BadInput(f"{path}: cannot be read ({reason}), expected {expected}")


def _too_large(path: Path | str, size: int, most: int, expected: str) -> BadInput:
    return BadInput(
        f"{path}: too large ({size} bytes), expected {expected} of at most {most // MIB} MiB"
    )


# -- writing -------------------------------------------------------------------------------------


def write_atomically(path: Path | str, data: bytes) -> None:
    """Write a file whole or not at all; its folder is made if needed.

    The content and the name are on the disk when this returns: a crash of the process or of the
    computer never leaves a part of the file.

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
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"{path}: cannot be written ({reason})") from error


def sync_folder(folder: Path) -> None:
    """Flush a folder's file names to the disk, as `os.fsync` does for the content of a file."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some file systems do not support it
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


# -- contents ------------------------------------------------------------------------------------


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """The bytes of a JSON file that people can read, too."""
    return (json.dumps(content, indent=2) + "\n").encode()


def png(figure: "Figure", about: Mapping[str, Any] | None = None) -> bytes:
    """The bytes of a PNG file; the same figure gives the same bytes.

    Args:
      figure: what to draw.
      about: its provenance, stored as JSON in the file's description; None: nothing.
    """
    buffer = io.BytesIO()
    text = {} if about is None else {"Description": json.dumps(about, sort_keys=True)}
    figure.savefig(buffer, format="png", dpi=150, metadata=text)
    return buffer.getvalue()


def pdf(figure: "Figure", about: Mapping[str, Any] | None = None) -> bytes:
    """The bytes of a PDF file; the same figure gives the same bytes. For `about` see `png`."""
    buffer = io.BytesIO()
    text = {} if about is None else {"Subject": json.dumps(about, sort_keys=True)}
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None, **text})
    return buffer.getvalue()


def write_figure(
    path: Path | str, figure: "Figure", about: Mapping[str, Any] | None = None
) -> None:
    """Write a figure as its file's name says, .png or .pdf. For `about` see `png`.

    Raises:
      BadInput: another kind of file, or it cannot be written there.
    """
    draw = {".png": png, ".pdf": pdf}.get(Path(path).suffix.lower())
    if draw is None:
        raise BadInput(f"{path}: expected a file .png or .pdf")
    write_atomically(path, draw(figure, about))


def sha256(data: bytes) -> str:
    """The SHA-256 digest of some bytes, in hex."""
    return hashlib.sha256(data).hexdigest()
