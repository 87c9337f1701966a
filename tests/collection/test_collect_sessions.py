"""Recorded sessions as training data: what is taken of them, and what is refused."""

import dataclasses
import json
import math
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from sweep_toys import ghost, write_scene  # registers the toys
from write_log import write_log

from pgf_jax import cli
from pgf_jax.collection import sessions
from pgf_jax.collection.collect import collect
from pgf_jax.collection.config import CollectConfig
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.session_spec import SessionSpec
from pgf_jax.errors import BadInput
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.planning.types import UNANSWERED, Push, Status
from pgf_jax.sweeping.sweep import sweep
from pgf_jax.tables.event_log import JOURNAL, TABLE, digest, read_log
from pgf_jax.tables.parquet import encode_table, read_provenance
from pgf_jax.tables.runs import Mode, read_runs, runs_path
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.rows import human_rows
from pgf_jax.training.train import train

TICK_NS = 500_000_000  # how long the person takes, at most


@dataclasses.dataclass
class Recorded:
    """A session as it went.

    Attributes:
      folder: its files.
      runs: (robot, task) -> what its robot wrote down.
      records: (robot, task) -> its record.
    """

    folder: Path
    runs: dict[tuple[int, int], pl.DataFrame]
    records: dict[tuple[int, int], TaskRecord]

    def ended(self) -> list[tuple[int, int]]:
        return [task for task, r in self.records.items() if r.status is not Status.CENSORED]

    def rows(self) -> int:
        return sum(len(self.runs[task]) for task in self.ended())


def record(out: Path, *, stop_s: float | None = None, **changes) -> Recorded:
    """A session, as fast as it goes; a person says something else each time."""
    settings = {
        "robots": 2,
        "tasks": 3,
        "policy": "or-hitl",
        "engine": "ghost",
        "operator": "nudge",
        "lanes": 4,
        "world": "none",  # nothing that a ghost does is true in any
        "physics": "authors",
        "out": out,
    }
    spec = SessionSpec.load(ConsoleConfig(**(settings | changes)))
    asked, said = [], 0
    runner = spec.new_runner(asked.append)
    runs: dict[tuple[int, int], pl.DataFrame] = {}

    def note(index, robot):
        runs[index, robot.task] = robot.log.frame()

    runner.robots._on_task_end = note
    runner.observer.update = lambda: None  # nobody observes it
    written = spec.open_recorder(runner)
    now_ns, stop_ns = 0, math.inf if stop_s is None else stop_s * 1e9
    while not runner.fleet.done and now_ns < stop_ns:
        now_ns += TICK_NS
        runner.run_until(now_ns)
        written.write()
        while asked:
            one = asked.pop()
            x, y = map(float, one.view.objects[0])
            one.answer((Push(0, x, y), None, Push(1, 0.9 * x, -y), UNANSWERED)[said % 4])
            said += 1
    written.close()
    records = {(r.robot, r.task): r for r in runner.fleet.records}
    return Recorded(out, runs, records)


def settings(out: Path, *logs: Path, **changes) -> CollectConfig:
    return CollectConfig(**({"mode": "human", "out": out, "log": logs} | changes))


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Recorded:
    """A session of a simulated operator."""
    return record(tmp_path_factory.mktemp("session"))


@pytest.fixture(scope="module")
def person(tmp_path_factory) -> Recorded:
    """A session of a person, who is asked before anything is planned."""
    out = tmp_path_factory.mktemp("person")
    return record(out, operator="live", policy="always", seed=7, scene_class="all", tasks=4)


# -- what is taken -------------------------------------------------------------------------------


def test_the_runs_are_those_that_the_robots_wrote_down(tmp_path, session):
    done = collect(settings(tmp_path, session.folder))
    runs = read_runs(done.path)
    assert done.path == tmp_path / "human" / "runs.parquet"
    assert [p.name for p in done.path.parent.iterdir()] == ["runs.parquet"]
    assert session.ended() and len(runs) == session.rows()
    for (robot, task), run in session.runs.items():
        ours = runs.filter(pl.col("scene") == f"tight_0_{robot}_{task}")
        assert_frame_equal(ours, run, check_exact=True)
        assert ours["seed"].unique().to_list() == [0]


def test_the_summary_counts_tasks(tmp_path, session):
    done = collect(settings(tmp_path, session.folder))
    runs = read_runs(done.path)
    records = session.records.values()
    assert (done.scenes, done.runs, done.cut_off) == (6, 6, 0)
    assert done.by_class == {"tight": 6}
    assert done.solved == sum(r.status is Status.SOLVED for r in records)
    assert done.iterations == len(runs)
    assert done.inputs == runs.filter(pl.col("asked_before")).n_unique("scene") > 0
    assert 0 < done.solved < 6


def test_it_is_said_where_the_runs_come_from(tmp_path, session, person):
    done = collect(settings(tmp_path, session.folder, person.folder))
    about = read_provenance(done.path)
    first, second = about["settings"]["sessions"]
    for folder, ours in ((session.folder, first), (person.folder, second)):
        log = read_log(folder)
        assert ours["settings"] == log.settings
        assert ours["sha256"] == digest(log.events)
        assert ours["versions"] == log.about["identity"]["versions"]
    assert (first["operator"], second["operator"]) == ("nudge", "live")
    assert (first["tasks"], second["tasks"], about["scenes"]) == (6, 8, 14)
    assert about["versions"].keys() >= {"python", "jax", "pgf_jax"}
    assert str(tmp_path) not in json.dumps(about)


def test_a_run_may_begin_with_an_input(tmp_path, person):
    """There is no iteration of the first reach, then, and the push is segment 0."""
    done = collect(settings(tmp_path, person.folder))
    runs = read_runs(done.path)
    assert done.by_class.keys() == {"tight", "medium", "wide"}
    first = runs.group_by("scene", "seed", maintain_order=True).first()
    assert first["segment"].to_list() == [0] * 8
    assert {"push", "reach"} == set(first["kind"])
    assert first.filter(pl.col("kind") == "push")["asked_before"].all()
    went_on = first.filter(pl.col("kind") == "reach")["asked_before"]
    assert went_on.any() and not went_on.all()  # without an answer, there was no input
    skipping = 0
    for (robot, task), run in person.runs.items():
        ours = runs.filter(pl.col("scene").str.ends_with(f"_7_{robot}_{task}"))
        assert_frame_equal(ours.drop("segment"), run.drop("segment"), check_exact=True)
        change = ours["segment"].diff().fill_null(0)
        assert (change > 0).to_list() == (run["segment"].diff().fill_null(0) > 0).to_list()
        assert set(change) <= {0, 1}
        skipping += run["segment"][0] == 1
    assert skipping == first["kind"].eq("push").sum()
    assert human_rows(runs).short == runs["asked_before"].sum()  # all before any history


@pytest.mark.parametrize("file", [JOURNAL, TABLE])
def test_tasks_that_were_cut_off_are_left_out(tmp_path, session, file):
    """A session that was stopped: the runs of the tasks that had ended until then."""
    whole = collect(settings(tmp_path / "whole", session.folder))
    ends_s = sorted(r.end_ns / 1e9 for r in session.records.values())
    cut = record(tmp_path / "cut", stop_s=(ends_s[2] + ends_s[3]) / 2)
    done = collect(settings(tmp_path / "data", cut.folder / file))
    assert len(cut.ended()) == 3 and done.runs == 3
    assert done.cut_off == len(cut.records) - 3 > 0
    assert done.scenes == len(cut.records)
    names = [f"tight_0_{robot}_{task}" for robot, task in cut.ended()]
    expected = read_runs(whole.path).filter(pl.col("scene").is_in(names))
    assert_frame_equal(read_runs(done.path), expected, check_exact=True)
    (about,) = read_provenance(done.path)["settings"]["sessions"]
    assert (about["tasks"], about["cut_off"]) == (done.scenes, done.cut_off)


def test_a_killed_session_is_a_session(tmp_path, session):
    lines = (session.folder / JOURNAL).read_bytes().splitlines(keepends=True)
    ends = [i for i, line in enumerate(lines) if b"task_end" in line]
    log = tmp_path / "killed.jsonl"
    log.write_bytes(b"".join(lines[: ends[1] + 3]) + b'{"time_ns": 12')
    done = collect(settings(tmp_path, log))
    assert done.runs == 2 and done.cut_off == done.scenes - 2 > 0


def test_a_horizon_cuts_off_too(tmp_path):
    cut = record(tmp_path / "cut", horizon=120.0)
    done = collect(settings(tmp_path, cut.folder))
    assert 0 < done.runs == len(cut.ended()) < done.scenes == len(cut.records)
    assert len(read_runs(done.path)) == cut.rows()


def test_logs_need_not_be_alike(tmp_path, session, person):
    """Other policies, people, classes and numbers of objects; their order does not matter."""
    folder = tmp_path / "scenes"
    folder.mkdir()
    for number in range(2):
        write_scene(folder / f"shelf_{number}.xml", n_objects=6)
    shelves = record(tmp_path / "shelves", scenes=folder)
    logs = [session.folder, person.folder, shelves.folder]
    done = collect(settings(tmp_path / "one", *logs))
    again = collect(settings(tmp_path / "other", *reversed(logs)))
    runs = read_runs(done.path)
    assert_frame_equal(runs, read_runs(again.path), check_exact=True)
    assert len(runs) == session.rows() + person.rows() + shelves.rows()
    assert done.runs == 6 + 8 + 6
    assert runs["n_objects"].unique().sort().to_list() == [6, 20]
    repeated = collect(settings(tmp_path / "repeated", *logs))
    assert repeated.path.read_bytes() == done.path.read_bytes()


def test_robots_that_had_the_same_scene_have_runs_of_their_own(tmp_path):
    """A folder's scenes come again for each robot; the split keeps their runs together."""
    folder = tmp_path / "scenes"
    folder.mkdir()
    for number in range(2):
        write_scene(folder / f"shelf_{number}.xml", n_objects=6)
    shelves = record(tmp_path / "shelves", scenes=folder, seed=5)
    done = collect(settings(tmp_path, shelves.folder))
    runs = read_runs(done.path)
    by_run = runs.group_by("scene", "seed").len()
    assert len(by_run) == 6 and set(by_run["scene"]) == {"shelf_0", "shelf_1"}
    assert done.by_class == {"file": 6}
    # (0, 0); (1, 0), (0, 1); (1, 1), (0, 2); (1, 2) is on the fourth diagonal.
    numbers = {(0, 0): 0, (1, 0): 1, (0, 1): 2, (1, 1): 4, (0, 2): 5, (1, 2): 8}
    assert sorted(by_run["seed"]) == sorted(5 + 2**32 * n for n in numbers.values())
    for task, run in shelves.runs.items():
        ours = runs.filter(pl.col("seed") == 5 + 2**32 * numbers[task])
        assert_frame_equal(ours.drop("seed"), run.drop("seed"), check_exact=True)


def test_progress_counts_tasks(tmp_path, session, person):
    seen = []
    collect(
        settings(tmp_path, session.folder, person.folder), on_progress=lambda *c: seen.append(c)
    )
    assert seen == [(done, 14) for done in range(15)]


def test_training_takes_them_beside_autonomous_runs(tmp_path, session):
    other = record(tmp_path / "other", seed=1)
    done = collect(settings(tmp_path / "data", session.folder, other.folder))
    toys = {"engine": "ghost", "world": "none", "physics": "authors", "workers": 1}
    collect(CollectConfig(mode="autonomous", scenes=6, out=tmp_path / "data", **toys))
    config = TrainConfig(max_epochs=2, hidden=(4,))
    report = train(tmp_path / "data", tmp_path / "networks", config)
    assert report["phi_human"]["runs"] == done.runs == 12
    assert report["phi_human"]["rows"] == len(human_rows(read_runs(done.path)).target) > 5
    assert all(Path(file).is_file() for file in report["files"])


def test_a_session_of_the_real_engine(tmp_path):
    real = record(
        tmp_path / "real",
        robots=1,
        tasks=1,
        policy="always",
        engine="planar",
        operator="heuristic",
        lanes=None,
        world="solid",
        physics="default",
        scene_class="wide",
    )
    done = collect(settings(tmp_path, real.folder))
    (run,) = real.runs.values()
    assert (done.runs, done.inputs, done.cut_off) == (1, 1, 0)
    ours = read_runs(done.path)
    assert_frame_equal(ours.drop("segment"), run.drop("segment"), check_exact=True)


# -- what is refused -----------------------------------------------------------------------------


def test_a_run_counts_once(tmp_path, session):
    """The same session under another name, or one with the same seed."""
    copy = tmp_path / "copy.jsonl"
    copy.write_bytes((session.folder / JOURNAL).read_bytes())
    with pytest.raises(BadInput) as error:
        collect(settings(tmp_path, session.folder, copy))
    assert str(error.value) == (
        f"{session.folder / TABLE} and {copy}: both hold the run of scene tight_0_0_0 with seed 0, "
        "expected each run once"
    )
    other = record(tmp_path / "other", policy="queue", robots=1, tasks=1)
    with pytest.raises(BadInput, match="both hold the run of scene tight_0_0_0 with seed 0"):
        collect(settings(tmp_path, session.folder, other.folder))
    with pytest.raises(BadInput, match="both hold"):
        collect(settings(tmp_path, session.folder, session.folder))
    assert not runs_path(tmp_path, Mode.HUMAN).exists()


def test_a_log_that_does_not_replay_is_named(tmp_path, session):
    log = read_log(session.folder)
    events = list(log.events)
    number = next(i for i, e in enumerate(events) if e.kind == "iteration" and e.outcome is None)
    events[number] = events[number]._replace(outcome="stuck")
    path = tmp_path / "altered.parquet"
    write_log(path, events, log.about)
    with pytest.raises(BadInput) as error:
        collect(settings(tmp_path, path))
    message = f"{path}: the replay differs from event {number + 1} on; it was recorded with"
    assert str(error.value).startswith(message)
    assert not runs_path(tmp_path, Mode.HUMAN).exists()


def test_logs_are_looked_at_before_any_is_replayed(tmp_path, session, monkeypatch):
    def run_fleets(fleets, planner_service):
        raise AssertionError("nothing is to be replayed")

    monkeypatch.setattr(sessions, "run_fleets", run_fleets)
    with pytest.raises(BadInput, match=r"missing.jsonl: no such file"):
        collect(settings(tmp_path, session.folder, tmp_path / "missing.jsonl"))
    with pytest.raises(BadInput, match=r"nobody.parquet: no such file"):
        collect(settings(tmp_path, session.folder, tmp_path / "nobody.parquet"))


def test_the_log_of_a_sweep_is_none_of_a_session(tmp_path):
    config = ghost(tmp_path / "sweep", robots=(1,), policies=("autonomous",), tasks=1)
    result = sweep(config, quiet=True)
    log = tmp_path / TABLE
    log.write_bytes(encode_table(result.cell(config.cells()[0]).events))
    with pytest.raises(BadInput, match="does not say its settings, expected the log of a session"):
        collect(settings(tmp_path, log))


def test_nothing_to_train_on_is_an_error(tmp_path):
    cut = record(tmp_path / "cut", stop_s=3.0)
    with pytest.raises(BadInput, match="log: of 2 tasks 2 were cut off"):
        collect(settings(tmp_path, cut.folder))
    assert not (tmp_path / "human").exists()


@pytest.mark.parametrize("resume", [False, True])
def test_what_is_there_is_not_added_to(tmp_path, session, resume):
    config = settings(tmp_path, session.folder, resume=resume)
    before = collect(config).path.read_bytes()
    with pytest.raises(BadInput, match=r"runs\.parquet: exists; expected a new folder, nothing"):
        collect(config)
    planned = CollectConfig(mode="human", scenes=2, out=tmp_path, engine="ghost", resume=resume)
    with pytest.raises(BadInput):
        collect(planned)
    assert runs_path(tmp_path, Mode.HUMAN).read_bytes() == before


def test_an_interrupted_collection_is_kept_out(tmp_path, session):
    (tmp_path / "human").mkdir()
    (tmp_path / "human" / "collect.json").write_text("{}")
    with pytest.raises(BadInput, match=r"collect\.json: exists"):
        collect(settings(tmp_path, session.folder))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mode": "autonomous"}, "log: expected with mode human only, got autonomous"),
        ({"mode": "forks"}, "log: expected with mode human only, got forks"),
        ({"scenes": 3}, "scenes: expected none beside log (sessions have their own settings), "),
        ({"seed": 1}, "seed: expected none beside log (sessions have their own settings), got 1"),
        ({"engine": "native"}, "engine: expected none beside log"),
        ({"lanes": 64}, "lanes: expected none beside log"),
        ({"classes": ("wide",)}, "classes: expected none beside log"),
        ({"workers": 2}, "workers: expected none beside log"),
        ({"log": ()}, "scenes: expected how many (or log, with recorded sessions), got none"),
    ],
)
def test_wrong_settings_are_named(tmp_path, changes, message):
    with pytest.raises(BadInput) as error:
        settings(tmp_path, *changes.pop("log", (tmp_path,)), **changes)
    assert str(error.value).startswith(message)


# -- the command line ----------------------------------------------------------------------------


def run(capsys, *arguments) -> tuple[int, str, str]:
    code = cli.main(["collect", *map(str, arguments)])
    return code, *capsys.readouterr()


def test_the_command_says_what_it_took_and_what_not(tmp_path, session, capsys):
    cut = record(tmp_path / "cut", seed=3, horizon=250.0)
    assert 0 < len(cut.ended()) < len(cut.records)
    logs = (session.folder, cut.folder / JOURNAL)
    code, out, err = run(capsys, "human", "--log", *logs, "--out", tmp_path / "data")
    assert code == 0 and err.count("\n") <= 1
    assert "tasks" in out and "engine" not in out
    left_out = len(cut.records) - len(cut.ended())
    assert f"left out: {left_out}," in " ".join(out.split())
    runs = read_runs(runs_path(tmp_path / "data", Mode.HUMAN))
    assert len(runs) == session.rows() + cut.rows()


def test_the_command_names_what_is_wrong_in_one_line(tmp_path, session, capsys):
    for arguments, message in (
        (["human"], "--scenes: expected how many (or log, with recorded sessions), got none"),
        (["human", "--log"], "--scenes: expected how many"),
        (["autonomous", "--log", session.folder], "--log: expected with mode human only"),
        (["human", "--log", session.folder, "--scenes", 1], "--scenes: expected none beside log"),
        (["human", "--log", session.folder, "--task-limit", 9], "--task-limit: expected none"),
        (["human", "--log", tmp_path / "x.jsonl"], "x.jsonl: no such file"),
    ):
        code, out, err = run(capsys, *arguments, "--out", tmp_path / "data")
        assert (code, out) == (2, "")
        assert err.count("\n") == 1 and message in err


def test_an_interruption_leaves_nothing(tmp_path, session, monkeypatch, capsys):
    def run_fleets(fleets, planner_service):
        raise KeyboardInterrupt

    monkeypatch.setattr(sessions, "run_fleets", run_fleets)
    code, out, err = run(capsys, "human", "--log", session.folder, "--out", tmp_path)
    assert (code, out) == (130, "") and "nothing was written" in err and "--resume" not in err
    assert not (tmp_path / "human").exists()
