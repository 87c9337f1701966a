"""Nominal trajectories: the end effector follows straight lines; for one robot, no randomness."""

import jax
import jax.numpy as jnp

from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics
from pgf_jax.planning.config import Cost
from pgf_jax.planning.cost import beyond_standard, end_effector, reach_distance, rotation, wrap
from pgf_jax.scene.shelf import Shelf

REACH_SHORT = 0.04  # m, where a reach nominal stops before the goal
OPEN_WITHIN = 0.15  # m, d(goal) under which the hand is open throughout
CLOSED_SHARE = 0.6  # the last floor(0.6 T) knots of a reach are with the hand open
PUSH_BEHIND = 0.07  # m, from the object, as seen from the target
PUSH_SHORT = 0.05  # m, where a push nominal stops before the target


def _follow(pose: jax.Array, waypoints: jax.Array, yaws: jax.Array, physics: Physics) -> jax.Array:
    """[T, 3] velocities that bring `ee` to the [T, 2] waypoints, at the [T] yaws, knot by knot."""
    base = waypoints - rotation(yaws) @ jnp.asarray(hand.EE_POINT)  # [T, 2]
    poses = jnp.concatenate([pose[None], jnp.concatenate([base, yaws[:, None]], 1)])
    return jnp.diff(poses, axis=0) / physics.knot_s


def reach(
    pose: jax.Array,
    objects: jax.Array,
    goal: jax.Array,
    physics: Physics,
    cost: Cost,
    shelf: Shelf | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Nominal of a reach: straight to 0.04 m short of the goal, turning by half its angle.

    The angle is that between the goal and the pointing direction, as seen from the robot's base
    point. The base moves so that `ee` is on the line at every knot's end, whatever the turn. The
    hand is open in the last knots, and throughout where the goal is near.

    Args:
      pose: [3] hand pose at the start.
      objects: [N, 2] centres.
      goal: [] index of the goal.
      physics: static; gives T and the knot's duration.
      cost: static; gives d(goal).
      shelf: unbatched; None: standard. Distances to a larger object are larger.

    Returns:
      [T, 3] velocities and [T] gripper values.
    """
    t = physics.knots
    ee, to = end_effector(pose), objects[goal] - end_effector(pose)
    length = jnp.linalg.norm(to)
    travel = to / length * (length - (REACH_SHORT + beyond_standard(shelf, goal)))
    seen = objects[goal] - pose[:2]
    turn = 0.5 * wrap(jnp.arctan2(seen[1], seen[0]) - pose[2] - hand.POINTING_YAW)
    yaws = jnp.linspace(pose[2], pose[2] + turn, t + 1)[1:]
    controls = _follow(pose, jnp.linspace(ee, ee + travel, t + 1)[1:], yaws, physics)
    closed_knots = t - int(CLOSED_SHARE * t)
    near = reach_distance(pose, objects, cost)[goal] < OPEN_WITHIN
    closed = (jnp.arange(t) < closed_knots) & ~near
    return controls, jnp.where(closed, hand.GRIPPER_CLOSED, 0.0)


def push(
    pose: jax.Array,
    objects: jax.Array,
    pushed: jax.Array,
    target: jax.Array,
    physics: Physics,
    shelf: Shelf | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Nominal of a push: half the knots to behind the object, half towards the target.

    The hand goes to 0.07 m behind the object, as seen from the target, and stops 0.05 m before the
    target. It is closed and does not turn. Args and returns as `reach`; `target` is [2] in metres.
    """
    t = physics.knots
    o = objects[pushed]
    along = (target - o) / jnp.maximum(jnp.linalg.norm(target - o), 1e-6)
    more = beyond_standard(shelf, pushed)
    ee = end_effector(pose)
    behind, stop = o - (PUSH_BEHIND + more) * along, target - (PUSH_SHORT + more) * along
    first, second = t // 2, t - t // 2
    waypoints = jnp.concatenate(
        [
            jnp.linspace(ee, behind, first + 1)[1:],
            jnp.linspace(behind, stop, second + 1)[1:],
        ]
    )
    yaws = jnp.full(t, pose[2])
    return _follow(pose, waypoints, yaws, physics), jnp.full(t, hand.GRIPPER_CLOSED)
