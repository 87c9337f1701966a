"""Measures the solid world: does its step suffice, does it slide right, and how far is planar?

    python experiments/solid_world.py [--scenes 125] [--plans 150]

What is executed: the reach nominals of sampled scenes with the planner's noise (eight a scene), and
the reaches of plans that are feasible by the engine `planar`. The script prints

- convergence: the same executions with the step halved once and twice. How many reaches grasp, how
  many verdicts differ from those of the smallest step, and how far apart the objects end that have
  moved (by more than 5 mm in the smallest step);
- sliding: an object's way on the table from a velocity, in eight directions, against
  v^2 / (2 mu g), less the v step / 2 by which a step that first brakes and then moves falls short;
- the largest overlap of any two bodies and the largest tilt at any time of the noisy reaches;
- the time that an execution takes on one core;
- how far apart moved objects end in the solid world and in the planar model (MuJoCo in C), and how
  often each ends within reach of the goal.
"""

import dataclasses
import time
from collections.abc import Iterable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pgf_jax import PlanConfig, configure, make_engine, sample_scene
from pgf_jax.physics.config import PhysicsName, physics_of
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.physics.worlds.solid_model import Solid
from pgf_jax.physics.worlds.world import GRASP_M, Command, Executed
from pgf_jax.planning.config import Cost
from pgf_jax.planning.cost import reach_distance
from pgf_jax.plans.plan import plan_scenes
from pgf_jax.profiling.measure import noisy_nominals
from pgf_jax.scene import PUBLISHED_CLASSES, Scene

MOVED_M = 0.005
GRAVITY = 9.81  # MuJoCo's
SPEEDS = (0.1, 0.2, 0.4, 0.8)  # m/s; a hand moves at 0.1 to 0.2
DIRECTIONS = 8
FINER = 20  # times within a knot at which overlap and tilt are looked at


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: int = 125  # a third of each class; noisy reaches are eight a scene
    plans: int = 150  # scenes that are planned, others than those
    converge: int = 250  # noisy reaches in the convergence table
    halvings: int = 2
    seed: int = 30_000
    lanes: int = 32
    physics: PhysicsName = "default"  # of the planar model
    physics_constants: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Case:
    """A reach to execute."""

    scene: Scene
    controls: np.ndarray  # [T, 3]
    gripper: np.ndarray  # [T]
    seconds: float

    def command(self, world: SolidWorld) -> Command:
        """The command from the scene's start."""
        start = world.start(self.scene)
        controls, gripper = self.controls.astype(float), self.gripper.astype(float)
        return Command(start, controls, gripper, self.seconds, goal=self.scene.goal)


class Watched(SolidWorld):
    """A solid world that notes the largest overlap at the ends of knots, and lists no contacts."""

    overlap = 0.0  # m

    def _contacts(self, data: Any, force: np.ndarray, bodies: np.ndarray) -> bool:
        distances = data.contact.dist
        if len(distances):
            self.overlap = max(self.overlap, -float(distances.min()))
        return False


def scenes_of(first: int, count: int) -> list[Scene]:
    return [sample_scene(first + i // 3, PUBLISHED_CLASSES[i % 3]) for i in range(count)]


def planned(config: Config) -> list[Case]:
    """The reaches of the plans that the engine calls solved."""
    scenes = scenes_of(config.seed + config.scenes, config.plans)
    settings = PlanConfig(
        lanes=config.lanes,
        physics=config.physics,
        physics_constants=config.physics_constants,
        world="none",  # the engine is believed
    )
    plans = plan_scenes([(scene, config.seed + i) for i, scene in enumerate(scenes)], settings)
    reaches = [(plan.scene, plan.segments[-1]) for plan in plans if plan.solved]
    return [
        Case(scene, np.array(reach.controls), np.array(reach.gripper), reach.duration_s)
        for scene, reach in reaches
    ]


def execute(cases: Sequence[Case], solid: Solid) -> list[Executed]:
    world = SolidWorld(20, solid)
    return [world.execute(case.command(world)) for case in cases]


def ends(executed: Iterable[Executed]) -> np.ndarray:
    """[cases, N, 2] centres at the end."""
    return np.stack([one.rollout.objects[-1] for one in executed])


def spread(values: np.ndarray) -> list[str]:
    """Median, mean and 95th percentile."""
    if not len(values):
        return ["-"] * 3
    return [f"{v:.2f}" for v in (np.median(values), np.mean(values), np.percentile(values, 95))]


def convergence(kinds: dict[str, list[Case]], halvings: int) -> Table:
    """The table of executions with ever smaller steps."""
    columns = ("reaches", "step, ms", "within reach", "verdicts changed", "moved objects")
    table = Table(title="convergence", caption="against the smallest step; apart: mm")
    for column in (*columns, "apart: median", "mean", "p95"):
        table.add_column(column, justify="right")
    for name, cases in kinds.items():
        if not cases:
            continue
        steps = [Solid().step_s / 2**i for i in range(halvings + 1)]
        found = [execute(cases, Solid(step_s=step)) for step in steps]
        finest, right = ends(found[-1]), np.array([one.grasped for one in found[-1]])
        starts = np.stack([case.scene.positions for case in cases])
        moved = np.linalg.norm(finest - starts, axis=-1) > MOVED_M
        for step, executed in zip(steps, found, strict=True):
            grasped = np.array([one.grasped for one in executed])
            apart = 1e3 * np.linalg.norm(ends(executed) - finest, axis=-1)[moved]
            counts = (f"{grasped.sum()}/{len(cases)}", str((grasped != right).sum()))
            table.add_row(name, f"{1e3 * step:.3f}", *counts, str(moved.sum()), *spread(apart))
    return table


def slides(solid: Solid, speed: float) -> tuple[np.ndarray, float]:
    """[directions] ways of an object alone, m, and the largest tilt, rad."""
    world, ways, upright = SolidWorld(1, solid), [], 1.0
    start = np.array([[0.4, 0.0]])
    for angle in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        velocity = speed * np.array([[np.cos(angle), np.sin(angle)]])
        state = world.state_of(World(start, velocity, np.array([-0.5, 0.0, 0.0]), np.array(0.0)))
        executed = world.execute(Command(state, np.zeros((8, 3)), np.zeros(8), 3.0))
        ways.append(np.linalg.norm(executed.rollout.objects[-1, 0] - start[0]))
        upright = min(upright, executed.upright)
    return np.array(ways), float(np.arccos(min(upright, 1.0)))


def sliding(halvings: int) -> Table:
    table = Table(title="sliding", caption="ways: mm")
    columns = ("step, ms", "speed, m/s", "by the formula", "less v step / 2", "least", "mean")
    for column in (*columns, "most", "tilt, deg"):
        table.add_column(column, justify="right")
    for i in range(halvings + 1):
        solid = Solid(step_s=Solid().step_s / 2**i)
        for speed in SPEEDS:
            ways, tilt = slides(solid, speed)
            way = speed**2 / (2 * solid.table_friction * GRAVITY)
            values = (way, way - speed * solid.step_s / 2, ways.min(), ways.mean(), ways.max())
            table.add_row(
                f"{1e3 * solid.step_s:.3f}",
                f"{speed:g}",
                *(f"{1e3 * v:.2f}" for v in values),
                f"{np.degrees(tilt):.2f}",
            )
    return table


def watch(cases: Sequence[Case]) -> tuple[float, float]:
    """The largest overlap, m, and the largest tilt, rad, of any time."""
    world, upright = Watched(20), 1.0
    for case in cases:
        command = case.command(world)
        # The gripper moves linearly within a knot: at its parts it is between the knots' values.
        knots = np.arange(len(command.gripper) + 1)
        parts = np.arange(1, FINER * len(command.gripper) + 1) / FINER
        gripper = np.interp(parts, knots, [command.state.gripper, *command.gripper])
        fine = dataclasses.replace(
            command, controls=np.repeat(command.controls, FINER, axis=0), gripper=gripper
        )
        upright = min(upright, world.execute(fine).upright)
    return world.overlap, float(np.arccos(min(upright, 1.0)))


def within_reach(hand: np.ndarray, centres: np.ndarray, goal: np.ndarray) -> np.ndarray:
    poses, objects = jnp.asarray(hand, jnp.float32), jnp.asarray(centres, jnp.float32)
    distance = reach_distance(poses, objects, Cost())
    return np.asarray(distance)[np.arange(len(goal)), goal] < GRASP_M


def main(config: Config) -> None:
    """Measure, and print the results."""
    configure(None)
    console = Console()
    physics = physics_of(config.physics, config.physics_constants)
    engine = make_engine("native", physics=physics)
    scenes = scenes_of(config.seed, config.scenes)
    start, controls, gripper, _ = noisy_nominals(engine, scenes, config.seed)
    a_scene = len(controls) // len(scenes)
    noisy = [
        Case(scenes[i // a_scene], u, g, physics.rollout_s)
        for i, (u, g) in enumerate(zip(controls, gripper, strict=True))
    ]
    some = noisy[:: max(1, len(noisy) // config.converge)]
    console.print(convergence({"noisy": some, "planned": planned(config)}, config.halvings))
    console.print(sliding(config.halvings))

    overlap, tilt = watch(noisy)
    console.print(
        f"{len(noisy)} noisy reaches: overlap at most {1e3 * overlap:.2f} mm, tilt at most "
        f"{np.degrees(tilt):.1f} deg"
    )
    world, took, executed = SolidWorld(20), [], []
    for case in noisy:
        command, begin = case.command(world), time.perf_counter()
        executed.append(world.execute(command))
        took.append(time.perf_counter() - begin)
    console.print(
        f"an execution takes {1e3 * np.median(took):.0f} ms (median), "
        f"{1e3 * np.percentile(took, 95):.0f} ms (p95)"
    )
    planar = engine.rollout(start, controls, gripper, physics.substeps)
    flat, solid = np.asarray(planar.objects)[:, -1], ends(executed)
    moved = np.linalg.norm(solid - start.objects, axis=-1) > MOVED_M
    apart = spread(1e3 * np.linalg.norm(flat - solid, axis=-1)[moved])
    goal = np.array([case.scene.goal for case in noisy])
    reached = within_reach(np.asarray(planar.hand)[:, -1], flat, goal)
    grasped = np.array([one.grasped for one in executed])
    console.print(
        f"planar and solid: {moved.sum()} objects moved, apart by {apart[0]} mm (median), "
        f"{apart[1]} mm (mean), {apart[2]} mm (p95)\nwithin reach of the goal: "
        f"planar {reached.sum()}, solid {grasped.sum()}, both {(reached & grasped).sum()}"
    )


if __name__ == "__main__":
    main(tyro.cli(Config))
