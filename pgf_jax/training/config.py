"""Settings of the predictors' training; no JAX here, the command line builds on it."""

import dataclasses
from typing import Literal

from pgf_jax.errors import BadInput
from pgf_jax.settings import check_fields

Loss = Literal["rmse", "mae", "logistic"]


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Settings of `pgf-jax train`; the defaults are the paper's where it gives them.

    Attributes:
      seed: seeds the split, the initial weights and the order of the batches.
      restarts: networks trained from different weights, of which the best by validation is kept.
      members: networks in an ensemble; its prediction is the mean of theirs.
      batch: rows in a batch.
      learning_rate: Adam's step size (the paper gives none; Adam's usual one).
      max_epochs: at most so many epochs.
      patience: epochs without a better validation loss before training stops.
      validation_fraction: share of the scenes that is held out.
      hidden: widths of the hidden layers (the published code has 16 in the third).
      dropout: share of the hidden units dropped while training (the published code: 0.1 for
        phi_human).
      loss: what is minimised; the published code calls mean absolute error RMSE.
    """

    seed: int = 0
    restarts: int = 1
    members: int = 1
    batch: int = 50
    learning_rate: float = 1e-3
    max_epochs: int = 100
    patience: int = 4
    validation_fraction: float = 0.2
    hidden: tuple[int, ...] = (64, 32, 8)
    dropout: float = 0.0
    loss: Loss = "rmse"

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("restarts", "members", "batch", "max_epochs", "patience"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.seed < 2**32:
            raise BadInput(f"seed must be within 0..{2**32 - 1}, got {self.seed}")
        if not 0.0 < self.learning_rate < float("inf"):
            raise BadInput(f"learning_rate must be positive, got {self.learning_rate}")
        if not 0.0 < self.validation_fraction < 1.0:
            raise BadInput(
                f"validation_fraction must be within (0, 1), got {self.validation_fraction}"
            )
        if not 0.0 <= self.dropout < 1.0:
            raise BadInput(f"dropout must be within [0, 1), got {self.dropout}")
        if not self.hidden or min(self.hidden) < 1:
            raise BadInput(f"hidden must be one or more widths of at least 1, got {self.hidden}")
