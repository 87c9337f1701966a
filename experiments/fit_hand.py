"""Fits the planar hand to the measured footprint, for the tables of `pgf_jax/physics/hand.py`.

    python experiments/fit_hand.py FOOTPRINT.json

The script prints the joint and the angle of each moving link (least squares over the four gripper
values; the residual says how rigid the link is), and the capsule that covers the footprint of each
link best. The pads of the fingertips are then set by hand: a thin capsule along the inner face and
one across the front, which reaches 6 mm into the gap.
"""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from matplotlib.path import Path as Polygon
from scipy.optimize import minimize

PARENT = {"driver": None, "coupler": "driver", "follower": "coupler", "spring": None}
CELL = 0.0008  # m, grid on which overlap is counted
EDGE = 0.0004  # m, over which a capsule's edge is softened for the optimiser


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    footprint: Annotated[Path, tyro.conf.Positional]


def rigid_motion(before: np.ndarray, after: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Fit the angle, rotation [2, 2] and shift [2] that map one polygon [V, 2] to the other."""
    best = (np.inf, 0.0, np.eye(2), np.zeros(2))
    a = before - before.mean(0)
    for start in range(len(after)):  # the two hulls may start at different vertices
        turned = np.roll(after, start, 0)
        b = turned - turned.mean(0)
        angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, -s], [s, c]])
        error = np.abs(a @ rotation.T - b).max()
        if error < best[0]:
            best = (error, angle, rotation, turned.mean(0) - rotation @ before.mean(0))
    return best[1:]


def distance(points: np.ndarray, capsule: np.ndarray) -> np.ndarray:
    """Signed distance [P] of points [P, 2] to a capsule (x1, y1, x2, y2, radius)."""
    a, b, radius = capsule[:2], capsule[2:4], capsule[4]
    ab = b - a
    t = np.clip(((points - a) @ ab) / max(ab @ ab, 1e-12), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * ab, axis=1) - radius


def fit_capsule(polygon: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit the capsule whose area differs least from the polygon's; also returns that area, mm^2."""
    low, high = polygon.min(0) - 0.015, polygon.max(0) + 0.015
    axes = [np.arange(low[i], high[i], CELL) for i in (0, 1)]
    points = np.stack(np.meshgrid(*axes), -1).reshape(-1, 2)
    inside = Polygon(polygon).contains_points(points)
    centred = polygon - polygon.mean(0)
    along, across = np.linalg.svd(centred)[2]
    radius = np.abs(centred @ across).max()
    reach = np.abs(centred @ along).max() - radius
    start = np.array(
        [*(polygon.mean(0) - reach * along), *(polygon.mean(0) + reach * along), radius]
    )

    def mismatch(capsule: np.ndarray) -> float:
        covered = 1 / (1 + np.exp(np.clip(distance(points, capsule) / EDGE, -50, 50)))
        return np.where(inside, 1 - covered, covered).sum() * CELL**2 * 1e6

    simplex = np.vstack([start, start + 0.004 * np.eye(5)])
    found = minimize(mismatch, start, method="Nelder-Mead", options={"initial_simplex": simplex})
    return found.x, found.fun


def main(config: Config) -> None:
    """Fit and print the links and capsules."""
    measured = json.loads(config.footprint.read_text())["gripper"]
    shapes = {g: {n: np.array(p) for n, p in links.items()} for g, links in measured.items()}
    closing = [g for g in shapes if g != "0"]
    for side in ("right", "left"):
        motions = {
            (link, g): rigid_motion(
                shapes["0"][f"{side}_{link}_mesh"], shapes[g][f"{side}_{link}_mesh"]
            )
            for link in PARENT
            for g in closing
        }
        for link, parent in PARENT.items():
            rows, values = [], []
            for g in closing:
                _, rotation, shift = motions[link, g]
                _, base, base_shift = (
                    motions[parent, g] if parent else (0.0, np.eye(2), np.zeros(2))
                )
                rows.append(rotation - base)
                values.append(base_shift - shift)
            matrix, target = np.concatenate(rows), np.concatenate(values)
            joint = np.linalg.lstsq(matrix, target, rcond=None)[0]
            residual = np.abs(matrix @ joint - target).max()
            print(
                f"{side}_{link}: joint ({joint[0]:.4f}, {joint[1]:.4f}), angle at 255 "
                f"{motions[link, '255'][0]:.4f} rad, residual {1e3 * residual:.3f} mm"
            )
    for name, polygon in shapes["0"].items():
        capsule, area = fit_capsule(polygon)
        print(f"{name}: {np.round(capsule, 4).tolist()}, {area:.0f} mm^2 mismatched")


if __name__ == "__main__":
    main(tyro.cli(Config))
