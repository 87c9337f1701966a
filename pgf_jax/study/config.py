"""Settings of `study`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Literal

import tyro

from pgf_jax.settings import check_fields


@dataclasses.dataclass(frozen=True)
class StudyConfig:
    """Prepare a study with people: what they do, in which order, and what is asked.

    Attributes:
      what: init writes an example that can be changed; check reads the folder, and says who does
        which blocks.
      folder: of the study.
    """

    what: tyro.conf.Positional[Literal["init", "check"]]
    folder: tyro.conf.Positional[Path]

    def __post_init__(self) -> None:
        check_fields(self)
