import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pgf_jax.arguments import parse
from pgf_jax.collection.config import CollectConfig
from pgf_jax.errors import BadInput
from pgf_jax.fleet.config import Cell, FleetConfig
from pgf_jax.fleet.policies import policy_names
from pgf_jax.physics.config import PHYSICS
from pgf_jax.planning.config import Cost, Planner, planner_of
from pgf_jax.plans.config import PlanConfig
from pgf_jax.sweeping.config import HOW, INPUTS, SweepConfig


def parsed(*words: str) -> SweepConfig:
    return parse(SweepConfig, words, "sweep")


def test_quick_is_forty_tasks():
    config = SweepConfig(preset="quick", seed=5, engine="native")
    assert config.cells() == (
        Cell("pgf", 1, 4, 5),
        Cell("pgf", 4, 4, 5),
        Cell("or-hitl", 1, 4, 5),
        Cell("or-hitl", 4, 4, 5),
    )
    assert sum(cell.robots * cell.tasks for cell in config.cells()) == 40
    assert config.sampled_class() == "tight"
    spelled_out = SweepConfig(
        preset="quick",
        robots=(1, 4),
        policies=("pgf", "or-hitl"),
        tasks=4,
        scene_class="tight",
        seed=5,
    )
    assert spelled_out.cells() == config.cells()


def test_lists_and_strings_will_do():
    config = SweepConfig(preset="quick", robots=[1, 4], out="x", scenes=None)  # pyright: ignore[reportArgumentType]
    assert config == SweepConfig(preset="quick", robots=(1, 4), out=Path("x"))


def test_a_plain_sweep_compares_the_baseline_the_paper_and_the_best_here():
    cells = SweepConfig().cells()
    assert list(dict.fromkeys(c.policy for c in cells)) == ["or-hitl", "pgf", "gain-rate"]
    assert list(dict.fromkeys((c.robots, c.tasks) for c in cells)) == [
        (1, 10),
        (10, 10),
        (20, 10),
        (30, 10),
    ]


def test_paper_sizes():
    cells = SweepConfig(preset="paper").cells()
    assert [(c.robots, c.tasks) for c in cells if c.policy == "pgf"] == [
        (1, 100),
        (10, 50),
        (20, 50),
        (30, 50),
    ]
    assert {c.policy for c in cells} == {"pgf", "or-hitl"}
    assert SweepConfig(preset="paper").physics == "default"
    other = SweepConfig(preset="paper", policies=("autonomous",), robots=(1, 20))
    assert other.cells() == (Cell("autonomous", 1, 100), Cell("autonomous", 20, 50))


def test_fleet_takes_over_every_time():
    config = SweepConfig(
        operators=2,
        service_mean=5.0,
        service_sd=1.0,
        context_switch=0.5,
        window=3.0,
        rollout_time=0.75,
        compute="shared:96",
        horizon=3600.0,
        seed=7,
        bid_threshold=2.5,
        task_limit=90.0,
        push_limit=12.0,
        push_execution=2.0,
        retreat=0.5,
        reach_execution=4.0,
        rollouts=16,
    )
    fleet = config.fleet(Cell("or-hitl", 20, 50, 7))
    assert (fleet.robots, fleet.tasks, fleet.policy, fleet.seed) == (20, 50, "or-hitl", 7)
    assert (fleet.operators, fleet.service_mean_s, fleet.service_sd_s) == (2, 5.0, 1.0)
    assert (fleet.context_switch_s, fleet.window_s, fleet.rollout_time_s) == (0.5, 3.0, 0.75)
    assert (fleet.compute, fleet.horizon_s) == ("shared:96", 3600.0)
    assert (fleet.bid_threshold, fleet.task_limit_s, fleet.push_limit_s) == (2.5, 90.0, 12.0)
    times = (fleet.push_execution_s, fleet.retreat_s, fleet.reach_execution_s)
    assert times == (2.0, 0.5, 4.0) and fleet.rollouts == 16


def test_every_setting_of_the_fleet_and_the_planner_can_be_reached():
    """And where it is left out, it has the value that was built in before it could be given."""
    ours = {field.name for field in dataclasses.fields(SweepConfig)}
    fleet = {field.name.removesuffix("_s") for field in dataclasses.fields(FleetConfig)}
    planner = {field.name for field in dataclasses.fields(Planner)}
    assert fleet - ours == {"policy"} and planner <= ours
    cell = Cell("pgf", 1, 50)
    assert SweepConfig().fleet(cell) == FleetConfig()
    assert SweepConfig().planner() == Planner() == planner_of(PlanConfig())
    assert PlanConfig(operator="heuristic", ask="gain").fleet(0) == FleetConfig(tasks=1)
    assert planner_of(CollectConfig("autonomous", Path("x"), scenes=1)) == Planner()
    given = SweepConfig(
        rollouts=4,
        sigma=(0.1, 0.2, 0.3),
        stuck_count=3,
        cost_weights=("w_d=2000", "edge_x=0.1,0.5"),
    )
    physics = SweepConfig(physics="paper", physics_constants=("mass=1.2", "substeps=100"))
    assert physics.physics_values() == dataclasses.replace(PHYSICS["paper"], mass=1.2, substeps=100)
    cost = Cost(w_d=2000.0, edge_x=(0.1, 0.5))
    assert given.planner() == Planner(4, sigma=(0.1, 0.2, 0.3), stuck_count=3, cost=cost)


def test_several_seeds_are_fleets_of_their_own():
    config = SweepConfig(robots=(1, 2), policies=("pgf",), tasks=1, seeds=(3, 0))
    sizes = [(cell.robots, cell.seed) for cell in config.cells()]
    assert sizes == [(1, 3), (1, 0), (2, 3), (2, 0)]
    assert [config.fleet(cell).seed for cell in config.cells()] == [3, 0, 3, 0]
    assert SweepConfig(seeds=(5,)) == SweepConfig(seed=5)
    own = config.of_cell(config.cells()[0])
    assert own["seed"] == 3 and "seeds" not in own


def test_lanes_are_a_constant_of_the_engine():
    for robots in ((1,), (30,)):
        for workers in (1, 4):
            config = SweepConfig(robots=robots, workers=workers)
            assert config.engine_lanes() == SweepConfig().engine_lanes()
    assert SweepConfig(lanes=3).engine_lanes() == 3


def test_planar_gets_a_process_a_core(monkeypatch):
    """Its calls use one core."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2})
    policies = ("pgf", "or-hitl", "always", "autonomous")
    assert SweepConfig(robots=(20,), policies=policies).processes() == 3
    assert SweepConfig(robots=(20,), policies=policies, workers=2).processes() == 2
    assert SweepConfig(robots=(20,), policies=policies, engine="mjx").processes() == 1


def test_every_policy_can_be_swept():
    """`oracle-gain` as well, which needs no network."""
    config = SweepConfig(policies=tuple(policy_names()), robots=(1,), tasks=1)
    assert {"oracle-gain", "classifier", "random"} < {cell.policy for cell in config.cells()}
    for policy in ("oracle-gain", "or-hitl"):
        assert not SweepConfig(policies=(policy,)).needs_gains()
    for policies in (("pgf",), ("oracle-gain", "pgf")):
        assert SweepConfig(policies=policies).needs_gains()


def test_a_random_winner_reaches_the_planner():
    assert SweepConfig().planner().random_winner == 0
    for chance in (0, 0.5, 1):
        assert SweepConfig(random_winner=chance).planner().random_winner == chance


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"preset": "huge"}, "preset: expected one of quick, paper, got 'huge'"),
        ({"engine": "bullet"}, "engine: expected one of .*mjx.*, got 'bullet'"),
        ({"physics": "moon"}, "physics: expected one of default, authors, paper, got 'moon'"),
        ({"cost": "free"}, "cost: .* got 'free'"),
        ({"update": "cem"}, "update: .* got 'cem'"),
        (
            {"scene_class": "huge"},
            "expected one of tight, .*, mixed, all, every, got 'huge'",
        ),
        ({"random_winner": -0.1}, r"random_winner: expected a number within 0\.\.1, got -0.1"),
        ({"random_winner": 1.5}, "random_winner: .* got 1.5"),
        ({"random_winner": float("nan")}, "random_winner: .* got nan"),
        ({"random_winner": 0.5, "update": "stomp"}, "random_winner: expected 0 with update stomp"),
        ({"policies": ("pgf", "best")}, "policies: expected one of pgf, .*, got 'best'"),
        ({"policies": ()}, "policies: expected one or more, all different, got none"),
        ({"policies": ("pgf", "pgf")}, "policies: .* all different, got pgf pgf"),
        ({"robots": ()}, "robots: expected one or more, all different, got none"),
        ({"robots": (4, 4)}, "robots: .* all different, got 4 4"),
        ({"robots": (4, 0)}, "robots: expected a whole number 1 or more, got 0"),
        ({"robots": (-1,)}, "robots: expected a whole number 1 or more, got -1"),
        ({"tasks": 0}, "tasks: expected a whole number 1 or more, got 0"),
        ({"tasks": -3}, "tasks: .* got -3"),
        ({"operators": 0}, "operators: .* got 0"),
        ({"workers": -1}, "workers: .* got -1"),
        ({"lanes": 0}, "lanes: .* got 0"),
        ({"seed": -1}, "seed: .* got -1"),
        ({"seed": 2**32}, "seed: .* got 4294967296"),
        ({"service_mean": -1.0}, "service_mean: .* 0 or more, got -1.0"),
        ({"service_sd": float("nan")}, "service_sd: .* got nan"),
        ({"service_mean": 0.0}, "service_sd: expected 0 with service_mean 0, got 4.0"),
        ({"context_switch": -0.1}, "context_switch: .* got -0.1"),
        ({"window": float("inf")}, "window: .* got inf"),
        ({"rollout_time": 0.0}, "rollout_time: .* got 0.0"),
        ({"horizon": 0.0}, "horizon: .* got 0.0"),
        ({"horizon": -5.0}, "horizon: .* got -5.0"),
        ({"compute": "cloud"}, "compute: expected dedicated, or shared:C .* got 'cloud'"),
        ({"compute": "shared:0"}, "compute: .* got 'shared:0'"),
        ({"scenes": Path("x"), "scene_class": "wide"}, "scene_class: expected none beside scenes"),
        ({"scenes": Path("x"), "scene_class": "all"}, "scene_class: expected none beside scenes"),
        ({"preset": "quick", "robots": (1, 2)}, "robots: fixed at 1 4 by the preset quick, got 1"),
        ({"preset": "quick", "tasks": 5}, "tasks: fixed at 4 by the preset quick, got 5"),
        ({"preset": "quick", "policies": ("pgf",)}, "policies: fixed at pgf or-hitl by"),
        ({"preset": "quick", "scene_class": "wide"}, "scene_class: fixed at tight by"),
        ({"preset": "quick", "scene_class": "all"}, "scene_class: fixed at tight by"),
        ({"preset": "quick", "scenes": Path("x")}, "scenes: the preset quick samples its own"),
        ({"scenes": []}, "scenes: expected one or more, got none"),
        ({"scenes": ["x.xml"]}, "scenes: expected a Scene, got 'x.xml'"),
        ({"seeds": (1, 1)}, "seeds: expected one or more, all different, got 1 1"),
        ({"seeds": (1, 2), "seed": 3}, "seed: expected none beside seeds, got 3"),
        ({"sigma": (0.1, 0.1)}, r"sigma: expected three numbers \(x, y, turn\), got"),
        ({"sigma": (0.1, 0.1, -1)}, "sigma: expected a number 0 or more, got -1"),
        ({"physics_constants": ("mass=0",)}, "mass: expected a number above 0, got 0.0"),
        ({"physics_constants": ("substeps=1.5",)}, "physics_constants: expected substeps=NUMBER"),
        ({"physics_constants": ("knots=9",)}, "physics_constants: expected one of substeps, .*"),
        ({"cost_weights": ("w_d",)}, "cost_weights: expected w_d=NUMBER once, got 'w_d'"),
        ({"cost_weights": ("w_x=1",)}, "cost_weights: expected one of w_d, .*, got 'w_x'"),
        ({"cost_weights": ("w_d=1", "w_d=2")}, "cost_weights: expected w_d=NUMBER once"),
        ({"cost_weights": ("w_d=nan",)}, "w_d: expected a number"),
        ({"cost_weights": ("edge_x=1",)}, "cost_weights: expected edge_x=LOW,HIGH once"),
    ],
)
def test_bad_values_are_named_in_one_line(changes, message):
    with pytest.raises(BadInput, match=message) as caught:
        SweepConfig(**changes)
    assert "\n" not in str(caught.value)


def test_command_line_flags():
    words = (
        "--preset paper --robots 1 10 --policies pgf or-hitl always --tasks 3 --seed 4 "
        "--engine native --physics paper --cost paper --update stomp --scene-class wide "
        "--operator none --operators 2 --service-mean 6 --service-sd 1 --window 3 "
        "--rollout-time 1 --compute shared:96 --predictor p --horizon 100 --workers 2 "
        "--lanes 5 --out o --resume"
    )
    config = parsed(*words.split())
    assert config == SweepConfig(
        preset="paper",
        robots=(1, 10),
        policies=("pgf", "or-hitl", "always"),
        tasks=3,
        seed=4,
        engine="native",
        physics="paper",
        cost="paper",
        update="stomp",
        scene_class="wide",
        operator="none",
        operators=2,
        service_mean=6.0,
        service_sd=1.0,
        window=3.0,
        rollout_time=1.0,
        compute="shared:96",
        predictor="p",
        horizon=100.0,
        workers=2,
        lanes=5,
        out=Path("o"),
        resume=True,
    )
    assert parsed("--scenes", "d").scenes == Path("d")
    words = ["--scene-class", "all", "--random-winner", "0.25", "--policies", "oracle-gain"]
    assert parsed(*words) == SweepConfig(
        scene_class="all", random_winner=0.25, policies=("oracle-gain",)
    )
    words = "--seeds 2 1 --rollouts 4 --sigma 0.1 0.2 0.3 --cost-weights w_d=2 w_b=1"
    assert parsed(*words.split()) == SweepConfig(
        seeds=(2, 1), rollouts=4, sigma=(0.1, 0.2, 0.3), cost_weights=("w_d=2", "w_b=1")
    )


def test_the_settings_of_one_cell():
    """Named in full, so that what the defaults of a version are does not matter."""
    config = SweepConfig(
        preset="quick",
        engine="native",
        workers=2,
        seed=5,
        predictor="best",
        resume=True,
        scenes=None,
        json=True,
    )
    own = config.of_cell(config.cells()[1])
    names = {field.name for field in dataclasses.fields(SweepConfig)}
    assert names - own.keys() == {*HOW, *INPUTS, "seeds"} and own.keys() <= names
    assert (own["robots"], own["policies"], own["tasks"]) == ([4], ["pgf"], 4)
    assert (own["scene_class"], own["lanes"], own["seed"]) == ("tight", 1, 5)
    assert config.inputs() == {"scenes": None, "predictor": "best", "log": None}
    alone = SweepConfig(**own, predictor="best")  # pyright: ignore[reportArgumentType]
    assert alone.cells() == (config.cells()[1],)
    assert alone.fleet(alone.cells()[0]) == config.fleet(config.cells()[1])
    files = SweepConfig(scenes=Path("a/b"), predictor="best:c")
    assert files.inputs() == {"scenes": "a/b", "predictor": "best:c", "log": None}
    assert files.of_cell(files.cells()[0])["scene_class"] == files.sampled_class()


@pytest.mark.parametrize("scheduler", ["tcp://here:1", "tls://10.0.0.1:8786", "slurm:12"])
def test_schedulers(scheduler):
    config = SweepConfig(scheduler=scheduler)
    assert config == parsed("--scheduler", scheduler)


@pytest.mark.parametrize(
    "scheduler", ["", "here:1", "tcp://here", "tcp://a b:1", "tcp://a/b:1", "slurm:0", "slurm:"]
)
def test_what_is_no_scheduler(scheduler):
    with pytest.raises(BadInput, match="scheduler: expected tcp://HOST:PORT"):
        SweepConfig(scheduler=scheduler)


def test_every_field_has_its_help():
    assert SweepConfig.__doc__ is not None
    for field in dataclasses.fields(SweepConfig):
        assert f"      {field.name}: " in SweepConfig.__doc__


def test_config_imports_nothing_heavy():
    code = (
        "import sys, pgf_jax.sweeping.config as c; c.SweepConfig(); "
        "print([m for m in ('jax', 'mujoco', 'polars', 'matplotlib', 'flax') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr
