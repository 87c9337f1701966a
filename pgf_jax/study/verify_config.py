"""Settings of `verify`; no JAX here."""

import dataclasses
from pathlib import Path

from tyro.conf import Positional

from pgf_jax.settings import check_fields
from pgf_jax.study.checks import MAX_SEED, whole


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
        whole("cells", self.cells, 0)
        if self.seed is not None:
            whole("seed", self.seed, 0, MAX_SEED)
        if self.workers is not None:
            whole("workers", self.workers, 1)
