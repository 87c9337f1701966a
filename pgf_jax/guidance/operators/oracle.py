"""Operators `oracle` and `clairvoyant`: try pushes by rollouts, as upper bounds.

`oracle` knows the physics perfectly, but not the noise: it tries going on and a number of pushes,
the best few of them several times, with noise that no robot will use. `clairvoyant` knows the
robot's own noise as well, so its trials show what will happen: no operator that is asked at that
moment and chooses among these pushes could do better.
"""

from collections.abc import Sequence

import numpy as np

from pgf_jax.batching.places import Place
from pgf_jax.batching.requests import Coroutine, gather, robot_key_path, trial_key_path
from pgf_jax.guidance.operators.heuristic import HeuristicOperator, candidates
from pgf_jax.guidance.trials import Trial, simulate_input
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push
from pgf_jax.streams import stream

TOTAL = 14  # iterations of a trial at most: a few for a push, then the predictors' look-ahead
# Number of an operator's first trial; forks of the same state have the numbers below.
FIRST_TRIAL = 1 << 16


class OracleOperator:
    """Operator that tries every candidate once, then the best ones again.

    Args:
      name: the operator's name in the registry.
      ranked: pushes that are best by the geometry of the heuristic operator.
      others: pushes drawn at random from all that the heuristic operator considers.
      again: pushes that are tried again; going on is always tried again.
      repeats: how many times they are tried again.
      clairvoyant: trials use the robot's own noise, so once is enough.
    """

    def __init__(
        self,
        name: str = "oracle",
        *,
        ranked: int = 10,
        others: int = 6,
        again: int = 5,
        repeats: int = 2,
        clairvoyant: bool = False,
    ) -> None:
        self.name, self._clairvoyant = name, clairvoyant
        self._ranked, self._others = ranked, others
        self._again, self._repeats = again, repeats

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        """See `RolloutOperator.deliberate`."""
        inputs: list[Push | None] = [None, *self._pushes(view, decision_key)]
        every = list(range(len(inputs)))
        scores = yield from self._try(inputs, every, 0, search, planner, decision_key, view.place)
        if not self._clairvoyant:
            # The order of equals is that of the candidates: going on first, then the heuristic's.
            best = sorted(every[1:], key=lambda i: scores[i])[: self._again]
            chosen = [0, *best]
            tried = [[scores[i]] for i in chosen]
            for repeat in range(1, 1 + self._repeats):
                more = yield from self._try(
                    inputs, chosen, repeat, search, planner, decision_key, view.place
                )
                for own, score in zip(tried, more, strict=True):
                    own.append(score)
            means = {i: float(np.mean(own)) for i, own in zip(chosen, tried, strict=True)}
            return inputs[min(means, key=lambda i: means[i])]
        return inputs[min(every, key=lambda i: scores[i])]

    def _pushes(self, view: View, decision_key: DecisionKey) -> list[Push]:
        pushes = HeuristicOperator().ranked(view, self._ranked)
        objects, targets = candidates(view)
        count = min(self._others, len(objects))
        seed, *rest = decision_key
        # Raw bits: NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
        bits = stream(seed, "oracle", *rest).bit_generator.random_raw(len(objects))
        drawn = np.argsort(bits, kind="stable")[:count]
        return pushes + [Push(int(objects[k]), *map(float, targets[k])) for k in drawn]

    def _try(
        self,
        inputs: Sequence[Push | None],
        chosen: Sequence[int],
        repeat: int,
        search: Search,
        planner: BatchPlanner,
        decision_key: DecisionKey,
        place: Place | None,
    ) -> Coroutine:
        """Try the chosen inputs; returns their scores, lower is better."""

        def one(i: int) -> Coroutine:
            if self._clairvoyant:
                key_paths = robot_key_path(*decision_key)
            else:
                number = FIRST_TRIAL + repeat * len(inputs) + i
                key_paths = trial_key_path(*decision_key, number)
            return simulate_input(
                planner,
                search,
                inputs[i],
                key_paths,
                reach_limit=TOTAL,
                total_limit=TOTAL,
                place=place,
            )

        trials = yield from gather([one(i) for i in chosen])
        return [_score(trial) for trial in trials]


def _score(trial: Trial) -> float:
    """Score of a trial: its iterations; if unsolved, 1.5 times the limit and a share of cost."""
    if trial.solved:
        return trial.iterations
    return 1.5 * TOTAL + min(trial.total, 1e4) / 1e3


def clairvoyant() -> OracleOperator:
    """Make the operator `clairvoyant`, which knows the robot's noise as well."""
    return OracleOperator("clairvoyant", ranked=16, others=16, clairvoyant=True)
