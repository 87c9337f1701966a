"""Candidates of an iteration: what the engine calls feasible, to be checked in a world.

The engine proposes and a world judges. A candidate that misses in the world is refuted: its
rollout, contacts and cost become those of the world, so that the search goes on as if it had never
been feasible. What passes ends the search.
"""

from typing import NamedTuple

import jax
import numpy as np

from pgf_jax.physics.engine import Rollout
from pgf_jax.planning import padding
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Rolled, Search

MOST_CHECKS = 3  # of one iteration


class Candidates(NamedTuple):
    """An iteration's rollouts while its feasible ones are checked, cheapest first.

    Attributes:
      before: the search before the iteration.
      rolled: R rollouts from which the winner is taken; then the best so far, if it is one that was
        never checked because its own iteration had too many.
      open: [R or R + 1] bool, feasible and not checked yet.
      checks: made so far.
      passed: the one that passed; None: none yet.
    """

    before: Search
    rolled: Rolled
    open: np.ndarray
    checks: int = 0
    passed: int | None = None

    @property
    def next(self) -> int | None:
        """The one to check next: the cheapest; None: all have been, or as many as may be."""
        if self.passed is not None or self.checks >= MOST_CHECKS or not self.open.any():
            return None
        return int(np.argmin(np.where(self.open, self.rolled.value.total, np.inf)))

    def checked(self, planner: BatchPlanner, grasped: bool, seen: Rollout) -> "Candidates":
        """The candidates after `next` has been checked.

        Args:
          planner: of the search.
          grasped: whether it passed.
          seen: its rollout in the world ([T, N, 2] and so on).
        """
        i = self.next
        assert i is not None
        seen = padding.pad_rollout(seen, self.rolled.rollout.objects.shape[-2])
        done = self._replace(checks=self.checks + 1, open=_with(self.open, i, False))
        if grasped:
            return done._replace(passed=i)
        value = planner.evaluate(self.before, seen)
        # What counts as a grasp is the world's to say; a cost with wider limits does not change it.
        total = np.where(value.feasible, np.inf, value.total)
        value = value._replace(total=total.astype(np.float32), feasible=np.array(False))
        rolled = self.rolled
        refuted = jax.tree.map(
            lambda xs, x: _with(xs, i, x), rolled, Rolled(rolled.controls[i], seen, value)
        )
        return done._replace(rolled=refuted)

    def search(self, planner: BatchPlanner) -> Search:
        """The search after the iteration, as far as it is checked: feasible is what passed."""
        places = np.arange(len(self.open))
        feasible = self.rolled.value.feasible & (places == self.passed)
        rolled = self.rolled._replace(value=self.rolled.value._replace(feasible=feasible))
        before, count = self.before, _count(self.before, planner)
        if len(places) > count:  # the best so far is among them
            best = _row(rolled, count)
            before = before._replace(best=best.rollout, value=best.value)
            rolled = _row(rolled, slice(count))
        return planner.take(before, rolled)


def candidates_of(before: Search, rolled: Rolled, planner: BatchPlanner) -> Candidates | None:
    """The candidates of a reach's iteration; None where nothing is to be checked.

    Args:
      before: the search before the iteration.
      rolled: R rollouts from which the winner is taken.
      planner: of the search.
    """
    if before.task.pushing:
        return None
    if _was_left_over(before, planner):
        best = Rolled(before.controls, before.best, before.value._replace(feasible=np.array(True)))
        rolled = jax.tree.map(lambda xs, x: np.concatenate([xs, np.asarray(x)[None]]), rolled, best)
    open_ = np.array(rolled.value.feasible)
    return Candidates(before, rolled, open_) if open_.any() else None


def warm_up(planner: BatchPlanner, search: Search) -> None:
    """Compile what the checks of candidates take; `search` is any."""
    planner.evaluate(search, search.best)
    best = Rolled(search.controls, search.best, search.value)
    for count in {1, _count(search._replace(iteration=np.int32(0)), planner)}:
        planner.take(search, jax.tree.map(lambda x, n=count: np.stack([x] * n), best))


def _was_left_over(search: Search, planner: BatchPlanner) -> bool:
    """Whether the best so far is feasible to the engine, and was not checked."""
    value, cost = search.value, planner.config.cost
    cheap = value.terms[2] == 0 if cost.variant == "paper" else value.total <= cost.feasible_cost
    return bool(value.finite & cheap & (value.distance < cost.goal_radius) & ~value.feasible)


def _count(before: Search, planner: BatchPlanner) -> int:
    """R, rollouts that the winner of an iteration is taken from."""
    config = planner.config
    return 1 if before.iteration < 0 or config.update == "stomp" else config.rollouts


def _row(rolled: Rolled, index: int | slice) -> Rolled:
    return jax.tree.map(lambda xs: xs[index], rolled)


def _with(rows: np.ndarray, i: int, row: object) -> np.ndarray:
    """A copy of rows with another one in place i, in their type."""
    rows = np.array(rows)
    rows[i] = row
    return rows
