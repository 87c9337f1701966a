import numpy as np
import pytest
from physics_cases import PHYSICS, idle, world
from registered import registered

from pgf_jax.errors import BadInput
from pgf_jax.physics.config import PHYSICS as PRESETS
from pgf_jax.physics.engine import ENGINES, engine_names, make_engine, register_engine


@pytest.mark.parametrize("name", ["warp", "", "MJX", "pgf_jax.physics.native:NativeEngine"])
def test_unknown_engine(name):
    with pytest.raises(BadInput, match=f"engine: expected one of .*mjx, native.*, got '{name}'"):
        make_engine(name)


@pytest.mark.parametrize("sizes", [{"n_objects": 0}, {"lanes": 0}, {"n_objects": -2}])
@pytest.mark.parametrize("name", ["mjx", "native"])
def test_sizes_must_be_positive(name, sizes):
    with pytest.raises(BadInput, match=f"engine {name}: n_objects and lanes must be positive"):
        make_engine(name, **sizes)


def test_a_registered_engine_is_made_by_name():
    made, engine = [], make_engine("native", n_objects=1)

    def make(physics, n_objects, *, lanes, flavour="plain"):
        made.append((physics, n_objects, lanes, flavour))
        return engine

    with registered(ENGINES, test_engine=make):
        assert "test_engine" in engine_names()
        assert make_engine("test_engine", n_objects=7, lanes=3, flavour="sour") is engine
        make_engine("test_engine", physics=PRESETS["paper"])
    assert made == [(PHYSICS, 7, 3, "sour"), (PRESETS["paper"], 20, 1, "plain")]


def test_what_is_no_engine_is_named():
    with registered(ENGINES, nothing=lambda *_, **__: (1, 2)):  # noqa: SIM117
        with pytest.raises(BadInput, match=r"^engine 'nothing': \(1, 2\) has no rollout"):
            make_engine("nothing")


def test_an_engine_is_registered_once():
    with pytest.raises(BadInput, match=r"^engine 'planar' is registered already; .*replace=True"):
        register_engine("planar", dict)  # pyright: ignore[reportArgumentType]


def test_engines_keep_what_they_are_made_of():
    engine = make_engine("native", physics=PRESETS["paper"], n_objects=2, lanes=5)
    assert (engine.name, engine.n_objects, engine.lanes) == ("native", 2, 5)
    assert engine.physics is PRESETS["paper"]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_split_the_paper_s_rollout(name):
    physics = PRESETS[name]
    assert physics.substeps * physics.knots * physics.substep_s == pytest.approx(3.0)
    assert physics.knot_s == pytest.approx(0.375)
    # MuJoCo raises a time constant below two substeps, silently.
    assert physics.solref_timeconst >= 2 * physics.substep_s


def test_the_paper_s_substep():
    assert PRESETS["paper"].substep_s == pytest.approx(0.0015)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e12])
def test_a_diverged_rollout_is_not_finite(bad, tmp_path, monkeypatch):
    """MuJoCo itself starts again from the model's own state, finite but wrong."""
    monkeypatch.chdir(tmp_path)  # it writes a log
    engine = make_engine("native", n_objects=2)
    controls, gripper = idle(2)
    controls[0, 3, 0] = bad
    start = world([(0.3, 0.1), (0.4, 0.0)])
    start = type(start)(*(np.repeat(x, 2, 0) for x in start))
    out = engine.rollout(start, controls, gripper, PHYSICS.substeps)
    assert np.isfinite(out.objects[0, :3]).all()
    for lost in (out.objects[0, 3:], out.hand[0, 3:], out.velocities[0]):
        assert np.isnan(lost).all()
    # Neither its neighbour nor what comes next on the same thread.
    np.testing.assert_array_equal(out.objects[1], np.repeat(start.objects[1:], 8, 0))
    start.objects[0, 0] = np.nan
    assert np.isnan(engine.rollout(start, *idle(2), PHYSICS.substeps).objects[0]).all()
    start.objects[0] = start.objects[1]
    assert np.isfinite(engine.rollout(start, *idle(2), PHYSICS.substeps).objects).all()


def test_an_unknown_option_s_value_is_one_line():
    with pytest.raises(BadInput, match=r"^engine native: solver must be one of .*, got 'x'$"):
        make_engine("native", solver="x")
    with pytest.raises(BadInput, match=r"^engine native: jacobian must be one of .*, got 'x'$"):
        make_engine("native", jacobian="x")
