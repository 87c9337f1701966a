"""The contact problem of one substep (`Problem`): rows, gradient, Hessian and forces.

Lanes are the last axis of every array, so that every loop runs over them. Axes: A objects that take
part, G ground rows of each (the hand's capsules and the walls: bodies whose motion is given), C
lanes.

MuJoCo's unknown is the acceleration a. With one softness for all contacts its reference
acceleration is -b v - k imp gap, so in w = a + b v each row is linear with a constant part:
along the normal P = n.w + k imp gap - b n.v_ground, along the tangent Q = mu (t.w - b t.v_ground).
The edges of the pyramid are P (twice), P + Q and P - Q; an edge of value x costs D/2 min(0, x)^2.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pgf_jax.physics.planar.constants import Constants

# P of a row that is not in contact: positive, so that it costs nothing.
APART = 1e6


class Hand(NamedTuple):
    """Capsules of the hand during one substep, in the world's frame."""

    start: tuple[jax.Array, jax.Array]  # [H, C] one end of each capsule's axis, m
    along: tuple[jax.Array, jax.Array]  # [H, C] from there to the other end
    twist: tuple[jax.Array, jax.Array, jax.Array]  # [H, C] surface velocity at the origin, spin


class Problem(NamedTuple):
    """The contact problem of one substep: its rows."""

    free: tuple[jax.Array, jax.Array]  # [A, C] w without any constraint, m/s^2
    friction: tuple[jax.Array, jax.Array]  # [A, C] what joint friction adds to w
    ground_n: tuple[jax.Array, jax.Array]  # [G, A, C] unit normals towards the object
    ground_p: jax.Array  # [G, A, C] constant part of P
    ground_q: jax.Array  # [G, A, C] and of Q
    pair_n: tuple[jax.Array, jax.Array]  # [A, A, C] unit normals from the second to the first
    pair_p: jax.Array  # [A, A, C]


def build(
    c: Constants,
    x: jax.Array,
    y: jax.Array,
    vx: jax.Array,
    vy: jax.Array,
    hand: Hand,
) -> Problem:
    """Build the rows for objects [A, C] at (x, y) m, moving with (vx, vy) m/s."""
    b = c.reference
    # The hand: a disk against each capsule's axis.
    ax, ay = hand.start[0][:, None], hand.start[1][:, None]
    ex, ey = hand.along[0][:, None], hand.along[1][:, None]
    rx, ry = x[None] - ax, y[None] - ay
    t = jnp.clip((rx * ex + ry * ey) / (ex * ex + ey * ey), 0.0, 1.0)
    nx, ny, distance = _unit(rx - t * ex, ry - t * ey)
    capsule = jnp.asarray(c.capsule_radii, x.dtype)[:, None, None]
    gap = distance - (c.radius + capsule)
    # The contact point lies half the gap inside.
    reach = c.radius + 0.5 * gap
    px, py = x[None] - nx * reach, y[None] - ny * reach
    ux = hand.twist[0][:, None] - hand.twist[2][:, None] * py
    uy = hand.twist[1][:, None] + hand.twist[2][:, None] * px
    # The walls do not move.
    side = jnp.where(y > 0, 1.0, -1.0)
    zero = jnp.zeros_like(x)
    wall_nx, wall_ny = jnp.stack([zero - 1, zero]), jnp.stack([zero, -side])
    wall_gap = jnp.stack([c.back_x - x, c.side_y - jnp.abs(y)]) - c.radius
    mu = jnp.asarray(c.ground_friction, x.dtype)[: len(c.capsule_radii), None, None]
    hand_p = jnp.where(gap < 0, c.stiffness * gap - b * (nx * ux + ny * uy), APART)
    hand_q = -b * mu * (nx * uy - ny * ux)
    wall_p = jnp.where(wall_gap < 0, c.stiffness * wall_gap, APART)
    # Pairs of objects; the diagonal is no pair.
    dx, dy = x[:, None] - x[None], y[:, None] - y[None]
    pair_nx, pair_ny, distance = _unit(dx, dy)
    gap = distance - 2 * c.radius
    no_pair = jnp.eye(len(x), dtype=bool)[..., None]
    pair_p = jnp.where((gap < 0) & ~no_pair, c.stiffness * gap, APART)

    extra = c.friction_reference - b
    keep = b - c.damping / c.mass
    return Problem(
        free=(keep * vx, keep * vy),
        friction=(extra * vx, extra * vy),
        ground_n=(jnp.concatenate([nx, wall_nx]), jnp.concatenate([ny, wall_ny])),
        ground_p=jnp.concatenate([hand_p, wall_p]),
        ground_q=jnp.concatenate([hand_q, jnp.zeros_like(wall_p)]),
        pair_n=(pair_nx, pair_ny),
        pair_p=pair_p,
    )


class Slopes(NamedTuple):
    """Gradient [A, C], and 2x2 blocks of the Hessian (diagonal [A, C], coupling [A, A, C])."""

    gradient: tuple[jax.Array, jax.Array]
    diagonal: tuple[jax.Array, jax.Array, jax.Array]  # xx, xy, yy
    coupling: tuple[jax.Array, jax.Array, jax.Array]


def slopes(c: Constants, p: Problem, wx: jax.Array, wy: jax.Array) -> Slopes:
    """First and second derivatives of the cost at w."""
    # Joint friction and inertia.
    limit, D = c.friction_loss, c.friction_weight
    fx, fy = D * (wx + p.friction[0]), D * (wy + p.friction[1])
    gx = c.mass * (wx - p.free[0]) + jnp.clip(fx, -limit, limit)
    gy = c.mass * (wy - p.free[1]) + jnp.clip(fy, -limit, limit)
    xx = c.mass + jnp.where(jnp.abs(fx) < limit, D, 0.0)
    yy = c.mass + jnp.where(jnp.abs(fy) < limit, D, 0.0)
    total = (gx, gy, xx, jnp.zeros_like(xx), yy)
    # The rows of an object are added one after another, so that their sums stay in registers.
    # Reductions over [G, A, C] would compute all rows again for each of the five sums, or write
    # them out first where XLA hands the reduction to a library.
    for g, (mu, D) in enumerate(zip(c.ground_friction, c.ground_weight, strict=True)):
        row = _Row(p.ground_n[0][g], p.ground_n[1][g], p.ground_p[g], p.ground_q[g])
        total = _add(total, _derivatives(row, wx, wy, float(mu), float(D)))
    row = _Row(*p.pair_n, p.pair_p, 0.0)
    ex, ey = wx[:, None] - wx[None], wy[:, None] - wy[None]
    pairs = _derivatives(row, ex, ey, c.pair_friction, c.pair_weight)
    for j in range(len(wx)):
        total = _add(total, tuple(v[:, j] for v in pairs))
    gx, gy, xx, xy, yy = total
    return Slopes((gx, gy), (xx, xy, yy), pairs[2:])


def forces(c: Constants, p: Problem, wx: jax.Array, wy: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Magnitude of each contact's force, N: ground [G, A, C] and pairs [A, A, C] (each twice)."""
    weight, mu = (
        jnp.asarray(v, wx.dtype)[:, None, None] for v in (c.ground_weight, c.ground_friction)
    )
    nx, ny = p.ground_n
    ground = _force(nx * wx + ny * wy + p.ground_p, mu * (nx * wy - ny * wx) + p.ground_q, mu)
    ex, ey = wx[:, None] - wx[None], wy[:, None] - wy[None]
    nx, ny = p.pair_n
    mu = c.pair_friction
    return weight * ground, c.pair_weight * _force(
        nx * ex + ny * ey + p.pair_p, mu * (nx * ey - ny * ex), mu
    )


class _Row(NamedTuple):
    nx: jax.Array
    ny: jax.Array
    p: jax.Array
    q: jax.Array | float


def _derivatives(row: _Row, wx: jax.Array, wy: jax.Array, mu: float, D: float):
    """Derivatives of a contact's cost by (wx, wy): gradient x, y, Hessian xx, xy, yy."""
    nx, ny = row.nx, row.ny
    P, Q = nx * wx + ny * wy + row.p, mu * (nx * wy - ny * wx) + row.q
    plus, minus = P + Q, P - Q
    # Along the normal and the tangent; an edge counts where it is negative, the middle one twice.
    f_plus, f_minus = jnp.minimum(plus, 0), jnp.minimum(minus, 0)
    fn = D * (2 * jnp.minimum(P, 0) + f_plus + f_minus)
    ft = D * mu * (f_plus - f_minus)
    on_plus, on_minus = jnp.where(plus < 0, D, 0.0), jnp.where(minus < 0, D, 0.0)
    hnn = jnp.where(P < 0, 2 * D, 0.0) + on_plus + on_minus
    hnt = mu * (on_plus - on_minus)
    htt = mu * mu * (on_plus + on_minus)
    # Turned to x and y, t = (-ny, nx); the normal is a unit vector.
    a, b = (hnn - htt) * nx, hnt * nx
    xx = a * nx - 2 * b * ny + htt
    return fn * nx - ft * ny, fn * ny + ft * nx, xx, a * ny + b * nx - hnt * ny * ny, hnn + htt - xx


def _force(P: jax.Array, Q: jax.Array, mu) -> jax.Array:
    plus, minus = jnp.minimum(P + Q, 0), jnp.minimum(P - Q, 0)
    normal, tangential = 2 * jnp.minimum(P, 0) + plus + minus, mu * (plus - minus)
    return jnp.sqrt(normal**2 + tangential**2)


def _add(a: tuple, b: tuple) -> tuple:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _unit(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    square = jnp.maximum(x * x + y * y, 1e-12)
    inverse = jax.lax.rsqrt(square)
    return x * inverse, y * inverse, square * inverse
