"""Engine `planar`: one jitted program that computes only the objects that can move.

A lane is one rollout, and its unit of work is a knot. Before a knot the lane gets a class: the
smallest one with room for all objects that can move in the knot, and for those near the hand
(`reach`). Then as many lanes as fill a chunk, of that class or smaller ones and each at its own
knot, go through their knots together. Afterwards the engine checks that nothing else was touched; a
lane that fails this check does the knot again, with what was touched. So a lane's result depends on
its own state alone, to the last bit, and is that of the full problem.
"""

import functools
import threading
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.physics import flops
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World, contact_slots
from pgf_jax.physics.planar import constants, contact, motion, reach
from pgf_jax.physics.planar.constants import Constants, of_shelf, taken
from pgf_jax.physics.planar.contact import Hand
from pgf_jax.physics.planar.motion import Motion, Objects
from pgf_jax.physics.planar.reach import Part
from pgf_jax.scene.shelf import Shelf

# Classes: A objects that can move, H of them within the hand's reach, as far as A < N; then all N.
# No result depends on them: a small call, which fills no chunk, has fewer programs to compile.
SIZES = ((4, 4), (8, 6), (12, 8), (16, 10), (22, 12), (30, 14))
FEW_SIZES = ((8, 6),)
FEW_LANES = 2  # robots
CHUNK = 16  # lanes that go through a knot together
# Rows of the hand that a substep looks at (`contact._slots`), for counting operations: the mean of
# the calls that `profile` makes with 32 robots.
SLOTS = 3.6
SWEEP = 5  # poses along a knot, which bound the hand's sweep


class _State(NamedTuple):
    """State of all lanes of a call, [..., B], and their results so far."""

    objects: Objects  # [N, B] each
    pose: jax.Array  # [3, B]
    knot: jax.Array  # [B] number of the next knot
    part: Part  # [..., B] the objects that take part in it
    size: jax.Array  # [B] class: 0 nothing moves, k the k-th size; -1: done, or not wanted
    out: tuple[jax.Array, ...]  # Rollout's arrays but for the velocities
    work: jax.Array  # lanes that were used; and those of the chunks computed, of each class


class PlanarEngine:
    """MuJoCo's contact problem for disks on a plane, float32."""

    name = "planar"

    def __init__(
        self,
        physics: Physics,
        n_objects: int,
        *,
        lanes: int = 1,
        iterations: int = 3,
        cg_iterations: int = 4,
        chunk: int = CHUNK,
        sizes: tuple[tuple[int, int], ...] | None = None,
    ) -> None:
        self.physics, self.n_objects, self.lanes = physics, n_objects, lanes
        self.iterations, self.cg_iterations = iterations, cg_iterations
        self._slots = contact_slots(n_objects)
        self._constants = constants.read(physics, n_objects)
        self._shape = motion.fit_shape(physics)
        self._used, self._computed, self._counting = 0, 0, threading.Lock()
        self._chunk = chunk
        if sizes is None:
            sizes = SIZES if lanes > FEW_LANES else FEW_SIZES
        self._sizes = (*(s for s in sizes if s[0] < n_objects), (n_objects, n_objects))
        self._substeps = np.zeros(len(self._sizes), np.int64)  # computed in each class
        # XLA's default, 256 bits, halves the speed where there are wider registers; a processor
        # without them ignores the option.
        options = {"xla_cpu_prefer_vector_width": 512} if jax.default_backend() == "cpu" else None
        self._jitted = jax.jit(self._rollout, compiler_options=options)

    def rollout(
        self,
        start: World,
        controls,
        gripper,
        substeps: int,
        wanted=None,
        shelf: Shelf | None = None,
    ) -> Rollout:
        """See `Engine.rollout`; rollouts that are not wanted cost nothing and are zeros.

        There is one program for standard shelves, and one for all others.
        """
        wanted = np.ones(len(controls), bool) if wanted is None else np.asarray(wanted, bool)
        start = World(*(jnp.asarray(a, jnp.float32) for a in start))
        controls, gripper = jnp.asarray(controls, jnp.float32), jnp.asarray(gripper, jnp.float32)
        # Lanes last.
        if shelf is not None:
            shelf = Shelf(*(jnp.asarray(a, jnp.float32).T for a in shelf))
        rollout, work = self._jitted(start, controls, gripper, np.int32(substeps), wanted, shelf)
        used, *computed = np.asarray(work).tolist()  # of each class
        with self._counting:  # several threads may call this
            self._used += used
            self._computed += sum(computed)
            self._substeps += substeps * np.array(computed)
        return rollout

    def occupancy(self) -> tuple[int, int]:
        """Lanes of work since the last call of `occupancy`: (used, computed).

        Computed but not used are empty lanes of a chunk, and knots that had to be done again.
        """
        work, self._used, self._computed = (self._used, self._computed), 0, 0
        return work

    def flops(self) -> float:
        """Floating-point operations since the last call of `flops`, see `physics.flops`."""
        done, self._substeps = self._substeps, np.zeros_like(self._substeps)
        return float(done @ self._substep_flops)

    @functools.cached_property
    def _substep_flops(self) -> np.ndarray:
        """Operations of a lane's substep in each class; the rest of a knot is left out."""

        def zeros(*shape: int) -> jax.Array:
            return jnp.zeros(shape)

        def substep(a: int, h: int) -> float:
            part, now = Objects(*[zeros(a, 1)] * 6), Motion(zeros(3, 1), zeros(3, 1), zeros(2, 1))
            known = self._constants, self.physics, self._shape
            many = h, self.iterations, self.cg_iterations
            return flops.count(lambda: motion.knot(*known, now, 1, part, *many), rounds=SLOTS)

        return np.array([substep(a, h) for a, h in self._sizes])

    def _rollout(
        self,
        start: World,
        controls,
        gripper,
        substeps: jax.Array,
        wanted: jax.Array,
        shelf: Shelf | None,
    ):
        b, t = controls.shape[:2]
        n = self.n_objects
        chunk = min(self._chunk, -(-b // 8) * 8)
        grippers = jnp.concatenate([start.gripper[None], gripper.T])  # [T + 1, B]
        velocities = jnp.moveaxis(controls, 0, -1)  # [T, 3, B]

        def motion_in(knot, lane, pose) -> Motion:
            """Motion of the hand in lanes [C], each at its own knot; none before the first."""
            before = knot < 0
            knot = jnp.clip(knot, 0, t - 1)
            velocity = jnp.where(before, 0.0, velocities[knot, :, lane].T)
            return Motion(
                pose, velocity, jnp.stack([grippers[knot, lane], grippers[knot + 1, lane]])
            )

        def shelf_in(lane) -> Shelf | None:
            """The shelves in lanes [C]."""
            return None if shelf is None else jax.tree.map(lambda a: a[..., lane], shelf)

        def next_size(objects: Objects, pose, knot, lane):
            sweep = self._sweep(motion_in(knot, lane, pose), substeps)
            part = reach.guess(self._of(shelf_in(lane)), *objects[:4], sweep)
            return part, jnp.where(knot < t, size_of(part), -1)

        def size_of(part: Part):
            most, most_near = np.array([(0, 0), *self._sizes]).T[..., None]
            taking, near = part.counts()
            return ((taking > most) | (near > most_near)).sum(0)

        zero = jnp.zeros((n, b))
        objects = Objects(
            start.objects[..., 0].T,
            start.objects[..., 1].T,
            start.velocities[..., 0].T,
            start.velocities[..., 1].T,
            zero,
            zero,
        )
        state = _State(
            objects,
            start.hand.T,
            # Each lane begins with a knot -1 in which nothing moves: it finds the class of knot 0.
            jnp.full(b, -1, jnp.int32),
            Part(zero, jnp.full((n, b), reach.RESTING), jnp.zeros(b, bool)),
            jnp.where(wanted, 0, -1),
            (
                jnp.zeros((b, t, n, 2)),
                jnp.zeros((b, t, 3)),
                jnp.zeros((b, t, self._slots)),
                jnp.zeros((b, t, self._slots, 2), jnp.int32),
            ),
            jnp.zeros(1 + len(self._sizes), jnp.int32),
        )

        def work(state: _State) -> _State:
            # The class with most lanes waiting; but knots without motion first where no class fills
            # a chunk, since they cost nothing and more lanes wait afterwards.
            kinds = jnp.arange(len(self._sizes) + 1)
            waiting = (state.size[None] == kinds[:, None]).sum(1)
            idle = (waiting[0] > 0) & (waiting[1:].max() < chunk)
            kind = jnp.where(idle, 0, jnp.argmax(waiting))
            # Its lanes, then those of smaller classes; those that are behind before others.
            mine = (state.size <= kind) & (state.size >= jnp.minimum(kind, 1))
            rank = jnp.where(mine, (kind - state.size) * t + state.knot, t * len(kinds))
            lane = jnp.argsort(rank, stable=True)[:chunk]
            lane = jnp.where(mine[lane], lane, b)
            got = jnp.minimum(lane, b - 1)
            before = jax.tree.map(lambda a: a[:, got], state.objects)
            part = jax.tree.map(lambda a: a[..., got], state.part)
            pose, knot = state.pose[:, got], state.knot[got]
            now = motion_in(knot, got, pose)
            branches = [self._stand, *(functools.partial(self._advance, *s) for s in self._sizes)]
            after, touched, reached, force, bodies = jax.lax.switch(
                kind, branches, substeps, before, part, now, shelf_in(got)
            )
            after = jax.tree.map(lambda a, v: jnp.where(knot < 0, v, a), after, before)

            # A lane that left something out does the knot again, with that.
            fine = ~(touched.any(0) | reached)
            where = jnp.where(fine, lane, b)
            pose = pose + substeps * self.physics.substep_s * now.velocity
            ends = jnp.where(knot < 0, b, where)
            positions = jnp.stack([after.x, after.y], -1).swapaxes(0, 1)  # [C, N, 2]
            values = (positions, pose.T, force, bodies)
            out = tuple(
                a.at[ends, knot].set(v, mode="drop") for a, v in zip(state.out, values, strict=True)
            )
            again = part.with_added(touched, reached)
            part, size = next_size(after, pose, knot + 1, got)
            part = jax.tree.map(lambda v, a: jnp.where(fine, v, a), part, again)
            size = jnp.where(fine, size, size_of(again))
            return _State(
                jax.tree.map(lambda a, v: a.at[:, where].set(v, mode="drop"), state.objects, after),
                state.pose.at[:, where].set(pose, mode="drop"),
                state.knot.at[where].add(1, mode="drop"),
                jax.tree.map(lambda a, v: a.at[..., lane].set(v, mode="drop"), state.part, part),
                state.size.at[lane].set(size, mode="drop"),
                out,
                state.work.at[jnp.where(kind > 0, jnp.stack([0, kind]), len(kinds))].add(
                    jnp.stack([(fine & (lane < b)).sum(), chunk]), mode="drop"
                ),
            )

        state = jax.lax.while_loop(lambda s: (s.size >= 0).any(), work, state)
        objects, hands, force, bodies = state.out
        velocities = jnp.stack([state.objects.vx, state.objects.vy], -1).swapaxes(0, 1)
        return Rollout(objects, hands, velocities, force, bodies), state.work

    def _sweep(self, now: Motion, substeps: jax.Array) -> Hand:
        """The hand at `SWEEP` poses along a knot, first and last included: [P, G, C] each."""

        def at(done):
            turn = motion.turn_at(self.physics, now, done)
            one = jnp.minimum(substeps, 1)
            return motion.hand_at(self.physics, self._shape, now, done, substeps, turn, one)

        return jax.lax.map(at, jnp.arange(SWEEP) * (substeps / (SWEEP - 1)))

    def _of(self, shelf: Shelf | None) -> Constants:
        return self._constants if shelf is None else of_shelf(self._constants, shelf)

    def _stand(self, substeps, objects: Objects, part: Part, now, shelf: Shelf | None):
        """Do a knot in which no object can move."""
        c = part.role.shape[1]
        zero = jnp.zeros_like(objects.vx)
        still = Objects(objects.x, objects.y, zero, zero, zero, zero)
        no_force = jnp.zeros((c, self._slots))
        no_bodies = jnp.zeros((c, self._slots, 2), jnp.int32)
        return still, jnp.zeros(part.role.shape, bool), jnp.zeros(c, bool), no_force, no_bodies

    def _advance(
        self, a: int, h: int, substeps, objects: Objects, part: Part, now, shelf: Shelf | None
    ):
        """Do a knot with `a` objects, of which the hand may touch the first `h`.

        Returns:
          All objects after the knot; [N, C] the objects that should have taken part too; [C]
          whether the hand may have touched others than the first `h`; the strongest contacts.
        """
        n, c = part.role.shape
        mine = part.order()[:a]
        of_all = self._of(shelf)
        of_mine = taken(of_all, mine, *contact.pairs(a))
        still = jax.tree.map(jnp.zeros_like, objects)._replace(x=objects.x, y=objects.y)
        # Resting objects that fill up are out of the way, so that they change nothing: wide apart
        # in front of the shelf.
        resting = part.role == reach.RESTING
        apart = -10.0 - jnp.arange(n, dtype=objects.x.dtype)[:, None]
        away = still._replace(x=jnp.broadcast_to(apart, (n, c)), y=jnp.zeros_like(still.y))
        begin = jax.tree.map(lambda v, w: jnp.where(resting, w, v), objects, away)
        moved, box, force = motion.knot(
            of_mine,
            self.physics,
            self._shape,
            now,
            substeps,
            jax.tree.map(lambda v: jnp.take_along_axis(v, mine, 0), begin),
            h,
            self.iterations,
            self.cg_iterations,
        )
        touched = reach.touched(of_mine, of_all, box, objects.x, objects.y) & resting
        way = jnp.take_along_axis(part.depth, mine[h:], 0) + box.way()[h:]
        lane = jnp.arange(c)
        after = jax.tree.map(
            lambda v, m: jnp.where(resting, v, v.at[mine, lane].set(m)), still, moved
        )
        reached = ~(way <= 0).all(0) & ~part.anywhere
        return after, touched, reached, *self._strongest(force, mine)

    def _strongest(self, force: tuple[jax.Array, jax.Array, jax.Array], mine: jax.Array):
        """The strongest contacts of each lane: [C, slots] N and [C, slots, 2] bodies."""
        by_hand, by_walls, by_pairs = force  # [G, H, C], [2, A, C], [T, C]
        (g, h, c), a, n = by_hand.shape, len(mine), self.n_objects
        first, second = contact.pairs(a)
        flat = jnp.concatenate(
            [by_hand.reshape(g * h, c), by_walls.reshape(-1, c), by_pairs]
        ).T  # [C, M]
        walls = len(by_walls)
        one = jnp.concatenate([jnp.tile(mine[:h], (g, 1)), jnp.tile(mine, (walls, 1)), mine[first]])
        ground = np.repeat([n, n + 1], [g * h, walls * a])[:, None]
        other = jnp.concatenate([jnp.broadcast_to(ground, (len(ground), c)), mine[second]])
        slots = min(self._slots, flat.shape[1])
        strongest, which = jax.lax.top_k(flat, slots)
        bodies = jnp.stack([jnp.take_along_axis(v.T, which, 1) for v in (one, other)], -1)
        bodies = jnp.where((strongest > 0)[..., None], bodies, 0).astype(jnp.int32)
        spare = self._slots - slots
        return jnp.pad(strongest, ((0, 0), (0, spare))), jnp.pad(
            bodies, ((0, 0), (0, spare), (0, 0))
        )
