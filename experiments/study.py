"""The whole study: computes the fleets that have no row yet, then draws the report.

    python experiments/study.py [--preset quick|full] [--parts served] [--hours 2] [--draw]

What is computed stands in `study_points.py`. The scenes of a set under one seed are computed
together, whatever the policy, fleet size or setting, because their searches are mostly the same.
Each fleet's row is stored, so that the study continues where it was interrupted, and grows. When
all points are done, the named differences get more seeds until their intervals are narrow enough.
`--hours` stops it before the next seed of a set that would take longer. Intervals are 95 %
(Student's t) over seeds; differences are paired by seed: the same scenes, noise and service times.
"""

import dataclasses
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import polars as pl
import study_report as report
import study_times
from rich.console import Console
from study_points import NAMED, POINTS, Difference, Point, scenes_of
from study_rows import difference
from study_runs import RAW, ROOT, Run, rows_of, script, stored

from pgf_jax import SweepConfig, sweeps
from pgf_jax.files import write_atomically
from pgf_jax.sweeping.summary import csv

KEY = ("set", "setting", "robots", "policy", "seed")
Key = tuple[str, str, int, str, int]


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    preset: Literal["quick", "full"] = "full"
    parts: tuple[str, ...] = ()  # of the study; none: all
    sets: tuple[str, ...] = ()  # of scenes; none: all
    policies: tuple[str, ...] = ()  # none: all
    seeds: tuple[int, ...] = ()  # none: all
    hours: float | None = None  # None: until all is done
    draw: bool = False  # only draw, from the stored rows
    scheduler: str | None = None  # as of `pgf-jax sweep`
    raw: Path = RAW  # folder of the raw results


@dataclasses.dataclass(frozen=True)
class Fleets:
    """Fleets of a point on one set under one seed."""

    name: str  # of the set
    seed: int
    point: Point

    def named(self) -> Iterator[Key]:
        """The keys of their rows."""
        point = self.point
        for robots, policy in itertools.product(point.robots, point.policies):
            yield self.name, point.setting, robots, policy, self.seed

    @property
    def tasks(self) -> int:
        """All tasks of all of them."""
        return sum(self.point.robots) * len(self.point.policies) * self.point.tasks


def small(point: Point) -> Point:
    """A point for those who try the study: two seeds, two robots, one task."""
    seeds = point.seeds[: 1 + (point.part != "tuning")]
    return dataclasses.replace(point, robots=(2,), seeds=seeds, tasks=1)


def lacking(fleets: Fleets, there: set[Key]) -> list[Fleets]:
    """What has no row, as fleets whose policies and sizes are every combination."""
    found = []
    for robots in fleets.point.robots:
        point = dataclasses.replace(fleets.point, robots=(robots,))
        keys = [key for key in dataclasses.replace(fleets, point=point).named() if key not in there]
        if keys:
            point = dataclasses.replace(point, policies=tuple(policy for *_, policy, _ in keys))
            found.append(dataclasses.replace(fleets, point=point))
    return found


def run_of(fleets: Fleets, config: Config) -> Run:
    """The sweep that computes fleets; its labels are columns of their rows."""
    point = fleets.point
    sweep = SweepConfig(
        robots=point.robots,
        policies=point.policies,
        tasks=point.tasks,
        seed=fleets.seed,
        resume=True,
        scheduler=config.scheduler,
        **scenes_of(fleets.name) | dict(point.changes),
    )
    run = Run({"set": fleets.name, "setting": point.setting, "robots": point.robots[0]}, sweep)
    folder = run.folder(config.raw / config.preset)
    return dataclasses.replace(run, config=dataclasses.replace(sweep, out=folder))


class Rows:
    """The stored rows, and what they say about the time that the others will take."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = pl.read_csv(path, infer_schema_length=None).to_dicts() if path.exists() else []
        for row in self.rows:
            row["setting"] = row["setting"] or ""
        self._spent: dict[str, tuple[float, int]] = {}  # set -> seconds, tasks

    @property
    def keys(self) -> set[Key]:
        """Of the fleets that have a row."""
        return {tuple(row[key] for key in KEY) for row in self.rows}  # pyright: ignore[reportReturnType]

    def compute(self, fleets: Sequence[Fleets], config: Config) -> None:
        """Compute fleets together, and store their rows."""
        start, start_core_s = time.monotonic(), study_times.processor_s()
        runs = [run_of(one, config) for one in fleets]
        outcomes = sweeps([run.config for run in runs], quiet=False, tables=False)
        for run, outcome in zip(runs, outcomes, strict=True):
            self.rows += [dict(run.labels) | row for row in rows_of(run.config, outcome)]
        frame = pl.DataFrame(self.rows, infer_schema_length=None).sort(KEY)
        write_atomically(self.path, csv(frame))
        took_s, done = time.monotonic() - start, sum(one.tasks for one in fleets)
        noted = [(one.point.part, one.name, one.seed, one.tasks) for one in fleets]
        core_s = study_times.processor_s() - start_core_s
        study_times.note(self.path.with_name(study_times.NAME), noted, core_s)
        seconds, tasks = self._spent.get(fleets[0].name, (0.0, 0))
        self._spent[fleets[0].name] = seconds + took_s, tasks + done

    def seconds(self, fleets: Sequence[Fleets]) -> float:
        """The time that fleets will take, by what others of their set took, s; 0: unknown."""
        total = [sum(part) for part in zip(*self._spent.values(), strict=True)] or [0.0, 1]
        left = 0.0
        for one in fleets:
            seconds, tasks = self._spent.get(one.name, total)
            left += one.tasks * seconds / tasks
        return left


def batches(points: Sequence[Point], config: Config, there: set[Key]) -> list[list[Fleets]]:
    """The fleets that are lacking; those of a set and a seed are together."""
    found: dict[tuple[int, str], list[Fleets]] = {}
    for point in points:
        if config.policies:
            policies = tuple(name for name in point.policies if name in config.policies)
            point = dataclasses.replace(point, policies=policies)
        for seed, name in itertools.product(point.seeds, point.sets):
            if (config.seeds and seed not in config.seeds) or (
                config.sets and name not in config.sets
            ):
                continue
            of_point = lacking(Fleets(name, seed, point), there)
            there |= {key for fleets in of_point for key in fleets.named()}
            found.setdefault((seed, name), []).extend(of_point)
    order = list(dict.fromkeys(name for point in points for name in point.sets))
    places = sorted(found, key=lambda place: (place[0], order.index(place[1])))
    return [found[place] for place in places if found[place]]


def undecided(rows: pl.DataFrame, one: Difference) -> bool:
    """Whether the interval of a difference is wider than it shall be."""
    its = rows.filter(pl.col("seed") < 100, set=one.set, setting=one.setting, robots=one.robots)
    found = difference(its.filter(policy=one.ours), its.filter(policy=one.theirs), "task_time_s")
    return not found.high - found.low <= one.width_s


def more_seeds(rows: Rows) -> list[Fleets]:
    """One more seed of the first named difference that is undecided; none: there is none."""
    frame = pl.DataFrame(rows.rows, infer_schema_length=None)
    for one in NAMED:
        for seed in range(one.seeds if undecided(frame, one) else 0):
            point = Point("named", one.setting, (one.set,), (one.ours, one.theirs), (one.robots,))
            found = lacking(Fleets(one.set, seed, point), rows.keys)
            if found:
                return found
    return []


def compute(config: Config, out: Path) -> None:
    """Compute what has no row, until all is done or the time is over."""
    console = Console(stderr=True)
    start, rows = time.monotonic(), Rows(out / "study.csv")
    points = [small(point) for point in POINTS] if config.preset == "quick" else list(POINTS)
    points = [point for point in points if not config.parts or point.part in config.parts]
    some = config.parts or config.sets or config.policies or config.seeds
    everything = config.preset == "full" and not some
    while True:
        to_do = batches(points, config, rows.keys)
        if not to_do and everything:
            to_do = [more] if (more := more_seeds(rows)) else []
        if not to_do:
            return
        tasks = sum(one.tasks for batch in to_do for one in batch)
        left, spent = sum(map(rows.seconds, to_do)), time.monotonic() - start
        guess = f", about {left / 60:.0f} min" if left else ""
        console.print(f"{spent / 60:.0f} min; left: {len(to_do)} batches, {tasks} tasks{guess}")
        if config.hours is not None and spent + rows.seconds(to_do[0]) > 3600 * config.hours:
            console.print("the time is over; the same command continues")
            return
        rows.compute(to_do[0], config)


def main(config: Config) -> None:
    """Compute the missing fleets, then draw."""
    out = stored(config.preset)
    if not config.draw:
        compute(config, out)
    print(report.write(out))
    if config.preset == "full":
        report.write_text(out, ROOT / "experiments/README.md")


if __name__ == "__main__":
    script(main, Config)
