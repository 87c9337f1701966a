"""Collection: what runs hold, and that an interruption changes nothing."""

import dataclasses
import json
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from registered import registered

import pgf_jax.guidance.operators.registry as operators
from pgf_jax.collection.collect import collect
from pgf_jax.collection.config import CollectConfig
from pgf_jax.collection.scenes import ask_at, scene_of
from pgf_jax.errors import BadInput
from pgf_jax.planning.types import Push
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plans.plan import plan
from pgf_jax.scene import sample_scene
from pgf_jax.tables.runs import Mode, read_runs, runs_path
from pgf_jax.training.rows import human_rows

pytestmark = pytest.mark.usefixtures("remembered_rollouts")

LIMIT = 20.0  # s: the nominal and six iterations


class Aside:
    """Pushes object_1 3 cm outwards."""

    name = "aside"

    def decide(self, view) -> Push:
        x, y = view.objects[0]
        return Push(0, float(x), float(y + (0.03 if y > 0 else -0.03)))


@pytest.fixture(autouse=True)
def aside():
    with registered(operators.OPERATORS, aside=Aside):
        yield


def settings(out: Path, **changes) -> CollectConfig:
    config = CollectConfig(
        mode="autonomous",
        scenes=3,
        out=out,
        engine="native",
        operator="aside",
        task_limit=LIMIT,
        chunk=1,
    )
    return dataclasses.replace(config, **changes)


@pytest.fixture(scope="module")
def autonomous(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("autonomous")
    collect(dataclasses.replace(settings(out), operator="none"))
    return runs_path(out, Mode.AUTONOMOUS)


class Interrupter:
    """Stands in for the user who presses Ctrl-C after so many runs."""

    def __init__(self, after: int) -> None:
        self.after = after
        self.seen: list[tuple[int, int]] = []

    def __call__(self, done: int, wanted: int) -> None:
        self.seen.append((done, wanted))
        if done == self.after:
            raise KeyboardInterrupt


def test_scenes_take_turns_through_the_classes(autonomous):
    runs = read_runs(autonomous, mode=Mode.AUTONOMOUS)
    by_run = runs.group_by("scene", maintain_order=True).first().sort("seed")
    assert by_run["scene"].to_list() == ["tight_0", "medium_1", "wide_2"]
    assert by_run["class"].to_list() == ["tight", "medium", "wide"]
    assert by_run["seed"].to_list() == [0, 1, 2]
    assert by_run["n_objects"].to_list() == [20, 20, 20]


def test_a_run_is_the_plan_of_its_scene(autonomous):
    config = PlanConfig(engine="native", task_limit=LIMIT)
    runs = read_runs(autonomous)
    for name, seed in (("tight", 0), ("wide", 2)):
        alone = plan(seed, sample_scene(seed, name), config)
        run = runs.filter(pl.col("seed") == seed)
        assert run.select("c_d", "c_f", "c_b").rows() == [tuple(row) for row in alone.history]
        assert run["feasible"].to_list() == [False] * alone.iterations + [alone.solved]


def test_the_summary_counts_runs(tmp_path):
    done = collect(settings(tmp_path, scenes=2, seed=1, classes=("wide", "tight")))
    runs = read_runs(done.path)
    assert done.path == tmp_path / "autonomous" / "runs.parquet"
    assert (done.runs, done.by_class) == (2, {"tight": 1, "wide": 1})
    assert done.iterations == len(runs)
    assert done.solved == runs.filter(pl.col("feasible")).n_unique("scene")
    assert done.inputs == 0


@pytest.mark.parametrize("after", [1, 2])
def test_an_interrupted_collection_resumes_to_the_same_bytes(tmp_path, autonomous, after):
    config = settings(tmp_path, operator="none")
    with pytest.raises(KeyboardInterrupt):
        collect(config, on_progress=Interrupter(after))
    parts = sorted((tmp_path / "autonomous" / "parts").iterdir())
    assert len(parts) == after and all(part.suffix == ".parquet" for part in parts)
    assert not runs_path(tmp_path, Mode.AUTONOMOUS).exists()

    progress = Interrupter(-1)
    collect(dataclasses.replace(config, resume=True), on_progress=progress)
    assert progress.seen == [(done, 3) for done in range(after, 4)]
    assert runs_path(tmp_path, Mode.AUTONOMOUS).read_bytes() == autonomous.read_bytes()
    assert not (tmp_path / "autonomous" / "parts").exists()


def test_finished_runs_of_an_unfinished_chunk_are_kept_too(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        collect(settings(tmp_path, chunk=10), on_progress=Interrupter(2))
    (part,) = (tmp_path / "autonomous" / "parts").iterdir()
    assert read_runs(part).n_unique("scene") == 2


def test_scenes_can_be_added(tmp_path, autonomous):
    collect(settings(tmp_path, scenes=1, operator="none"))
    collect(settings(tmp_path, scenes=3, operator="none", resume=True))
    assert runs_path(tmp_path, Mode.AUTONOMOUS).read_bytes() == autonomous.read_bytes()
    # A part that was merged, but not yet removed, when the power went is counted once.
    again = tmp_path / "autonomous" / "parts" / "part_00000.parquet"
    again.parent.mkdir()
    again.write_bytes(autonomous.read_bytes())
    collect(settings(tmp_path, scenes=3, operator="none", resume=True))
    assert runs_path(tmp_path, Mode.AUTONOMOUS).read_bytes() == autonomous.read_bytes()


def test_lanes_do_not_change_the_runs_of_native(tmp_path, autonomous):
    collect(settings(tmp_path, lanes=2))
    assert_frame_equal(
        read_runs(runs_path(tmp_path, Mode.AUTONOMOUS)), read_runs(autonomous), check_exact=True
    )


def test_a_human_run_is_the_autonomous_one_until_its_one_input(tmp_path, autonomous):
    config = settings(tmp_path, mode="human", ask_from=3, ask_to=4, task_limit=60.0)
    done = collect(config)
    runs, alone = read_runs(done.path), read_runs(autonomous)
    helped = 0
    for index in range(3):
        scene = scene_of(config, index)
        run = runs.filter(pl.col("scene") == scene.name)
        at = ask_at(config, scene)
        before = run.head(at + 1)  # iteration 0 and the iterations up to the input
        assert_frame_equal(
            before, alone.filter(pl.col("scene") == scene.name).head(at + 1), check_exact=True
        )
        given = run.filter(pl.col("asked_before"))["iteration"].to_list()
        solved_first = bool(before["feasible"].any())
        assert given == ([] if solved_first else [at + 1])
        if given:
            helped += 1
            assert run["kind"][at + 1] == "push"
    assert done.inputs == helped > 0
    assert len(human_rows(runs).target) == helped


def test_the_moment_of_the_input_is_drawn_by_seed_and_scene(tmp_path):
    config = settings(tmp_path, mode="human", ask_from=3, ask_to=6)
    scenes = [sample_scene(seed, "tight") for seed in range(40)]
    drawn = [ask_at(config, scene) for scene in scenes]
    assert drawn == [ask_at(config, scene) for scene in scenes]
    assert set(drawn) == {3, 4, 5, 6}
    assert drawn != [ask_at(dataclasses.replace(config, seed=1), scene) for scene in scenes]


def test_the_default_limit_leaves_ten_iterations_after_any_input(tmp_path):
    config = CollectConfig(mode="human", scenes=1, out=tmp_path, operator="aside")
    # The nominal, ask_to iterations, a push (30 s at most), a new nominal, ten iterations.
    assert 1.5 + 3.0 * config.ask_to + 30.0 + 1.5 + 10 * 3.0 <= config.task_limit


def test_what_is_there_is_not_overwritten(tmp_path):
    (tmp_path / "autonomous").mkdir()
    path = runs_path(tmp_path, Mode.AUTONOMOUS)
    path.write_bytes(b"somebody's data")
    with pytest.raises(BadInput, match=r"runs\.parquet: exists; expected a new folder"):
        collect(settings(tmp_path))
    assert path.read_bytes() == b"somebody's data"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": 1}, "collected with 0, expected the same to resume, got 1"),
        ({"task_limit": 30.0}, "collected with 20.0"),
        ({"classes": ("tight",)}, "classes: runs in "),
        ({"scenes": 2}, "scenes: expected 3 or more, got 2"),
    ],
)
def test_other_settings_are_not_mixed_in(tmp_path, changes, message):
    folder = tmp_path / "autonomous"
    with pytest.raises(KeyboardInterrupt):
        collect(settings(tmp_path), on_progress=Interrupter(0))
    before = (folder / "collect.json").read_bytes()
    with pytest.raises(BadInput) as error:
        collect(settings(tmp_path, resume=True, **changes))
    assert message in str(error.value)
    assert (folder / "collect.json").read_bytes() == before


def test_a_truncated_part_or_settings_file_is_named(tmp_path, autonomous):
    folder = tmp_path / "autonomous"
    with pytest.raises(KeyboardInterrupt):
        collect(settings(tmp_path), on_progress=Interrupter(0))
    part = folder / "parts" / "part_00000.parquet"
    part.parent.mkdir()
    part.write_bytes(autonomous.read_bytes()[:-20])
    with pytest.raises(BadInput, match=r"part_00000\.parquet: truncated or corrupt"):
        collect(settings(tmp_path, resume=True))
    (folder / "collect.json").write_text(json.dumps({"mode": "autonomous"})[:-3])
    with pytest.raises(BadInput, match=r"collect\.json: not readable"):
        collect(settings(tmp_path, resume=True))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mode": "both"}, "mode: expected one of autonomous, human, forks, futures, got 'both'"),
        ({"scenes": 0}, "scenes: expected a whole number 1 or more, got 0"),
        ({"seed": -1}, "seed: expected a whole number within 0"),
        ({"classes": ()}, "classes: expected one or more"),
        (
            {"classes": ("flat",)},
            "classes: expected one of tight, medium, wide, crowded, packed, mixed, got 'flat'",
        ),
        ({"classes": ("tight", "tight")}, "classes: expected each at most once"),
        ({"engine": "warp"}, "engine: expected one of"),
        ({"mode": "human", "operator": "nobody"}, "operator: expected one of"),
        ({"mode": "human", "operator": "none"}, "operator: human runs need one"),
        ({"task_limit": 1.0}, "task_limit: expected a number of seconds, 1.5 or more, got 1.0"),
        ({"ask_from": 5, "ask_to": 4}, "ask_to: expected a whole number 5 or more, got 4"),
        ({"mode": "forks", "operator": "none"}, "operator: forks runs need one"),
        ({"mode": "forks", "ask_from": 2}, "ask_from: expected a whole number 3 or more, got 2"),
        ({"keys": 0}, "keys: expected a whole number 1 or more, got 0"),
        ({"workers": 0}, "workers: expected a whole number 1 or more, got 0"),
        ({"chunk": 0}, "chunk: expected a whole number 1 or more, got 0"),
        ({"lanes": 0}, "lanes: expected a whole number 1 or more, got 0"),
    ],
)
def test_wrong_settings_are_named(tmp_path, changes, message):
    with pytest.raises(BadInput) as error:
        settings(tmp_path, **changes)
    assert message in str(error.value)


def test_runs_of_another_version_of_a_plugin_are_not_mixed_in(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        collect(settings(tmp_path, mode="human"), on_progress=Interrupter(0))
    resumed = settings(tmp_path, mode="human", resume=True)

    class Other(Aside):
        pass

    with (
        registered(operators.OPERATORS, aside=Other),
        pytest.raises(BadInput, match="collected with another version of a plugin"),
    ):
        collect(resumed)
    with registered(operators.OPERATORS, aside=Aside):
        collect(resumed)
