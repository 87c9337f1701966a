"""Cost terms of one rollout (Papallas & Dogar 2022); the planner vmaps them.

Axes: T knots, N objects, C contact slots.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pgf_jax.physics import hand
from pgf_jax.physics.engine import Array, Rollout
from pgf_jax.planning.config import Cost
from pgf_jax.scene.shelf import BACK_WALL_X, RADIUS, SIDE_WALL_Y, Shelf

SIDE_WALLS_FROM_X = 0.20  # m, where the shelf begins


class Task(NamedTuple):
    """Task of a segment: reach the goal, or push an object to a target."""

    goal: Array  # [] int32, the object to reach
    pushing: Array  # [] bool
    pushed: Array  # [] int32, q_o; any value while reaching
    target: Array  # [2] m, where q_o is pushed to


class Evaluation(NamedTuple):
    """Cost of a rollout, and whether the rollout is feasible."""

    total: Array  # []; +inf where the rollout is not finite
    terms: Array  # [5]: c_d (pushing: c_h), c_f, c_b, c_e, c_s
    distance: Array  # [] d(goal), or pushing |q_o - target|, m
    feasible: Array  # [] bool
    finite: Array  # [] bool


def rotation(yaw: jax.Array) -> jax.Array:
    """[..., 2, 2] rotation matrices of [...] angles."""
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([jnp.stack([c, -s], -1), jnp.stack([s, c], -1)], -2)


def end_effector(hand_pose: jax.Array) -> jax.Array:
    """[..., 2] position of `ee` in the world, m, for [..., 3] hand poses."""
    return hand_pose[..., :2] + rotation(hand_pose[..., 2]) @ jnp.asarray(
        hand.EE_POINT, jnp.float32
    )


def wrap(angle: jax.Array) -> jax.Array:
    """Wrap an angle into (-pi, pi]."""
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))


def reach_distance(hand_pose: jax.Array, objects: jax.Array, cost: Cost) -> jax.Array:
    """Distance d(o) = sqrt(|ee - o|^2 + (0.09 bearing)^2) of each object, m.

    Takes [..., 3] hand poses and [..., N, 2] centres; returns [..., N].
    """
    to = objects - end_effector(hand_pose)[..., None, :]
    bearing = wrap(
        jnp.arctan2(to[..., 1], to[..., 0]) - hand_pose[..., 2, None] - hand.POINTING_YAW
    )
    return jnp.sqrt((to**2).sum(-1) + (cost.bearing_m_per_rad * bearing) ** 2)


def force_cost(force: jax.Array, bodies: jax.Array, n_objects: int, cost: Cost) -> jax.Array:
    """Force term c_f of one knot from its contacts: [C] N and [C, 2] bodies.

    `source`: per movable object and contact of it (a contact of two objects counts at both);
    `paper`: every contact once, no threshold.
    """
    if cost.variant == "paper":
        return cost.w_f_paper * force.sum(-1)
    times = (bodies < n_objects).sum(-1).astype(force.dtype)
    over = jnp.where(force > cost.force_threshold, cost.w_f * force, 0.0)
    return (times * jnp.where(jnp.isfinite(force), over, cost.force_not_finite)).sum(-1)


def beyond_standard(shelf: Shelf | None, objects: Array = slice(None)) -> Array:
    """How much larger objects are than standard ones, m: lengths measured on those grow by it.

    Args:
      shelf: None: all are standard, and 0.0 is the result.
      objects: numbers of objects.
    """
    return 0.0 if shelf is None else jnp.asarray(shelf.radius)[objects] - RADIUS


def touches_shelf(
    hand_pose: jax.Array, gripper: jax.Array, shelf: Shelf | None = None
) -> jax.Array:
    """Whether any capsule of the hand overlaps a wall: [3], [] -> [] bool."""
    back_x = BACK_WALL_X if shelf is None else shelf.back_x
    side_y = SIDE_WALL_Y if shelf is None else shelf.side_y
    segments = hand.capsule_segments(gripper, jnp) @ rotation(hand_pose[2]).T
    segments += hand_pose[None, None, :2]
    a, b, radii = segments[:, 0], segments[:, 1], jnp.asarray(hand.RADII)
    back = jnp.maximum(a[:, 0], b[:, 0]) + radii > back_x

    # Only a part inside the shelf can touch its sides: clip each axis to x >= the shelf's front.
    def inside(p, q):
        outside = SIDE_WALLS_FROM_X - p[:, 0]
        along = q[:, 0] - p[:, 0]
        t = jnp.clip(outside / jnp.where(along == 0, 1.0, along), 0, 1)
        return jnp.where((outside > 0)[:, None], p + t[:, None] * (q - p), p)

    a, b = inside(a, b), inside(b, a)
    entered = jnp.maximum(a[:, 0], b[:, 0]) >= SIDE_WALLS_FROM_X
    side = jnp.maximum(jnp.abs(a[:, 1]), jnp.abs(b[:, 1])) + radii > side_y
    return (back | (entered & side)).any()


def evaluate(
    rollout: Rollout, gripper: jax.Array, task: Task, cost: Cost, shelf: Shelf | None = None
) -> Evaluation:
    """Evaluate one rollout: its cost terms, and whether it is feasible.

    Lengths of the cost are those of standard objects; an object that is larger by some millimetres
    has them longer by as much, and the walls' edges closer.

    Args:
      rollout: unbatched ([T, N, 2] objects and so on).
      gripper: [T] values at knot ends.
      task: the segment's task.
      cost: weights; static.
      shelf: unbatched; None: standard.
    """
    n = rollout.objects.shape[1]
    last, pose = rollout.objects[-1], rollout.hand[-1]
    each = jnp.arange(n)
    d = reach_distance(pose, last, cost)  # [N]
    goal_radius = cost.goal_radius + beyond_standard(shelf, task.goal)
    blocking_radius = cost.blocking_radius + beyond_standard(shelf)
    ee_to_goal = jnp.linalg.norm(end_effector(pose) - last[task.goal])

    if cost.variant == "paper":
        c_d = cost.w_d * ee_to_goal
    else:
        c_d = jnp.where(d[task.goal] < goal_radius, 1.0, cost.w_d) * d[task.goal]
    to_target = jnp.linalg.norm(last[task.pushed] - task.target)
    c_h = jnp.where(to_target < cost.target_radius, 1.0, cost.w_h) * to_target

    exempt = jnp.where(task.pushing, task.pushed, task.goal)
    c_b = jnp.where((d < blocking_radius) & (each != exempt), cost.w_b + d, 0.0).sum()
    c_f = force_cost(rollout.force, rollout.bodies, n, cost).sum()
    if cost.variant == "paper":
        c_e = c_s = jnp.zeros(())
    else:
        low, high = _edges(cost, shelf)
        beyond = (rollout.objects < low) | (rollout.objects > high)
        c_e = cost.w_edge * beyond.sum(dtype=jnp.float32)
        touching = jax.vmap(lambda pose, grip: touches_shelf(pose, grip, shelf))(
            rollout.hand, gripper
        )
        c_s = cost.w_static * touching.sum(dtype=jnp.float32)

    terms = jnp.stack([jnp.where(task.pushing, c_h, c_d), c_f, c_b, c_e, c_s]).astype(jnp.float32)
    finite = jnp.isfinite(terms).all()
    finite &= jnp.isfinite(rollout.objects).all() & jnp.isfinite(rollout.hand).all()
    total = jnp.where(finite, terms.sum(), jnp.inf)
    distance = jnp.where(task.pushing, to_target, d[task.goal])
    arrived = distance < jnp.where(task.pushing, cost.target_radius, goal_radius)
    cheap = (c_b == 0) | task.pushing if cost.variant == "paper" else total <= cost.feasible_cost
    return Evaluation(total, terms, distance, arrived & cheap & finite, finite)


def _edges(cost: Cost, shelf: Shelf | None) -> tuple[jax.Array, jax.Array]:
    """Where centres of objects may be: lowest and highest (x, y), [1, 1 or N, 2] each."""
    low, high = jnp.asarray([cost.edge_x, cost.edge_y]).T
    if shelf is None:
        return low[None, None], high[None, None]
    more = beyond_standard(shelf)
    back, side = shelf.back_x - BACK_WALL_X, shelf.side_y - SIDE_WALL_Y
    front = jnp.full_like(more, low[0])  # the table's edge: what counts there is the centre
    return (
        jnp.stack([front, low[1] - side + more], -1)[None],
        jnp.stack([high[0] + back - more, high[1] + side - more], -1)[None],
    )
