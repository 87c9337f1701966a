"""Settings of `render`, from Python and on the command line; no JAX here: help is instant."""

import dataclasses
import math
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from pgf_jax.errors import BadInput
from pgf_jax.settings import check_fields, check_int, check_seconds

SUFFIXES = (".png", ".mp4")
SMALLEST, LARGEST = 240, 7680  # px: less is not legible, more is not played


@dataclasses.dataclass(frozen=True)
class RenderConfig:
    """Draw a plan, a robot's task or a whole fleet, as a picture or as a film.

    Attributes:
      what: a plan's execution, one task of one robot, or the wall of all robots' shelves.
      file: the plan (NAME.plan.json), or the recorded session for task and fleet.
      out: the file to write; .png is a picture, .mp4 a film.
      robot: which one, for task; counted from 0.
      task: which of its tasks, for task; counted from 0.
      at: of a picture, simulated s; by default a plan's end, or when somebody is first served.
      start: of a film, simulated s.
      stop: of a film, simulated s; by default the end.
      speed: simulated seconds in a second of film.
      fps: frames per second of film.
      view: of the shelves: from above, or three-dimensional (needs EGL).
      size: width and height, pixels.
    """

    what: Positional[Literal["plan", "task", "fleet"]]
    file: Positional[Path]
    out: Path
    robot: int = 0
    task: int = 0
    at: float | None = None
    start: float = 0.0
    stop: float | None = None
    speed: float = 1.0
    fps: int = 20
    view: Literal["top", "3d"] = "top"
    size: tuple[int, int] = (1280, 800)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.out.suffix.lower() not in SUFFIXES:
            raise BadInput(f"out: expected a file {' or '.join(SUFFIXES)}, got {str(self.out)!r}")
        for name in ("robot", "task"):
            check_int(name, getattr(self, name), 0)
            if self.what != "task" and getattr(self, name):
                raise BadInput(f"{name}: goes with task only, got {self.what}")
        check_int("fps", self.fps, 1, 120)
        if len(self.size) != 2:
            raise BadInput(f"size: expected a width and a height, got {self.size}")
        for pixels in self.size:
            check_int("size", pixels, SMALLEST, LARGEST)
        if not isinstance(self.speed, int | float) or not 0 < self.speed < math.inf:
            raise BadInput(f"speed: expected a positive number, got {self.speed!r}")
        self._check_times()

    @property
    def is_film(self) -> bool:
        """Whether a film is written, and not a picture."""
        return self.out.suffix.lower() == ".mp4"

    def _check_times(self) -> None:
        check_seconds("start", self.start, 0.0)
        if self.at is not None:
            check_seconds("at", self.at, 0.0)
            if self.is_film:
                raise BadInput("at: goes with a picture only (.png), got a film; see start, stop")
        if self.stop is not None:
            check_seconds("stop", self.stop, 0.0)
            if self.stop <= self.start:
                raise BadInput(f"stop: expected more than start {self.start:g}, got {self.stop:g}")
        if not self.is_film and (self.start or self.stop is not None):
            raise BadInput("start, stop: go with a film only (.mp4), got a picture; see at")
