"""Finds predictors by name: the shipped ones, or those in a folder of the user's."""

import dataclasses
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path

import jax
import numpy as np

from pgf_jax.batching.requests import GainPredictor
from pgf_jax.errors import BadInput, did_you_mean
from pgf_jax.files import is_folder
from pgf_jax.guidance.predictors.checkpoint import Checkpoint, load_network, shipped_checkpoints
from pgf_jax.guidance.predictors.network import CostDifference, FailureClassifier, GainNetwork

_MAKE = {"paper": CostDifference, "best": GainNetwork, "classifier": FailureClassifier}
NETWORKS: Mapping[str, tuple[str, ...]] = {
    "paper": ("phi_auto", "phi_human"),
    "best": ("gain",),
    "classifier": ("failure",),  # for the policy of that name: a probability, not a gain
}
PREDICTORS = ("paper", "best")


@dataclasses.dataclass(frozen=True)
class PredictorSpec:
    """Names a predictor and the folder of its checkpoints.

    Attributes:
      name: one of `NETWORKS`.
      folder: the folder of its checkpoints; None: the shipped ones.
    """

    name: str = "paper"
    folder: Path | None = None

    def files(self) -> Traversable:
        """The folder of the checkpoints."""
        return shipped_checkpoints() if self.folder is None else self.folder

    def load(self) -> tuple[GainPredictor, tuple[Checkpoint, ...]]:
        """Load the predictor; returns it and the checkpoints that it is made of.

        Raises:
          BadInput: one line that names the folder or the file.
        """
        folder = self.files()
        if not is_folder(folder):
            hint = did_you_mean(str(folder), PREDICTORS)
            raise BadInput(f"{folder}: no such folder, expected one with checkpoints{hint}")
        checkpoints = tuple(load_network(folder, network) for network in NETWORKS[self.name])
        networks = [checkpoint.predictor for checkpoint in checkpoints]
        # NumPy leaves: JAX arrays would start JAX's backend in every process that unpickles them.
        return _MAKE[self.name](*(jax.tree.map(np.asarray, net) for net in networks)), checkpoints


def predictor_spec(text: str) -> PredictorSpec:
    """Parse `--predictor TEXT`: `paper`, `best`, `paper:FOLDER`, `best:FOLDER` or `FOLDER`.

    A folder alone stands for the paper's pair of networks in it.
    """
    if text in PREDICTORS:
        return PredictorSpec(text)
    name, colon, folder = text.partition(":")
    if not text or (colon and name in PREDICTORS and not folder):
        raise BadInput(f"predictor: expected {', '.join(PREDICTORS)} or a folder, got {text!r}")
    if colon and name in PREDICTORS:
        return PredictorSpec(name, Path(folder))
    return PredictorSpec("paper", Path(text))
