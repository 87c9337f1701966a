"""Settings of `profile`; no JAX here, so that help is instant."""

import dataclasses
from typing import Annotated, Literal

import tyro

from pgf_jax.physics.config import PhysicsName
from pgf_jax.physics.engine import engine_names
from pgf_jax.settings import Bounds, Count, check_choice, check_fields

# Classes whose scenes have one number of objects, all standard: what every engine simulates.
MeasuredClass = Literal["all", "tight", "medium", "wide", "crowded", "packed"]


@dataclasses.dataclass(frozen=True)
class ProfileConfig:
    """Measure the engines' speed on the same rollouts, on one core and on all, taking turns.

    Attributes:
      engines: physics engines to measure: planar (fast, disks on a plane), mjx (MuJoCo in JAX),
        native (MuJoCo in C), or registered ones.
      lanes: values of L, robots computed in one call of the engine, to try; the fastest one stands
        for its engine, whose settings are tried at the first. None: that of a sweep with the
        engine, but at least 8.
      cores: cores that are used; None: all. With 1, what engines do on all cores is not measured.
      repeats: timed calls of each engine and L; the median counts.
      physics: physics constants of the engines on the plane: default (fitted to the solid world),
        authors (to the published simulation), or paper (its time step and softness of contacts).
      scene_class: class of the scenes: tight, medium, wide, crowded, packed, or all (the first
        three in turn).
      seed: seed of scenes and noise.
      json: print one JSON object instead of tables.
    """

    engines: tuple[str, ...] = ("planar", "mjx", "native")
    lanes: tuple[Count, ...] | None = None
    cores: Count | None = None
    repeats: Count = 3
    physics: PhysicsName = "default"
    scene_class: Annotated[MeasuredClass, tyro.conf.arg(aliases=["--preset"])] = "all"
    seed: Annotated[int, Bounds(0)] = 0
    json: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        for engine in self.engines:
            check_choice("engines", engine, engine_names())
