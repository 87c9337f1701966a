"""Settings of `fit-operator`; no JAX here."""

import dataclasses
from pathlib import Path

from pgf_jax.errors import BadInput
from pgf_jax.settings import check_fields


@dataclasses.dataclass(frozen=True)
class FitOperatorConfig:
    """Fit the service times that a sweep draws to those of recorded sessions, or of sweeps.

    Attributes:
      log: event logs, taken together: folders, events.parquet or events.jsonl files.
      out: figure to write (PNG): how long services took, and the fit.
      json: print one JSON object instead of a table.
    """

    log: tuple[Path, ...]
    out: Path | None = None
    json: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.log:
            raise BadInput("log: expected one or more event logs, got none")
        if self.out is not None and self.out.suffix.lower() != ".png":
            raise BadInput(f"out: expected a .png file, got {self.out}")
