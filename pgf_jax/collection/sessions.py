"""Recorded sessions as runs to train on.

A log holds the inputs of a session and their times. So the session is replayed bit for bit, and its
robots record their runs once more. A run that ends early is carried forward with its last cost when
training rows are made of it (`training.rows`): right for a solved task or one out of time, wrong
for one that the end of its session cut off. Those are left out.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.fleet.events import EventKind
from pgf_jax.planning.types import Status
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.simulation.robot import Robot
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.sweeping.replay import replay, replay_difference
from pgf_jax.tables.event_log import EventLog, digest

_SEEDS = 2**32  # a seed is less

_Task = tuple[int, int]  # robot, task


@dataclasses.dataclass(frozen=True, eq=False)
class Sessions:
    """The runs of recorded sessions.

    Attributes:
      runs: in the columns of `runs.parquet`, one frame for each task that ended by itself; empty
        where it ended before an iteration did.
      tasks: tasks that were begun.
      cut_off: those of them that did not end by themselves.
      about: of each session, for the file's metadata: its `settings`, its `operator`, the
        `versions` that it was recorded with, `sha256` of its events, `tasks` and `cut_off`.
    """

    runs: list[pl.DataFrame]
    tasks: int
    cut_off: int
    about: list[dict[str, Any]]


def replay_sessions(
    paths: Sequence[Path | str], *, on_progress: Callable[[int, int], None] | None = None
) -> Sessions:
    """Replay sessions to their ends.

    A run is named by its scene and seed. Scenes of a folder are planned by several robots, each
    with noise of its own; there, the runs of one seed are told apart by `_seed_of`.

    Args:
      paths: the logs: folders of sessions, events.jsonl or events.parquet.
      on_progress: called with (tasks ended, tasks begun in all logs) at the start and as they end.

    Raises:
      BadInput: one line that names the log: it cannot be read, is no session's, does not replay as
        it was recorded, or holds a run that another one holds too.
    """
    replays = [_Replay(path) for path in paths]  # before any is run: a bad one costs no time
    wanted = sum(r.begun for r in replays)
    done = 0

    def ended() -> None:
        nonlocal done
        done += 1
        if on_progress is not None:
            on_progress(done, wanted)

    if on_progress is not None:
        on_progress(0, wanted)
    holder: dict[tuple[str, int], Path] = {}
    runs: list[pl.DataFrame] = []
    about = []
    tasks = cut_off = 0
    while replays:
        session = replays.pop(0)
        whole, cut = session.runs(ended)
        for run in whole:
            _check_new(run, session.log.path, holder)
        runs += whole
        tasks += len(whole) + cut
        cut_off += cut
        about.append(_about(session.log) | {"tasks": len(whole) + cut, "cut_off": cut})
    return Sessions(runs, tasks, cut_off, about)


class _Replay:
    """One session, before it is replayed."""

    def __init__(self, path: Path | str) -> None:
        self._runner: FleetRunner
        self.log: EventLog
        self._runner, self.log = replay(path, on_task_end=self._task_end)
        self.begun = sum(event.kind is EventKind.TASK_START for event in self.log.events)
        self._ended: Callable[[], None] = lambda: None
        self._runs: dict[_Task, pl.DataFrame] = {}

    def runs(self, ended: Callable[[], None]) -> tuple[list[pl.DataFrame], int]:
        """Replay it; the runs of the tasks that ended by themselves, and how many did not."""
        self._ended = ended
        fleet = self._runner.fleet
        planned = PlannedFleet(fleet, self._runner.robots)  # in one go, without the observer
        list(run_fleets([planned], self._runner.planner_service))
        difference = replay_difference(fleet.events, self.log)
        if difference is not None:
            raise BadInput(difference)
        cut = {(r.robot, r.task) for r in fleet.records if r.status is Status.CENSORED}
        return [run for task, run in sorted(self._runs.items()) if task not in cut], len(cut)

    def _task_end(self, index: int, robot: Robot) -> None:
        task = (index, robot.task)
        run = robot.log.frame().with_columns(_consecutive())
        if (self.log.settings or {}).get("scenes") is not None:
            run = run.with_columns(_seed_of(task))
        self._runs[task] = run
        self._ended()


def _consecutive() -> pl.Expr:
    """Segment numbers without gaps: segments without any iteration are not counted.

    A robot that asks before it plans begins with a push, and its first reach remains empty; so does
    a push that there was no time for.
    """
    return pl.col("segment").rle_id().cast(pl.Int64())


def _seed_of(task: _Task) -> pl.Expr:
    """The seed of a run on a scene of a folder: seed + 2^32 n, with n numbering (robot, task).

    By diagonals, so that n does not depend on how many robots and tasks there are, and (0, 0) keeps
    the session's seed.
    """
    diagonal = sum(task)
    return pl.col("seed") + _SEEDS * (diagonal * (diagonal + 1) // 2 + task[1])


def _check_new(run: pl.DataFrame, path: Path, holder: dict[tuple[str, int], Path]) -> None:
    """Raise BadInput where another log holds the same run; otherwise note it."""
    if run.is_empty():
        return
    scene, seed = run["scene"][0], run["seed"][0]
    other = holder.setdefault((scene, seed), path)
    if other is not path:
        raise BadInput(
            f"{other} and {path}: both hold the run of scene {scene} with seed {seed}, expected "
            "each run once"
        )


def _about(log: EventLog) -> dict[str, Any]:
    identity = log.about.get("identity", {})
    return {
        "settings": log.settings,
        "operator": identity.get("operator"),
        "versions": identity.get("versions"),
        "sha256": digest(log.events),
    }
