"""The profiler: its numbers add up; speed itself is not tested."""

import json

import pytest

from pgf_jax.errors import BadInput
from pgf_jax.profiling.config import ProfileConfig
from pgf_jax.profiling.profile import profile


def test_the_figures_of_an_engine_add_up(capsys):
    result = profile(
        ProfileConfig(engines=("native",), lanes=(1, 2), repeats=1, memory_lanes=1, json=True)
    )
    assert json.loads(capsys.readouterr().out) == result
    entry = result["engines"]["native"]
    assert entry["ratio_to_native"] == 1.0
    assert entry["steps_per_s"] == max(run["steps_per_s"] for run in entry["by_lanes"])
    assert {run["lanes"] for run in entry["by_lanes"]} == {1, 2}
    for run in entry["by_lanes"]:
        assert run["substep_s"] == pytest.approx(0.375 / 36)
        # 8 rollouts of 8 knots of 36 substeps an iteration.
        assert run["steps_per_s"] == pytest.approx(run["rollouts_per_s"] * 8 * 36)
        assert run["rollouts_per_s"] == pytest.approx(run["iterations_per_s"] * 8)
        assert run["call_s"] * run["iterations_per_s"] == pytest.approx(run["lanes"])
        assert run["robot_s_per_s"] == pytest.approx(3 * run["iterations_per_s"])
    split = entry["iteration"]
    assert all(ms > 0 for ms in split.values())
    parts = [split[f"{part}_ms"] for part in ("rollout", "propose", "absorb", "host")]
    assert split["total_ms"] == pytest.approx(sum(parts))
    assert entry["memory_mib"] > 50  # an interpreter with JAX alone is more


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lanes": (0,)}, "lanes: expected a whole number 1 or more, got 0"),
        ({"cores": 0}, "cores: expected a whole number 1 or more, got 0"),
        ({"repeats": -1}, "repeats: expected a whole number 1 or more, got -1"),
        ({"physics": "x"}, "physics: expected one of default, paper, got 'x'"),
        ({"engines": ("x",)}, "engines: expected one of .*, got 'x'"),
    ],
)
def test_bad_settings_are_one_line(settings, message):
    with pytest.raises(BadInput, match=f"^{message}$"):
        ProfileConfig(**settings)
