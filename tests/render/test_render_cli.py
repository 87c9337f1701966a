"""The command `pgf-jax render`: its files, and one line for every kind of bad input."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from render_cases import fleet
from render_plans import plan

from pgf_jax.cli import main
from pgf_jax.errors import BadInput
from pgf_jax.plans.file import save_plan
from pgf_jax.render.command import render
from pgf_jax.render.config import RenderConfig
from pgf_jax.sweeping import stored_fleet

SESSION_S = 10.0  # robot 1 is served within 4..6 s; tasks 0 and 1 of 5 s each
SMALL = (320, 240)
snapshot_times: list[float] = []  # of the session, in the order in which they were taken, s


@pytest.fixture
def plan_file(tmp_path) -> Path:
    return save_plan(tmp_path, plan())


@pytest.fixture
def session(tmp_path, monkeypatch) -> Path:
    """A made-up session of three robots; its file is empty, because `snapshots` is replaced."""

    def snapshots(path, *, every_ns, start_ns=0, stop_ns=None, choice=None):
        assert path == file
        time_ns = start_ns
        while time_ns <= min(SESSION_S * 1e9, stop_ns or np.inf):
            s = time_ns / 1e9
            snapshot_times.append(s)
            yield fleet(3, 1 if 4 <= s < 6 else None, time_s=s, task=int(s >= 5))
            time_ns += every_ns

    file = tmp_path / "events.jsonl"
    file.write_bytes(b"")
    snapshot_times.clear()
    monkeypatch.setattr(stored_fleet, "snapshots", snapshots)
    return file


def film_size(path: Path) -> tuple[tuple[int, int], int]:
    """Width and height, and the number of frames."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    reader = ffmpeg.read_frames(str(path))
    return next(reader)["size"], sum(1 for _ in reader)


def test_a_plan_is_drawn_at_its_end_and_when_asked(plan_file, tmp_path, capsys):
    out = tmp_path / "new" / "end.png"
    arguments = ["render", "plan", str(plan_file), "--size", "400", "300", "--out", str(out)]
    assert main(arguments) == 0
    assert capsys.readouterr().out == f"{out}: 400 x 300 pixels\n"
    pictures = []
    for at in (None, 0.0, 7.0):
        config = RenderConfig("plan", plan_file, tmp_path / f"{at}.png", at=at, size=(400, 300))
        render(config)
        pictures.append(np.array(Image.open(config.out)))
    np.testing.assert_array_equal(pictures[0], np.array(Image.open(out)))
    np.testing.assert_array_equal(pictures[0], pictures[2])
    assert (pictures[0] != pictures[1]).any()


def test_a_plan_is_drawn_as_it_is_executed_in_a_world(plan_file, tmp_path, capsys):
    ends = []
    for words in ([], ["--world", "solid"], ["--world-error", "position=0.01"]):
        out = tmp_path / f"{len(ends)}.png"
        arguments = ["render", "plan", str(plan_file), "--size", "400", "300", "--out", str(out)]
        assert main([*arguments, *words]) == 0
        ends.append(np.array(Image.open(out)))
    assert (ends[0] != ends[1]).any() and (ends[1] != ends[2]).any()
    again = [*arguments, "--world-error", "position=0.01", "--repeat", "1"]
    assert main(again) == 0
    assert (np.array(Image.open(out)) != ends[2]).any()
    capsys.readouterr()
    for words, message in (
        (["--world", "scene"], "expected --scenes with the folder of that"),
        (["--repeat", "1"], "repeat: goes with world_error only, got 1"),
        (["--world-error", "mass=2"], "mass"),
    ):
        assert main([*arguments, *words]) == 2
        said = capsys.readouterr().err
        assert message in said and said.count("\n") == 1
    with pytest.raises(BadInput, match="world: goes with plan only, got fleet"):
        RenderConfig("fleet", plan_file, out, world="solid")


def test_a_plan_is_filmed(plan_file, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "a.mp4"
    said = render(RenderConfig("plan", plan_file, out, fps=2, speed=2.0, size=(321, 241)))
    assert film_size(out) == ((320, 240), 8)  # 0, 1, .. 7 s
    assert said == f"{out}: 8 frames of 320 x 240 pixels, 4.0 s of film"


def test_a_fleet_is_drawn_when_somebody_is_first_served(session, tmp_path):
    out = tmp_path / "a.png"
    render(RenderConfig("fleet", session, out, size=SMALL))
    assert snapshot_times[-1] == 4.0 and out.is_file()
    render(RenderConfig("fleet", session, out, at=9.0, size=SMALL))
    assert snapshot_times[-1] == 9.0


def test_a_fleet_is_filmed(session, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "a.mp4"
    render(RenderConfig("fleet", session, out, fps=4, speed=4.0, start=2.0, stop=8.0, size=SMALL))
    assert film_size(out) == ((320, 240), 7)
    render(RenderConfig("fleet", session, out, fps=4, speed=4.0, size=SMALL))
    assert film_size(out) == ((320, 240), 11)  # to the session's end


def test_a_task_is_filmed_as_long_as_it_lasts(session, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "a.mp4"
    for task, first in ((0, 0), (1, 5)):
        config = RenderConfig(
            "task", session, out, robot=1, task=task, fps=4, speed=4.0, size=SMALL
        )
        render(config)
        assert film_size(out)[1] == (5, 6)[task]
        assert first in snapshot_times


def test_a_task_is_drawn_when_it_is_first_served_or_at_last(session, tmp_path):
    config = RenderConfig("task", session, tmp_path / "a.png", robot=1, size=SMALL)
    render(config)
    assert snapshot_times[-1] == 4.0
    render(RenderConfig("task", session, tmp_path / "b.png", robot=0, size=SMALL))  # never served
    assert snapshot_times[-1] == 5.0  # where its next task began


BAD = {
    "suffix": (["plan", "FILE", "--out", "a.gif"], "--out: expected a file .png or .mp4"),
    "no out": (["plan", "FILE"], "options missing: --out"),
    "what": (
        ["shelf", "FILE", "--out", "a.png"],
        "expected one of fleet, plan, sweep, task, got 'shelf'",
    ),
    "missing": (["plan", "none.plan.json", "--out", "a.png"], "no such file, expected a plan"),
    "session": (["fleet", "none", "--out", "a.png"], "no such file, expected a recorded session"),
    "no plan": (["plan", "SESSION", "--out", "a.png"], "not a plan"),
    "at": (["plan", "FILE", "--out", "a.png", "--at", "-1"], "--at: expected a number of seconds"),
    "late": (
        ["plan", "FILE", "--out", "a.png", "--at", "8"],
        "ends after 7.000 s, expected --at within",
    ),
    "film at": (["plan", "FILE", "--out", "a.mp4", "--at", "1"], "--at: goes with a picture only"),
    "span": (["plan", "FILE", "--out", "a.png", "--stop", "1"], "go with a film only"),
    "stop": (
        ["plan", "FILE", "--out", "a.mp4", "--start", "3", "--stop", "2"],
        "--stop: expected more than start 3, got 2",
    ),
    "speed": (
        ["plan", "FILE", "--out", "a.mp4", "--speed", "0"],
        "--speed: expected a number above 0, got 0.0",
    ),
    "fps": (["plan", "FILE", "--out", "a.mp4", "--fps", "0"], "--fps: expected a whole number"),
    "size": (["plan", "FILE", "--out", "a.png", "--size", "10", "800"], "--size: expected a whole"),
    "view": (["plan", "FILE", "--out", "a.png", "--view", "4d"], "--view: expected one of 3d, top"),
    "robot": (["plan", "FILE", "--out", "a.png", "--robot", "1"], "--robot: goes with task only"),
    "no robot": (
        ["task", "SESSION", "--out", "a.png", "--robot", "3"],
        ": expected --robot within 0..2, got 3",
    ),
    "no task": (
        ["task", "SESSION", "--out", "a.png", "--task", "2"],
        ": expected --task within 0..1",
    ),
    "task later": (
        ["task", "SESSION", "--out", "a.png", "--task", "1", "--at", "1"],
        "robot 0 is not at its task 1 at 1 s, but at 0 (planning)",
    ),
    "over": (["fleet", "SESSION", "--out", "a.png", "--at", "11"], "ends before --at 11 s"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case, plan_file, session, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    arguments, expected = BAD[case]
    names = {"FILE": str(plan_file), "SESSION": str(session)}
    assert main(["render", *(names.get(word, word) for word in arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("pgf-jax: ") and err.count("\n") == 1
    assert expected in err
    assert sorted(tmp_path.iterdir()) == before


def test_a_film_of_no_time_is_one_line(session, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    for what in ("fleet", "task"):
        with pytest.raises(BadInput, match=r"nothing to film|not at its task"):
            render(RenderConfig(what, session, tmp_path / "a.mp4", start=20.0, size=SMALL))
    assert [p.name for p in tmp_path.iterdir()] == [session.name]
