"""Simulates the execution of a plan again: its pushes with their retreats, then the reach."""

import math
from collections.abc import Iterator

import numpy as np

from pgf_jax.errors import BadInput
from pgf_jax.fleet.records import State
from pgf_jax.physics import hand
from pgf_jax.physics.config import Physics, physics_of
from pgf_jax.physics.engine import World
from pgf_jax.physics.hand import RETREAT_M, RETREAT_S
from pgf_jax.physics.sized import SizedEngine
from pgf_jax.physics.worlds.world import State as WorldState
from pgf_jax.planning import padding
from pgf_jax.planning.search import start_world
from pgf_jax.planning.types import Push
from pgf_jax.plans.config import ExecuteConfig
from pgf_jax.plans.execute import segments_executed, world_of
from pgf_jax.plans.file import Plan
from pgf_jax.scene.shelf import Shelf
from pgf_jax.simulation.snapshot import RobotSnapshot, end_effector

# Most parts that a knot is simulated in. With one part, objects drawn between the ends of a knot
# would lag behind the hand.
_PARTS = 6

# Times, objects, hand, gripper, leaning.
_Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
_STAND = np.empty((0, 4))  # how objects lean of which nothing is said


class Motion:
    """The execution of a plan over time, from 0; planning takes no time here.

    Without settings, a plan that was checked in the solid world is executed there once more, bit
    for bit as it was checked; any other is rolled out by its engine.

    M is the number of times, N the number of objects.

    Args:
      plan: the plan.
      config: executes it as `pgf_jax.execute` does with these settings.
      repeat: number of the execution, 0-based: of the draw of the world's error.

    Attributes:
      plan: the plan.
      times: [M] s, from 0, at which the other arrays are known; between two times they are
        interpolated.
      objects: [M, N, 2] centres x (into the shelf) and y (to the left), m.
      hand: [M, 3] poses of the hand's base: x, y (m) and yaw (rad).
      gripper: [M] 0 open .. 255 closed.
      leaning: [M, N, 4] height of each centre, m, and direction of each object's axis; [M, 0, 4] in
        an engine, in which all stand.

    Raises:
      BadInput: the plan's engine or physics is unknown, its world cannot be had, or its simulation
        does not stay finite.
    """

    def __init__(self, plan: Plan, config: ExecuteConfig | None = None, repeat: int = 0) -> None:
        self.plan = plan
        self._knots: list[np.ndarray] = []  # of each segment, [T + 1, 3] hand poses
        self._pushes: list[Push | None] = []
        self._starts: list[float] = []  # of each segment, s
        if config is None and plan.settings.get("world") == "solid":
            config = ExecuteConfig()
        rows = self._rolled_out(plan) if config is None else self._executed(plan, config, repeat)
        table = [np.concatenate(part) for part in zip(*rows, strict=True)]
        self.times, self.objects, self.hand, self.gripper, self.leaning = table
        if not all(np.isfinite(part).all() for part in table):
            raise BadInput(
                f"plan {plan.scene.name}: does not stay finite in engine {plan.engine}; "
                "expected a plan that can be executed"
            )

    def _executed(self, plan: Plan, config: ExecuteConfig, repeat: int) -> list[_Rows]:
        """Execute the plan in a world in three dimensions."""
        spec, scene = world_of(plan, config)
        worlds = spec.worlds(scene, 0, repeat)
        world, state = worlds.acting, worlds.start()
        rows = [_rows(np.zeros(1), world.seen(state), world.leaning(state))]
        parts: list[tuple[float, World, np.ndarray]] = []

        def note(share: float, state: WorldState) -> None:
            parts.append((share, world.seen(state), world.leaning(state)))

        segments = iter(plan.segments)
        for kind, executed in segments_executed(plan, world, state, note):
            if not np.isfinite(executed.upright):
                raise BadInput(
                    f"plan {plan.scene.name}: diverges in the world; expected a plan that can be "
                    "executed"
                )
            before = rows[-1]
            begins = float(before[0][-1])
            seconds = RETREAT_S if kind == "retreat" else next(segments).duration_s
            shares, worlds_seen, leaning = zip(*parts, strict=True)
            times = begins + seconds * np.array(shares)
            seen = [np.stack(part) for part in zip(*worlds_seen, strict=True)]
            rows.append((times, seen[0], seen[2], seen[3], np.stack(leaning)))
            parts.clear()
            if kind == "retreat":
                continue
            self._starts.append(begins)
            hands = executed.rollout.hand.astype(np.float32)
            self._knots.append(np.concatenate([before[2][-1:], hands]))
            moved = _pushed(before[1][-1], seen[0][-1]) if kind == "push" else None
            self._pushes.append(moved)
        return rows

    def _rolled_out(self, plan: Plan) -> list[_Rows]:
        """Roll the plan out by its engine."""
        engine, n = SizedEngine.of_name(plan.engine, _physics(plan), 1), len(plan.scene.objects)
        world, shelf = padding.pad(
            start_world(plan.scene.positions),
            plan.scene.shelf,
            n if plan.scene.shelf is None else engine.places(n),
        )
        rows = [_rows(np.zeros(1), world)]
        for segment in plan.segments:
            begins = float(rows[-1][0][-1])
            self._starts.append(begins)
            before = world
            knot_s = segment.duration_s / len(segment.controls)
            substeps = max(round(knot_s / engine.physics.substep_s), 1)
            controls = (segment.controls, segment.gripper)
            world, done = _roll(engine, shelf, world, *controls, substeps, begins)
            rows.append(done)
            at_knots = np.linspace(0, len(done[0]), len(segment.controls) + 1).astype(int)
            self._knots.append(np.concatenate([before.hand[None], done[2]])[at_knots])
            push = segment.kind == "push"
            self._pushes.append(_pushed(before.objects, world.objects) if push else None)
            if push:
                world, done = _retreat(engine, shelf, world, float(done[0][-1]))
                rows.append(done)
        return [(at, seen[:, :n], pose, grip, lean) for at, seen, pose, grip, lean in rows]

    @property
    def duration_s(self) -> float:
        """Duration of the execution, s."""
        return float(self.times[-1])

    def at(self, time_s: float) -> RobotSnapshot:
        """The robot at a time (s); its task is done from the end on.

        The file of a plan does not hold the targets of its pushes. The push shown is that of the
        object that moved farthest, to the place where it ended.
        """
        time_s = min(max(time_s, 0.0), self.duration_s)
        over = time_s >= self.duration_s
        segment = max(int(np.searchsorted(self._starts, time_s, "right")) - 1, 0)
        last = len(self.times) - 1
        after = min(max(int(np.searchsorted(self.times, time_s, "right")), 1), last)
        low, high = self.times[after - 1], self.times[after]
        share = (time_s - low) / (high - low)

        def between(values: np.ndarray) -> np.ndarray:
            return values[after - 1] + share * (values[after] - values[after - 1])

        plan = self.plan
        return RobotSnapshot(
            robot=0,
            task=0,
            scene=plan.scene.name,
            state=State.IDLE if over else State.EXECUTING,
            objects=between(self.objects),
            goal=plan.scene.goal,
            hand=between(self.hand),
            gripper=float(between(self.gripper)),
            path=self._knots[segment],
            push=self._pushes[segment],
            # Without c_e and c_s (the shelf's edge and walls), which the file does not hold.
            costs=tuple(float(c) for c in plan.history.sum(1)),
            inputs_at=plan.history_starts[1:],
            stuck=False,
            gain=math.nan,
            bid=None,
            waited_s=time_s - (0.0 if over else self._starts[segment]),
            done=(plan.status,) if over else (),
            origins=plan.scene.positions,
            leaning=between(self.leaning),
            shelf=plan.scene.shelf,
        )

    def end_effector_paths(self) -> list[np.ndarray]:
        """Of each segment, [T + 1, 2] positions of the end-effector point at knot ends, m."""
        return [end_effector(poses) for poses in self._knots]

    def film(
        self, step_s: float, start_s: float = 0.0, stop_s: float | None = None
    ) -> Iterator[RobotSnapshot]:
        """Yield snapshots every `step_s` from `start_s` to `stop_s`, by default the end."""
        last_s = self.duration_s if stop_s is None else stop_s
        for i in range(self.frames(step_s, start_s, stop_s)):
            yield self.at(min(start_s + i * step_s, last_s))

    def frames(self, step_s: float, start_s: float = 0.0, stop_s: float | None = None) -> int:
        """Number of snapshots that `film` yields."""
        stop_s = self.duration_s if stop_s is None else min(stop_s, self.duration_s)
        if start_s > stop_s:
            return 0
        # Where the steps do not meet the end, one more snapshot shows it.
        return math.ceil((stop_s - start_s) / step_s - 1e-9) + 1


def _physics(plan: Plan) -> Physics:
    """The physics that a plan was made in."""
    constants = plan.settings.get("physics_constants", ())
    try:
        return physics_of(plan.physics, [str(text) for text in constants])
    except (BadInput, TypeError) as error:
        raise BadInput(f"plan {plan.scene.name}: {error}") from None


def _rows(times: np.ndarray, world: World, leaning: np.ndarray = _STAND) -> _Rows:
    gripper = np.array([world.gripper])
    return times, world.objects[None], world.hand[None], gripper, leaning[None]


def _roll(
    engine: SizedEngine,
    shelf: Shelf | None,
    start: World,
    controls: np.ndarray,
    gripper: np.ndarray,
    substeps: int,
    begins_s: float,
) -> tuple[World, _Rows]:
    """Simulate controls ([T, 3], `substeps` each); returns the world after them, and the rows."""
    parts = max(p for p in range(1, _PARTS + 1) if substeps % p == 0)
    targets = np.concatenate([[start.gripper], gripper])
    shares = np.arange(1, parts + 1) / parts
    fingers = (targets[:-1, None] + np.diff(targets)[:, None] * shares).reshape(-1)
    shelves = None if shelf is None else Shelf(*(np.asarray(x, np.float32)[None] for x in shelf))
    out = engine.rollout(
        World(*(np.asarray(value, np.float32)[None] for value in start)),
        np.repeat(controls, parts, axis=0).astype(np.float32)[None],
        fingers.astype(np.float32)[None],
        substeps // parts,
        **({} if shelves is None else {"shelf": shelves}),
    )
    objects, poses, velocities = (
        np.asarray(a, np.float32)[0] for a in (out.objects, out.hand, out.velocities)
    )
    step = substeps // parts * engine.physics.substep_s
    times = begins_s + step * np.arange(1, len(fingers) + 1)
    after = World(objects[-1], velocities, poses[-1], np.float32(fingers[-1]))
    return after, (times, objects, poses, fingers, np.empty((len(times), *_STAND.shape)))


def _retreat(
    engine: SizedEngine, shelf: Shelf | None, start: World, begins_s: float
) -> tuple[World, _Rows]:
    """Simulate a straight retreat, as `BatchPlanner.retreat` does after a push."""
    physics = engine.physics
    substeps = round(RETREAT_S / physics.substep_s / physics.knots)
    yaw = float(start.hand[2]) + hand.POINTING_YAW
    back = -np.array([math.cos(yaw), math.sin(yaw), 0.0])
    speed = RETREAT_M / (substeps * physics.knots * physics.substep_s)
    controls = np.repeat((speed * back)[None], physics.knots, axis=0)
    still = np.full(physics.knots, start.gripper)
    return _roll(engine, shelf, start, controls, still, substeps, begins_s)


def _pushed(before: np.ndarray, after: np.ndarray) -> Push:
    farthest = int(np.argmax(((after - before) ** 2).sum(-1)))
    return Push(farthest, float(after[farthest, 0]), float(after[farthest, 1]))
