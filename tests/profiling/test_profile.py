"""The profiler: its numbers add up; speed itself is not tested."""

import contextlib
import copy
import io
import json
import re

import profile_toys
import pytest
from rich.console import Console

from pgf_jax.errors import BadInput, WorkersLost
from pgf_jax.profiling import profile as module
from pgf_jax.profiling.config import ProfileConfig
from pgf_jax.profiling.profile import profile
from pgf_jax.profiling.report import print_report


def keys_of(tree) -> set[str]:
    if isinstance(tree, dict):
        return {*tree, *(key for value in tree.values() for key in keys_of(value))}
    if isinstance(tree, list):
        return {key for value in tree for key in keys_of(value)}
    return set()


@pytest.fixture(scope="module")
def measured():
    """Figures of two engines on one core twice, as if it were two; and what was printed."""
    with pytest.MonkeyPatch.context() as patch:
        core = module.usable()[0]
        patch.setattr(module, "usable", lambda: [core, core])
        patch.setattr(module, "default_processes", lambda name: {"counted": 5, "native": 1}[name])
        patch.setitem(module.SETTINGS, "counted", [{"tick": 1}, {"tick": 400}])
        patch.setitem(module.SETTINGS, "native", [{}])
        written: list[str] = []
        patch.setattr(module.sys, "stdout", type("Out", (), {"write": written.append}))
        engines = ("counted", "native")
        result = profile(ProfileConfig(engines=engines, lanes=(1, 2), repeats=1, json=True))
    return result, "".join(written)


def test_the_figures_of_engines_add_up(measured):
    result, written = measured
    assert json.loads(written) == result
    assert list(result["engines"]) == ["counted", "native"]
    assert result["machine"]["cores"] == 2
    for entry in result["engines"].values():
        for where, cores in (("one_core", 1), ("all_cores", 2)):
            figures, native = entry[where], result["engines"]["native"][where]
            assert [run["lanes"] for run in figures["by_lanes"]] == [1, 2]
            assert figures["steps_per_s"] == max(r["steps_per_s"] for r in figures["by_lanes"])
            for run in figures["by_lanes"]:
                assert run["cores"] == cores
                assert run["substep_s"] == pytest.approx(0.375 / 36)
                # 8 rollouts of 8 knots of 36 substeps an iteration.
                assert run["steps_per_s"] == pytest.approx(run["rollouts_per_s"] * 8 * 36)
                assert run["rollouts_per_s"] == pytest.approx(run["iterations_per_s"] * 8)
                robots = run["lanes"] * run["processes"]
                assert run["call_s"] * run["iterations_per_s"] == pytest.approx(robots)
                assert run["robot_s_per_s"] == pytest.approx(3 * run["iterations_per_s"])
                ratio = run["steps_per_s"] / native["steps_per_s"]
                assert run["ratio_to_native"] == pytest.approx(ratio)
        split = entry["iteration"]
        assert all(ms > 0 for ms in split.values())
        parts = [split[f"{part}_ms"] for part in ("rollout", "propose", "absorb", "host")]
        assert split["total_ms"] == pytest.approx(sum(parts))
        assert entry["memory_mib"] > 50  # an interpreter with JAX alone is more


def test_engines_are_measured_in_processes_as_sweeps_start_them(measured):
    engines = measured[0]["engines"]
    processes = {
        name: [
            run["processes"] for where in ("one_core", "all_cores") for run in e[where]["by_lanes"]
        ]
        for name, e in engines.items()
    }
    assert processes == {"counted": [1, 1, 2, 2], "native": [1, 1, 1, 1]}


def test_the_fastest_settings_stand_for_an_engine(measured):
    counted, native = (measured[0]["engines"][name] for name in ("counted", "native"))
    assert [one["settings"] for one in counted["tried"]] == [{"tick": 1}, {"tick": 400}]
    assert counted["settings"] == {"tick": 1}
    assert (native["settings"], native["tried"]) == ({}, [])


def test_operations_are_those_that_the_engine_tells(measured):
    result = measured[0]
    peak = result["machine"]["peak_gflops"]
    assert peak > 0
    for where in ("one_core", "all_cores"):
        assert "gflops" not in result["engines"]["native"][where]
        for run in result["engines"]["counted"][where]["by_lanes"]:
            assert run["occupancy"] == 0.75
            assert run["flops_per_step"] == profile_toys.FLOPS
            assert run["gflops"] == pytest.approx(run["steps_per_s"] * profile_toys.FLOPS / 1e9)
            assert run["peak_share"] == pytest.approx(run["gflops"] / (peak * run["cores"]))


def test_all_keys_are_documented(measured):
    documented = set(re.findall(r"`(\w+)`", profile.__doc__ or ""))
    documented |= set(re.findall(r"`(\w+)`", module.measure.split_iteration.__doc__ or ""))
    own = {"counted", "tick"}
    keys = {key.removesuffix("_ms") for key in keys_of(measured[0])} - own
    assert keys - documented == {"total"}
    assert keys >= {"one_core", "all_cores", "peak_share", "memory_mib", "rollout"}


def test_one_core_alone_starts_nothing_on_others(monkeypatch):
    monkeypatch.setattr(module, "usable", lambda: [0, 1])
    for cores, processes in ((1, []), (2, [2, 2]), (None, [2, 2])):
        monkeypatch.setattr(module, "default_processes", lambda name: 3)
        config = ProfileConfig(lanes=(1, 2), cores=cores)
        with contextlib.ExitStack() as stack:
            measurement = module._Measurement(config, Console(), stack)
            measurement._add("counted", {})  # no process starts before its first call
        assert [run.processes for run in measurement.one["counted"]] == [1, 1]
        assert [run.processes for run in measurement.every["counted"]] == processes


def test_a_process_that_ends_is_one_line(monkeypatch):
    monkeypatch.setattr(module.measure, "warm", profile_toys.dies)
    with pytest.raises(WorkersLost, match=r"^a process ended early, maybe for want of memory"):
        profile(ProfileConfig(engines=("counted",), lanes=(1,), cores=1, repeats=1))


def test_tables_show_what_there_is(measured):
    def printed(result):
        console = Console(width=120, record=True, file=io.StringIO())
        print_report(result, console)
        return console.export_text()

    result = copy.deepcopy(measured[0])
    text = printed(result)
    assert "rollouts on one core" in text and "rollouts on 2 cores" in text
    assert "counted, 400:" in text
    heads = [line.split() for line in text.splitlines() if line.strip().startswith("engine")]
    assert len(heads) == 2
    for head in heads:
        assert head[-4:] == ["flops/step", "GFLOP/s", "of", "peak"]  # nothing is cut off
    assert ["compile" in head for head in heads] == [True, False]
    for entry in result["engines"].values():
        entry["memory_mib"] = None
        entry.pop("all_cores")
    del result["engines"]["counted"]
    text = printed(result)
    assert "rollouts on 2 cores" not in text
    assert "flops/step" not in text and "full" not in text
    assert "MiB" not in text


def test_lanes_are_those_of_a_sweep_unless_told():
    def lanes(name, **settings):
        config = ProfileConfig(engines=(name,), **settings)
        return module.lanes_of(config, name)

    assert [lanes(name) for name in ("planar", "mjx", "native")] == [(64,), (8,), (8,)]
    assert lanes("planar", lanes=(3, 1, 3)) == (3, 1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lanes": (0,)}, "lanes: expected a whole number 1 or more, got 0"),
        ({"cores": 0}, "cores: expected a whole number 1 or more, got 0"),
        ({"repeats": -1}, "repeats: expected a whole number 1 or more, got -1"),
        ({"physics": "x"}, "physics: expected one of default, authors, paper, got 'x'"),
        ({"engines": ("x",)}, "engines: expected one of .*, got 'x'"),
    ],
)
def test_bad_settings_are_one_line(settings, message):
    with pytest.raises(BadInput, match=f"^{message}$"):
        ProfileConfig(**settings)
