"""The true gain from help, computed by rollouts; robots bid it under the policy `oracle-gain`."""

import dataclasses

import numpy as np

from pgf_jax.batching.places import Place
from pgf_jax.batching.requests import Coroutine, Request, gather, robot_key_path
from pgf_jax.guidance.trials import simulate_input
from pgf_jax.guidance.view import DecisionKey
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import LOOK_AHEAD


@dataclasses.dataclass(frozen=True)
class TrueGain:
    """Simulates both futures, with help and without, in place of a predictor.

    The futures use the robot's own noise and the input that the operator would give now, so they
    are what will happen, except for other inputs within the look-ahead: no predictor could know
    more. The gain is known from the same iteration on as the paper's prediction, so that the two
    differ in knowledge alone.
    """

    def simulate_gain(
        self,
        search: Search,
        input_request: Request,
        planner: BatchPlanner,
        decision_key: DecisionKey,
        place: Place | None = None,
    ) -> Coroutine:
        """Coroutine that returns the gain: the cost without help minus the cost with help.

        The cost is c_d + c_f + c_b of the best trajectory `LOOK_AHEAD` reach iterations on. The
        gain is nan where the reach is solved, while its history is short, and where a cost of
        either future is not finite.

        Args:
          search: a reach.
          input_request: request for the input that the operator would give now.
          planner: of the search.
          decision_key: identifies the robot's iteration; the keys of its noise are made of it.
          place: where the search stands in a world, see `simulate_input`.
        """
        if planner.terminate(search) or not np.isfinite(search.history).all():
            return np.nan
        (push,) = yield [input_request]
        if push is None:
            return 0.0
        key_paths = robot_key_path(*decision_key)
        alone, helped = yield from gather(
            [
                simulate_input(
                    planner, search, given, key_paths, reach_limit=LOOK_AHEAD, place=place
                )
                for given in (None, push)
            ]
        )
        return alone.cost - helped.cost if np.isfinite([alone.cost, helped.cost]).all() else np.nan
