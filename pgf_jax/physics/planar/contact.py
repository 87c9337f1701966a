"""The contact problem of one substep (`Problem`): rows, gradient, Hessian and forces.

Lanes are the last axis of every array, so that every loop runs over them. Axes: A objects that take
part, the first H of them within the hand's reach; G capsules of the hand; T pairs of objects, each
once; C lanes.

MuJoCo's unknown is the acceleration a. With one softness for all contacts its reference
acceleration is -b v - k imp gap, so in w = a + b v each row is linear with a constant part:
along the normal P = n.w + k imp gap - b n.v_ground, along the tangent Q = mu (t.w - b t.v_ground).
The edges of the pyramid are P (twice), P + Q and P - Q; an edge of value x costs D/2 min(0, x)^2.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.physics import hand as hand_shape
from pgf_jax.physics.planar.constants import Constants, head
from pgf_jax.physics.planar.fusion import rows, written_out

# P of a row that is not in contact: positive, so that it costs nothing.
APART = 1e6

Pair = tuple[jax.Array, jax.Array]


class Hand(NamedTuple):
    """Capsules of the hand during one substep, in the world's frame."""

    start: Pair  # [G, C] one end of each capsule's axis, m
    along: Pair  # [G, C] from there to the other end
    twist: tuple[jax.Array, jax.Array, jax.Array]  # [bodies, C] surface velocity at origin, spin


class Problem(NamedTuple):
    """The contact problem of one substep: its rows."""

    free: Pair  # [A, C] w without any constraint, m/s^2
    friction: Pair  # [A, C] what joint friction adds to w
    hand: tuple[jax.Array, ...]  # [G, H, C] unit normals towards the object x, y; parts of P and Q
    slots: jax.Array  # [] how many of the G are in use in this chunk
    back_p: jax.Array  # [A, C] of the back wall, whose normal is -x
    side_p: jax.Array  # [A, C] of the side wall that is nearer
    side: jax.Array  # [A, C] 1 or -1: its normal is -side y
    pair_n: Pair  # [T, C] unit normals from the second to the first
    pair_p: jax.Array  # [T, C]


def build(
    c: Constants,
    x: jax.Array,
    y: jax.Array,
    vx: jax.Array,
    vy: jax.Array,
    hand: Hand,
    near: int,
    one: jax.Array | int,
) -> Problem:
    """Build the rows for objects [A, C] at (x, y) m, moving with (vx, vy) m/s.

    The hand can touch the first `near` of them.
    """
    b = c.reference
    # The hand: a disk against each capsule's axis.
    hx, hy = x[None, :near], y[None, :near]
    ex, ey = hand.along[0][:, None], hand.along[1][:, None]
    rx, ry = hx - hand.start[0][:, None], hy - hand.start[1][:, None]
    shorten = jnp.asarray(1 / c.capsule_lengths**2, x.dtype)[:, None, None]
    t = jnp.clip((rx * ex + ry * ey) * shorten, 0.0, 1.0)
    nx, ny, distance = written_out(one, lambda: _unit(rx - t * ex, ry - t * ey))
    gap = distance - _hand_reach(c, near, x.dtype)
    # The contact point lies half the gap inside.
    reach = head(c.radius, near) + 0.5 * gap
    px, py = hx - nx * reach, hy - ny * reach
    vx0, vy0, spin = (rows(v, hand_shape.CAPSULE_BODY)[:, None] for v in hand.twist)
    ux, uy = vx0 - spin * py, vy0 + spin * px
    hand_p = c.stiffness * gap - b * (nx * ux + ny * uy)
    hand_q = -b * head(c.hand_friction, near) * (nx * uy - ny * ux)
    in_slots, slots = _slots(gap < 0, (nx, ny, hand_p, hand_q), one)
    # Pairs of objects.
    first, second = pairs(len(x))
    dx, dy = rows(x, first) - rows(x, second), rows(y, first) - rows(y, second)
    pair_nx, pair_ny, apart = written_out(one, lambda: _unit(dx, dy))
    # The walls do not move.
    back, side = c.back_x - x - c.radius, c.side_y - jnp.abs(y) - c.radius
    extra = c.friction_reference - b
    keep = b - c.damping / c.mass
    return Problem(
        free=(keep * vx, keep * vy),
        friction=(extra * vx, extra * vy),
        hand=in_slots,
        slots=slots,
        back_p=jnp.where(back < 0, c.stiffness * back, APART),
        side_p=jnp.where(side < 0, c.stiffness * side, APART),
        side=jnp.where(y > 0, 1.0, -1.0),
        pair_n=(pair_nx, pair_ny),
        pair_p=jnp.where(apart < c.pair_reach, c.stiffness * (apart - c.pair_reach), APART),
    )


def _hand_reach(c: Constants, near: int, dtype: jnp.dtype) -> jax.Array:
    """Distance from a capsule's axis at which an object touches it, [G, 1 or H, 1 or C] m."""
    if isinstance(c.radius, float):
        return jnp.asarray(c.radius + c.capsule_radii, dtype)[:, None, None]
    return jnp.asarray(c.capsule_radii, dtype)[:, None, None] + c.radius[:near]


def empty(x: jax.Array, near: int) -> Problem:
    """A problem of zeros, in the shapes of one of objects at x [A, C]."""
    (a, c), zero = x.shape, jnp.zeros_like(x)
    row = jnp.zeros((hand_shape.N_CAPSULES, near, c), x.dtype)
    pair = jnp.zeros((a * (a - 1) // 2, c), x.dtype)
    two = (zero, zero)
    return Problem(two, two, (row,) * 4, jnp.int32(0), zero, zero, zero, (pair, pair), pair)


class Slopes(NamedTuple):
    """Gradient [A, C], and 2x2 blocks of the Hessian."""

    gradient: Pair
    diagonal: tuple[jax.Array, jax.Array, jax.Array]  # xx, xy, yy; [A, C]
    coupling: tuple[jax.Array, jax.Array, jax.Array]  # [A, A, C] minus the blocks off the diagonal


def slopes(c: Constants, p: Problem, wx: jax.Array, wy: jax.Array, one: jax.Array | int) -> Slopes:
    """First and second derivatives of the cost at w; `one` is 1, see `written_out`."""
    P, Q = _pair_values(c, p, wx, wy)
    edges = _edges(P, Q, c.pair_friction, c.pair_weight)
    of_pairs = written_out(one, lambda: _turned(*p.pair_n, *edges))
    of_hand = _of_hand(c, p, wx, wy)

    def of_objects():
        # Joint friction and inertia.
        limit, D = c.friction_loss, c.friction_weight
        fx, fy = D * (wx + p.friction[0]), D * (wy + p.friction[1])
        gx = c.mass * (wx - p.free[0]) + jnp.clip(fx, -limit, limit)
        gy = c.mass * (wy - p.free[1]) + jnp.clip(fy, -limit, limit)
        xx = c.mass + jnp.where(jnp.abs(fx) < limit, D, 0.0)
        yy = c.mass + jnp.where(jnp.abs(fy) < limit, D, 0.0)
        total = (gx, gy, xx, jnp.zeros_like(xx), yy)
        total = _add(total, _of_walls(c, p, wx, wy))
        # An object's pairs one after another, so that the sum stays in registers; the gradient's
        # sign is that of the first.
        for pair, sign in zip(*_pairs_of(len(wx)), strict=True):
            gx, gy, *h = (rows(v, pair) for v in of_pairs)
            turn = jnp.asarray(sign[:, None], gx.dtype)
            total = _add(total, (turn * gx, turn * gy, *h))
        rest = ((0, len(wx) - len(of_hand[0])), (0, 0))
        return _add(total, tuple(jnp.pad(v, rest) for v in of_hand))

    gx, gy, xx, xy, yy = written_out(one, of_objects)
    table = _table(len(wx))
    two = jnp.asarray(1 - np.eye(len(wx))[..., None], wx.dtype)  # nothing couples one with itself
    kxx, kxy, kyy = (rows(v, table) * two for v in of_pairs[2:])
    return Slopes((gx, gy), (xx, xy, yy), (kxx, kxy, kyy))


def forces(
    c: Constants, p: Problem, wx: jax.Array, wy: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Magnitude of each contact's force, N: hand [G, H, C], walls [2, A, C] and pairs [T, C]."""
    nx, ny, hand_p, hand_q = p.hand
    near = nx.shape[1]
    mu, weight = head(c.hand_friction, near), head(c.hand_weight, near)
    hx, hy = wx[:near], wy[:near]
    by_hand = _force(nx * hx + ny * hy + hand_p, mu * (nx * hy - ny * hx) + hand_q, mu)
    (mu_back, mu_side), (back, side) = c.wall_friction, c.wall_weight
    by_walls = (
        back * _force(p.back_p - wx, mu_back * wy, mu_back),
        side * _force(p.side_p - p.side * wy, mu_side * wx, mu_side),
    )
    by_pairs = _force(*_pair_values(c, p, wx, wy), c.pair_friction)
    return weight * by_hand, jnp.stack(by_walls), c.pair_weight * by_pairs


def _slots(
    on: jax.Array, values: tuple[jax.Array, ...], one: jax.Array | int
) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Move the rows of each object that count to the front: few of the capsules touch it.

    Args:
      on: [G, H, C] whether a row counts.
      values: [G, H, C] of the rows: normal x, y, P and Q.
      one: 1.

    Returns:
      [G, H, C] values of the rows that count, then rows that are apart; and how many rows have to
      be looked at in this chunk.
    """
    count = jnp.zeros_like(values[0][0])
    places = []
    for row in on:
        count = count + jnp.where(row, 1.0, 0.0)
        places.append(jnp.where(row, count, 0.0))  # 1.. in the order of the capsules
    place = jnp.stack(places)
    place, values = written_out(one, lambda: (place, values))
    slots = count.max().astype(jnp.int32)
    apart = (0.0, 0.0, APART, 0.0)

    def slot(k, filled):
        here = []
        for value, empty, old in zip(values, apart, filled, strict=True):
            total = jnp.where(count > k, 0.0, empty)
            for g in range(len(value)):
                total = total + jnp.where(place[g] == k + 1, value[g], 0.0)
            here.append(old.at[k].set(total))
        return tuple(here)

    empty = tuple(jnp.full_like(v, e) for v, e in zip(values, apart, strict=True))
    return jax.lax.fori_loop(0, slots, slot, empty), slots


def pairs(objects: int) -> tuple[np.ndarray, np.ndarray]:
    """The first and the second object of each pair, [T] each."""
    first, second = np.triu_indices(objects, 1)
    return first, second


def _table(objects: int) -> np.ndarray:
    """The pair of any two objects, [A, A]; the diagonal is no pair."""
    table = np.zeros((objects, objects), int)
    first, second = pairs(objects)
    table[first, second] = table[second, first] = np.arange(len(first))
    return table


def _pairs_of(objects: int) -> tuple[np.ndarray, np.ndarray]:
    """The pairs that each object is in, [A - 1, A], and 1 where it is their first, else -1."""
    index = _table(objects)[~np.eye(objects, dtype=bool)].reshape(objects, objects - 1)
    first, _ = pairs(objects)
    return index.T, np.where(first[index] == np.arange(objects)[:, None], 1.0, -1.0).T


def _pair_values(c: Constants, p: Problem, wx: jax.Array, wy: jax.Array) -> Pair:
    """P and Q of the pairs, [T, C] each."""
    first, second = pairs(len(wx))
    ex, ey = rows(wx, first) - rows(wx, second), rows(wy, first) - rows(wy, second)
    nx, ny = p.pair_n
    return nx * ex + ny * ey + p.pair_p, c.pair_friction * (nx * ey - ny * ex)


def _of_hand(c: Constants, p: Problem, wx: jax.Array, wy: jax.Array) -> tuple:
    """Derivatives of the hand's contacts: gradient x, y, Hessian xx, xy, yy, [H, C] each."""
    near = p.hand[0].shape[1]
    mu, D = head(c.hand_friction, near), head(c.hand_weight, near)
    wx, wy = wx[:near], wy[:near]

    def slot(k, total):
        nx, ny, hand_p, hand_q = (v[k] for v in p.hand)
        P, Q = nx * wx + ny * wy + hand_p, mu * (nx * wy - ny * wx) + hand_q
        return _add(total, _turned(nx, ny, *_edges(P, Q, mu, D)))

    zero = jnp.zeros_like(wx)
    return jax.lax.fori_loop(0, p.slots, slot, (zero,) * 5)


def _of_walls(c: Constants, p: Problem, wx: jax.Array, wy: jax.Array) -> tuple:
    """Derivatives of the walls' contacts, whose normals are along the axes."""
    (mu_back, mu_side), (back, side) = c.wall_friction, c.wall_weight
    fn, ft, nn, nt, tt = _edges(p.back_p - wx, mu_back * wy, mu_back, back)
    # Towards -x, with the tangent y.
    total = (-fn, ft, nn, -nt, tt)
    fn, ft, nn, nt, tt = _edges(p.side_p - p.side * wy, mu_side * wx, mu_side, side)
    return _add(total, (ft, -p.side * fn, tt, -p.side * nt, nn))


def _edges(P: jax.Array, Q: jax.Array, mu: float, D: float):
    """Derivatives of a contact's cost along normal and tangent: f_n, f_t, h_nn, h_nt, h_tt.

    An edge counts where it is negative, the middle one twice.
    """
    plus, minus = P + Q, P - Q
    f_plus, f_minus = jnp.minimum(plus, 0), jnp.minimum(minus, 0)
    fn = D * (2 * jnp.minimum(P, 0) + f_plus + f_minus)
    ft = D * mu * (f_plus - f_minus)
    on_plus, on_minus = jnp.where(plus < 0, D, 0.0), jnp.where(minus < 0, D, 0.0)
    nn = jnp.where(P < 0, 2 * D, 0.0) + on_plus + on_minus
    return fn, ft, nn, mu * (on_plus - on_minus), mu * mu * (on_plus + on_minus)


def _turned(nx: jax.Array, ny: jax.Array, fn, ft, nn, nt, tt) -> tuple:
    """Turn derivatives along the unit normal and the tangent (-ny, nx) to x and y."""
    a, b = (nn - tt) * nx, nt * nx
    xx = a * nx - 2 * b * ny + tt
    return fn * nx - ft * ny, fn * ny + ft * nx, xx, a * ny + b * nx - nt * ny * ny, nn + tt - xx


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
