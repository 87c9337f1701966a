"""Compares sampled scenes with the published ones: one row of statistics for each class.

    python experiments/scene_statistics.py [--count 1000] [--seed 0] [DIRECTORY of published scenes]

Published files warehouse_1..1000 are `tight`, 1001..2000 `medium`, 2001..3000 `wide`.
"""

import argparse
import re
import sys

from pgf_jax.errors import BadInput
from pgf_jax.scene import (
    PRESETS,
    PUBLISHED_CLASSES,
    Scene,
    load_scenes,
    sample_scene,
    scene_statistics,
)

COLUMNS = (
    f"{'class':<17}{'scenes':>6}  {'x range':<11}{'y range':<12}{'goal x 5..50..95 %':<20}"
    f"{'deeper':<11}{'corridor':<11}{'spacing':<9}{'nearest 5..50..95 %':<21}pairs < 0.08"
)


def main() -> int:
    parser = argparse.ArgumentParser(description="statistics of scene classes")
    parser.add_argument("directory", nargs="?", help="published scenes to compare with")
    parser.add_argument("--count", type=int, default=1000, help="sampled scenes a class")
    parser.add_argument("--seed", type=int, default=0, help="the first of the seeds")
    args = parser.parse_args()
    if args.count < 1:
        parser.error(f"argument --count: expected 1 or more, got {args.count}")
    try:
        published = _by_class(load_scenes(args.directory)) if args.directory else {}
        print(COLUMNS)
        for preset in PRESETS:
            seeds = range(args.seed, args.seed + args.count)
            print(_row(preset, [sample_scene(seed, preset) for seed in seeds]))
            if preset in published:
                print(_row(f"{preset}, published", published[preset]))
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _by_class(scenes: list[Scene]) -> dict[str, list[Scene]]:
    classes: dict[str, list[Scene]] = {}
    for scene in scenes:
        number = re.search(r"\d+$", scene.name)
        index = (int(number[0]) - 1) // 1000 if number else -1
        if not 0 <= index < len(PUBLISHED_CLASSES):
            raise BadInput(f"scene {scene.name}: expected a name that ends in a number 1..3000")
        classes.setdefault(PUBLISHED_CLASSES[index], []).append(scene)
    return classes


def _row(label: str, scenes: list[Scene]) -> str:
    s = scene_statistics(scenes)
    y_range = f"{s.y_range[0]:.2f}..{s.y_range[1]:.2f}"
    goal_x = ", ".join(f"{q:.3f}" for q in s.goal_x)
    nearest = ", ".join(f"{q:.4f}" for q in s.nearest)
    deeper = f"{s.deeper[0]:.0f} to {s.deeper[2]:.0f}"
    corridor = f"{s.corridor_mean:.2f} (>={s.corridor_min})"
    return (
        f"{label:<17}{s.scenes:>6}  {s.x_range[0]:.2f}..{s.x_range[1]:.2f} {y_range:<12}"
        f"{goal_x:<20} {deeper:<10}{corridor:<11}{s.spacing_min:<9.4f}{nearest:<21} "
        f"{s.near_pairs:.2f}"
    )


if __name__ == "__main__":
    sys.exit(main())
