"""Features of a robot's reach: the numbers that predictors take.

`FEATURES` are the paper's ten history features (Papallas & Dogar 2022, Alg. 3): the number of
objects, and the cost terms of the best trajectory after each of the last P = 3 iterations. `STATE`
is wider: it begins with these ten and goes on with the state of the search, the best trajectory so
far, and the shelf around the goal. A predictor names the features of `STATE` that it takes.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pgf_jax.guidance.geometry import culprits, end_effector, wrap
from pgf_jax.guidance.view import View
from pgf_jax.physics import hand
from pgf_jax.scene.statistics import CORRIDOR_HALF_WIDTH

if TYPE_CHECKING:  # the planner needs JAX, and modules that only read or write tables do not
    from pgf_jax.planning.search import Search

HISTORY = 3  # P
# Feature -> its meaning, with its unit.
STATE_MEANINGS = {
    "n_objects": "N, the number of movable objects",
    **{
        f"{term}[t-{age}]": f"{term} of the best trajectory {age} iterations before the last one"
        for age in reversed(range(HISTORY))
        for term in ("c_d", "c_f", "c_b")
    },
    # The search.
    "iteration": "iterations of this segment so far",
    "stuck_count": "the planner's counter n",
    "last_excess": "the last winner's cost above the best's, log10(1 + x)",
    # The best trajectory so far.
    "c_e": "c_e of the best trajectory",
    "c_s": "c_s of the best trajectory",
    "distance": "d(goal) at the best trajectory's end, m",
    "bearing": "bearing of the goal there, rad",
    "goal_moved": "how far the best trajectory moves the goal, m",
    "end_room": "from the goal there to the nearer side wall, m",
    "end_depth": "from the goal there to the back wall, m",
    "culprits": "objects that stop the best trajectory (see `geometry.culprits`)",
    "force": "largest contact force at its end, log10(1 + force in N)",
    "moved": "objects that the best trajectory moves by more than 0.01 m",
    # The shelf as it is.
    "goal_x": "x of the goal, m",
    "room": "from the goal to the nearer side wall now, m",
    "range": "from the end-effector point to the goal, m",
    "turn": "the angle that the reach nominal turns by, rad, positive towards the nearer wall",
    "deeper": "objects that stand deeper in the shelf than the goal",
    "corridor": "objects in the straight corridor",
    "corridor_last": "of these, the ones within 0.12 m of the goal",
    "neighbours": "objects within 0.09 m of the goal",
    "wall_side": "of these, the ones between the goal and the nearer side wall",
}
# An input that is no part of a state: how far ahead a prediction looks.
AHEAD = "ahead"  # log2 of the number of the iteration from now on, 1 for the next one
FEATURES = tuple(STATE_MEANINGS)[: 1 + 3 * HISTORY]
STATE = tuple(STATE_MEANINGS)


def ahead(iterations: np.ndarray) -> np.ndarray:
    """The feature `AHEAD` of iterations that are 1, 2, ... from now."""
    return np.log2(np.asarray(iterations, dtype=np.float64))


def history_features(n_objects: int, history: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
    """Compute the paper's history features; nan where the history is too short.

    Args:
      n_objects: N, the number of movable objects.
      history: (c_d, c_f, c_b) of the best trajectory after each iteration of this segment, oldest
        first, iteration 0 excluded; only the last P entries are read.

    Returns:
      [10] float64, in the order of `FEATURES`; all nan where there are fewer than P entries.
    """
    if len(history) < HISTORY:
        return np.full(len(FEATURES), np.nan)
    recent = np.asarray(history[-HISTORY:], dtype=np.float64)  # [P, 3]
    return np.concatenate([[float(n_objects)], recent.ravel()])


def state_features(search: "Search") -> np.ndarray:
    """Compute the state of a reach, of which the history features are a part.

    Args:
      search: of one robot, at the end of an iteration.

    Returns:
      [S] float64 in the order of `STATE`; nan where the history is too short or a number is not
      finite.
    """
    view = View.of(search)
    n, goal = len(view.objects), view.goal
    history = search.history[np.isfinite(search.history).all(axis=1)]
    paper = history_features(n, history)
    if not np.isfinite(paper).all():
        return np.full(len(STATE), np.nan)

    excess = max(float(search.last_cost) - float(search.value.total), 0.0)
    end = view.path[-1]
    ee_end, pointing_end = end_effector(view.hands[-1]), view.hands[-1][2] + hand.POINTING_YAW
    to_end = end[goal] - ee_end
    force = np.where(np.isfinite(view.force[-1]), view.force[-1], 0.0)
    moved = np.linalg.norm(end - view.objects, axis=1)

    goal_xy = view.objects[goal]
    ee, pointing = end_effector(view.hand), view.hand[2] + hand.POINTING_YAW
    line = goal_xy - ee
    length = float(np.hypot(*line))
    line = line / length
    rel = view.objects - ee
    along, aside = rel @ line, rel[:, 0] * line[1] - rel[:, 1] * line[0]
    other = np.arange(n) != goal
    inside = (
        (along > 0) & (along < length - 0.01) & (np.abs(aside) < CORRIDOR_HALF_WIDTH + view.larger)
    )
    inside &= other
    base = goal_xy - view.hand[:2]
    turn = 0.5 * wrap(np.arctan2(base[1], base[0]) - pointing)
    near_side = 1.0 if goal_xy[1] >= 0 else -1.0
    close = np.linalg.norm(view.objects - goal_xy, axis=1) < 0.09 + view.larger + view.larger[goal]
    by_wall = near_side * (view.objects[:, 1] - goal_xy[1]) > view.radii
    state = np.array(
        [
            *paper,
            search.iteration,
            search.stuck_count,
            np.log10(1 + excess),
            search.value.terms[3],
            search.value.terms[4],
            search.value.distance,
            wrap(np.arctan2(to_end[1], to_end[0]) - pointing_end),
            moved[goal],
            view.side_y - abs(end[goal, 1]),
            view.back_x - end[goal, 0],
            culprits(view).sum(),
            np.log10(1 + force.max()),
            (moved > 0.01).sum(),
            goal_xy[0],
            view.side_y - abs(goal_xy[1]),
            length,
            near_side * turn,
            (view.objects[:, 0] > goal_xy[0]).sum(),
            inside.sum(),
            (inside & (length - along < 0.12)).sum(),
            (other & close).sum(),
            (other & close & by_wall).sum(),
        ],
        dtype=np.float64,
    )
    return state if np.isfinite(state).all() else np.full(len(STATE), np.nan)
