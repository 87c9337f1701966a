"""Settings of `reproduce`; no JAX here."""

import dataclasses
from pathlib import Path

from tyro.conf import Positional

from pgf_jax.errors import BadInput
from pgf_jax.settings import MAX_SEED, check_fields, check_int


@dataclasses.dataclass(frozen=True)
class ReproduceConfig:
    """Compute one iteration of a sweep again: what each rollout did, and where it broke.

    Without --iteration, the first in which a rollout was not finite.

    Attributes:
      folder: of the sweep's results.
      policy: of the fleet; None: any.
      robots: the fleet's size; None: any.
      robot: which robot; 0-based. None: any.
      task: which of its tasks; 0-based. None: any.
      iteration: its number in the event log.
      out: file for all arrays (NumPy's .npz).
    """

    folder: Positional[Path]
    policy: str | None = None
    robots: int | None = None
    robot: int | None = None
    task: int | None = None
    iteration: int | None = None
    out: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name, least in (("robots", 1), ("robot", 0), ("task", 0), ("iteration", 0)):
            if getattr(self, name) is not None:
                check_int(name, getattr(self, name), least)
        if self.iteration is not None:
            for name in ("policy", "robots", "robot", "task"):
                if getattr(self, name) is None:
                    raise BadInput(f"{name}: expected with --iteration {self.iteration}, got none")
        if self.out is not None and self.out.suffix != ".npz":
            raise BadInput(f"out: expected a .npz file, got {self.out}")


@dataclasses.dataclass(frozen=True)
class VerifyConfig:
    """Check a sweep's results: each file against what is known of it, some cells by computing them.

    Attributes:
      folder: of the results, finished or not.
      cells: how many cells, drawn at random, are computed again and compared bit for bit; more than
        there are: all of them.
      seed: of the draw; None: another one each time.
      workers: as in `sweep`.
      scenes: where the scene files lie now; None: where they were.
      predictor: where the checkpoints lie now, as in `sweep`; None: where they were.
      log: where a replay's recording lies now; None: where it was.
    """

    folder: Positional[Path]
    cells: int = 3
    seed: int | None = None
    workers: int | None = None
    scenes: Path | None = None
    predictor: str | None = None
    log: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        check_int("cells", self.cells, 0)
        if self.seed is not None:
            check_int("seed", self.seed, 0, MAX_SEED)
        if self.workers is not None:
            check_int("workers", self.workers, 1)
