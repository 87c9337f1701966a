"""What a robot knows of its own reach when it may bid, in numbers: what predictors choose from.

The first ten are the paper's (`rows.FEATURES`); a predictor names those that it takes.
"""

from collections.abc import Sequence

import numpy as np

from pgf_jax.guidance.geometry import CORRIDOR, culprits, end_effector, wrap
from pgf_jax.guidance.view import View
from pgf_jax.physics import hand
from pgf_jax.planning.planner import Search
from pgf_jax.scene.scene import BACK_WALL_X, RADIUS, SIDE_WALL_Y

HISTORY = 3  # P


FEATURES = (
    "n_objects",
    *(f"{term}[t-{age}]" for age in reversed(range(HISTORY)) for term in ("c_d", "c_f", "c_b")),
)


def history_features(n_objects: int, history: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
    """One row of features from a history, or nan where it is too short.

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


STATE = (
    *FEATURES,
    "iteration",  # of this segment
    "stuck_count",  # n of D4
    "last_excess",  # the last winner's cost above the best's, log10(1 + x)
    "c_e",  # of the best trajectory, like all below but the last nine
    "c_s",
    "distance",  # d(goal) at its end, m
    "bearing",  # of the goal there, rad
    "goal_moved",  # m
    "end_room",  # of the goal to the nearer side wall at the end, m
    "end_depth",  # of the goal to the back wall, m
    "culprits",  # objects that stop it (see `geometry.culprits`)
    "force",  # largest contact force at its end, log10(1 + N)
    "moved",  # objects that it moves by a centimetre or more
    "goal_x",  # where the goal stands, m
    "room",  # to the nearer side wall, m
    "range",  # from the end-effector point, m
    "turn",  # the angle that the reach nominal turns by, rad, positive towards the nearer wall
    "deeper",  # objects that stand deeper in the shelf
    "corridor",  # objects in the straight corridor
    "corridor_last",  # of them, those within 0.12 m of the goal
    "neighbours",  # objects within 0.09 m of the goal
    "wall_side",  # of them, those between it and the nearer side wall
)


def state_features(search: Search) -> np.ndarray:
    """State of a reach.

    Args:
      search: of one robot, at the end of an iteration.

    Returns:
      [S] float64 in the order of `STATE`; nan where the history is too short, or a rollout blew up.
    """
    seen = View.of(search)
    n, goal = len(seen.objects), seen.goal
    history = search.history[np.isfinite(search.history).all(axis=1)]
    paper = history_features(n, history)
    if not np.isfinite(paper).all():
        return np.full(len(STATE), np.nan)

    excess = max(float(search.last_cost) - float(search.value.total), 0.0)
    end = seen.path[-1]
    ee_end, pointing_end = end_effector(seen.hands[-1]), seen.hands[-1][2] + hand.POINTING_YAW
    to_end = end[goal] - ee_end
    force = np.where(np.isfinite(seen.force[-1]), seen.force[-1], 0.0)
    moved = np.linalg.norm(end - seen.objects, axis=1)

    at = seen.objects[goal]
    ee, pointing = end_effector(seen.hand), seen.hand[2] + hand.POINTING_YAW
    line = at - ee
    length = float(np.hypot(*line))
    line = line / length
    rel = seen.objects - ee
    along, aside = rel @ line, rel[:, 0] * line[1] - rel[:, 1] * line[0]
    other = np.arange(n) != goal
    inside = (along > 0) & (along < length - 0.01) & (np.abs(aside) < CORRIDOR) & other
    base = at - seen.hand[:2]
    turn = 0.5 * wrap(np.arctan2(base[1], base[0]) - pointing)
    near_side = 1.0 if at[1] >= 0 else -1.0
    near = np.linalg.norm(seen.objects - at, axis=1)
    by_wall = near_side * (seen.objects[:, 1] - at[1]) > RADIUS
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
            SIDE_WALL_Y - abs(end[goal, 1]),
            BACK_WALL_X - end[goal, 0],
            culprits(seen).sum(),
            np.log10(1 + force.max()),
            (moved > 0.01).sum(),
            at[0],
            SIDE_WALL_Y - abs(at[1]),
            length,
            near_side * turn,
            (seen.objects[:, 0] > at[0]).sum(),
            inside.sum(),
            (inside & (length - along < 0.12)).sum(),
            (other & (near < 0.09)).sum(),
            (other & (near < 0.09) & by_wall).sum(),
        ],
        dtype=np.float64,
    )
    return state if np.isfinite(state).all() else np.full(len(STATE), np.nan)
