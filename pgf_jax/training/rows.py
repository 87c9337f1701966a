"""Training rows of the predictors, made of runs and forks (Papallas & Dogar 2022, Alg. 3).

A row of a run is taken at the end of a reach iteration, which is when a robot bids:

- Features, 10 numbers (`predictors.features`): N, then (c_d, c_f, c_b) after each of the last P = 3
  iterations of the segment in time order, iteration 0 excluded; so the third iteration of a segment
  is the first with features.
- Target: c_d + c_f + c_b of the best trajectory l = 10 reach iterations later. Neither iterations
  of pushes nor iteration 0 of a segment count (an iteration 0 tries nothing); a run that ends
  earlier is carried forward with its last reach cost.
- There is no row at or after the iteration that solves the task, since no robot bids then.

`autonomous_rows` takes a row at every reach iteration of runs without help. `human_rows` takes one
at the iteration before each human input; a further input within the 10 iterations counts as a
result of the first. `failure_rows`, `gain_rows` and `hazard_rows` have other targets. `PUBLISHED`
is the published code's rule in place of the paper's, for an ablation.
"""

import dataclasses
import hashlib
from collections.abc import Callable, Iterator

import numpy as np
import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.features import (
    AHEAD,
    FEATURES,
    HISTORY,
    STATE,
    ahead,
    history_features,
)
from pgf_jax.planning.types import LOOK_AHEAD
from pgf_jax.tables.forks import FORK, forks_of
from pgf_jax.tables.runs import RUN, check_unhelped


@dataclasses.dataclass(frozen=True)
class Rule:
    """Rule for making rows of runs; the default is the paper's.

    Attributes:
      look_ahead: l, in reach iterations.
      carried: a run that ends earlier is carried forward with its last reach cost; otherwise it
        gives no row there, so that the predictor learns from the slow runs only.
      ring: the history has the order of a ring buffer of P places: the order of time at every
        third iteration only.
    """

    look_ahead: int = LOOK_AHEAD
    carried: bool = True
    ring: bool = False


PAPER = Rule()
PUBLISHED = Rule(look_ahead=11, carried=False, ring=True)


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Training rows, M of them.

    Attributes:
      features: [M, F] float64, in the order of `names`.
      target: [M] float64, the cost `LOOK_AHEAD` reach iterations on.
      unsolved: [M] bool, whether the task is still unsolved then.
      scene: [M] str, the scene each row comes from.
      iteration: [M] int64, the iteration (over the run) at whose end the row is taken.
      non_finite: rows left out because a feature or the target is not finite.
      short: human inputs without a row, because fewer than P iterations came before them.
      names: names of the features.
    """

    features: np.ndarray  # [M, F]
    target: np.ndarray  # [M]
    unsolved: np.ndarray  # [M]
    scene: np.ndarray  # [M]
    iteration: np.ndarray  # [M]
    non_finite: int = 0
    short: int = 0
    names: tuple[str, ...] = FEATURES

    def only(self, names: tuple[str, ...]) -> "Rows":
        """Return the same rows with only the named features."""
        columns = [self.names.index(name) for name in names]
        return dataclasses.replace(self, features=self.features[:, columns], names=names)


@dataclasses.dataclass(frozen=True, eq=False)
class _Run:
    """One run up to the iteration that solved it; I iterations."""

    scene: str
    n_objects: int
    reach: np.ndarray  # [I] bool
    local: np.ndarray  # [I] iteration within its segment
    terms: np.ndarray  # [I, 3]
    solved: bool  # by the last iteration
    asked_before: np.ndarray  # [I] bool


def autonomous_rows(frame: pl.DataFrame, rule: Rule = PAPER) -> Rows:
    """Make a row at the end of every reach iteration with enough history, of runs without help.

    Args:
      frame: runs as `read_runs` returns them.
      rule: how rows are made.

    Returns:
      The rows, run by run in order of (scene, seed), then of iteration.

    Raises:
      BadInput: a run has human input in it.
    """
    check_unhelped(frame, "runs")
    return _rows(frame, lambda run: np.flatnonzero(run.reach), rule)


def failure_rows(frame: pl.DataFrame, rule: Rule = PAPER) -> Rows:
    """Make `autonomous_rows` with another target: 1 where the task is unsolved then, else 0."""
    rows = autonomous_rows(frame, rule)
    return dataclasses.replace(rows, target=rows.unsolved.astype(np.float64))


def human_rows(frame: pl.DataFrame, rule: Rule = PAPER) -> Rows:
    """Make a row for each human input, at the end of the iteration before it.

    Args:
      frame: runs as `read_runs` returns them.
      rule: how rows are made.

    Returns:
      The rows, run by run in order of (scene, seed), then of iteration.
    """
    rows = _rows(frame, _before_inputs, rule)
    inputs = sum(len(_before_inputs(run)) for run in _split_runs(frame))
    missing = inputs - len(rows.target) - rows.non_finite if rule.carried else 0
    return dataclasses.replace(rows, short=missing)


def gain_rows(frame: pl.DataFrame) -> Rows:
    """Make a row for each forked state: its features, with its true gain as the target."""
    forks = forks_of(frame)
    states = frame.select(FORK).unique().height
    return Rows(
        features=forks.state,
        target=forks.gain,
        unsolved=np.ones(len(forks.gain), bool),
        scene=forks.scene.astype(np.str_),
        iteration=forks.iteration,
        non_finite=states - len(forks.gain),
        names=STATE,
    )


def hazard_rows(frame: pl.DataFrame, which: str, step_s: float = 3.0, drawn_to: int = 39) -> Rows:
    """Make a row for each iteration of each future: was it solved in it, having not been before?

    An iteration is a step of the clock of `step_s`. A future that the task's limit cut off has a
    row for each step that was whole, all with target 0. Futures alone count more often the longer
    their run was: see `stands_for`.

    Args:
      frame: futures as `read_futures` returns them.
      which: `alone` or `helped`.
      step_s: time of an iteration, s.
      drawn_to: the last iteration of which states were drawn.
    """
    if which == "alone":
        frame = frame[np.repeat(np.arange(len(frame)), stands_for(frame, drawn_to))]
    states = frame.select(f"state:{name}" for name in STATE).to_numpy()
    seconds, solved = frame[f"{which}_s"].to_numpy(), frame[f"{which}_solved"].to_numpy()
    steps = np.where(solved, np.ceil(seconds / step_s), np.floor(seconds / step_s)).astype(int)
    finite = np.isfinite(states).all(axis=1)
    steps = np.where(finite, np.maximum(steps, solved), 0)
    of = np.repeat(np.arange(len(frame)), steps)  # [M] row of the future
    number = np.arange(len(of)) - np.repeat(np.cumsum(steps) - steps, steps) + 1  # [M] 1, 2, ...
    last = number == steps[of]
    return Rows(
        features=np.concatenate([states[of], ahead(number)[:, None]], axis=1),
        target=(last & solved[of]).astype(np.float64),
        unsolved=~(last & solved[of]),
        scene=frame["scene"].to_numpy()[of].astype(np.str_),
        iteration=frame["iteration"].to_numpy()[of],
        non_finite=int((~finite).sum()),
        names=(*STATE, AHEAD),
    )


def stands_for(frame: pl.DataFrame, drawn_to: int = 39) -> np.ndarray:
    """[F] of how many states of its run each future's state is one, rounded.

    A run that is soon solved has few states, and each of them is likely drawn; its own future is
    short. Without this the futures of key 0, which are the runs' own, would be too short a sample.

    Args:
      frame: futures as `read_futures` returns them.
      drawn_to: the last iteration of which states were drawn.
    """
    state = ["scene", "seed", "iteration"]
    own = frame.filter(pl.col("key") == 0)
    last = pl.col("iteration") + pl.col("alone_iterations") - pl.col("alone_solved").cast(int)
    among = pl.min_horizontal(last, drawn_to) - HISTORY + 1
    drawn = pl.len().over("scene", "seed")
    counts = own.select(*state, (among / drawn).round().clip(lower_bound=1).cast(int).alias("n"))
    return (
        frame.select(state)
        .join(counts, on=state, how="left", maintain_order="left")["n"]
        .to_numpy()
    )


def _before_inputs(run: _Run) -> np.ndarray:
    # Input before the very first iteration gives -1: it has no history at all.
    return np.flatnonzero(run.asked_before) - 1


def _rows(frame: pl.DataFrame, moments: Callable[[_Run], np.ndarray], rule: Rule) -> Rows:
    """Make rows at the iterations `moments(run)` that have features and are not solved."""
    features, target, unsolved, scene, iteration = [], [], [], [], []
    for run in _split_runs(frame):
        with np.errstate(over="ignore"):  # finite terms may have an infinite sum: no row then
            cost = run.terms.sum(axis=1)  # [I]
        reach = np.flatnonzero(run.reach)
        counted = np.cumsum(run.reach & (run.local > 0))  # [I] reach iterations so far
        for t in moments(run):
            if t < 0 or run.local[t] < HISTORY or (run.solved and t == len(cost) - 1):
                continue
            # The first iteration with the count; an iteration 0 after it repeats the count.
            ahead = int(np.searchsorted(counted, counted[t] + rule.look_ahead))
            if ahead == len(cost) and not rule.carried:
                continue
            history = run.terms[t - HISTORY + 1 : t + 1]
            if rule.ring:
                history = np.roll(history, run.local[t], axis=0)
            features.append(history_features(run.n_objects, history))
            target.append(cost[ahead] if ahead < len(cost) else cost[reach[-1]])
            unsolved.append(not run.solved or ahead < len(cost) - 1)
            scene.append(run.scene)
            iteration.append(int(t))
    x = np.array(features, dtype=np.float64).reshape(-1, len(FEATURES))
    y = np.array(target, dtype=np.float64)
    kept = np.isfinite(x).all(axis=1) & np.isfinite(y)
    return Rows(
        features=x[kept],
        target=y[kept],
        unsolved=np.array(unsolved, dtype=bool)[kept],
        scene=np.array(scene, dtype=np.str_)[kept],
        iteration=np.array(iteration, dtype=np.int64)[kept],
        non_finite=int((~kept).sum()),
    )


def _split_runs(frame: pl.DataFrame) -> Iterator[_Run]:
    frame = frame.sort([*RUN, "iteration"])
    for run in frame.partition_by(list(RUN), maintain_order=True):
        kind = run["kind"].to_numpy() == "reach"
        solved = np.flatnonzero(kind & run["feasible"].to_numpy())
        end = int(solved[0]) + 1 if len(solved) else len(run)
        segment = run["segment"].to_numpy()[:end]
        yield _Run(
            scene=run["scene"][0],
            n_objects=run["n_objects"][0],
            reach=kind[:end],
            local=np.arange(end) - np.searchsorted(segment, segment),
            terms=run.select("c_d", "c_f", "c_b").to_numpy()[:end],
            solved=bool(len(solved)),
            asked_before=run["asked_before"].to_numpy()[:end],
        )


def split_by_scene(
    scene: np.ndarray, *, fraction: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Split rows for training and validation so that no scene is in both.

    Scenes are ordered by a hash of (seed, name), so a scene that is in two data sets falls on the
    same side of both, but for a few at the boundary.

    Args:
      scene: [M] the scene of each row.
      fraction: share of the scenes for validation, in (0, 1); at least one, and not all.
      seed: another seed gives another split.

    Returns:
      Indices of the rows for training and of those for validation, ascending.

    Raises:
      BadInput: there are fewer than two scenes.
    """
    names = [str(name) for name in np.unique(scene)]
    if len(names) < 2:
        raise BadInput(f"a split by scene needs rows from at least 2 scenes, got {len(names)}")
    names.sort(key=lambda name: hashlib.sha256(f"{seed}:{name}".encode()).digest())
    held_out = min(max(round(fraction * len(names)), 1), len(names) - 1)
    validation = np.isin(scene, names[:held_out])
    return np.flatnonzero(~validation), np.flatnonzero(validation)
