"""Settings of `fit-operator`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.settings import check_fields


@dataclasses.dataclass(frozen=True)
class FitOperatorConfig:
    """Fit the service times that a sweep draws to those of recorded sessions or sweeps.

    Attributes:
      log: recorded sessions, taken together: their folders, or event logs (events.parquet,
        events.jsonl).
      out: picture to write (.png) of the service times and the fit; None: no picture is written.
      json: print one JSON object instead of tables.
    """

    log: tuple[Path, ...]
    out: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    json: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.log:
            raise BadInput("log: expected one or more event logs, got none")
        if self.out is not None and self.out.suffix.lower() != ".png":
            raise BadInput(f"out: expected a .png file, got {self.out}")
