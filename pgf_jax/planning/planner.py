"""The planner (Papallas & Dogar 2022, Alg. 1): noisy rollouts improve a trajectory.

A search goes init -> propose -> roll out -> absorb, until its best trajectory is feasible.
Functions are written for one robot and vmapped over L lanes at the edge; an engine does the physics
in between. A `Search` (`search.py`) is one segment's state; nothing in it is mutated.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.physics import hand
from pgf_jax.physics.engine import Array, Engine, Rollout, World, contact_slots, takes_shelves
from pgf_jax.physics.hand import RETREAT_M, RETREAT_S
from pgf_jax.physics.sized import SizedEngine
from pgf_jax.planning import arrays, nominal, padding
from pgf_jax.planning.config import Planner as Config
from pgf_jax.planning.cost import Evaluation, Task, evaluate
from pgf_jax.planning.search import HISTORY, Rolled, Search, asked
from pgf_jax.planning.types import Push
from pgf_jax.scene.shelf import MASS, RADIUS, Shelf

WINNER = 1  # folded into an iteration's key for the draw of a random winner, apart from the noise


class BatchPlanner:
    """Plans for up to L robots in one call; no lane's content changes another lane's result."""

    def __init__(self, engine: Engine | SizedEngine, config: Config | None = None) -> None:
        self.engine, self.config = engine, config or Config()
        self._init_reach = jax.jit(self._reach)
        self._init_push = jax.jit(self._push)
        self._propose = jax.jit(jax.vmap(self._propose_one))
        self._absorb = jax.jit(jax.vmap(self._absorb_one))
        self._blend = jax.jit(jax.vmap(self._blend_one))
        self._value = jax.jit(jax.vmap(self._evaluate))
        # Of searches whose candidates are checked in a world.
        self._absorb_valued = jax.jit(jax.vmap(self._absorb_valued_one))
        self._take_one = jax.jit(self._take)
        self._evaluate_one = jax.jit(self._evaluate)
        self._retreat = jax.jit(jax.vmap(self._retreat_one))

    # -- segments ---------------------------------------------------------------------------------

    def begin_reach(self, world: World, goal: int, shelf: Shelf | None = None) -> Search:
        """Start a reach segment; nothing is rolled out yet.

        Args:
          world: unbatched.
          goal: index of the object to reach.
          shelf: unbatched; None: standard.

        Raises:
          BadInput: the engine simulates standard objects only.
        """
        world, shelf = self._padded(world, shelf)
        return arrays.to_host(self._init_reach(world, np.int32(goal), shelf))

    def begin_push(self, world: World, goal: int, push: Push, shelf: Shelf | None = None) -> Search:
        """Start a push segment; other arguments and errors are as of `begin_reach`."""
        n = padding.count(shelf, len(world.objects))
        if not 0 <= push.object < n:
            raise BadInput(f"push: object must be within 0..{n - 1}, got {push.object}")
        target = np.array([push.x, push.y], np.float32)
        if not np.isfinite(target).all():
            raise BadInput(f"push: target must be finite numbers, got ({push.x}, {push.y})")
        world, shelf = self._padded(world, shelf)
        return arrays.to_host(
            self._init_push(world, np.int32(goal), np.int32(push.object), target, shelf)
        )

    def _padded(self, world: World, shelf: Shelf | None) -> tuple[World, Shelf | None]:
        """World and shelf with as many places as their program has."""
        n = len(world.objects) if shelf is None else len(np.asarray(shelf.radius))
        engine = self.engine
        if isinstance(engine, SizedEngine):
            n = n if shelf is None else engine.places(n)
            engine = engine.of(n)
        world, shelf = padding.pad(world, shelf, n)
        if shelf is not None and not takes_shelves(engine):
            raise BadInput(
                f"engine {engine.name}: simulates cylinders of {RADIUS} m and {MASS:g} kg on "
                "the standard shelf only, got a scene with others"
            )
        return arrays.as_float32(world), arrays.as_float32(shelf)

    def go_on(self, search: Search) -> Search:
        """Keep the trajectory, clear the stuck counter (a departure: the source restarts)."""
        return search._replace(stuck_count=np.zeros_like(search.stuck_count))

    def is_stuck(self, search: Search) -> bool:
        """Whether the stuck counter has reached its limit."""
        return bool(search.stuck_count >= self.config.stuck_count)

    def terminate(self, search: Search) -> bool:
        """Whether the best so far is feasible."""
        return bool(search.value.feasible)

    # -- iterations -------------------------------------------------------------------------------

    def step(self, searches: Sequence[Search], keys: Sequence[np.ndarray]) -> list[Search]:
        """Do one iteration of each search; a search's iteration 0 rolls out its nominal.

        Args:
          searches: up to L segments, of any robots; the rest of the lanes is padded.
          keys: one raw PRNG key ([2] uint32) each; consumed.

        Returns:
          The searches after the iteration, in order.
        """
        return self._iterate(searches, keys)[0]

    def step_valued(
        self, searches: Sequence[Search], keys: Sequence[np.ndarray]
    ) -> list[tuple[Search, Rolled]]:
        """Do one iteration of each search, and return all its rollouts; arguments as of `step`.

        Returns:
          Of each: the search after it, and the rollouts that its winner is of, with their values.
        """
        pairs, rounds = self._iterate(searches, keys, valued=True)
        count = len(pairs)
        controls, rollouts = (arrays.unstack(arrays.to_host(x), count) for x in rounds[-1])
        return [
            (after, asked(before, Rolled(c, rollout, value)))
            for before, (after, value), c, rollout in zip(
                searches, pairs, controls, rollouts, strict=True
            )
        ]

    def take(self, search: Search, rolled: Rolled) -> Search:
        """The search after an iteration whose rollouts have these values, the engine's or not."""
        return arrays.to_host(self._take_one(search, *rolled))

    def evaluate(self, search: Search, rollout: Rollout) -> Evaluation:
        """Evaluate one rollout ([T, N, 2] and so on) as a trajectory of a search."""
        one = jax.tree.map(lambda x: np.asarray(x)[None], arrays.as_float32(rollout))
        return jax.tree.map(lambda x: np.asarray(x)[0], self._evaluate_one(search, one))

    def rolled(self, search: Search, key: np.ndarray) -> tuple[Search, Rolled]:
        """Do one iteration of one search, and return all its rollouts.

        Args:
          search: a segment.
          key: raw PRNG key ([2] uint32); consumed.

        Returns:
          The search after it, bit-equal to the result of `step`; and the iteration's rollouts, with
          values of a program of their own, which may differ in the last bit.
        """
        (after,), rounds = self._iterate([search], [key])
        batch = arrays.stack(arrays.pad([search], self.engine.lanes))
        parts = [
            asked(
                search,
                jax.tree.map(lambda x: np.asarray(x)[0], Rolled(c, r, self._value(batch, r))),
            )
            for c, r in rounds
        ]
        return after, jax.tree.map(lambda *xs: np.concatenate(xs), *parts)

    def _iterate(
        self, searches: Sequence[Search], keys: Sequence[np.ndarray], *, valued: bool = False
    ) -> tuple[list[Any], list[tuple[Array, Rollout]]]:
        """The searches after an iteration, and each round's [L, k, T, 3] controls and rollouts.

        With `valued`, each search has the values of the last round's rollouts with it.
        """
        absorb = self._absorb_valued if valued else self._absorb
        lanes, k = self.engine.lanes, self.config.rollouts
        batch = arrays.stack(arrays.pad(searches, lanes))
        padded_keys = np.stack(arrays.pad(keys, lanes))  # [L, 2]
        noisy = self._propose(batch, padded_keys)  # [L, K, T, 3]
        # Do not roll out the padding, nor the nominal more than once.
        used = np.arange(lanes) < len(searches)
        once = (np.asarray(batch.iteration)[:, None] >= 0) | (np.arange(k) == 0)
        rollout = self._roll(batch, noisy, used[:, None] & once)
        rounds = [(noisy, rollout)]
        if self.config.update == "stomp":
            batch, blended = self._blend(batch, noisy, rollout)  # [L, 1, T, 3]
            winner = self._roll(batch, blended, used[:, None])
            rounds.append((blended, winner))
            after = absorb(batch, blended, winner)
        elif self.config.random_winner:
            after = absorb(batch, noisy, rollout, padded_keys)
        else:
            after = absorb(batch, noisy, rollout)
        return arrays.unstack(arrays.to_host(after), len(searches)), rounds

    def retreat(self, searches: Sequence[Search]) -> list[World]:
        """Worlds after each push was executed and the hand has retracted 0.07 m straight back.

        The hand keeps its gripper and moves back along its pointing direction in 1 s (the published
        source's retreat). The push itself has been rolled out: its end is the retreat's start.
        """
        lanes, k, physics = self.engine.lanes, self.config.rollouts, self.engine.physics
        substeps = round(RETREAT_S / physics.substep_s / physics.knots)
        duration = substeps * physics.knots * physics.substep_s
        batch = arrays.stack(arrays.pad(searches, lanes))
        start, velocity = self._retreat(batch)
        controls = np.asarray(velocity)[:, None, None] * (RETREAT_M / duration)
        controls = np.broadcast_to(controls, (lanes, k, physics.knots, 3))
        gripper = np.broadcast_to(
            np.asarray(start.gripper)[:, None, None], (lanes, k, physics.knots)
        )
        # The same batch shape as an iteration's, so that no second program is compiled.
        start = jax.tree.map(lambda x: np.repeat(np.asarray(x), k, 0), start)
        used = (np.arange(lanes)[:, None] < len(searches)) & (np.arange(k) == 0)
        out = self._rollout(
            start,
            arrays.flat(controls),
            arrays.flat(gripper),
            substeps,
            arrays.flat(used),
            batch.shelf,
        )
        out = jax.tree.map(lambda x: np.asarray(x, np.float32)[::k], out._replace(bodies=out.force))
        worlds = World(out.objects[:, -1], out.velocities, out.hand[:, -1], start.gripper[::k])
        return arrays.unstack(worlds, len(searches))

    def _roll(self, batch: Search, controls: jax.Array, wanted: np.ndarray) -> Rollout:
        """Roll out [L, k, T, 3] controls of a batch of searches where wanted; [L, k, ...]."""
        lanes, k = wanted.shape
        start = jax.tree.map(lambda x: np.repeat(np.asarray(x), k, 0), batch.start)
        gripper = np.repeat(np.asarray(batch.gripper), k, 0)
        substeps, wanted = self.engine.physics.substeps, arrays.flat(wanted)
        out = self._rollout(start, arrays.flat(controls), gripper, substeps, wanted, batch.shelf)
        return jax.tree.map(lambda x: x.reshape(lanes, k, *x.shape[1:]), arrays.as_float32(out))

    def _rollout(self, start, controls, gripper, substeps, wanted, shelf: Shelf | None) -> Rollout:
        """Roll out on standard shelves, or on one for each of the L lanes."""
        if shelf is None:
            return self.engine.rollout(start, controls, gripper, substeps, wanted)
        each = len(controls) // self.engine.lanes
        shelves = jax.tree.map(lambda x: np.repeat(np.asarray(x), each, 0), shelf)
        return self.engine.rollout(start, controls, gripper, substeps, wanted, shelf=shelves)  # pyright: ignore[reportCallIssue]

    # -- one robot, traced ------------------------------------------------------------------------

    def _begin(
        self,
        start: World,
        task: Task,
        controls: jax.Array,
        gripper: jax.Array,
        shelf: Shelf | None,
    ) -> Search:
        t, n, c = self.engine.physics.knots, len(start.objects), contact_slots(len(start.objects))
        return Search(
            start=start,
            task=task,
            gripper=gripper.astype(jnp.float32),
            controls=controls.astype(jnp.float32),
            best=Rollout(
                jnp.broadcast_to(start.objects, (t, n, 2)),
                jnp.broadcast_to(start.hand, (t, 3)),
                start.velocities,
                jnp.zeros((t, c)),
                jnp.zeros((t, c, 2), jnp.int32),
            ),
            value=Evaluation(
                jnp.float32(jnp.inf),
                jnp.full(5, jnp.inf),
                jnp.float32(jnp.inf),
                jnp.array(False),
                jnp.array(False),
            ),
            iteration=jnp.int32(-1),
            last_cost=jnp.float32(0),
            stuck_count=jnp.int32(0),
            history=jnp.full((HISTORY, 3), jnp.nan),
            non_finite=jnp.int32(0),
            saturated=jnp.int32(0),
            shelf=shelf,
        )

    def _reach(self, start: World, goal: jax.Array, shelf: Shelf | None) -> Search:
        task = Task(goal, jnp.array(False), goal, start.objects[goal])
        controls, gripper = nominal.reach(
            start.hand, start.objects, goal, self.engine.physics, self.config.cost, shelf
        )
        return self._begin(start, task, controls, gripper, shelf)

    def _push(self, start: World, goal, pushed, target, shelf: Shelf | None) -> Search:
        task = Task(goal, jnp.array(True), pushed, target)
        controls, gripper = nominal.push(
            start.hand, start.objects, pushed, target, self.engine.physics, shelf
        )
        return self._begin(start, task, controls, gripper, shelf)

    def _propose_one(self, search: Search, key: jax.Array) -> jax.Array:
        """[K, T, 3] noisy trajectories from the best so far; K times the nominal at iteration 0."""
        shape = (self.config.rollouts, *search.controls.shape)
        noise = jnp.asarray(self.config.sigma)[None, None] * jax.random.normal(key, shape)
        return search.controls[None] + jnp.where(search.iteration < 0, 0.0, noise)

    def _evaluate(self, search: Search, rollout: Rollout) -> Evaluation:
        def one(rollout: Rollout) -> Evaluation:
            return evaluate(rollout, search.gripper, search.task, self.config.cost, search.shelf)

        return jax.vmap(one)(rollout)

    def _blend_one(
        self, search: Search, noisy: jax.Array, rollout: Rollout
    ) -> tuple[Search, jax.Array]:
        """STOMP's update: noise weighted by exp(-h (S - min S) / (max S - min S)); [1, T, 3].

        S is the whole trajectory's cost, since most of it arises at the last knot.
        """
        total = self._evaluate(search, rollout).total  # [K]
        finite = jnp.isfinite(total)
        low = jnp.min(total, where=finite, initial=jnp.inf)
        high = jnp.max(total, where=finite, initial=-jnp.inf)
        spread = jnp.where(high > low, high - low, 1.0)
        weight = jnp.where(finite, jnp.exp(-self.config.stomp_h * (total - low) / spread), 0.0)
        weight = weight / jnp.maximum(weight.sum(), 1e-30)
        delta = (weight[:, None, None] * (noisy - search.controls[None])).sum(0)
        return self._count(search, finite, rollout), (search.controls + delta)[None]

    def _absorb_one(
        self, search: Search, noisy: jax.Array, rollout: Rollout, key: jax.Array | None = None
    ) -> Search:
        """Evaluate an iteration's rollouts, and take the winner; see `_take`."""
        return self._take(search, noisy, rollout, self._evaluate(search, rollout), key)

    def _absorb_valued_one(
        self, search: Search, noisy: jax.Array, rollout: Rollout, key: jax.Array | None = None
    ) -> tuple[Search, Evaluation]:
        values = self._evaluate(search, rollout)
        return self._take(search, noisy, rollout, values, key), values

    def _take(
        self,
        search: Search,
        noisy: jax.Array,
        rollout: Rollout,
        values: Evaluation,
        key: jax.Array | None = None,
    ) -> Search:
        """Replace the best by the iteration's winner where it is cheaper; update the stuck counter.

        The winner is the cheapest; with the iteration's key it may be a random one (the ablation
        `random_winner`). The stuck counter is the published source's.
        """
        config = self.config
        first = search.iteration < 0
        asked = ~first | (jnp.arange(len(values.total)) == 0)
        winner = jnp.argmin(jnp.where(asked, values.total, jnp.inf))
        if key is not None:
            winner = jnp.where(first, winner, self._perhaps_any(winner, key))
        c_i, best = values.total[winner], search.value.total
        better = (c_i < best) | first

        def improve(new, old):
            return jax.tree.map(lambda a, b: jnp.where(better, a[winner], b), new, old)

        value = improve(values, search.value)

        n = jnp.where(c_i < best, 0, search.stuck_count)
        no_progress = jnp.abs(c_i - search.last_cost) < config.stuck_change
        # inf - inf: a segment without any finite rollout yet does not progress either.
        far = ~(c_i - jnp.minimum(best, c_i) <= config.stuck_excess)
        n = jnp.where(no_progress | far, n + 1, 0)

        history = jnp.concatenate([search.history[1:], value.terms[None, :3]])
        return self._count(search, values.finite, rollout)._replace(
            controls=improve(noisy, search.controls),
            best=improve(rollout, search.best),
            value=value,
            iteration=search.iteration + 1,
            last_cost=jnp.where(first, 0.0, c_i),
            stuck_count=jnp.where(first, 0, n).astype(jnp.int32),
            history=jnp.where(first, search.history, history),
        )

    def _perhaps_any(self, winner: jax.Array, key: jax.Array) -> jax.Array:
        """[] the winner, or with probability `random_winner` one of the K, drawn uniformly."""
        coin, which = jax.random.split(jax.random.fold_in(key, WINNER))
        replaced = jax.random.uniform(coin) < self.config.random_winner
        drawn = jax.random.randint(which, (), 0, self.config.rollouts)
        return jnp.where(replaced, drawn, winner)

    def _count(self, search: Search, finite: jax.Array, rollout: Rollout) -> Search:
        """Count non-finite and saturated rollouts among the K; at iteration 0 only the first."""
        full = (rollout.force > 0).all(-1).any(-1)  # [K]
        counted = (search.iteration >= 0) | (jnp.arange(len(full)) == 0)
        return search._replace(
            non_finite=search.non_finite + (counted & ~finite).sum().astype(jnp.int32),
            saturated=search.saturated + (counted & full).sum().astype(jnp.int32),
        )

    def _retreat_one(self, search: Search) -> tuple[World, jax.Array]:
        end = search.best
        world = World(end.objects[-1], end.velocities, end.hand[-1], search.gripper[-1])
        yaw = world.hand[2] + hand.POINTING_YAW
        return world, jnp.stack([-jnp.cos(yaw), -jnp.sin(yaw), jnp.zeros(())])
