"""Settings of `reproduce`; no JAX here."""

import dataclasses
from pathlib import Path

from tyro.conf import Positional

from pgf_jax.errors import BadInput
from pgf_jax.settings import check_fields
from pgf_jax.study.checks import whole


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
                whole(name, getattr(self, name), least)
        if self.iteration is not None:
            for name in ("policy", "robots", "robot", "task"):
                if getattr(self, name) is None:
                    raise BadInput(f"{name}: expected with --iteration {self.iteration}, got none")
        if self.out is not None and self.out.suffix != ".npz":
            raise BadInput(f"out: expected a .npz file, got {self.out}")
