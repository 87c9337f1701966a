"""Settings of `profile`; no JAX here."""

import dataclasses

from pgf_jax.physics.engine import engine_names
from pgf_jax.settings import check_choice, check_fields, check_int


@dataclasses.dataclass(frozen=True)
class ProfileConfig:
    """What is measured: engines on the same rollouts, in one run, taking turns.

    Attributes:
      engines: which engines.
      lanes: lane counts (robots per call) to try; the best one is an engine's headline.
      cores: cores that everything is measured on; None: all. planar's calls use one whatever there
        is, so that "one core each" is `--cores 1`.
      repeats: timed calls of each engine and lane count; the median counts.
      memory_lanes: robots in the batch whose memory is reported.
      physics: default, or the paper's substep and the authors' softness.
      seed: of scenes and noise.
      json: print one JSON object instead of tables.
    """

    engines: tuple[str, ...] = ("planar", "mjx", "native")
    lanes: tuple[int, ...] = (1, 8, 20, 32)
    cores: int | None = None
    repeats: int = 3
    memory_lanes: int = 20
    physics: str = "default"
    seed: int = 0
    json: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        for engine in self.engines:
            check_choice("engines", engine, engine_names())
        for lanes in self.lanes:
            check_int("lanes", lanes, 1)
        if self.cores is not None:
            check_int("cores", self.cores, 1)
        check_int("repeats", self.repeats, 1)
        check_int("memory_lanes", self.memory_lanes, 1)
        check_int("seed", self.seed, 0)
        check_choice("physics", self.physics, ["default", "paper"])
