"""Motion of the hand during a knot, and the knot's substeps for the objects that take part."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics
from pgf_jax.physics.planar import contact
from pgf_jax.physics.planar.constants import Constants
from pgf_jax.physics.planar.contact import Hand, Problem
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


class Shape(NamedTuple):
    """Coefficients that give the hand's shape at any gripper value (see `fit_shape`)."""

    segments: np.ndarray  # [DEGREE + 1, 2, 2, H] coefficients of start/end, x/y in g / 127.5 - 1
    creep_knots: np.ndarray  # [8] gripper values at which the creep's slope changes
    creep_at_0: np.ndarray  # [3, 2] (vx, vy, wz) of both fingers at gripper 0
    creep_bends: np.ndarray  # [8, 3, 2] how much the slope changes there


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
        table[0].reshape(2, 3).T,
        bends.reshape(-1, 2, 3).swapaxes(1, 2),
    )


def hand_at(physics: Physics, shape: Shape, motion: Motion, done, substeps) -> Hand:
    """The hand's capsules when `done` of the knot's `substeps` are done."""
    before, after = motion.gripper
    gripper = before + (after - before) * (done / substeps)  # [C]
    elapsed = done * physics.substep_s
    x, y, yaw = (motion.pose[i] + elapsed * motion.velocity[i] for i in range(3))
    scaled = gripper * (2 / hand.GRIPPER_CLOSED) - 1
    # Horner's rule; [2, 2, H, C] start/end, x/y.
    terms = jnp.asarray(shape.segments, gripper.dtype)[..., None]
    local = terms[-1] + jnp.zeros_like(scaled)
    for term in terms[-2::-1]:
        local = local * scaled + term
    ramps = jnp.maximum(gripper - jnp.asarray(shape.creep_knots, gripper.dtype)[:, None], 0.0)
    bends = jnp.asarray(shape.creep_bends, gripper.dtype)[..., None]  # [8, 3, 2, 1]
    creep = jnp.asarray(shape.creep_at_0, gripper.dtype)[..., None]
    for ramp, bend in zip(ramps, bends, strict=True):
        creep = creep + ramp * bend  # [3, 2, C]
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)

    def turned(local_x, local_y):  # [..., C] each
        return cos * local_x - sin * local_y, sin * local_x + cos * local_y

    start, end = turned(local[0, 0], local[0, 1]), turned(local[1, 0], local[1, 1])  # [H, C]
    # The palm's motion, and on the fingers the creep of their surface: of a twist (u, w) given at
    # the hand's origin o, the velocity at a point p is u + w x (p - o).
    slip = (*turned(creep[0], creep[1]), creep[2])  # [2, C] each
    still = jnp.zeros_like(creep[0, :1])
    per_body = [jnp.concatenate([still, s]) + v for s, v in zip(slip, motion.velocity, strict=True)]
    count = np.bincount(hand.CAPSULE_BODY)
    ux, uy, spin = (
        jnp.concatenate([jnp.broadcast_to(v[i], (n, *v[i].shape)) for i, n in enumerate(count)])
        for v in per_body
    )
    return Hand(
        start=(start[0] + x, start[1] + y),
        along=(end[0] - start[0], end[1] - start[1]),
        twist=(ux + spin * y, uy - spin * x, spin),
    )


def knot(
    c: Constants,
    hand_after: Callable[[jax.Array], Hand],
    substeps: jax.Array,
    objects: Objects,
    iterations: int,
    cg_iterations: int,
) -> tuple[Objects, jax.Array, tuple[jax.Array, jax.Array]]:
    """Do a knot's substeps; `hand_after` gives the hand after a number of them.

    Returns:
      The objects after them; [A, C] the largest distance of each from its start, squared (m^2);
      and the forces of the last substep's contacts (`contact.forces`).
    """
    x0, y0 = objects.x, objects.y
    b, dt = c.reference, c.substep_s

    def problem_at(o: Objects, done: jax.Array) -> Problem:
        return contact.build(c, o.x, o.y, o.vx, o.vy, hand_after(done))

    def substep(done, carry):
        o, _, far = carry
        # The last substep's acceleration is the first guess.
        guess = o.ax + b * o.vx, o.ay + b * o.vy
        wx, wy = solve(c, problem_at(o, done), guess, iterations, cg_iterations)
        ax, ay = wx - b * o.vx, wy - b * o.vy
        vx, vy = o.vx + dt * ax, o.vy + dt * ay
        after = Objects(o.x + dt * vx, o.y + dt * vy, vx, vy, ax, ay)
        far = jnp.maximum(far, (after.x - x0) ** 2 + (after.y - y0) ** 2)
        return after, o, far

    begin = (objects, objects, jnp.zeros_like(x0))
    after, before, far = jax.lax.fori_loop(0, substeps, substep, begin)
    problem = problem_at(before, substeps - 1)
    w = after.ax + b * before.vx, after.ay + b * before.vy
    return after, far, contact.forces(c, problem, *w)
