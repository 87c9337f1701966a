"""The gain that a robot will really have from help: what the policy `oracle-gain` bids (D7)."""

import dataclasses

import numpy as np

from pgf_jax.batching.requests import Coroutine, Request, gather, robot_key_path
from pgf_jax.guidance.trials import simulate_input
from pgf_jax.guidance.view import DecisionKey
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import LOOK_AHEAD


@dataclasses.dataclass(frozen=True)
class TrueGain:
    """In place of a predictor: no prediction at all, both futures are planned.

    They use the robot's own noise and the input that the operator would give now, so they are what
    will happen, up to the other inputs that may come within the look-ahead: no predictor could know
    more. It is known when the paper's prediction is, so that the two differ in knowledge alone.
    """

    def deliberate(
        self, search: Search, what: Request, planner: BatchPlanner, at: DecisionKey
    ) -> Coroutine:
        """c_d + c_f + c_b of the best trajectory `LOOK_AHEAD` reach iterations on, without help
        less with it; nan where it is solved, while the history is short,
        and where either future blows up.

        Args:
          search: a reach.
          what: asks for the operator's input as it would be now.
          planner: of the search.
          at: whose turn it is.
        """
        if planner.terminate(search) or not np.isfinite(search.history).all():
            return np.nan
        (push,) = yield [what]
        if push is None:
            return 0.0
        words = robot_key_path(*at)
        alone, helped = yield from gather(
            [
                simulate_input(planner, search, given, words, reach_limit=LOOK_AHEAD)
                for given in (None, push)
            ]
        )
        return alone.cost - helped.cost if np.isfinite([alone.cost, helped.cost]).all() else np.nan
