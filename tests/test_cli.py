"""The command line: its files, its help, and one line for every kind of bad input."""

import dataclasses
import importlib
import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import pgf_jax.arguments
import pgf_jax.cli as cli
from pgf_jax.cli import COMMANDS, main
from pgf_jax.errors import BadInput
from pgf_jax.plans.config import PlanCommand, PlanConfig
from pgf_jax.plans.file import load_plan
from pgf_jax.training.config import TrainCommand, TrainConfig

OBJECT = (
    '<body name="object_{i}" pos="{x} {y} 0.1826"><joint type="free"/>'
    '<geom type="cylinder" size="0.03 0.05" mass="1"/></body>'
)
CENTRES = [(0.40, 0.20), (0.45, -0.20), (0.50, 0.10)]


def scene_file(path: Path, centres=CENTRES) -> Path:
    objects = "".join(OBJECT.format(i=i, x=x, y=y) for i, (x, y) in enumerate(centres, 1))
    path.write_text(f"<mujoco><worldbody>{objects}</worldbody></mujoco>")
    return path


def run(arguments: Sequence[object], capsys) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `pgf-jax`, in this process."""
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def process(*arguments: object) -> subprocess.CompletedProcess:
    """`python -m pgf_jax` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "pgf_jax", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )


# --- bad input ----------------------------------------------------------------------------------

ARGUMENTS = {
    "command": (
        ["plane"],
        "command: expected one of scene, plan, execute, sweep, verify, reproduce, console, "
        "study, collect, train, fit-operator, profile, render, got 'plane'",
    ),
    "robots": (["console", "--robots", "0"], "--robots: expected a whole number within 1..100"),
    "host": (["console", "--host", "here"], "--host: expected an address such as 127.0.0.1"),
    "live sweep": (["sweep", "--operator", "live"], "operator: live is for pgf-jax console"),
    "log": (["sweep", "--log", "x"], "--log: expected with operator replay and only with it"),
    "no log": (["sweep", "--operator", "replay", "--log", "x"], "x: no such file"),
    "option": (
        ["plan", "--scene-class", "tight", "--bogus", "3"],
        "unrecognized options: --bogus 3",
    ),
    "stray": (["plan", "stray", "--scene-class", "tight"], "unrecognized options: stray"),
    "no scene": (["plan"], "--scene, --scene-class: expected one of the two, got neither"),
    "no file": (
        ["plan", "--scene"],
        "--scene, --scene-class: expected one of the two, got neither",
    ),
    "two": (["plan", "--scene", "a.xml", "--scene-class", "wide"], "one of the two, got both"),
    "class": (
        ["plan", "--scene-class", "huge"],
        "--scene-class: expected one of crowded, medium, mixed, packed, tight, wide, got 'huge'",
    ),
    "class by its other name": (
        ["plan", "--preset", "huge"],
        "pgf-jax: --scene-class: expected one of crowded, medium, mixed, packed, tight, wide, got ",
    ),
    "negative": (
        ["plan", "--scene-class", "tight", "--count", "-2"],
        "--count: expected a whole number 1 or more, got -2",
    ),
    "count of files": (
        ["plan", "--scene", "a.xml", "--count", "2"],
        "--count: goes with scene_class",
    ),
    "seed": (
        ["plan", "--scene-class", "tight", "--seed", "-1"],
        "--seed: expected a whole number within",
    ),
    "seed range": (
        ["plan", "--scene-class", "tight", "--seed", 2**32 - 1, "--count", 2],
        "--seed: expected a whole number within 0..4294967294, got 4294967295",
    ),
    "text": (
        ["plan", "--scene-class", "tight", "--seed", "x"],
        "--seed: expected a whole number, got 'x'",
    ),
    "number": (
        ["plan", "--scene-class", "tight", "--service-mean", "x"],
        "--service-mean: expected a number, got 'x'",
    ),
    "nan": (
        ["plan", "--scene-class", "tight", "--service-sd", "nan"],
        "--service-sd: expected a number",
    ),
    "no value": (
        ["plan", "--scene-class", "tight", "--count"],
        "--count: expected a value, got none",
    ),
    "engine": (
        ["plan", "--scene-class", "tight", "--engine", "bull"],
        "--engine: expected one of ",
    ),
    "operator": (
        ["plan", "--scene-class", "tight", "--operator", "x"],
        "--operator: expected one of",
    ),
    "physics": (
        ["plan", "--scene-class", "tight", "--physics", "x"],
        "--physics: expected one of authors, default, paper, got 'x'",
    ),
    "update": (
        ["plan", "--scene-class", "tight", "--update", "x"],
        "--update: expected one of greedy, stomp, got 'x'",
    ),
    "ask": (["plan", "--scene-class", "tight", "--ask", "after:-1"], "got 'after:-1'"),
    "lanes": (
        ["plan", "--scene-class", "tight", "--lanes", "0"],
        "--lanes: expected a whole number 1",
    ),
    "limit": (
        ["plan", "--scene-class", "tight", "--task-limit", "1"],
        "--task-limit: expected a number",
    ),
    "mode": (
        ["collect", "both", "--scenes", 1, "--out", "x"],
        "mode: expected one of autonomous, forks, futures, human, got 'both'",
    ),
    "missing": (["collect", "human"], "options missing: --out (see"),
    "several missing": (["train"], "options missing: --data, --out (see"),
    "scenes by their other name": (
        ["collect", "human", "--count", "x", "--out", "x"],
        "pgf-jax: --scenes: expected a whole number, got 'x'",
    ),
    "classes": (
        ["collect", "human", "--scenes", 1, "--out", "x", "--classes", "flat"],
        "--classes: expected one of tight, medium, wide, crowded, packed, mixed, got 'flat'",
    ),
    "sweep": (["sweep", "--robots", "-1"], "robots"),
    "sweep preset": (["sweep", "--preset", "x"], "--preset: expected one of paper, quick, got 'x'"),
    "scheduler": (
        ["sweep", "--scheduler", "there"],
        "--scheduler: expected tcp://HOST:PORT (or tls://), or slurm:N with N workers, got 'there'",
    ),
    "scheduler and workers": (
        ["sweep", "--scheduler", "slurm:4", "--workers", "2"],
        "--workers: expected none beside a scheduler, which has its own, got 2",
    ),
    "verify what": (["verify"], "options missing: folder"),
    "verify": (["verify", "nothing"], "nothing: holds no results of a sweep (no folder cells)"),
    "verify cells": (
        ["verify", "x", "--cells", "-1"],
        "--cells: expected a whole number 0 or more, got -1",
    ),
    "training": (
        ["train", "--data", "x", "--out", "y", "--batch", "0"],
        "--batch: expected a whole number 1 or more, got 0",
    ),
}


COLLECT = ("collect", "human", "--out", "x")
RENDER = ("render", "plan", "x", "--out", "y.png")
TRAIN = ("train", "--data", "x")
# What somebody types who has not read the help, and the end of the line that says what was meant.
MISTAKES = {
    ("swep",): "got 'swep': did you mean sweep?",
    ("SWEEP",): "got 'SWEEP': did you mean sweep?",
    ("fit",): "got 'fit': did you mean fit-operator?",
    ("help",): "got 'help': did you mean --help?",
    ("sweep", "--robot", "5"): "unrecognized option --robot: did you mean --robots?",
    ("sweep", "--robot=5"): "unrecognized option --robot: did you mean --robots?",
    ("sweep", "-robots", "5"): "unrecognized option -robots: did you mean --robots?",
    ("sweep", "robots", "5"): "unrecognized option robots: did you mean --robots?",
    ("sweep", "--policy", "pgf"): "unrecognized option --policy: did you mean --policies?",
    ("sweep", "--class", "wide"): "unrecognized option --class: did you mean --scene-class?",
    ("sweep", "--output", "x"): "unrecognized option --output: did you mean --out?",
    ("sweep", "--service", "3"): "--service: did you mean --service-mean or --service-sd?",
    ("sweep", "--verbose"): "unrecognized options: --verbose (see pgf-jax sweep --help)",
    (*TRAIN, "--outt", "y"): "unrecognized option --outt: did you mean --out?",
    ("fit-operator", "x"): "--log; unrecognized: x (see pgf-jax fit-operator --help)",
    (
        "verify",
        "--folder",
        "x",
    ): "option --folder: expected as in pgf-jax verify FOLDER",
    ("verify", "--cell", "3", "x"): "unrecognized option --cell: did you mean --cells?",
    ("verify", "--bogus", "x"): "unrecognized options: --bogus (see pgf-jax verify --help)",
    ("sweep", "--resume", "yes"): "--resume: expected no value, got 'yes'",
    ("sweep", "--resume=yes"): "--resume: expected no value, got 'yes'",
    ("console", "--robots", "1", "2"): "--robots: expected one value, got another, '2'",
    ("sweep", "--robots", "1,5"): (
        "--robots: expected whole numbers with spaces between them, as in --robots 1 5, got '1,5'"
    ),
    ("sweep", "--policies", "pgf,queue"): "as in --policies pgf queue, got 'pgf,queue'",
    (*COLLECT, "--classes", "tight,wide"): "as in --classes tight wide, got 'tight,wide'",
    ("plan", "--scene", "a.xml,b.xml"): "as in --scene a.xml b.xml, got 'a.xml,b.xml'",
    (*TRAIN, "--out", "y", "--hidden", "[64, 32]"): "as in --hidden 64 32, got '[64, 32]'",
    (*RENDER, "--size", "100,200"): "expected 2 whole numbers, as in --size 1280 800, got fewer",
    (*RENDER, "--size", "a", "2"): "--size: expected a whole number, got 'a'",
    ("sweep", "--robots", "1", "x"): "--robots: expected a whole number, got 'x'",
    ("sweep", "--policies", "PGF"): "got 'PGF': did you mean pgf?",
    ("sweep", "--policies", "or_hitl"): "got 'or_hitl': did you mean or-hitl?",
    ("console", "--policy", "PGF"): "got 'PGF': did you mean pgf?",
    ("sweep", "--preset", "Quick"): "got 'Quick': did you mean quick?",
    (*COLLECT, "--scenes", "1", "--classes", "Tight"): "got 'Tight': did you mean tight?",
    (*RENDER, "--view", "3D"): "--view: expected one of 3d, top, got '3D': did you mean 3d?",
    ("render", "plans", "x", "--out", "y.png"): "got 'plans': did you mean plan?",
}


@pytest.mark.parametrize("typed", MISTAKES, ids=" ".join)
def test_a_mistake_is_told_what_was_meant(typed, capsys):
    code, out, err = run(typed, capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.endswith(f"{MISTAKES[typed]}\n")


def test_a_file_may_have_a_comma(tmp_path, monkeypatch, capsys):
    seen = []
    monkeypatch.setitem(COMMANDS, "plan", cli.Command("", COMMANDS["plan"].config, seen.append))
    path = scene_file(tmp_path / "a,b.xml")
    assert run(["plan", "--scene", path], capsys) == (0, "", "")
    assert seen[0].scene == (path,)


@pytest.mark.parametrize("case", ARGUMENTS)
def test_a_wrong_argument_is_one_line(case, capsys):
    arguments, expected = ARGUMENTS[case]
    code, out, err = run(arguments, capsys)
    assert (code, out) == (2, "")
    assert err.startswith("pgf-jax: ") and err.count("\n") == 1 and err.endswith("\n")
    assert expected in err


def test_a_rejection_of_a_new_kind_is_one_line_too(monkeypatch, capsys):
    monkeypatch.setattr(pgf_jax.arguments, "_rejection", lambda *_: None)
    code, out, err = run(["plan", "--scene-class", "tight", "--physics", "x"], capsys)
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert "invalid choice 'x' for argument '--physics'" in err and "│" not in err


def bad_scene(path: Path, kind: str) -> Path:
    """A scene file with something wrong in it."""
    if kind == "overlap":
        return scene_file(path, [*CENTRES, (0.41, 0.20)])
    if kind == "no goal":
        return scene_file(path, CENTRES[:2])
    if kind == "outside":
        return scene_file(path, [(0.40, 0.39), *CENTRES[1:]])
    scene_file(path)
    if kind == "truncated":
        path.write_text(path.read_text()[:-30])
    if kind == "binary":
        path.write_bytes(bytes(range(256)))
    if kind == "missing":
        path.unlink()
    return path


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("overlap", "object_1 and object_4 overlap"),
        ("no goal", "object_3"),
        ("outside", "object_1 at (0.4, 0.39) is outside the shelf"),
        ("truncated", "expected"),
        ("binary", "expected"),
        ("missing", "no such file"),
    ],
)
def test_a_wrong_scene_is_one_line_and_nothing_is_planned(kind, expected, tmp_path, capsys):
    good = scene_file(tmp_path / "good.xml")
    bad = bad_scene(tmp_path / "bad.xml", kind)
    arguments = ["plan", "--scene", good, bad, "--engine", "native", "--out", tmp_path / "out"]
    code, out, err = run(arguments, capsys)
    assert (code, out) == (2, "")
    assert err.startswith(f"pgf-jax: {bad}: ") and err.count("\n") == 1
    assert expected in err
    assert not (tmp_path / "out").exists()


def test_two_scenes_of_one_name_would_share_a_file(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    scenes = [scene_file(tmp_path / "s.xml"), scene_file(tmp_path / "a" / "s.xml")]
    code, _, err = run(["plan", "--scene", *scenes], capsys)
    assert code == 2 and "--scene: expected scenes of different names, got s twice" in err


def test_an_out_that_is_no_folder_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    code, _, err = run(["plan", "--scene-class", "tight", "--out", tmp_path / "file"], capsys)
    assert code == 2 and err.count("\n") == 1
    assert f"--out {tmp_path / 'file'}: expected a folder to write to" in err


@pytest.mark.parametrize("damage", ["missing", "truncated", "foreign"])
def test_a_wrong_checkpoint_is_one_line(damage, tmp_path, capsys):
    if damage != "missing":
        (tmp_path / "phi_auto.msgpack").write_bytes(b"\x82\xa7" if damage == "truncated" else b"x")
    arguments = ["plan", "--scene-class", "tight", "--engine", "native", "--ask", "gain"]
    code, out, err = run([*arguments, "--predictor", tmp_path], capsys)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert f"{tmp_path / 'phi_auto.msgpack'}: " in err


def test_data_that_is_not_there_is_one_line(tmp_path, capsys):
    code, out, err = run(["train", "--data", tmp_path, "--out", tmp_path / "out"], capsys)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and "runs.parquet: no such file" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments", [["plan", "--preset", "x"], ["plan", "--scene", "x.xml"], ["plan", "--x"], ["x"]]
)
def test_bad_input_in_a_process_of_its_own(arguments):
    done = process(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


def test_a_message_of_several_lines_becomes_one(monkeypatch, capsys):
    def fail(config):
        raise BadInput("scene\nx")

    monkeypatch.setitem(COMMANDS, "plan", cli.Command("", COMMANDS["plan"].config, fail))
    assert run(["plan", "--scene-class", "tight"], capsys) == (2, "", "pgf-jax: scene x\n")


@pytest.mark.parametrize(
    ("error", "line"),
    [(KeyboardInterrupt(), "interrupted"), (KeyboardInterrupt("all is kept"), "all is kept")],
)
def test_an_interruption_is_one_line_and_130(error, line, monkeypatch, capsys):
    def interrupt(config):
        raise error

    monkeypatch.setitem(COMMANDS, "plan", cli.Command("", COMMANDS["plan"].config, interrupt))
    assert run(["plan", "--scene-class", "tight"], capsys) == (130, "", f"pgf-jax: {line}\n")


# --- help and laziness --------------------------------------------------------------------------


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_needs_no_jax(name):
    code = (
        "import sys; from pgf_jax.cli import main\n"
        f"assert main(['{name}', '--help']) == 0\n"
        "assert not {'jax', 'mujoco', 'polars', 'matplotlib', 'flax'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"usage: pgf-jax {name}" in done.stdout


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help_lists_the_commands(flag, capsys):
    code, out, err = run([flag], capsys)
    assert (code, err) == (0, "")
    for name, command in COMMANDS.items():
        assert f"\n  {name} " in out and command.summary in out
    assert max(map(len, out.splitlines())) <= 80


def test_no_command_lists_the_commands_too(capsys):
    _, listed, _ = run(["--help"], capsys)
    code, out, err = run([], capsys)
    assert (code, out) == (2, "")
    assert err.startswith(listed)
    assert (
        err[len(listed) :] == f"pgf-jax: command: expected one of {', '.join(COMMANDS)}, got none\n"
    )


def test_the_flags_that_are_promised(capsys):
    _, out, _ = run(["plan", "--help"], capsys)
    flags = "scene scene-class preset seed count engine physics cost update operator ask lanes out"
    for flag in [*flags.split(), "predictor"]:
        assert f"--{flag} " in out
    words = " ".join(out.replace("│", " ").split())
    # The operator, the scene files, constants of the physics and weights of the cost.
    assert words.count("(default: none)") == 4
    assert "--plugin MODULE" in words
    assert "(default: stuck)" in words and "(default: planar)" in words


def config_of(name: str) -> type:
    """The class of a command's settings."""
    module, kind = COMMANDS[name].config.split(":")
    return getattr(importlib.import_module(module), kind)


def texts(name: str) -> dict[str, str]:
    """The options' texts, by field."""
    found = {}
    for kind in pgf_jax.arguments._classes(config_of(name)):
        text = pgf_jax.arguments._texts(kind).partition("\n\nAttributes:")[2]
        found |= dict(re.findall(r"^  (\w+): (.*)$", text.partition("\n\n")[0], re.MULTILINE))
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_at_80_columns(name, monkeypatch, capsys):
    """Every option is there, with its whole text, in lines that fit."""
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = run([name, "--help"], capsys)
    assert (code, err) == (0, "")
    assert out.startswith(f"usage: pgf-jax {name} ")
    usage, *lines = out.splitlines()
    assert max(map(len, lines)) <= 80 and len(usage) <= 100  # tyro does not wrap the usage
    words = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    options = pgf_jax.arguments._options(config_of(name))
    assert texts(name).keys() - {"config"} == options.keys()
    for field, text in texts(name).items():
        if field in options:
            assert text in words
            positional = f"--{field.replace('_', '-')}" not in words
            assert positional == (field in ("mode", "what", "file", "folder", "plans"))


@pytest.mark.parametrize("name", COMMANDS)
def test_groups_hold_options_once(name):
    config = config_of(name)
    groups = [field for _, names in getattr(config, "GROUPS", ()) for field in names]
    assert len(groups) == len({*groups})
    options = pgf_jax.arguments._options(config)
    ungrouped = options.keys() - {*groups}
    assert {*groups} <= options.keys()
    if groups:
        assert ungrouped <= {"mode", "what", "file", "folder", "plans"}  # those without a flag


@pytest.mark.parametrize("name", COMMANDS)
def test_what_none_means_is_said(name):
    """A default of None is shown as such, and so the text tells what happens then."""
    for field, (_, _, made) in pgf_jax.arguments._options(config_of(name)).items():
        assert (made.default is None) == ("None: " in texts(name)[field]), field


# Options of one name that mean something else in each command, or have more choices in some.
OTHER_MEANING = {
    "host",
    *("json", "log", "out", "patience", "policies", "repeats", "resume", "scene", "scenes", "seed"),
    *("speed", "world", "world_error"),
}
MORE_CHOICES = {"operator", "policy", "predictor", "robot", "robots", "scene_class", "task"}


def test_an_option_has_one_text_in_all_commands():
    found: dict[str, set[str]] = {}
    for name in COMMANDS:
        for field, text in texts(name).items():
            start = re.split(r"[;.] (?:None: |The default )", text)[0]  # defaults differ
            found.setdefault(field, set()).add(start.removesuffix("."))
    several = {field for field, some in found.items() if len(some) > 1}
    lists = {"lanes"}  # those that profile tries
    inner = {"config", "folder", "what"}  # no options
    assert several - inner - lists == OTHER_MEANING | MORE_CHOICES
    # A session is a sweep of one fleet.
    sweeps, sessions = texts("sweep"), texts("console")
    differ = {field for field in sweeps.keys() & sessions if sweeps[field] != sessions[field]}
    assert differ == {"robots", "tasks", "operator", "scene_class", "out", "resume"}


def test_scenes_are_asked_for_by_the_same_names(monkeypatch, capsys):
    seen = []
    for name in ("plan", "collect"):
        command = cli.Command("", COMMANDS[name].config, seen.append)
        monkeypatch.setitem(COMMANDS, name, command)
    for flag in ("--scene-class", "--preset", "--preset=wide"):
        value = [] if "=" in flag else ["wide"]
        assert run(["plan", flag, *value, "--count", 2], capsys) == (0, "", "")
    assert seen[0] == seen[1] == seen[2] == PlanCommand(scene_class="wide", count=2)
    collect = ["collect", "human", "--out", "x"]
    assert run([*collect, "--count", 3, "--scene-classes", "wide", "tight"], capsys)[0] == 0
    assert run([*collect, "--scenes", 3, "--classes", "wide", "tight"], capsys)[0] == 0
    assert seen[3] == seen[4]
    assert (seen[3].scenes, seen[3].classes) == (3, ("wide", "tight"))


def test_settings_within_settings_are_set(monkeypatch, capsys):
    seen = []
    for name in ("plan", "train"):
        command = cli.Command("", COMMANDS[name].config, seen.append)
        monkeypatch.setitem(COMMANDS, name, command)
    run(["plan", "--scene-class", "tight", "--ask", "gain", "--lanes", 3], capsys)
    assert seen[0].config == PlanConfig(ask="gain", lanes=3)
    run(["train", "--data", "x", "--out", "y", "--hidden", 8, 4, "--loss", "mae"], capsys)
    assert seen[1] == TrainCommand(Path("x"), Path("y"), TrainConfig(hidden=(8, 4), loss="mae"))


def test_the_version(capsys):
    code, out, _ = run(["--version"], capsys)
    assert code == 0 and out.count(".") == 2


# --- what is written ----------------------------------------------------------------------------


def test_plans_of_files_and_presets_are_written(tmp_path, capsys):
    files = [scene_file(tmp_path / f"{name}.xml") for name in ("one", "two")]
    arguments = ["plan", "--engine", "native", "--out", tmp_path / "plans"]
    code, out, err = run([*arguments, "--scene", *files, "--seed", "5"], capsys)
    assert (code, err) == (0, "")
    assert "one" in out and "two" in out and "engine native" in out
    one, two = (load_plan(tmp_path / "plans" / f"{name}.plan.json") for name in ("one", "two"))
    assert one.seed == two.seed == 5
    np.testing.assert_allclose(one.scene.positions, CENTRES)
    assert one.scene.goal == 2
    # Equal scenes of one seed have equal plans: common random numbers.
    assert one.to_json() == {**two.to_json(), "scene": "one"}


def test_a_preset_plan_does_not_depend_on_the_count(tmp_path, capsys):
    arguments = ["plan", "--scene-class", "wide", "--engine", "native", "--task-limit", "10"]
    assert run([*arguments, "--seed", 1, "--count", 2, "--out", tmp_path / "a"], capsys)[0] == 0
    assert run([*arguments, "--seed", 2, "--out", tmp_path / "b"], capsys)[0] == 0
    both = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert both == ["wide_1.plan.json", "wide_2.plan.json"]
    alone = (tmp_path / "b" / "wide_2.plan.json").read_bytes()
    assert (tmp_path / "a" / "wide_2.plan.json").read_bytes() == alone
    assert json.loads(alone)["seed"] == 2


def test_an_unsolved_plan_is_no_error_and_is_not_written_unasked(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["plan", "--scene-class", "wide", "--engine", "native", "--task-limit", "4.5"]
    code, out, err = run(arguments, capsys)
    assert (code, err) == (0, "")
    assert "0 of 1 solved" in out
    assert list(tmp_path.iterdir()) == []


def test_collect_writes_runs_and_says_how_to_go_on(tmp_path, capsys):
    arguments = ["collect", "autonomous", "--scenes", 2, "--out", tmp_path, "--engine", "native"]
    arguments += ["--task-limit", "4.5", "--classes", "wide"]
    code, out, err = run(arguments, capsys)
    assert (code, err) == (0, "")
    assert "2 wide" in out and "runs.parquet" in out.replace("\n", "")
    code, out, err = run(arguments, capsys)
    assert (code, out) == (2, "") and "--resume" in err
    assert run([*arguments, "--resume"], capsys)[0] == 0


def test_an_interrupted_collection_names_resume(tmp_path, monkeypatch, capsys):
    def interrupt(config, on_progress):
        raise KeyboardInterrupt

    monkeypatch.setattr("pgf_jax.collection.collect.collect", interrupt)
    arguments = ["collect", "autonomous", "--scenes", 2, "--out", tmp_path, "--engine", "native"]
    code, out, err = run(arguments, capsys)
    assert (code, out) == (130, "")
    assert err.count("\n") == 1 and "--resume" in err


@pytest.mark.parametrize(
    ("arguments", "engine"),
    [
        (["plan", "--scene-class", "tight"], "planar"),
        (["sweep", "--engine", "mjx"], "mjx"),
        (["verify", "results"], "planar"),
        (["profile"], None),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_jax_is_configured_for_the_engine(arguments, engine, monkeypatch):
    seen = []
    command = dataclasses.replace(COMMANDS[arguments[0]], run=lambda config: seen.append("run"))
    monkeypatch.setitem(COMMANDS, arguments[0], command)
    monkeypatch.setattr(cli, "configure_early", seen.append)
    assert cli.main(arguments) == 0
    assert seen == [engine, "run"]
