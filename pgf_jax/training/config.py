"""Settings of `train`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.settings import Bounds, Count, Seed, check_fields

Loss = Literal["rmse", "mae", "logistic"]


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """How the predictors are trained; the defaults are the paper's where it gives them.

    Attributes:
      seed: seed of the split, the initial weights and the order of the batches.
      restarts: networks trained from different weights, of which the best by validation is kept.
      members: networks in an ensemble; its prediction is the mean of theirs.
      batch: rows in a batch.
      learning_rate: Adam's step size (the paper gives none; Adam's usual one).
      max_epochs: epochs after which training stops in any case.
      patience: epochs without a better validation loss after which training stops.
      validation_fraction: share of the scenes that is held out.
      hidden: widths of the hidden layers (the published code has 16 in the third).
      dropout: share of the hidden units dropped while training (the published code has 0.1 for
        phi_human).
      loss: what is minimised: rmse, mae (which the published code calls RMSE), or logistic.
    """

    seed: Seed = 0
    restarts: Count = 1
    members: Count = 1
    batch: Count = 50
    learning_rate: Annotated[float, Bounds(above=0)] = 1e-3
    max_epochs: Count = 100
    patience: Count = 4
    validation_fraction: Annotated[float, Bounds(above=0, below=1)] = 0.2
    hidden: tuple[Count, ...] = (64, 32, 8)
    dropout: Annotated[float, Bounds(0, below=1)] = 0.0
    loss: Loss = "rmse"

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.hidden:
            raise BadInput("hidden: expected one or more widths, got none")


@dataclasses.dataclass(frozen=True)
class TrainCommand:
    """Train the predictors on collected runs, and stop early by scenes held out.

    Attributes:
      data: folder of the data, as `collect` writes it: autonomous/runs.parquet, human/runs.parquet
        and, for the predictor best, forks/forks.parquet; for policies that rank by time,
        futures/futures.parquet.
      out: folder for the checkpoints and the figure of their losses.
      config: how they are trained.
    """

    data: Path
    out: Path
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = dataclasses.field(
        default_factory=TrainConfig
    )
