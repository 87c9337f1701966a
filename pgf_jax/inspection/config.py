"""Settings of `reproduce` and `verify`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from pgf_jax.errors import BadInput
from pgf_jax.settings import Bounds, Count, Index, Seed, check_fields


@dataclasses.dataclass(frozen=True)
class ReproduceConfig:
    """Compute one iteration of a sweep again: what each rollout did, and where it broke.

    Without --iteration it is the first one in which a rollout was not finite.

    Attributes:
      folder: folder of the sweep's results.
      policy: the fleet's policy; None: any.
      robots: fleet size; None: any.
      seed: the fleet's seed, where the sweep has several; None: any.
      robot: number of the robot, from 0; None: any.
      task: number of its task, from 0; None: any.
      iteration: number of the iteration in the event log, from 0; None: the first with a rollout
        that was not finite.
      out: file for all arrays (.npz of NumPy); None: none is written.
    """

    folder: Positional[Path]
    policy: str | None = None
    robots: Count | None = None
    seed: Seed | None = None
    robot: Index | None = None
    task: Index | None = None
    iteration: Index | None = None
    out: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.iteration is not None:
            for name in ("policy", "robots", "robot", "task"):
                if getattr(self, name) is None:
                    raise BadInput(f"{name}: expected with --iteration {self.iteration}, got none")
        if self.out is not None and self.out.suffix != ".npz":
            raise BadInput(f"out: expected a .npz file, got {self.out}")


@dataclasses.dataclass(frozen=True)
class VerifyConfig:
    """Check a sweep's results: all files, and some of the cells by computing them again.

    Attributes:
      folder: folder of the sweep's results, finished or not.
      cells: how many cells, drawn at random, are computed again and compared bit for bit; more than
        there are: all of them.
      seed: seed of the draw; None: another one each time.
      workers: cores of this computer that share the work with planar, processes with other engines;
        results do not depend on how many. None: one a core for planar, else 1.
      scenes: folder in which the scene files lie now; None: where they were.
      predictor: where the checkpoints lie now: a folder, or best:FOLDER; None: where they were.
      log: where the replayed session lies now; None: where it was.
    """

    folder: Positional[Path]
    cells: Annotated[int, Bounds(0)] = 3
    seed: Seed | None = None
    workers: Count | None = None
    scenes: Path | None = None
    predictor: str | None = None
    log: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
