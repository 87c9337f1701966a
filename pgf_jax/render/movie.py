"""Writes the files of pictures and films; an interrupted film leaves no file."""

import contextlib
import io
import os
import subprocess
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.files import write_atomically
from pgf_jax.terminal import Progress

_QUALITY = ("-crf", "18", "-movflags", "+faststart")  # sharp text; a browser can start at once


def write_picture(path: Path | str, picture: np.ndarray) -> Path:
    """Write a PNG; `picture` is [H, W, 3] uint8.

    Raises:
      BadInput: it cannot be written there.
    """
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="png", optimize=True)
    write_atomically(path, buffer.getvalue())
    return Path(path)


def even(size: tuple[int, int]) -> tuple[int, int]:
    """Round a size down to even numbers, which H.264 requires."""
    return size[0] // 2 * 2, size[1] // 2 * 2


def check_films() -> None:
    """Check that films can be written; cheap, so call it before long work.

    Raises:
      BadInput: there is no `imageio-ffmpeg`, or it has no program here.
    """
    _ffmpeg()


def write_film(
    path: Path | str, frames: Iterable[np.ndarray], fps: int, *, total: int | None = None
) -> int:
    """Write a film (MP4, H.264, yuv420p), frame by frame.

    Args:
      path: of the file; it appears when the film is complete.
      frames: [H, W, 3] uint8, all of one size with even sides.
      fps: frames per second.
      total: number of frames to come, for the progress display; None: not known.

    Returns:
      The number of frames written.

    Raises:
      BadInput: no `imageio-ffmpeg`, no frame, or the file cannot be written.
    """
    path, frames, ffmpeg = Path(path), iter(frames), _ffmpeg()
    frame = next(frames, None)
    if frame is None:
        raise BadInput(f"{path}: there is nothing to film in that time")
    size = frame.shape[1], frame.shape[0]
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    done = 0
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
        with _encoder(ffmpeg, temporary, size, fps) as pipe, _progress(total) as show:
            while frame is not None:
                pipe.write(np.ascontiguousarray(frame).data)
                done += 1
                show(done)
                frame = next(frames, None)
        os.replace(temporary, path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    return done


def _ffmpeg() -> str:
    """Path of the ffmpeg program."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise BadInput(
            "films need the package imageio-ffmpeg: pip install 'pgf_jax[render]'"
        ) from None
    try:
        return imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:  # the wheel has no program for this platform
        raise BadInput(
            "films need ffmpeg, which imageio-ffmpeg has none of here: install it, or name it in "
            "IMAGEIO_FFMPEG_EXE"
        ) from error


@contextlib.contextmanager
def _encoder(program: str, path: Path, size: tuple[int, int], fps: int) -> Iterator[IO[bytes]]:
    """Open a pipe that takes the bytes of frames; BadInput at the end if encoding failed.

    The writer of imageio-ffmpeg itself forks in Python, which JAX warns about.
    """
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(fps))
    film = ("-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", *_QUALITY)
    command = [program, "-y", "-loglevel", "error", *raw, "-i", "-", *film, str(path)]
    broken = False
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stderr is not None
        try:
            yield process.stdin
            process.stdin.close()
        except BrokenPipeError:  # the encoder ended early; its own message says why
            broken = True
        except BaseException:
            process.kill()
            raise
        finally:
            with contextlib.suppress(OSError):  # bytes that are left in the pipe are of no use
                process.stdin.close()
        lines = process.stderr.read().decode(errors="replace").split("\n")
    if process.returncode or broken:
        reason = next((line for line in reversed(lines) if line.strip()), "no reason given")
        raise BadInput(f"{path.parent}: the film cannot be written (ffmpeg: {reason.strip()})")


@contextlib.contextmanager
def _progress(total: int | None) -> Iterator[Callable[[int], None]]:
    """A function that shows the number of frames done."""
    if total is not None:
        with Progress("frames") as progress:
            yield lambda done: progress.update(done, total)
        return
    from rich.console import Console

    # Without a total: a running number on a terminal, nothing elsewhere.
    with Console(stderr=True).status("frames") as status:
        yield lambda done: status.update(f"{done} frames")
