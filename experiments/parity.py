"""Measures how far an engine ends from MuJoCo C whose solver has converged.

    python experiments/parity.py [SCENES_DIR] [--engine mjx] [--count 60] [--json]
    python experiments/parity.py [SCENES_DIR] --engine native --reference-substeps 300

The engine, at the settings that ship, and `native` with a converged solver simulate the same
rollouts: the reach nominal of each scene with the planner's noise, 8 times (sigma 0.04, seed 0).
The script prints the distances between the final positions (after 3 s) of the objects that `native`
moved by more than 5 mm, and the relative difference of contact forces over 1 N at the first knot
with contact. Without SCENES_DIR the scenes are sampled, of `--classes`.
"""

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from pgf_jax import configure, load_scene, make_engine, sample_scene
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Engine, Rollout
from pgf_jax.physics.model import KINEMATIC_ARMATURE
from pgf_jax.physics.sized import SizedEngine
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import start_world
from pgf_jax.profiling.measure import Nominals, noisy_nominals
from pgf_jax.scene import PUBLISHED_CLASSES, Scene, SceneClass

MOVED_M, FORCE_N = 0.005, 1.0


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: Annotated[Path | None, tyro.conf.Positional] = None  # folder of MJCF scenes
    engine: str = "mjx"
    count: int = 60  # scenes
    classes: tuple[SceneClass, ...] = PUBLISHED_CLASSES  # of sampled scenes, in turn
    seed: int = 0
    reference_substeps: int | None = None  # of the reference, to measure the error of the substep
    json: bool = False


def force_differences(reference: Rollout, other: Rollout) -> np.ndarray:
    """Relative differences of the forces over 1 N of pairs of bodies, at the first such knot."""
    differences = []
    for force, bodies, force2, bodies2 in zip(
        reference.force, reference.bodies, other.force, other.bodies, strict=True
    ):
        knots = np.flatnonzero((force > FORCE_N).any(1))
        if len(knots):
            k = knots[0]
            mine, theirs = by_pair(force[k], bodies[k]), by_pair(force2[k], bodies2[k])
            differences += [
                abs(theirs.get(pair, 0.0) - f) / f for pair, f in mine.items() if f > FORCE_N
            ]
    return np.array(differences)


def by_pair(force: np.ndarray, bodies: np.ndarray) -> dict[tuple[int, int], float]:
    """Sum of the contact forces of each pair of bodies, N."""
    total: dict[tuple[int, int], float] = {}
    for f, (a, b) in zip(force, bodies, strict=True):
        if f > 0:
            pair = (int(min(a, b)), int(max(a, b)))
            total[pair] = total.get(pair, 0.0) + float(f)
    return total


def rolled(nominals: Nominals, engine: SizedEngine, lanes: int) -> Rollout:
    """All rollouts, in calls of one shape, of which the last is padded."""
    count, size, parts = len(nominals.controls), lanes * 8, []
    for i in range(0, count, size):
        index = np.minimum(np.arange(i, i + size), count - 1)
        part = jax.tree.map(lambda x, index=index: x[index], nominals)
        out = part.roll(engine, engine.physics.substeps)
        parts.append(jax.tree.map(lambda x, i=i: np.asarray(x)[: count - i], out))
    return jax.tree.map(lambda *xs: np.concatenate(xs), *parts)


def main(config: Config) -> None:
    """Roll out with both engines and print the distances."""
    configure(config.engine)
    if config.scenes is not None:
        scenes = [load_scene(p) for p in sorted(config.scenes.glob("*.xml"))][: config.count]
    else:
        classes = config.classes
        scenes = [
            sample_scene(config.seed + i, classes[i % len(classes)]) for i in range(config.count)
        ]
    # MuJoCo scales its tolerance by the inertias, which include the hand's armature. A tolerance of
    # 1e-10 for an object needs this smaller value.
    tolerance = 1e-10 / KINEMATIC_ARMATURE
    physics = Physics()
    if config.reference_substeps is not None:
        physics = dataclasses.replace(physics, substeps=config.reference_substeps)
    solver = {"tolerance": tolerance, "iterations": 200, "sleep": False}

    def converged(n_objects: int) -> Engine:
        return make_engine("native", physics=physics, n_objects=n_objects, **solver)

    lanes = 8
    reference = SizedEngine(converged, name="native", physics=physics, lanes=lanes)
    other = SizedEngine.of_name(config.engine, Physics(), lanes)

    planner = BatchPlanner(other)

    def program(scene: Scene) -> tuple[int, bool]:
        return planner.begin_reach(start_world(scene.positions), scene.goal, scene.shelf).program

    moved, apart, forces = 0, [], []
    full = knots = bad = rollouts = programs = 0
    for (count, _), some in itertools.groupby(sorted(scenes, key=program), key=program):
        group, programs = [*some], programs + 1
        nominals = noisy_nominals(other, group, config.seed)
        result = rolled(nominals, other, lanes)
        a_scene = len(nominals.controls) // len(group)
        for i, scene in enumerate(group):
            n, own = len(scene.objects), slice(a_scene * i, a_scene * (i + 1))
            alone = noisy_nominals(reference, [scene], config.seed)
            alone = alone._replace(controls=nominals.controls[own])
            exact = alone.roll(reference, physics.substeps)
            ours = jax.tree.map(lambda x, own=own: x[own], result)
            went = np.linalg.norm(exact.objects[:, -1] - alone.start.objects, axis=-1) > MOVED_M
            ends = ours.objects[:, -1, :n] - exact.objects[:, -1]
            apart += (1e3 * np.linalg.norm(ends, axis=-1)[went]).tolist()
            moved += int(went.sum())
            # Hand and walls are numbered after the places, of which some may be empty.
            beyond = (count - n) * (ours.bodies >= count)
            named = ours._replace(bodies=ours.bodies - beyond)
            forces += force_differences(exact, named).tolist()
        full += int((result.force > 0).all(-1).sum())
        knots += result.force[..., 0].size
        bad += int((~np.isfinite(result.objects)).any((1, 2, 3)).sum())
        rollouts += len(result.force)
    figures = {
        "engine": config.engine,
        "scenes": len(scenes),
        "rollouts": rollouts,
        "programs": programs,
        "substep_s": other.physics.substep_s,
        "objects_moved": moved,
        "position_mm": {
            "median": float(np.median(apart)),
            "mean": float(np.mean(apart)),
            "p95": float(np.percentile(apart, 95)),
        },
        "force_relative_median": float(np.median(forces)),
        "forces_compared": len(forces),
        # Contacts beyond the slots are dropped, the shallowest first (counted at knot ends only).
        "knots_with_all_contact_slots_in_use": full,
        "knots": knots,
        "non_finite": bad,
    }
    if config.json:
        print(json.dumps(figures, indent=2))
    else:
        p = figures["position_mm"]
        print(
            f"{config.engine} against native (tolerance 1e-10): {len(scenes)} scenes, "
            f"{rollouts} rollouts, {moved} objects moved\n"
            f"final position, mm: median {p['median']:.2f}, mean {p['mean']:.2f}, "
            f"p95 {p['p95']:.2f}\n"
            f"contact force over 1 N, first knot with contact: median difference "
            f"{100 * figures['force_relative_median']:.2f} % of {len(forces)}\n"
            f"knots with all contact slots in use: {full} of {knots}; programs: {programs}; "
            f"non-finite rollouts: {bad}"
        )


if __name__ == "__main__":
    main(tyro.cli(Config))
