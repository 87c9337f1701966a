"""Settings with any values of any type: they come to be, or are refused in one line."""

import dataclasses
import decimal
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from pgf_jax.collection.config import CollectConfig
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.errors import BadInput
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.inspection.config import ReproduceConfig, VerifyConfig
from pgf_jax.operator_fit.config import FitOperatorConfig
from pgf_jax.plans.config import PlanCommand, PlanConfig
from pgf_jax.profiling.config import ProfileConfig
from pgf_jax.render.config import RenderConfig
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.replay import settings_of
from pgf_jax.training.config import TrainConfig

LONGEST = 500


class Hostile:
    """Fails wherever it is touched."""

    def _fail(self, *args):
        raise RuntimeError("touched\ntwice")

    __repr__ = __str__ = __bool__ = __len__ = __iter__ = __float__ = __int__ = __index__ = _fail
    __lt__ = __le__ = __gt__ = __ge__ = __eq__ = __hash__ = __getitem__ = __fspath__ = _fail
    __contains__ = __format__ = _fail


ODD = [
    object(),
    Hostile,
    print,
    len,
    np.zeros(3),
    np.array(1.0),
    np.int64(3),
    np.float32("nan"),
    np.str_("pgf"),
    np.bool_(True),
    decimal.Decimal("NaN"),
    1 + 2j,
    range(3),
    range(1 << 62),
    b"pgf",
    bytearray(b"x"),
    Path("a\0b"),
    Path("x" * 5000),
    Path("/dev/zero"),
    10**400,
    10**5000,
    -(10**5000),
    1 << 63,
    5e-324,
    1e308,
    "shared:" + "9" * 5000,
    "after:" + "9" * 5000,
    "best:",
    "\ud800",
    "\0",
    "a\nb\x1b[31m",
    "z" * 10_000,
    [[[[]]]],
    {"a": {"b": 1}},
    {1, 2},
    frozenset("ab"),
    (None,),
    [10**5000],
]
HOSTILE = [Hostile(), ("pgf", Hostile()), [Hostile()]]  # Hypothesis would touch them, too
ANYTHING = (
    st.sampled_from(ODD)
    | st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(st.characters(), max_size=20)
    | st.recursive(
        st.none() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
        max_leaves=6,
    )
)
# Values that are good, or nearly, so that one bad field is not always met before the next.
GOOD: dict[str, list[Any]] = {
    "log": [(Path("x"),), ["a", "b"], Path("x"), "x", (), None],
    "mode": ["autonomous", "human", "forks"],
    "what": ["plan", "task", "fleet"],
    "file": [Path("x"), "x"],
    "folder": [Path("x"), "x"],
    "out": [Path("x.png"), "x.mp4", "x", "x.npz"],
    "scheduler": ["tcp://here:8786", "slurm:4", "slurm:0", None],
    "scene": [(Path("a.xml"),), ()],
    "scenes": [3, Path("x"), None],
    "preset": ["quick", "paper", "tight", None],
    "scene_class": ["tight", "wide", "all", None],
    "robots": [(1, 2), [3], 4, 1],
    "policies": [("pgf",), ["or-hitl", "random"], None],
    "policy": ["pgf", "or-hitl", "oracle-gain"],
    "operator": ["heuristic", "none", "live", "replay"],
    "compute": ["dedicated", "shared:96", "shared:0", "shared:"],
    "ask": ["stuck", "gain", "after:3", "never"],
    "classes": [("tight",), ["wide", "tight"]],
    "engine": ["planar", "native"],
    "engines": [("planar",), ["native", "mjx"]],
    "lanes": [1, 8, (1, 8), None],
    "config": [PlanConfig(), TrainConfig(), None],
    "hidden": [(64, 32), [8]],
    "loss": ["rmse", "logistic"],
    "size": [(640, 480), [1280, 800], (1,), (1, 2, 3)],
    "host": ["127.0.0.1", "0.0.0.0", "::1", "here"],
    "cost": ["source", "paper"],
    "view": ["top", "3d"],
    "update": ["greedy", "stomp"],
    "physics": ["default", "paper"],
}
NUMBERS = [0, 1, 2, 7, 0.5, 1.0, 30.0, -1, None]
ENOUGH = {  # fields without a default
    CollectConfig: ("mode", "out"),
    RenderConfig: ("what", "file", "out"),
    FitOperatorConfig: ("log",),
    VerifyConfig: ("folder",),
    ReproduceConfig: ("folder",),
}
CONFIGS = (
    SweepConfig,
    CollectConfig,
    PlanConfig,
    PlanCommand,
    TrainConfig,
    ProfileConfig,
    RenderConfig,
    FitOperatorConfig,
    ConsoleConfig,
    FleetConfig,
    VerifyConfig,
    ReproduceConfig,
)


def values(config: type) -> st.SearchStrategy[dict[str, Any]]:
    """Some of the fields, most of them good."""
    fields = [field.name for field in dataclasses.fields(config)]

    def of(name: str) -> st.SearchStrategy:
        good = st.sampled_from(GOOD.get(name, NUMBERS))
        return good | good | ANYTHING

    needed = ENOUGH.get(config, ())
    return st.fixed_dictionaries(
        {name: of(name) for name in needed},
        optional={name: of(name) for name in fields if name not in needed},
    )


def check(config: type, given_values: dict[str, Any]) -> str:
    """Make one; "made" or "refused"."""
    try:
        made = config(**given_values)
    except BadInput as error:
        message = str(error)
        assert message and message.isprintable() and len(message) <= LONGEST, message
        return "refused"
    repr(made)
    if isinstance(made, SweepConfig):
        json.dumps(settings_of(made))
        assert made.cells() and made.engine_lanes() >= 1
    if isinstance(made, ConsoleConfig):
        assert made.needs_token in (True, False)
    return "made"


def fuzz(config: type, examples: int, *, phases: tuple[Phase, ...] = tuple(Phase)) -> None:
    """So many examples; the same ones each time."""
    kept = [HealthCheck.too_slow, HealthCheck.large_base_example, HealthCheck.data_too_large]

    @settings(
        max_examples=examples,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=kept,
        phases=phases,
    )
    @given(values(config))
    def run(given_values: dict[str, Any]) -> None:
        check(config, given_values)

    run()


@pytest.mark.parametrize("config", CONFIGS)
def test_any_values(config):
    fuzz(config, 150)


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS)
def test_any_values_many(config):
    fuzz(config, 1000)


@pytest.mark.parametrize("config", CONFIGS)
def test_each_field_with_each_odd_value(config):
    for field in dataclasses.fields(config):
        for value in [*ODD, *HOSTILE]:
            good = {need: GOOD[need][0] for need in ENOUGH.get(config, ())}
            check(config, good | {field.name: value})


def test_good_values_are_taken_as_they_are_meant():
    config = SweepConfig(robots=[np.int64(2), 3], scenes="x", predictor=Path("y"), window=1)  # pyright: ignore
    assert config.robots == (2, 3) and {*map(type, config.robots or ())} == {int}
    assert config.scenes == Path("x") and config.predictor == "y"
    assert config.window == 1 and type(config.window) is int  # as it was given
    assert TrainConfig(learning_rate=np.float32(0.5)).learning_rate == 0.5  # pyright: ignore
