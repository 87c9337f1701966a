"""How sure each robot is to find its way by itself, for the bar on the page.

It is the survival model's chance that the reach is solved within `WITHIN` iterations without help,
whatever policy the condition has: so what the page shows does not differ between conditions.
"""

import numpy as np

from pgf_jax.guidance.predictors.features import STATE, state_features
from pgf_jax.guidance.predictors.registry import PredictorSpec
from pgf_jax.guidance.predictors.survival import TimeToSolution, survival
from pgf_jax.planning.search import Search
from pgf_jax.simulation.planned_robots import PlannedRobots

WITHIN = 10  # iterations: 30 s


class Sureness:
    """Keeps what was predicted of each robot until its search has changed."""

    def __init__(self) -> None:
        predictor, _ = PredictorSpec("time").load()
        assert isinstance(predictor, TimeToSolution)
        self._network = predictor.alone
        self._of: dict[int, tuple[Search, float | None]] = {}
        self._predict([np.zeros(len(STATE))])  # compiles, before somebody waits for a frame

    def of(self, robots: PlannedRobots) -> dict[int, float | None]:
        """Robot -> its chance, 0..1; None: not reaching, or nothing is known yet."""
        changed = []
        for number, robot in robots.robots.items():
            search = robot.search
            known = self._of.get(number)
            if known is None or known[0] is not search:
                self._of[number] = search, None
                if not search.task.pushing:
                    changed.append((number, search, state_features(search)))
        if changed:
            chances = self._predict([state for *_, state in changed])
            for (number, search, _), chance in zip(changed, chances, strict=True):
                self._of[number] = search, float(chance) if np.isfinite(chance) else None
        return {number: chance for number, (_, chance) in self._of.items()}

    def _predict(self, states: list[np.ndarray]) -> np.ndarray:
        return 1 - survival(self._network, np.stack(states))[:, WITHIN - 1]
