"""Sweeps whose solutions are checked in the solid world: any workers, killed or not, verified."""

import functools
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.fleet.events import EventKind
from pgf_jax.inspection.config import VerifyConfig
from pgf_jax.inspection.reproduce import reproduce
from pgf_jax.inspection.verify import run as verify
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.resolve import resolve
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.tables.results import EVENT_SCHEMA, event_log


def config(out: Path, **changes: Any) -> SweepConfig:
    settings = dict(
        robots=(4,),
        policies=("or-hitl", "autonomous"),
        tasks=2,
        seed=1,
        lanes=8,
        world="solid",
        workers=1,
        out=out,
    )
    return SweepConfig(**{**settings, **changes})


@functools.cache
def _folder(base: Path, error: bool) -> Path:
    out = base / ("error" if error else "exact")
    sweep(config(out, world_error=("default",) if error else ()), quiet=True)
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return functools.partial(_folder, tmp_path_factory.mktemp("sweeps"))


@pytest.mark.parametrize("error", [pytest.param(False, marks=pytest.mark.slow), True])
def test_two_workers_give_the_same_bytes(folder, tmp_path, error):
    one = folder(error)
    changes: dict[str, Any] = {"world_error": ("default",)} if error else {}
    sweep(config(tmp_path / "two", workers=2, **changes), quiet=True)
    names = ["summary.csv", "fleets.csv", "paired.csv", "tasks.parquet", "events.parquet"]
    cells = [path.relative_to(one) for path in one.glob("cells/*.parquet")]
    assert len(cells) == 2
    for name in [*names[:3], *cells]:
        assert (tmp_path / "two" / name).read_bytes() == (one / name).read_bytes(), name
    for name in names[3:]:
        assert pl.read_parquet(tmp_path / "two" / name).equals(pl.read_parquet(one / name))


@pytest.mark.parametrize("error", [False, True])
def test_checks_are_in_the_tables(folder, error):
    tasks = pl.read_parquet(folder(error) / "tasks.parquet")
    events = pl.read_parquet(folder(error) / "events.parquet")
    checks = events.filter(pl.col("kind") == "check")
    assert tasks["checks"].sum() == len(checks) > 0
    assert set(checks["outcome"]) == {"passed", "missed"}
    assert tasks["world"].unique().to_list() == ["solid"]
    missed = events.filter((pl.col("kind") == "execution_end") & (pl.col("outcome") == "missed"))
    assert (len(missed) > 0) == error
    solved = tasks.filter(pl.col("status") == "solved")
    assert solved["attempts"].min() == 1 and (solved["attempts"] > 1).any() <= error


@pytest.mark.parametrize("error", [False, True])
def test_it_verifies(folder, error, capsys):
    verify(VerifyConfig(folder(error), cells=1))
    assert "bit for bit" in capsys.readouterr().out


@pytest.mark.parametrize("error", [False, True])
def test_an_iteration_is_reproduced_after_checks_and_misses(folder, error):
    out = folder(error)
    events = pl.read_parquet(out / "events.parquet")
    kind = "execution_end" if error else "check"
    missed = events.filter((pl.col("kind") == kind) & (pl.col("outcome") == "missed"))
    specs = resolve(config(out, world_error=("default",) if error else ())).cells
    done = 0
    for row in missed.unique(["policy", "robot", "task"], maintain_order=True).head(4).to_dicts():
        (spec,) = (s for s in specs if s.cell.policy == row["policy"])
        own = events.filter(pl.col("policy") == row["policy"]).select(list(EVENT_SCHEMA))
        log = event_log(own)
        mine = [e for e in log if (e.robot, e.task) == (row["robot"], row["task"])]
        last = [e for e in mine if e.kind is EventKind.ITERATION][-1]
        assert last.iteration is not None
        found = reproduce(spec, log, robot=row["robot"], task=row["task"], iteration=last.iteration)
        assert found.iteration == last.iteration
        done += 1
    assert done


def test_a_log_in_which_a_check_went_another_way_is_refused(folder):
    out = folder(False)
    events = pl.read_parquet(out / "events.parquet")
    (spec,) = (s for s in resolve(config(out)).cells if s.cell.policy == "autonomous")
    own = events.filter(pl.col("policy") == "autonomous").select(list(EVENT_SCHEMA))
    log = event_log(own)
    i, miss = next(
        (i, e) for i, e in enumerate(log) if e.kind is EventKind.CHECK and e.outcome == "missed"
    )
    whose = (miss.robot, miss.task)
    after = next(e for e in log[i:] if e.kind is EventKind.ITERATION and (e.robot, e.task) == whose)
    assert miss.robot is not None and miss.task is not None and after.iteration is not None
    which = {"robot": miss.robot, "task": miss.task, "iteration": after.iteration}
    reproduce(spec, log, **which)
    forged = [*log[:i], miss._replace(outcome="passed"), *log[i + 1 :]]
    with pytest.raises(BadInput, match="'passed' in the log, 'missed' here"):
        reproduce(spec, forged, **which)
    with pytest.raises(BadInput, match="planning goes on with what is feasible"):
        reproduce(spec, [*log[:i], *log[i + 1 :]], **which)


def test_the_world_is_in_the_name_of_a_cell(tmp_path):
    """Without one the name is what it was before there were worlds."""
    keys = {
        name: resolve(config(tmp_path, **changes)).cells[0].key
        for name, changes in {
            "none": {"world": "none"},
            "solid": {},
            "error": {"world_error": ("default",)},
            "other": {"world_error": ("mass=0.1",)},
        }.items()
    }
    assert len(set(keys.values())) == 4
    without = resolve(config(tmp_path, world="none")).cells[0].identity
    assert "world" not in without


def test_sampled_scenes_have_no_world_of_their_own(tmp_path):
    with pytest.raises(BadInput, match="world scene: expected scene files"):
        resolve(config(tmp_path, world="scene"))
