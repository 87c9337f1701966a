"""Is the robot that help saves most time the one to help? Policies that rank robots by time.

    python experiments/ranking.py [--tune] [--sets every packed] [--seeds 0 1] [--draw]

Fleets of 1, 10, 20 and 30 robots on four sets of scenes, in the solid world. What a fleet gave is
stored as a row, and a fleet that has a row is not computed again, so that the study can grow seed
by seed. Policies and their options are chosen on seeds 100 to 107 (`--tune`), and judged on seeds 0
to 7. Intervals are 95 % (Student's t), over seeds, of paired differences: the same scenes, the same
noise and the same service times. Solved an operator minute is the return on human effort, and
fan-out how many robots one operator could serve if none waited (`metrics/effort.py`).
"""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path

import polars as pl
from study_rows import difference, over_seeds, table, text
from study_runs import RAW, ROOT, Run, rows_of, script

from pgf_jax import SweepConfig, sweep
from pgf_jax.files import write_atomically
from pgf_jax.sweeping.summary import csv

POLICIES = ("or-hitl", "pgf", "or-hitl+plan", "pgf+plan", "time-saved", "gain-rate", "urgency")
BEST, BASE, ORACLE = "gain-rate", "or-hitl", "oracle-time"
KEY = ("set", "robots", "policy", "seed")


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    sets: tuple[str, ...] = ("all", "every", "crowded", "packed")
    robots: tuple[int, ...] = (1, 10, 20, 30)
    policies: tuple[str, ...] = POLICIES
    seeds: tuple[int, ...] | None = None  # None: 0 to 7, or 100 to 107
    tune: bool = False  # the seeds by which policies and options are chosen
    draw: bool = False  # only write the tables, from the stored rows
    out: Path = ROOT / "experiments/results"
    raw: Path = RAW / "ranking"


def tasks_of(robots: int) -> int:
    """Tasks of each robot: more where there is one robot, so that its fleet says something."""
    return 40 if robots == 1 else 5


def batches(config: Config) -> Iterator[tuple[str, int, tuple[int, ...]]]:
    """What is computed together: a set, a fleet size, and seeds.

    The tasks of one robot come one after another, so its seeds share their batches of rollouts.
    """
    first = 100 if config.tune else 0
    seeds = config.seeds or tuple(range(first, first + 8))
    for name in config.sets:
        if 1 in config.robots:
            yield name, 1, seeds
    for seed in seeds:
        for name in config.sets:
            for robots in config.robots:
                if robots > 1:
                    yield name, robots, (seed,)


def compute(config: Config, path: Path) -> None:
    """Compute the fleets that have no row, and store their rows as they end."""
    rows = pl.read_csv(path).to_dicts() if path.exists() else []
    for name, robots, seeds in batches(config):
        there = {tuple(row[key] for key in KEY) for row in rows}
        fleets = itertools.product(config.policies, seeds)
        lacking = [(p, seed) for p, seed in fleets if (name, robots, p, seed) not in there]
        if not lacking:
            continue
        policies, seeds = (tuple(dict.fromkeys(names)) for names in zip(*lacking, strict=True))
        sweep_config = SweepConfig(
            robots=(robots,),
            tasks=tasks_of(robots),
            policies=policies,
            seeds=seeds,
            scene_class=name,  # pyright: ignore[reportArgumentType]
            resume=True,
        )
        run = Run({"set": name, "robots": robots, "seeds": "-".join(map(str, seeds))}, sweep_config)
        sweep_config = dataclasses.replace(sweep_config, out=run.folder(config.raw))
        found = [
            {"set": name, **row} for row in rows_of(sweep_config, sweep(sweep_config, quiet=True))
        ]
        rows += [row for row in found if tuple(row[key] for key in KEY) not in there]
        write_atomically(path, csv(pl.DataFrame(rows, infer_schema_length=None).sort(KEY)))
        print(f"{name}, {robots} robots, seeds {seeds}: {', '.join(policies)}", flush=True)


def tables(frame: pl.DataFrame) -> str:
    """The tables as Markdown: by set and fleet size, every policy against `BEST`."""
    headings = ["robots", "policy", "seeds", "success, %", "planning, s", "in the task, s"]
    headings += [f"`{BEST}` less it, s", "success, points"]
    headings += ["utilisation", "solved an operator minute", "fan-out"]
    parts = []
    for name in dict.fromkeys(frame["set"]):
        of_set = frame.filter(set=name)
        rows = []
        for robots in sorted(set(of_set["robots"])):
            ours = of_set.filter(robots=robots, policy=BEST)
            for policy in dict.fromkeys(of_set.filter(robots=robots)["policy"]):
                its = of_set.filter(robots=robots, policy=policy)
                cells = [str(robots), f"`{policy}`", str(len(its))]
                cells += [text(over_seeds(its, "success"), scale=100)]
                cells += [text(over_seeds(its, c)) for c in ("planning_time_s", "task_time_s")]
                if policy == BEST or not len(ours):
                    cells += ["", ""]
                else:
                    cells += [
                        text(difference(ours, its, "task_time_s")),
                        text(difference(ours, its, "success"), scale=100),
                    ]
                cells += [
                    text(over_seeds(its, c), 2)
                    for c in ("utilisation", "return_on_effort", "fan_out")
                ]
                rows.append(cells)
        lines = [
            f"## {name}",
            "",
            table(headings, rows),
            "",
            *way_to_oracle(of_set),
            served(of_set),
        ]
        parts.append("\n".join(lines).rstrip() + "\n")
    return "\n".join(parts)


def way_to_oracle(of_set: pl.DataFrame) -> list[str]:
    """How much of what `oracle-time` saves against `or-hitl`, `BEST` saves; a line a fleet size."""
    lines = []
    for robots in sorted(set(of_set.filter(policy=ORACLE)["robots"])):
        oracle, ours, base = (
            of_set.filter(robots=robots, policy=policy) for policy in (ORACLE, BEST, BASE)
        )
        most, saved = (difference(base, of, "task_time_s") for of in (oracle, ours))
        share = f"{100 * saved.mean / most.mean:.0f} %" if most.mean > 0 else "no share"
        lines += [
            f"With {robots} robots `{ORACLE}` saves {text(most)} s against `{BASE}`, and `{BEST}` "
            f"{text(saved)}: {share} of it.",
            "",
        ]
    return lines


def served(of_set: pl.DataFrame) -> str:
    """The largest fleet of `BEST` whose time in the task is no longer than that of `BASE` with 10.

    Between two sizes that were computed the time is taken to grow in a straight line.
    """

    def mean_s(policy: str, robots: int) -> float:
        return over_seeds(of_set.filter(policy=policy, robots=robots), "task_time_s").mean

    limit_s = mean_s(BASE, 10)
    sizes = sorted(set(of_set.filter(policy=BEST)["robots"]))
    times = [mean_s(BEST, robots) for robots in sizes]
    within = [i for i, time_s in enumerate(times) if time_s <= limit_s]
    if not within:
        return ""
    last = within[-1]
    most = f"{sizes[last]} robots or more"
    if last + 1 < len(sizes):
        part = (limit_s - times[last]) / (times[last + 1] - times[last])
        most = f"{int(sizes[last] + part * (sizes[last + 1] - sizes[last]))} robots"
    return f"`{BEST}` serves {most} at the {limit_s:.1f} s that `{BASE}` needs with 10."


def main(config: Config) -> None:
    """Compute the missing fleets, then write the tables."""
    name = "ranking_tuning" if config.tune else "ranking"
    path = config.out / f"{name}.csv"
    if not config.draw:
        compute(config, path)
    report = f"# Policies that rank by time{' (tuning)' if config.tune else ''}\n\n"
    command = "python experiments/ranking.py" + (" --tune" if config.tune else "")
    report += f"Written by `{command}`, which says what was done.\n\n"
    report += tables(pl.read_csv(path))
    write_atomically(config.out / f"{name}.md", report.encode())
    print(report)


if __name__ == "__main__":
    script(main, Config)
