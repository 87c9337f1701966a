"""Settings of `study`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pgf_jax.console.config import LOOPBACK, check_host
from pgf_jax.settings import Bounds, Count, Index, check_fields


@dataclasses.dataclass(frozen=True)
class StudyConfig:
    """Conduct a study with people: what they do, in which order, and what is asked.

    Attributes:
      what: init writes an example that can be changed; check reads the folder, and says who does
        which blocks; serve opens the pages, until Ctrl-C, and goes on where it was.
      folder: of the study.
      host: address to listen on; others than 127.0.0.1 belong behind a proxy that speaks TLS.
      port: port to listen on; 0: any free one.
      participants: serve: so many more are added, and their links printed.
      at_once: serve: sessions at a time; more of them make the robots slower.
    """

    what: tyro.conf.Positional[Literal["init", "check", "serve"]]
    folder: tyro.conf.Positional[Path]
    host: str = LOOPBACK
    port: Annotated[int, Bounds(0, 65535)] = 8080
    participants: Index = 0
    at_once: Count = 1

    def __post_init__(self) -> None:
        check_fields(self)
        check_host(self.host)
