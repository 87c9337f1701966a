"""Finds the objects that can move during a knot, so that only these are computed.

An object takes part if it moves, if the hand can touch it, or if an object that takes part can be
pushed into it. The hand's sweep is bounded from a few poses along the knot. How far a pushed object
gets is a guess that is checked afterwards (`touched`): a wrong guess costs time, but never changes
a result.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pgf_jax.physics.planar.constants import Constants, reach_of
from pgf_jax.physics.planar.contact import Hand
from pgf_jax.physics.planar.motion import REST, Box

SLACK = 5e-4  # m added to every guess
ASIDE = 0.7  # share of its way that an object may get in any other direction
ROUNDS = 4  # objects in a row that one push can move


# Roles of the objects in a knot, in the order in which the contact problem has them.
NEAR, MOVING, ADDED, RESTING = range(4)


class Part(NamedTuple):
    """Which objects take part in a knot, and in which role.

    Objects are added where a guess was wrong, but never change places; and those that take part to
    fill up come last, where they add zeros to every sum. So a result does not depend on the class
    in which it was computed.
    """

    depth: jax.Array  # [N, C] how deep the hand gets at most into each where it is now, m
    role: jax.Array  # [N, C] int32
    anywhere: jax.Array  # [C] bool, the hand may touch all that take part, not only those near

    def order(self) -> jax.Array:
        """The objects in the order of the contact problem, [N, C]."""
        return jnp.argsort(self.role, axis=0, stable=True)

    def counts(self) -> tuple[jax.Array, jax.Array]:
        """How many objects take part, and how many of them the hand may touch, [C] each."""
        taking = (self.role != RESTING).sum(0)
        return taking, jnp.where(self.anywhere, taking, (self.role == NEAR).sum(0))

    def with_added(self, touched: jax.Array, anywhere: jax.Array) -> "Part":
        """The part with the objects that were touched ([N, C] bool)."""
        role = jnp.where(touched & (self.role == RESTING), ADDED, self.role)
        return self._replace(role=role, anywhere=self.anywhere | anywhere)


def guess(
    c: Constants, x: jax.Array, y: jax.Array, vx: jax.Array, vy: jax.Array, sweep: Hand
) -> Part:
    """Guess which objects take part in a knot.

    Args:
      c: constants.
      x, y: [N, C] centres, m.
      vx, vy: [N, C] m/s.
      sweep: [P, H, C] the hand at P times of the knot, first and last included.
    """
    hand = _hand_depth(c, x, y, sweep)
    far = _travel(c, x, y, vx, vy, hand)
    resting = far <= 0  # not where it is not a number
    role = jnp.where(hand[0] + far <= 0, MOVING, NEAR)
    return Part(hand[0], jnp.where(resting, RESTING, role), jnp.zeros(x.shape[1], bool))


def _travel(
    c: Constants,
    x: jax.Array,
    y: jax.Array,
    vx: jax.Array,
    vy: jax.Array,
    hand: tuple[jax.Array, jax.Array, jax.Array],
) -> jax.Array:
    """Guess how far each object gets: [N, C] m; 0 where it cannot move."""
    depth, nx, ny = hand
    speed = jnp.sqrt(vx * vx + vy * vy)
    coasting = jnp.where(speed > REST, speed**2 / (2 * c.deceleration) + SLACK, 0.0)
    pushed = jnp.where(depth > 0, depth + SLACK, 0.0)
    # The direction: out of the hand, or on as before.
    ahead = 1 / jnp.maximum(speed, REST)
    mx = jnp.where(pushed > coasting, pushed * nx, coasting * vx * ahead)
    my = jnp.where(pushed > coasting, pushed * ny, coasting * vy * ahead)
    far = jnp.maximum(coasting, pushed)
    dx, dy = x[None] - x[:, None], y[None] - y[:, None]  # [from, to, C]
    other, touching = ~jnp.eye(len(x), dtype=bool)[..., None], reach_of(c.radius, c.radius)
    for _ in range(ROUNDS):
        # How deep the way of one object ends in another, which is then pushed as far along the
        # line of centres.
        square = jnp.maximum(far * far, 1e-12)[:, None]
        t = jnp.clip((dx * mx[:, None] + dy * my[:, None]) / square, 0.0, 1.0)
        rx, ry = dx - t * mx[:, None], dy - t * my[:, None]
        distance = jnp.sqrt(rx * rx + ry * ry)
        nearest = jnp.minimum(distance, jnp.sqrt(dx * dx + dy * dy) - ASIDE * far[:, None])
        into = jnp.where(other & (far > 0)[:, None], touching + SLACK - nearest, -1.0)
        most = into.max(0)
        first = jnp.argmax(into, 0)[None]
        scale = most / jnp.maximum(jnp.take_along_axis(distance, first, 0)[0], 1e-6)
        further = most > far
        mx = jnp.where(further, scale * jnp.take_along_axis(rx, first, 0)[0], mx)
        my = jnp.where(further, scale * jnp.take_along_axis(ry, first, 0)[0], my)
        far = jnp.where(further, most, far)
    return far


def touched(
    moving: Constants, resting: Constants, box: Box, rest_x: jax.Array, rest_y: jax.Array
) -> jax.Array:
    """Which of the resting objects ([rest, C] m) those on their ways [A, C] may have touched."""
    gap_x = jnp.maximum(box.left[:, None] - rest_x, rest_x - box.right[:, None])
    gap_y = jnp.maximum(box.low[:, None] - rest_y, rest_y - box.high[:, None])
    gap_x, gap_y = jnp.maximum(gap_x, 0.0), jnp.maximum(gap_y, 0.0)
    near = reach_of(moving.radius, resting.radius)
    return ~(gap_x * gap_x + gap_y * gap_y >= near**2).all(0)


def _hand_depth(
    c: Constants, x: jax.Array, y: jax.Array, sweep: Hand
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Bound how deep the hand's sweep gets into each object, and find the direction out of it.

    Returns [N, C] each: depth in m (<= 0: the hand cannot touch it), and the direction's x and y.
    """
    radii = jnp.asarray(c.capsule_radii, x.dtype)[:, None, None]
    ends = (sweep.start, (sweep.start[0] + sweep.along[0], sweep.start[1] + sweep.along[1]))
    # No point of an axis is further from where it is at one of the poses than half the longest way
    # of an end between two of them; 5 % and 0.2 mm more for the arcs between.
    ways = [
        jnp.sqrt(jnp.diff(ex, axis=0) ** 2 + jnp.diff(ey, axis=0) ** 2).max(0) for ex, ey in ends
    ]
    margin = 0.525 * jnp.maximum(*ways)[:, None] + 2e-4  # [H, 1, C]

    def deeper(k: int, deepest):
        hand = jax.tree.map(lambda a: a[k // len(radii), k % len(radii)], sweep)
        h = k % len(radii)
        ex, ey = hand.along
        rx, ry = x - hand.start[0], y - hand.start[1]
        t = jnp.clip((rx * ex + ry * ey) / (ex * ex + ey * ey), 0.0, 1.0)
        rx, ry = rx - t * ex, ry - t * ey
        distance = jnp.sqrt(rx * rx + ry * ry)
        depth = c.radius + radii[h] + margin[h] - distance
        more = depth > deepest[0]
        inverse = 1 / jnp.maximum(distance, 1e-6)
        new = (depth, rx * inverse, ry * inverse)
        return tuple(jnp.where(more, a, b) for a, b in zip(new, deepest, strict=True))

    zero = jnp.zeros_like(x)
    count = sweep.start[0].shape[0] * len(radii)
    return jax.lax.fori_loop(0, count, deeper, (zero - 1, zero, zero))
