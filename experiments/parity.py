"""Measures how far an engine ends from MuJoCo C whose solver has converged.

    python experiments/parity.py [SCENES_DIR] [--engine mjx] [--count 60] [--json]
    python experiments/parity.py [SCENES_DIR] --engine native --reference-substeps 300

The engine, at the settings that ship, and `native` with a converged solver simulate the same
rollouts: the reach nominal of each scene with the planner's noise, 8 times (sigma 0.04, seed 0).
The script prints the distances between the final positions (after 3 s) of the objects that `native`
moved by more than 5 mm, and the relative difference of contact forces over 1 N at the first knot
with contact. Without SCENES_DIR the scenes are sampled.
"""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from pgf_jax import configure, load_scene, make_engine, sample_scene
from pgf_jax.physics.config import Physics
from pgf_jax.physics.engine import Rollout, World
from pgf_jax.physics.model import KINEMATIC_ARMATURE
from pgf_jax.profiling.measure import noisy_nominals
from pgf_jax.scene import PUBLISHED_CLASSES

MOVED_M, FORCE_N = 0.005, 1.0


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scenes: Annotated[Path | None, tyro.conf.Positional] = None  # folder of MJCF scenes
    engine: str = "mjx"
    count: int = 60  # scenes
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


def main(config: Config) -> None:
    """Roll out with both engines and print the distances."""
    configure(config.engine)
    if config.scenes is None:
        scenes = [
            sample_scene(config.seed + i, PUBLISHED_CLASSES[i % 3]) for i in range(config.count)
        ]
    else:
        scenes = [load_scene(p) for p in sorted(config.scenes.glob("*.xml"))][: config.count]
    n = len(scenes[0].objects)
    # MuJoCo scales its tolerance by the inertias, which include the hand's armature. A tolerance of
    # 1e-10 for an object needs this smaller value.
    tolerance = 1e-10 / KINEMATIC_ARMATURE
    physics = Physics()
    if config.reference_substeps is not None:
        physics = dataclasses.replace(physics, substeps=config.reference_substeps)
    solver = {"tolerance": tolerance, "iterations": 200, "sleep": False}
    converged = make_engine("native", physics=physics, n_objects=n, **solver)
    lanes = 8
    other = make_engine(config.engine, n_objects=n, lanes=lanes)
    start, controls, gripper = noisy_nominals(converged, scenes, config.seed)
    substeps = other.physics.substeps
    reference = converged.rollout(start, controls, gripper, physics.substeps)
    parts = []
    size = lanes * 8
    for i in range(0, len(controls), size):  # one batch shape; the last call is padded
        index = np.minimum(np.arange(i, i + size), len(controls) - 1)
        part = other.rollout(
            World(*(f[index] for f in start)), controls[index], gripper[index], substeps
        )
        keep = min(size, len(controls) - i)
        parts.append(Rollout(*(np.asarray(f)[:keep] for f in part)))
    result = Rollout(*(np.concatenate(f) for f in zip(*parts, strict=True)))

    moved = np.linalg.norm(reference.objects[:, -1] - start.objects, axis=-1) > MOVED_M
    apart = 1e3 * np.linalg.norm(result.objects[:, -1] - reference.objects[:, -1], axis=-1)[moved]
    forces = force_differences(reference, result)
    slots = result.force.shape[-1]
    figures = {
        "engine": config.engine,
        "scenes": len(scenes),
        "rollouts": len(controls),
        "substep_s": other.physics.substep_s,
        "objects_moved": int(moved.sum()),
        "position_mm": {
            "median": float(np.median(apart)),
            "mean": float(apart.mean()),
            "p95": float(np.percentile(apart, 95)),
        },
        "force_relative_median": float(np.median(forces)),
        "forces_compared": len(forces),
        # Contacts beyond the slots are dropped, the shallowest first (counted at knot ends only).
        "knots_with_all_contact_slots_in_use": int(((result.force > 0).sum(-1) == slots).sum()),
        "non_finite": int((~np.isfinite(result.objects)).any((1, 2, 3)).sum()),
    }
    if config.json:
        print(json.dumps(figures, indent=2))
    else:
        p = figures["position_mm"]
        print(
            f"{config.engine} against native (tolerance 1e-10): {len(scenes)} scenes, "
            f"{len(controls)} rollouts, {figures['objects_moved']} objects moved\n"
            f"final position, mm: median {p['median']:.2f}, mean {p['mean']:.2f}, "
            f"p95 {p['p95']:.2f}\n"
            f"contact force over 1 N, first knot with contact: median difference "
            f"{100 * figures['force_relative_median']:.2f} % of {len(forces)}\n"
            f"knots with all {slots} contact slots in use: "
            f"{figures['knots_with_all_contact_slots_in_use']} of {result.force[..., 0].size}; "
            f"non-finite rollouts: {figures['non_finite']}"
        )


if __name__ == "__main__":
    main(tyro.cli(Config))
