"""Pictures of a sweep's fleets, which are simulated again, and of its results."""

import dataclasses

import numpy as np
import pytest
from PIL import Image
from sweep_toys import ghost

from pgf_jax.cli import main
from pgf_jax.errors import BadInput
from pgf_jax.render.fleet_view import draw_one
from pgf_jax.render.top import TopView
from pgf_jax.sweeping.stored_fleet import CellChoice, StoredFleet, snapshots
from pgf_jax.sweeping.sweep import sweep

S = 10**9


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A sweep of two policies; its robots are helped, and push."""
    out = tmp_path_factory.mktemp("stored") / "sweep"
    config = ghost(out, policies=("eager", "autonomous"), robots=(1, 2), operator="nudge")
    return sweep(config, quiet=True)


def render(what, folder, out, *words: str) -> int:
    return main(["render", what, str(folder), "--out", str(out), "--size", "400", "300", *words])


def test_any_fleet_of_a_sweep_is_drawn(stored, tmp_path, capsys):
    out = tmp_path / "fleet.png"
    words = ("--policy", "eager", "--robots", "2", "--seed", "0")
    assert render("fleet", stored.out, out, *words, "--at", "3") == 0
    assert Image.open(out).size == (400, 300)
    assert render("task", stored.out, out, *words, "--robot", "1", "--at", "3") == 0
    capsys.readouterr()
    assert render("fleet", stored.out, out) == 2
    err = capsys.readouterr().err
    assert "several fleets; choose by policy, robots and seed one of: autonomous with 1" in err
    assert "eager with 2 robots, seed 0" in err and err.count("\n") == 1
    assert render("fleet", stored.out, out, "--policy", "pgf") == 2
    assert "no such fleet; choose by policy, robots and seed one of" in capsys.readouterr().err


def test_a_time_after_the_end_is_refused(stored, tmp_path, capsys):
    words = ("--policy", "eager", "--robots", "1", "--at", "9999")
    for what in ("fleet", "task"):
        assert render(what, stored.out, tmp_path / "x.png", *words) == 2
        err = capsys.readouterr().err
        assert "s, expected --at within it, got 9999" in err and "ends after " in err
    assert not (tmp_path / "x.png").exists()


def test_a_fleet_that_goes_another_way_is_refused(stored):
    fleet = StoredFleet(stored.out, CellChoice("eager", 1))
    fleet.runner.run_until()
    fleet.check()
    fleet._events = fleet._events[:-1]
    with pytest.raises(BadInput, match=r"goes another way here from event \d+ on"):
        fleet.check()


def test_bids_grants_and_inputs_are_seen_when_they_happen(stored):
    frames = [
        fleet.robots[0]
        for fleet in snapshots(stored.out, every_ns=S // 2, choice=CellChoice("eager", 1))
    ]
    news = list(dict.fromkeys(robot.news for robot in frames))
    assert "granted: the operator looks at it" in news
    assert any(words.startswith("input: ") for words in news)
    assert "" in news  # it passes
    asked = [robot for robot in frames if robot.bids_at]
    last = asked[-1]
    assert len(last.bids_at) >= len(last.grants_at) >= len(last.inputs_at) > 0
    # Each kind of mark is on the picture of the robot.
    picture = draw_one(last, (900, 600), TopView())
    for name in ("bids_at", "grants_at", "inputs_at"):
        without = dataclasses.replace(last, **{name: ()})
        assert (draw_one(without, (900, 600), TopView()) != picture).any()


@pytest.mark.parametrize("suffix", [".png", ".pdf"])
def test_the_figure_of_a_sweep_under_a_name_of_ones_choice(stored, tmp_path, suffix, capsys):
    files = [tmp_path / f"{name}{suffix}" for name in ("one", "two")]
    for file in files:
        assert main(["render", "sweep", str(stored.out), "--out", str(file)]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    assert files[0].read_bytes()[1:4] == (b"PNG" if suffix == ".png" else b"PDF")
    assert main(["render", "sweep", str(stored.out), "--out", str(tmp_path / "x.mp4")]) == 2
    assert "--out: expected a file .png or .pdf" in capsys.readouterr().err


def test_a_ring_shows_where_an_object_came_from(stored):
    robot = next(iter(snapshots(stored.out, every_ns=S, choice=CellChoice("eager", 1)))).robots[0]
    view = TopView()
    before = view.shelf(robot, 500, 400)
    still = view.shelf(dataclasses.replace(robot, origins=robot.objects), 500, 400)
    moved = robot.objects + np.array([0.0, 0.05])
    ringed = view.shelf(dataclasses.replace(robot, origins=moved), 500, 400)
    assert (before == still).all() and (before != ringed).any()
