"""The true time that a reach still takes, by rollouts; `oracle-time` ranks robots by it."""

import dataclasses
import math

from pgf_jax.batching.places import Place
from pgf_jax.batching.requests import Coroutine, Memoised, robot_key_path
from pgf_jax.fleet.robots import TimeLeft
from pgf_jax.guidance.trials import simulate_input
from pgf_jax.guidance.view import DecisionKey
from pgf_jax.simulation.search_cache import Node, SearchCache


@dataclasses.dataclass(frozen=True)
class TrueTime:
    """Simulates both futures to their ends, without help and with it, in place of a predictor.

    Both are by the robot's own noise, and the input is the one that the operator would give now. A
    robot that plans while it is served gets its answer some iterations later, from when on other
    noise is drawn; so the second is a true time, but not the one that will be.

    Attributes:
      limit: rollouts that fit into a task's time.
      keep: see `simulate_input`.
    """

    limit: float
    keep: bool

    def simulate(
        self,
        cache: SearchCache,
        node: Node,
        input_request: Memoised,
        decision_key: DecisionKey,
        place: Place | None,
    ) -> Coroutine:
        """Coroutine that returns the `TimeLeft`, None where the reach is solved or has just begun.

        Args:
          cache: of the robot's searches.
          node: a reach, after an iteration.
          input_request: request for the input that the operator would give now.
          decision_key: identifies the robot's iteration; the keys of its noise are made of it.
          place: where the search stands in a world.
        """
        planner = cache.planner_service.planner
        if planner.terminate(node.search) or int(node.search.iteration) < 1:
            return None
        _, robot, task, iteration = decision_key
        # Of the iterations before, iteration 0s took a rollout, and all others two or more.
        left = self.limit - iteration
        alone = yield from self._alone(cache, node, (robot, task, iteration), left, place)
        (push,) = yield [input_request]
        helped = alone
        if push is not None:
            trial = yield from simulate_input(
                planner,
                node.search,
                push,
                robot_key_path(*decision_key),
                reach_limit=math.inf,
                rollout_limit=left,
                keep=self.keep,
                place=place,
            )
            helped = trial.rollouts if trial.solved else math.inf
        return TimeLeft(*(_certain(rollouts, left) for rollouts in (alone, helped)))

    @staticmethod
    def _alone(
        cache: SearchCache, node: Node, number: tuple[int, int, int], left: float, place
    ) -> Coroutine:
        """Rollouts until it is solved alone; along the robot's own nodes, so computed once."""
        robot, task, iteration = number
        spent = 0
        while spent + 2 <= left:
            (node,) = yield [cache.iterated(node, robot, task, iteration)]
            spent, iteration = spent + 2, iteration + 1
            while node.candidates is not None:
                (node,) = yield [cache.checked(node, place)]
                spent += 1
            if cache.planner_service.planner.terminate(node.search):
                return spent
        return math.inf


def _certain(rollouts: float, left: float) -> tuple[float, ...]:
    """Probabilities to be unsolved after 1, 2, ... iterations where the end is known."""
    steps = math.ceil(left / 2) + 1
    return tuple(float(2 * step < rollouts) for step in range(1, steps + 1))
