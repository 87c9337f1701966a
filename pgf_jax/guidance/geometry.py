"""Geometry of a view, as operators and features use it."""

import numpy as np

from pgf_jax.guidance.view import View
from pgf_jax.physics import hand

_FRONT = hand.capsule_segments(0.0).max((1, 2)) > 0.12  # not the base and the wrist
_FRONT_RADII = hand.RADII[_FRONT]
OPEN = hand.capsule_segments(0.0)[_FRONT]  # [C, 2, 2] axes of the open hand ahead of the wrist
CLOSED = hand.capsule_segments(hand.GRIPPER_CLOSED)[_FRONT]


def culprits(view: View) -> np.ndarray:
    """Mark the objects that stop the best trajectory so far: [N] 1, else 0."""
    n = len(view.objects)
    marked = np.zeros(n)
    if not np.isfinite(view.terms).all():
        return marked
    last, pose = view.path[-1], view.hands[-1]
    ee, yaw = end_effector(pose), pose[2] + hand.POINTING_YAW
    to = last - ee
    bearing = wrap(np.arctan2(to[:, 1], to[:, 0]) - yaw)
    away = np.hypot(np.linalg.norm(to, axis=1), 0.09 * bearing)
    marked[away < 0.075 + view.larger] = 1  # sits in the hand
    goal_and_hand = {view.goal, n}
    for force, (a, b) in zip(view.force[-1], view.bodies[-1], strict=True):
        for one, other in ((a, b), (b, a)):
            # An object ahead of the hand stops it, and so does one that is jammed between hand and
            # wall; an object that slides along the hand's side does not.
            stops = other in goal_and_hand and abs(bearing[one % n]) < 1.2 and force > 1
            jammed = other == n + 1 and force > 20
            if one < n and (stops or jammed):
                marked[one] = 1
    marked[view.goal] = 0
    return marked


def segment_distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances [P, N] of points [N, 2] to the segments a-b, each [P, 2] or [2]."""
    a, b = np.broadcast_arrays(a, b)
    a, b = np.atleast_2d(a)[:, None], np.atleast_2d(b)[:, None]
    ab = b - a
    t = ((points[None] - a) * ab).sum(-1) / np.maximum((ab**2).sum(-1), 1e-12)
    return np.linalg.norm(points[None] - a - np.clip(t, 0, 1)[..., None] * ab, axis=-1)


def into_walls(view: View, ee: np.ndarray, yaw: np.ndarray, capsules: np.ndarray) -> np.ndarray:
    """Depth [P], m, in a wall of a hand at `ee` ([P, 2]), turned by `yaw` ([P]).

    `capsules` are the [C, 2, 2] axes, in the hand's frame, of its parts ahead of the wrist.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    rel = capsules - hand.EE_POINT
    x = ee[:, 0, None, None] + c[:, None, None] * rel[..., 0] - s[:, None, None] * rel[..., 1]
    y = ee[:, 1, None, None] + s[:, None, None] * rel[..., 0] + c[:, None, None] * rel[..., 1]
    over = np.maximum(np.abs(y) - view.side_y, x - view.back_x) + _FRONT_RADII[:, None]
    return np.clip(over.max((1, 2)), 0, None)


def end_effector(pose: np.ndarray) -> np.ndarray:
    """Position [2] of `ee`, m, at a hand pose [3]."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose[:2] + np.array([[c, -s], [s, c]]) @ hand.EE_POINT


def wrap(angle: np.ndarray) -> np.ndarray:
    """Wrap angles into (-pi, pi]."""
    return np.arctan2(np.sin(angle), np.cos(angle))
