"""Finds predictors by name: the shipped ones, or those in a folder of the user's."""

import dataclasses
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pgf_jax.errors import BadInput, did_you_mean
from pgf_jax.files import is_folder
from pgf_jax.guidance.predictors.checkpoint import Checkpoint, load_network, shipped_checkpoints
from pgf_jax.guidance.predictors.network import CostDifference, FailureClassifier, GainNetwork
from pgf_jax.guidance.predictors.survival import TimeToSolution

_MAKE = {
    "paper": CostDifference,
    "best": GainNetwork,
    "classifier": FailureClassifier,
    "time": TimeToSolution,
}
NETWORKS: Mapping[str, tuple[str, ...]] = {
    "paper": ("phi_auto", "phi_human"),
    "best": ("gain",),
    "classifier": ("failure",),  # for the policy of that name: a probability, not a gain
    "time": ("time_alone", "time_helped"),  # for the policies that rank by time
}
# Names of shipped predictors: which one, and the folder of its checkpoints in theirs.
_SHIPPED = {
    "paper": ("paper", ""),
    "best": ("best", ""),
    "first": ("paper", "first"),
    "first-best": ("best", "first"),
}
PREDICTORS = tuple(_SHIPPED)


@dataclasses.dataclass(frozen=True)
class PredictorSpec:
    """Names a predictor and the folder of its checkpoints.

    Attributes:
      name: one of `NETWORKS`.
      folder: the folder of its checkpoints; None: the shipped ones.
      part: of the shipped ones: the folder in theirs; first: those that shipped before solutions
        were checked in a world.
    """

    name: str = "paper"
    folder: Path | None = None
    part: str = ""

    def files(self) -> Traversable:
        """The folder of the checkpoints."""
        if self.folder is not None:
            return self.folder
        shipped = shipped_checkpoints()
        return shipped / self.part if self.part else shipped

    def load(self) -> tuple[Any, tuple[Checkpoint, ...]]:
        """Load the predictor (of gains, or of times); returns it and its checkpoints.

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
    """Parse `--predictor TEXT`: a shipped one's name, `paper:FOLDER`, `best:FOLDER` or `FOLDER`.

    A folder alone stands for the paper's pair of networks in it.
    """
    if text in _SHIPPED:
        name, part = _SHIPPED[text]
        return PredictorSpec(name, part=part)
    name, colon, folder = text.partition(":")
    own = colon and name in _MAKE and name in PREDICTORS
    if not text or (own and not folder):
        raise BadInput(f"predictor: expected {', '.join(PREDICTORS)} or a folder, got {text!r}")
    if own:
        return PredictorSpec(name, Path(folder))
    return PredictorSpec("paper", Path(text))
