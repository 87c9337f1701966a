"""Executes plans in a world in three dimensions, and says what became of them.

A plan is executed as its checks were: each segment from the state that the one before it left, the
retreat after a push included. So what a check called solved is grasped here, bit for bit.
"""

import concurrent.futures
import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pgf_jax import cores
from pgf_jax.errors import BadInput
from pgf_jax.physics.worlds.config import world_error_of
from pgf_jax.physics.worlds.world import Command, Executed, State, World3D
from pgf_jax.plans.config import ExecuteConfig
from pgf_jax.plans.file import Plan
from pgf_jax.scene.load import load_scene
from pgf_jax.scene.scene import Scene
from pgf_jax.settings import check_type
from pgf_jax.simulation.task_worlds import TaskWorlds, WorldSpec


@dataclasses.dataclass(frozen=True)
class Execution:
    """The execution of a plan.

    Attributes:
      scene: name of the plan's scene.
      claimed: status of the plan.
      world: in which it was executed: solid or scene.
      repeat: number of the draw of the world's error, 0-based.
      grasped: the goal is within the hand at the end.
      distance_m: of the goal from the end-effector point at the end, its bearing counted in, m;
        None: the simulation diverged.
      tilt_deg: the largest tilt of an object at a knot's end, degrees; None: it diverged.
      shelf_touched: whether the robot touched the shelf at a knot's end.
    """

    scene: str
    claimed: str
    world: str
    repeat: int
    grasped: bool
    distance_m: float | None
    tilt_deg: float | None
    shelf_touched: bool


def execute(plan: Plan, config: ExecuteConfig | None = None) -> list[Execution]:
    """Execute a plan; an unsolved one too.

    Args:
      plan: to execute.
      config: settings; None: once, in the world that the plan was checked in, or else in `solid`.

    Returns:
      Its executions, one for each repeat.

    Raises:
      BadInput: the world `scene` is asked for, and there is no file of the plan's scene.
    """
    check_type("plan", plan, Plan)
    return [done for _, done in iter_executions([plan], config or ExecuteConfig())]


def iter_executions(
    plans: Sequence[Plan], config: ExecuteConfig
) -> Iterator[tuple[int, Execution]]:
    """Execute plans side by side on the cores; see `execute`.

    Yields:
      The number of a plan and one of its executions, in order.
    """
    chosen = [world_of(plan, config) for plan in plans]
    jobs = [(i, repeat) for i in range(len(plans)) for repeat in range(config.repeats)]

    def one(job: tuple[int, int]) -> tuple[int, Execution]:
        i, repeat = job
        spec, scene = chosen[i]
        # A robot's only task, as in planning; each repeat is another task to the draw.
        worlds = spec.worlds(scene, 0, repeat)
        return i, _execution(plans[i], worlds, spec.name, repeat)

    with concurrent.futures.ThreadPoolExecutor(len(cores.usable())) as pool:
        yield from pool.map(one, jobs)


def segments_executed(
    plan: Plan,
    world: World3D,
    state: State,
    watch: Callable[[float, State], None] | None = None,
) -> Iterator[tuple[str, Executed]]:
    """Execute the segments of a plan in turn.

    Args:
      plan: to execute.
      world: in which.
      state: before the plan.
      watch: see `World3D.execute`.

    Yields:
      Of each segment its kind (push, retreat or reach), and what happened.
    """
    for segment in plan.segments:
        command = Command(
            state,
            np.asarray(segment.controls, np.float64),
            np.asarray(segment.gripper, np.float64),
            segment.duration_s,
            goal=plan.scene.goal,
            keep=True,
        )
        executed = world.execute(command, watch)
        yield segment.kind, executed
        assert executed.state is not None
        state = executed.state
        if segment.kind == "push":
            executed = world.execute(world.retreat(state), watch)
            yield "retreat", executed
            assert executed.state is not None
            state = executed.state


def _execution(plan: Plan, worlds: TaskWorlds, world: str, repeat: int) -> Execution:
    done = [executed for _, executed in segments_executed(plan, worlds.acting, worlds.start())]
    upright = float(np.min([executed.upright for executed in done]))  # nan where one is
    finite = math.isfinite(upright) and math.isfinite(done[-1].distance)
    return Execution(
        scene=plan.scene.name,
        claimed=str(plan.status),
        world=world,
        repeat=repeat,
        grasped=done[-1].grasped,
        distance_m=done[-1].distance if finite else None,
        tilt_deg=math.degrees(math.acos(min(1.0, max(-1.0, upright)))) if finite else None,
        shelf_touched=any(executed.touched for executed in done),
    )


def world_of(plan: Plan, config: ExecuteConfig) -> tuple[WorldSpec, Scene]:
    """The world to execute a plan in, and its scene with the file that it is of, if needed.

    Raises:
      BadInput: the world `scene` is asked for, and there is no file of the plan's scene.
    """
    checked_in = plan.settings.get("world")
    name = config.world or (checked_in if checked_in in ("solid", "scene") else "solid")
    error = world_error_of(config.world_error, name)
    scene = plan.scene
    if name == "scene":
        if config.scenes is None:
            raise BadInput(
                f"plan {scene.name}: to be executed in the world of its scene file; expected "
                "--scenes with the folder of that, or --world solid"
            )
        scene = load_scene(config.scenes / f"{scene.name}.xml")
    spec = WorldSpec.of(name, [scene])
    assert spec is not None
    return dataclasses.replace(spec, error=error, seed=plan.seed), scene
