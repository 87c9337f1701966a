"""Predicts how long a reach still takes: a discrete-time survival model (Singer & Willett 1993).

A network gives the hazard of a future iteration: the log-odds that the reach is solved in it, given
that it was not before. Its inputs are the state now and how far ahead that iteration is. The
probability of being unsolved after k iterations is the product of (1 - hazard) over 1..k. Runs that
the task's limit cuts off are censored: they count as unsolved in the iterations that they had, and
say nothing of later ones (`training.rows.hazard_rows`).
"""

import dataclasses

import numpy as np

from pgf_jax.guidance.predictors.features import AHEAD, STATE, ahead
from pgf_jax.guidance.predictors.network import Predictor

HORIZON = 60  # H, iterations ahead: 180 s of 3 s
# Iterations at which hazards are computed; between them, log-odds are interpolated in log2.
KNOTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 44, 60)


@dataclasses.dataclass(frozen=True, eq=False)
class TimeToSolution:
    """The two networks of hazards: without help, and from an operator's answer on."""

    alone: Predictor
    helped: Predictor

    def survival(self, states: np.ndarray) -> np.ndarray:
        """[B, S] -> [B, 2, H] probabilities of being unsolved; see `TimePredictor.survival`."""
        return np.stack([survival(network, states) for network in (self.alone, self.helped)], 1)


def survival(network: Predictor, states: np.ndarray) -> np.ndarray:
    """Probabilities of being unsolved after 1..H more iterations.

    Args:
      network: of hazards.
      states: [B, S] in the order of `features.STATE`.

    Returns:
      [B, H] float64, not increasing; nan where a state has a nan.
    """
    states = np.asarray(states, dtype=np.float64)
    at = ahead(np.array(KNOTS))  # [J]
    columns = [
        np.tile(at, len(states))
        if name == AHEAD
        else np.repeat(states[:, STATE.index(name)], len(KNOTS))
        for name in network.features
    ]
    rows = np.stack(columns, axis=1)  # [B J, F]
    log_odds = network.predict(rows).astype(np.float64).reshape(len(states), len(KNOTS))
    every = ahead(np.arange(1, HORIZON + 1))
    hazard = np.array(
        [0.5 * (1 + np.tanh(0.5 * np.interp(every, at, row))) for row in log_odds]
    ).reshape(len(states), HORIZON)
    return np.cumprod(1 - hazard, axis=1)
