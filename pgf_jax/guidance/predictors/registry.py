"""Which predictor a study uses: by name, the shipped ones, or from a folder of one's own."""

import dataclasses
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path

import jax
import numpy as np

from pgf_jax.batching.requests import GainPredictor
from pgf_jax.errors import BadInput
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
    """A predictor that was asked for.

    Attributes:
      name: one of `NETWORKS`.
      folder: where its checkpoints lie; None: those that ship.
    """

    name: str = "paper"
    folder: Path | None = None

    def files(self) -> Traversable:
        """The folder."""
        return shipped_checkpoints() if self.folder is None else self.folder

    def load(self) -> tuple[GainPredictor, tuple[Checkpoint, ...]]:
        """The predictor, and the checkpoints that it is made of.

        Raises:
          BadInput: one line that names the folder or the file.
        """
        folder = self.files()
        if not is_folder(folder):
            raise BadInput(f"{folder}: no such folder, expected one with checkpoints")
        checkpoints = tuple(load_network(folder, network) for network in NETWORKS[self.name])
        networks = [checkpoint.predictor for checkpoint in checkpoints]
        # NumPy leaves: arrays of JAX would start its backend wherever they are unpickled.
        return _MAKE[self.name](*(jax.tree.map(np.asarray, net) for net in networks)), checkpoints


def predictor_spec(text: str) -> PredictorSpec:
    """What `--predictor TEXT` asks for: `paper` or `best`, those of a folder, `best:FOLDER`, or a
    folder, for the paper's pair in it.
    """
    if text in PREDICTORS:
        return PredictorSpec(text)
    name, colon, folder = text.partition(":")
    if not text or (colon and name in PREDICTORS and not folder):
        raise BadInput(f"predictor: expected {', '.join(PREDICTORS)} or a folder, got {text!r}")
    if colon and name in PREDICTORS:
        return PredictorSpec(name, Path(folder))
    return PredictorSpec("paper", Path(text))
