"""Picture and film files, whole or not at all."""

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

_QUALITY = ("-crf", "18", "-movflags", "+faststart")  # fine lines and text; begins at once on pages


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
    """The nearest size that is not larger and whose numbers H.264 takes: even ones."""
    return size[0] // 2 * 2, size[1] // 2 * 2


def check_films() -> None:
    """BadInput unless films can be written; cheap, and so worth asking before long work."""
    _ffmpeg()


def write_film(
    path: Path | str, frames: Iterable[np.ndarray], fps: int, *, total: int | None = None
) -> int:
    """Write a film (MP4, H.264, yuv420p), frame by frame.

    Args:
      path: of the file; it is there once the film is whole. Interrupted, nothing is.
      frames: [H, W, 3] uint8, all of one size with even sides.
      fps: frames per second.
      total: how many frames there will be, to show progress by; None: not known.

    Returns:
      How many frames were written.

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
        with _encoder(ffmpeg, temporary, size, fps) as pipe, _count(total) as count:
            while frame is not None:
                pipe.write(np.ascontiguousarray(frame).data)
                done += 1
                count(done)
                frame = next(frames, None)
        os.replace(temporary, path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    return done


def _ffmpeg() -> str:
    """The program."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise BadInput(
            "films need the package imageio-ffmpeg: pip install 'pgf_jax[render]'"
        ) from None
    try:
        return imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:  # a wheel for a platform that it has no program for
        raise BadInput(
            "films need ffmpeg, which imageio-ffmpeg has none of here: install it, or name it in "
            "IMAGEIO_FFMPEG_EXE"
        ) from error


@contextlib.contextmanager
def _encoder(program: str, path: Path, size: tuple[int, int], fps: int) -> Iterator[IO[bytes]]:
    """What takes frames' bytes; afterwards the file is whole, or BadInput says why not.

    Not imageio-ffmpeg's own: it forks in Python, which JAX warns of.
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
        except BrokenPipeError:  # it has ended early: its own words say why
            broken = True
        except BaseException:
            process.kill()
            raise
        finally:
            with contextlib.suppress(OSError):  # what it has not taken is of no use
                process.stdin.close()
        words = process.stderr.read().decode(errors="replace").split("\n")
    if process.returncode or broken:
        reason = next((line for line in reversed(words) if line.strip()), "no reason given")
        raise BadInput(f"{path.parent}: the film cannot be written (ffmpeg: {reason.strip()})")


@contextlib.contextmanager
def _count(total: int | None) -> Iterator[Callable[[int], None]]:
    """A function to call with the number of frames done, which shows it."""
    if total is not None:
        with Progress("frames") as progress:
            yield lambda done: progress.update(done, total)
        return
    from rich.console import Console

    # How far it is to the end is not known: on a terminal a running number, elsewhere nothing.
    with Console(stderr=True).status("frames") as status:
        yield lambda done: status.update(f"{done} frames")
