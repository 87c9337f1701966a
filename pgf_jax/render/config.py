"""Settings of `render`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from pgf_jax.errors import BadInput
from pgf_jax.physics.worlds.config import world_error_of
from pgf_jax.settings import Bounds, Count, Index, Seconds, Seed, check_fields

SUFFIXES = (".png", ".mp4")
FIGURE_SUFFIXES = (".png", ".pdf")
Pixels = Annotated[int, Bounds(240, 7680)]  # less is not legible, more is not played


@dataclasses.dataclass(frozen=True)
class RenderConfig:
    """Draw a plan, a robot's task or a whole fleet, as a picture or as a film; or a sweep's figure.

    A fleet is simulated again, as it was recorded in a session or computed in a sweep.

    Attributes:
      what: plan (the execution of a plan), task (one task of one robot), fleet (the shelves of all
        robots), or sweep (the figure of its results).
      file: the plan (NAME.plan.json); for task and fleet a recorded session (its folder, or its
        event log), or the folder of a sweep; for sweep the folder of a sweep.
      out: file to write: a picture (.png) or a film (.mp4); the figure of a sweep may be .pdf.
      policy: which fleet of a sweep: its policy; None: the only one there is.
      robots: which fleet of a sweep: its size; None: the only one there is.
      seed: which fleet of a sweep: its seed; None: the only one there is.
      robot: number of the robot, from 0; with task only.
      task: number of its task, from 0; with task only.
      world: execute the plan in this world: solid (a shelf in 3-D of our own) or scene (that of the
        scene file); None: solid if it was checked there, else its engine; with plan only.
      scenes: folder of the scene files (*.xml), for world scene; None: there is none.
      world_error: how far that world is from the one in which the plan was checked, drawn once for
        each repeat: default, or spreads as in friction=0.3 mass=0.3 position=0.005 (shares, and m);
        the names are the fields of WorldError.
      repeat: which draw of world_error, from 0.
      at: simulated time of the picture, s; None: the plan's end, or when an operator first serves.
      start: simulated time at which the film starts, s.
      stop: simulated time at which the film stops, s; None: the end.
      speed: simulated seconds in a second of the film.
      fps: frames in a second of the film.
      view: how shelves are seen: top (from above), or 3d (three-dimensional, needs EGL).
      size: width and height, pixels.
    """

    what: Positional[Literal["plan", "task", "fleet", "sweep"]]
    file: Positional[Path]
    out: Path
    robot: Index = 0
    task: Index = 0
    at: Seconds | None = None
    start: Seconds = 0.0
    stop: Seconds | None = None
    speed: Annotated[float, Bounds(above=0)] = 1.0
    fps: Annotated[int, Bounds(1, 120)] = 20
    view: Literal["top", "3d"] = "top"
    size: tuple[Pixels, Pixels] = (1280, 800)
    policy: str | None = None
    robots: Count | None = None
    seed: Seed | None = None
    world: Literal["solid", "scene"] | None = None
    scenes: Path | None = None
    world_error: tuple[str, ...] = ()
    repeat: Index = 0

    GROUPS = (  # of options, for the help
        ("picture", ("out", "view", "size", "robot", "task", "at")),
        ("sweep", ("policy", "robots", "seed")),
        ("plan", ("world", "scenes", "world_error", "repeat")),
        ("film", ("start", "stop", "speed", "fps")),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        suffixes = FIGURE_SUFFIXES if self.what == "sweep" else SUFFIXES
        if self.out.suffix.lower() not in suffixes:
            raise BadInput(f"out: expected a file {' or '.join(suffixes)}, got {str(self.out)!r}")
        for name in ("robot", "task"):
            if self.what != "task" and getattr(self, name):
                raise BadInput(f"{name}: goes with task only, got {self.what}")
        for name in ("policy", "robots", "seed"):
            if self.what in ("plan", "sweep") and getattr(self, name) is not None:
                raise BadInput(f"{name}: goes with task and fleet only, got {self.what}")
        for name in ("world", "scenes", "world_error", "repeat"):
            if self.what != "plan" and getattr(self, name):
                raise BadInput(f"{name}: goes with plan only, got {self.what}")
        world_error_of(self.world_error, self.world or "solid")
        if self.repeat and not self.world_error:
            raise BadInput(f"repeat: goes with world_error only, got {self.repeat} without")
        if len(self.size) != 2:
            raise BadInput(f"size: expected a width and a height, got {self.size}")
        self._check_times()

    @property
    def is_film(self) -> bool:
        """Whether a film is written, and not a picture."""
        return self.out.suffix.lower() == ".mp4"

    def _check_times(self) -> None:
        if self.at is not None and self.is_film:
            raise BadInput("at: goes with a picture only (.png), got a film; see start, stop")
        if self.stop is not None and self.stop <= self.start:
            raise BadInput(f"stop: expected more than start {self.start:g}, got {self.stop:g}")
        if not self.is_film and (self.start or self.stop is not None):
            raise BadInput("start, stop: go with a film only (.mp4), got a picture; see at")
