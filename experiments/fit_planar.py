"""Fits the free constants of the planar world to the solid one.

    python experiments/fit_planar.py [--scenes 120] [--rollouts 8]

Scenes of the three classes are planned with their solutions checked in the solid world. Around each
solution, noisy trajectories are executed there, and rolled out on the plane with several choices of
the constants. A line each says how often the two agree on what is grasped, what share of the
plane's grasps are true (precision), what share of the true ones it finds (recall), and how far
apart objects end that were moved by more than 5 mm. `inset` is how far the tips' fronts reach into
the gap (`physics/hand.py`), m; the others are fields of `Physics`.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console

from pgf_jax import PlanConfig, configure, make_engine, sample_scene
from pgf_jax.physics import hand, model
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.physics.worlds.world import GRASP_M, Command, Executed, execute_all
from pgf_jax.planning.config import Cost
from pgf_jax.planning.cost import reach_distance
from pgf_jax.plans.plan import plan_scenes
from pgf_jax.scene import PUBLISHED_CLASSES

INSET = 0.006  # m, of the planar hand
CHOICES: tuple[dict[str, float], ...] = (
    {"hand_friction": 1.0, "finger_creep": 1.0},
    {"hand_friction": 1.0},
    {"hand_friction": 0.5},
    {"hand_friction": 0.3},  # an object's own: MuJoCo takes the larger of two
    {"hand_friction": 0.15, "object_friction": 0.15},
    {"hand_friction": 0.3, "damping": 0.0},
    {"hand_friction": 0.3, "armature": 0.0},
    {"hand_friction": 0.3, "frictionloss": 3.3},
    {"hand_friction": 0.3, "frictionloss": 4.5},
    {"hand_friction": 0.3, "inset": 0.003},
    {"hand_friction": 0.3, "inset": 0.0},
)


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: int = 120  # a third of each class
    rollouts: int = 8  # of each solution; the first is the solution itself
    noise: float = 0.04  # of the others, m/s and rad/s
    seed: int = 7000


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """Trajectories, and what became of them in the solid world: B of them, N objects."""

    start: World  # [B, N, 2] and so on
    controls: np.ndarray  # [B, T, 3]
    gripper: np.ndarray  # [B, T]
    goals: np.ndarray  # [B]
    grasped: np.ndarray  # [B]
    ends: np.ndarray  # [B, N, 2]


def truth_of(config: Config) -> Truth:
    """Plan, draw trajectories around the solutions, and execute them in the solid world."""
    scenes = [
        (sample_scene(config.seed + i // 3, PUBLISHED_CLASSES[i % 3]), config.seed + i)
        for i in range(config.scenes)
    ]
    plans = [p for p in plan_scenes(scenes, PlanConfig(world="solid", lanes=64)) if p.solved]
    noise, world = np.random.default_rng(config.seed), SolidWorld(len(scenes[0][0].objects))
    commands: list[Command] = []
    for plan in plans:
        state, reach = world.start(plan.scene), plan.segments[-1]
        for k in range(config.rollouts):
            off = config.noise * (k > 0) * noise.standard_normal(reach.controls.shape)
            commands.append(
                Command(
                    state,
                    reach.controls.astype(float) + off,
                    reach.gripper.astype(float),
                    reach.duration_s,
                    goal=plan.scene.goal,
                )
            )
    done: list[Executed] = execute_all([(world, command) for command in commands])
    seen = [world.seen(command.state) for command in commands]
    return Truth(
        World(*(np.stack(x) for x in zip(*seen, strict=True))),
        np.array([command.controls for command in commands]),
        np.array([command.gripper for command in commands]),
        np.array([command.goal for command in commands]),
        np.array([one.grasped for one in done]),
        np.array([one.rollout.objects[-1] for one in done]),
    )


def compare(truth: Truth, choice: dict[str, float]) -> str:
    """Roll the trajectories out on the plane; returns how it agrees, as text."""
    constants: dict[str, Any] = {"finger_creep": 0.0, **choice}
    inset = constants.pop("inset", INSET)
    capsules = hand.CAPSULES
    try:
        hand.CAPSULES = with_inset(inset)
        model.compile_model.cache_clear()
        engine = make_engine("native", physics=Physics(**constants))
        out = engine.rollout(truth.start, truth.controls, truth.gripper, engine.physics.substeps)
    finally:
        hand.CAPSULES = capsules
        model.compile_model.cache_clear()
    pose, objects = (
        jnp.asarray(x, jnp.float32) for x in (out.hand[:, -1], np.asarray(out.objects)[:, -1])
    )
    each = np.arange(len(truth.goals))
    found = np.asarray(reach_distance(pose, objects, Cost()))[each, truth.goals] < GRASP_M
    moved = np.linalg.norm(truth.ends - truth.start.objects, axis=-1) > 0.005
    apart = 1e3 * np.linalg.norm(np.asarray(out.objects)[:, -1] - truth.ends, axis=-1)[moved]
    agree, precision, recall = (
        100 * share.mean()
        for share in (found == truth.grasped, truth.grasped[found], found[truth.grasped])
    )
    return (
        f"agree {agree:.1f} %, precision {precision:.1f} %, recall {recall:.1f} %, "
        f"apart {np.median(apart):.1f} mm (median), {apart.mean():.1f} mm (mean)"
    )


def with_inset(inset: float) -> tuple:
    """The capsules of the hand with another inset of the tips' fronts, m."""
    capsules = list(hand.CAPSULES)
    for number, y in hand.MEASURED_FRONTS.items():
        owner, x1, _, x2, y2, radius = capsules[number]
        capsules[number] = (owner, x1, y - float(np.sign(y)) * inset, x2, y2, radius)
    return tuple(capsules)


def main(config: Config) -> None:
    """Fit, and print the results."""
    configure()
    console = Console(width=160)
    truth = truth_of(config)
    share = 100 * truth.grasped.mean()
    console.print(f"{len(truth.goals)} trajectories, {share:.1f} % grasp in the solid world")
    for choice in CHOICES:
        words = " ".join(f"{name}={value}" for name, value in choice.items())
        console.print(f"{words}: {compare(truth, choice)}")


if __name__ == "__main__":
    main(tyro.cli(Config))
