"""Settings of `study`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pgf_jax.console.config import LOOPBACK, check_host
from pgf_jax.errors import BadInput
from pgf_jax.fleet.policies import check_policy
from pgf_jax.settings import Bounds, Count, Index, check_fields


@dataclasses.dataclass(frozen=True)
class StudyConfig:
    """Conduct a study with people: what they do, in which order, and what is asked.

    Attributes:
      what: init writes an example that can be changed; check reads the folder, and says who does
        which blocks; size says how many participants are needed, from simulated ones; serve opens
        the pages, until Ctrl-C, and goes on where it was; export writes the data set (Psych-DS);
        analyse compares the conditions; what-if runs the blocks again under other policies.
      folder: of the study.
      host: address to listen on; others than 127.0.0.1 belong behind a proxy that speaks TLS.
      port: port to listen on; 0: any free one.
      participants: serve: so many more are added, and their links printed; size: so many are
        simulated, 8 if not given.
      at_once: serve: sessions at a time; more of them make the robots slower.
      policies: what-if: the other policies.
      out: export, analyse: folder to write; None: one in that of the study.
    """

    what: tyro.conf.Positional[
        Literal["init", "check", "size", "serve", "export", "analyse", "what-if"]
    ]
    folder: tyro.conf.Positional[Path]
    host: str = LOOPBACK
    port: Annotated[int, Bounds(0, 65535)] = 8080
    participants: Index = 0
    at_once: Count = 1
    policies: tuple[str, ...] = ()
    out: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        check_host(self.host)
        for policy in self.policies:
            check_policy(policy, "policies")
        if self.what == "what-if" and not self.policies:
            raise BadInput("policies: what-if expects one or more, as in --policies pgf gain-rate")
