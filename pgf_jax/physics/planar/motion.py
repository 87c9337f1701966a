"""Motion of the hand during a knot, and the knot's substeps for the objects that take part."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics
from pgf_jax.physics.planar import contact
from pgf_jax.physics.planar.constants import Constants
from pgf_jax.physics.planar.contact import Hand, Problem
from pgf_jax.physics.planar.fusion import written_out
from pgf_jax.physics.planar.solver import solve


class Motion(NamedTuple):
    """Motion of the hand during a knot; lanes are the last axis."""

    pose: jax.Array  # [3, C] at the knot's start: x, y (m), yaw (rad)
    velocity: jax.Array  # [3, C]
    gripper: jax.Array  # [2, C] at the knot's start and end


class Objects(NamedTuple):
    """State of the objects that take part, [A, C] each: m, m/s, m/s^2."""

    x: jax.Array
    y: jax.Array
    vx: jax.Array
    vy: jax.Array
    ax: jax.Array
    ay: jax.Array


class Box(NamedTuple):
    """Bounds of each object's way during a knot, [A, C] each, m."""

    x0: jax.Array  # where it began
    y0: jax.Array
    left: jax.Array
    right: jax.Array
    low: jax.Array
    high: jax.Array

    def way(self) -> jax.Array:
        """The furthest that an object may have been from its start, [A, C] m."""
        x = jnp.maximum(self.right - self.x0, self.x0 - self.left)
        y = jnp.maximum(self.high - self.y0, self.y0 - self.low)
        return jnp.sqrt(x * x + y * y)


class Shape(NamedTuple):
    """Coefficients that give the hand's shape at any gripper value (see `fit_shape`)."""

    segments: np.ndarray  # [DEGREE + 1, 2, 2, H] coefficients of start/end, x/y in g / 127.5 - 1
    creep_knots: np.ndarray  # [8] gripper values at which the creep's slope changes
    creep_at_0: np.ndarray  # [3, bodies] (vx, vy, wz) of palm (0) and fingers at gripper 0
    creep_bends: np.ndarray  # [8, 3, bodies] how much the slope changes there


REST = 1e-4  # m/s; a slower object that is not touched stands still (MuJoCo's sleep)
DEGREE = 5  # of the polynomials: within 1e-8 m of the links' rotations


def fit_shape(physics: Physics) -> Shape:
    """Fit polynomials to `hand.capsule_segments` and ramps to `hand.creep`.

    Sines, cosines and table look-ups in each lane and substep would cost as much as the contacts.
    """
    nodes = np.cos(np.pi * (np.arange(2 * DEGREE) + 0.5) / (2 * DEGREE))
    values = np.stack([hand.capsule_segments((x + 1) * hand.GRIPPER_CLOSED / 2) for x in nodes])
    coefficients = np.polynomial.polynomial.polyfit(nodes, values.reshape(len(nodes), -1), DEGREE)
    table = physics.finger_creep * hand.CREEP[:, 1:]
    knots = hand.CREEP[:, 0]
    slopes = np.diff(table, axis=0) / np.diff(knots)[:, None]
    bends = np.concatenate([slopes[:1], np.diff(slopes, axis=0)])
    return Shape(
        coefficients.reshape(-1, hand.N_CAPSULES, 2, 2).transpose(0, 2, 3, 1),
        knots[:-1],
        np.pad(table[0].reshape(2, 3), ((1, 0), (0, 0))).T,
        np.pad(bends.reshape(-1, 2, 3), ((0, 0), (1, 0), (0, 0))).swapaxes(1, 2),
    )


class Turn(NamedTuple):
    """Cosine and sine of the hand's yaw, [C] each."""

    cos: jax.Array
    sin: jax.Array


def hand_at(
    physics: Physics, shape: Shape, motion: Motion, done, substeps, turn: Turn, one: jax.Array | int
) -> Hand:
    """The hand's capsules when `done` of the knot's `substeps` are done.

    `turn` is the hand's then; `one` is 1, see `written_out`.
    """
    before, after = motion.gripper
    gripper = before + (after - before) * (done / substeps)  # [C]
    elapsed = done * physics.substep_s
    x, y, _ = motion.pose + elapsed * motion.velocity
    scaled = gripper * (2 / hand.GRIPPER_CLOSED) - 1

    def in_hand():
        # Horner's rule; [2, 2, H, C] start/end, x/y.
        terms = jnp.asarray(shape.segments, gripper.dtype)[..., None]
        local = terms[-1] + jnp.zeros_like(scaled)
        for term in terms[-2::-1]:
            local = local * scaled + term
        ramps = jnp.maximum(gripper - jnp.asarray(shape.creep_knots, gripper.dtype)[:, None], 0.0)
        bends = jnp.asarray(shape.creep_bends, gripper.dtype)[..., None]  # [8, 3, bodies, 1]
        creep = jnp.asarray(shape.creep_at_0, gripper.dtype)[..., None]
        for ramp, bend in zip(ramps, bends, strict=True):
            creep = creep + ramp * bend
        return local, creep  # creep: [3, bodies, C]

    local, creep = written_out(one, in_hand)
    cos, sin = turn

    def turned(local_x, local_y):  # [..., C] each
        return cos * local_x - sin * local_y, sin * local_x + cos * local_y

    start, end = turned(local[0, 0], local[0, 1]), turned(local[1, 0], local[1, 1])  # [H, C]
    # The palm's motion, and on the fingers the creep of their surface: of a twist (u, w) given at
    # the hand's origin o, the velocity at a point p is u + w x (p - o).
    slip = (*turned(creep[0], creep[1]), creep[2])  # [bodies, C] each
    ux, uy, spin = (s + v for s, v in zip(slip, motion.velocity, strict=True))
    return written_out(
        one,
        lambda: Hand(
            start=(start[0] + x, start[1] + y),
            along=(end[0] - start[0], end[1] - start[1]),
            twist=(ux + spin * y, uy - spin * x, spin),
        ),
    )


def turn_at(physics: Physics, motion: Motion, done) -> Turn:
    """The hand's turn when `done` of the knot's substeps are done."""
    yaw = motion.pose[2] + done * physics.substep_s * motion.velocity[2]
    return Turn(jnp.cos(yaw), jnp.sin(yaw))


def knot(
    c: Constants,
    physics: Physics,
    shape: Shape,
    motion: Motion,
    substeps: jax.Array | int,
    objects: Objects,
    near: int,
    iterations: int,
    cg_iterations: int,
) -> tuple[Objects, Box, tuple[jax.Array, jax.Array, jax.Array]]:
    """Do a knot's substeps; the hand can touch the first `near` objects.

    Returns:
      The objects after them; where they have been; and the forces of the last substep's contacts
      (`contact.forces`).
    """
    b, dt = c.reference, c.substep_s
    one = 1 if isinstance(substeps, int) else jnp.minimum(substeps, 1)  # see `written_out`
    # Sines in each substep would cost a tenth of it.
    by = Turn(jnp.cos(dt * motion.velocity[2]), jnp.sin(dt * motion.velocity[2]))

    def problem_at(o: Objects, done: jax.Array, turn: Turn) -> Problem:
        now = hand_at(physics, shape, motion, done, substeps, turn, one)
        return contact.build(c, o.x, o.y, o.vx, o.vy, now, near, one)

    def substep(done, carry):
        o, box, turn, _ = carry
        # The last substep's acceleration is the first guess.
        guess = o.ax + b * o.vx, o.ay + b * o.vy
        problem = problem_at(o, done, turn)
        wx, wy = solve(c, problem, guess, iterations, cg_iterations, one)
        ax, ay = wx - b * o.vx, wy - b * o.vy
        vx, vy = o.vx + dt * ax, o.vy + dt * ay
        after = Objects(o.x + dt * vx, o.y + dt * vy, vx, vy, ax, ay)
        box = box._replace(
            left=jnp.minimum(box.left, after.x),
            right=jnp.maximum(box.right, after.x),
            low=jnp.minimum(box.low, after.y),
            high=jnp.maximum(box.high, after.y),
        )
        turn = Turn(turn.cos * by.cos - turn.sin * by.sin, turn.sin * by.cos + turn.cos * by.sin)
        return after, box, turn, (problem, wx, wy)

    x, y = objects.x, objects.y
    begin = (objects, Box(x, y, x, x, y, y), turn_at(physics, motion, 0))
    # The last substep's problem is kept for the forces: to build it again would take as long to
    # compile as the substep.
    last = (contact.empty(x, near), x, x)
    after, box, _, last = jax.lax.fori_loop(0, substeps, substep, (*begin, last))
    # At rest in the next knot whether it takes part there or not: so no result depends on that.
    awake = after.vx**2 + after.vy**2 > REST**2
    rest = (jnp.where(awake, v, 0.0) for v in after[2:])
    after = Objects(after.x, after.y, *rest)
    return after, box, contact.forces(c, *last)
