"""Operators that try pushes by rollouts before they say anything (D5): upper bounds.

`oracle` knows the physics perfectly, and not the noise: it tries going on and a number of pushes,
the best few of them several times, under noise that no robot will use. `clairvoyant` knows the
robot's own noise as well, so that what it tries is what will happen: no operator who is asked at
that moment and knows these pushes could do better.
"""

from collections.abc import Sequence

import numpy as np

from pgf_jax.batching.requests import Coroutine, gather, robot_key_path, trial_key_path
from pgf_jax.guidance.operators.heuristic import HeuristicOperator, candidates
from pgf_jax.guidance.trials import Trial, simulate_input
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import Push
from pgf_jax.streams import stream

TOTAL = 14  # iterations that a trial may take: a push in a few, and then the predictors' look-ahead

# Number of its first trial: forks of the state that it is asked about have those below.
FIRST = 1 << 16


class OracleOperator:
    """Halves its choices: every candidate once, then the best ones again.

    Args:
      name: as it is registered.
      ranked: pushes that the heuristic operator thinks best.
      others: pushes drawn from all that it would consider.
      again: candidates that are tried again; going on always is.
      repeats: how many times.
      clairvoyant: tries with the robot's own noise, so once is enough.
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
        self, view: View, search: Search, planner: BatchPlanner, at: DecisionKey
    ) -> Coroutine:
        """See `operators.Deliberate.deliberate`."""
        inputs: list[Push | None] = [None, *self._pushes(view, at)]
        every = list(range(len(inputs)))
        scores = yield from self._try(inputs, every, 0, search, planner, at)
        if not self._clairvoyant:
            # The order of equals is that of the candidates: going on first, then the heuristic's.
            best = sorted(every[1:], key=lambda i: scores[i])[: self._again]
            chosen = [0, *best]
            runs = [[scores[i]] for i in chosen]
            for repeat in range(1, 1 + self._repeats):
                more = yield from self._try(inputs, chosen, repeat, search, planner, at)
                for run, score in zip(runs, more, strict=True):
                    run.append(score)
            means = {i: float(np.mean(run)) for i, run in zip(chosen, runs, strict=True)}
            return inputs[min(means, key=lambda i: means[i])]
        return inputs[min(every, key=lambda i: scores[i])]

    def _pushes(self, view: View, at: DecisionKey) -> list[Push]:
        pushes = HeuristicOperator().ranked(view, self._ranked)
        objects, targets = candidates(view)
        count = min(self._others, len(objects))
        # Raw bits: NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
        bits = stream(at[0], "oracle", *at[1:]).bit_generator.random_raw(len(objects))
        drawn = np.argsort(bits, kind="stable")[:count]
        return pushes + [Push(int(objects[k]), *map(float, targets[k])) for k in drawn]

    def _try(
        self,
        inputs: Sequence[Push | None],
        chosen: Sequence[int],
        repeat: int,
        search: Search,
        planner: BatchPlanner,
        at: DecisionKey,
    ) -> Coroutine:
        """Scores of the chosen inputs, lower is better."""

        def one(i: int) -> Coroutine:
            number = FIRST + repeat * len(inputs) + i
            words = robot_key_path(*at) if self._clairvoyant else trial_key_path(*at, number)
            return simulate_input(
                planner, search, inputs[i], words, reach_limit=TOTAL, total_limit=TOTAL
            )

        trials = yield from gather([one(i) for i in chosen])
        return [_score(trial) for trial in trials]


def _score(trial: Trial) -> float:
    """Iterations to a solution; unsolved, half as many again as it had, and its cost decides."""
    if trial.solved:
        return trial.iterations
    return 1.5 * TOTAL + min(trial.total, 1e4) / 1e3


def clairvoyant() -> OracleOperator:
    """The operator that knows the noise as well."""
    return OracleOperator("clairvoyant", ranked=16, others=16, clairvoyant=True)
