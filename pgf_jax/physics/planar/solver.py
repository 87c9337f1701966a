"""Newton's method on the contact problem: conjugate gradients for the step, no line search.

The cost is convex and piecewise quadratic. Contacts are soft (impedance 0.5), so it is well
conditioned, and the last substep's acceleration is a good first guess: two or three full Newton
steps find the piece with the minimum, and a few conjugate-gradient iterations with 2x2 block-Jacobi
preconditioning are exact enough for each step. The Hessian is at least the mass, so that no step is
unbounded. Every lane does the same work. README.md of this folder lists what else was tried.
"""

import jax
import jax.numpy as jnp

from pgf_jax.physics.planar import contact
from pgf_jax.physics.planar.constants import Constants
from pgf_jax.physics.planar.contact import Pair, Problem, Slopes

_TINY = 1e-20  # keeps 0 / 0 finite in a lane that has converged


def solve(
    c: Constants, p: Problem, w: Pair, iterations: int, cg_iterations: int, one: jax.Array | int
) -> Pair:
    """Find the w ([A, C] each) that minimises the cost, from a first guess.

    `one` is 1, see `written_out`.
    """

    def newton(_, w: Pair) -> Pair:
        return _plus(w, 1.0, newton_step(contact.slopes(c, p, *w, one), cg_iterations))

    return jax.lax.fori_loop(0, iterations, newton, w)


def newton_step(s: Slopes, iterations: int) -> Pair:
    """Compute -H^-1 g by preconditioned conjugate gradients from zero."""
    kxx, kxy, kyy = s.coupling
    xx, xy, yy = s.diagonal

    def times_hessian(p: Pair) -> Pair:
        px, py = p
        # Row sums of the coupling belong to the diagonal blocks already. Sums are written out, as
        # in `contact.slopes`.
        hx, hy = xx * px + xy * py, xy * px + yy * py
        for j in range(len(px)):
            hx = hx - kxx[j] * px[j] - kxy[j] * py[j]
            hy = hy - kxy[j] * px[j] - kyy[j] * py[j]
        return hx, hy

    def precondition(r: Pair) -> Pair:
        rx, ry = r
        inverse = 1 / (xx * yy - xy * xy)
        return inverse * (yy * rx - xy * ry), inverse * (xx * ry - xy * rx)

    # XLA computes an intermediate again in every kernel that reads it, but not what enters a loop:
    # so everything that reads the derivatives is in the loop, the first direction included.
    def iterate(_, carry):
        step, residual, direction, before = carry
        z = precondition(residual)
        rz = _dot(residual, z)
        direction = _plus(z, rz / jnp.maximum(before, _TINY), direction)
        h = times_hessian(direction)
        alpha = rz / jnp.maximum(_dot(direction, h), _TINY)
        return _plus(step, alpha, direction), _plus(residual, -alpha, h), direction, rz

    zero = jnp.zeros_like(xx)
    residual = (-s.gradient[0], -s.gradient[1])
    begin = ((zero, zero), residual, (zero, zero), jnp.ones_like(xx[0]))
    return jax.lax.fori_loop(0, iterations, iterate, begin)[0]


def _dot(a: Pair, b: Pair) -> jax.Array:
    total = jnp.zeros_like(a[0][0])
    for ax, ay, bx, by in zip(*a, *b, strict=True):
        total = total + ax * bx + ay * by
    return total


def _plus(a: Pair, scale: jax.Array | float, b: Pair) -> Pair:
    return a[0] + scale * b[0], a[1] + scale * b[1]
