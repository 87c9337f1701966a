"""Checkpoints: exact round trips, and one line for every way a file can be bad."""

import dataclasses
import hashlib
import pickle

import jax
import numpy as np
import pytest
from flax import serialization
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors import checkpoint as ckpt
from pgf_jax.guidance.predictors.checkpoint import (
    NETWORKS,
    PAIR,
    Checkpoint,
    load,
    load_network,
    save,
)
from pgf_jax.guidance.predictors.features import FEATURES, STATE
from pgf_jax.guidance.predictors.network import combine, init


def example(network="phi_auto", seed=0, hidden=(64, 32, 8), *, names=FEATURES, members=1):
    rng = np.random.default_rng(seed)
    x = np.c_[np.full(40, 20.0), rng.gamma(1.0, 400.0, (40, len(names) - 1))]
    each = [
        init(jax.random.key(seed + 100 * m), x, x[:, -1], hidden=hidden, names=names)
        for m in range(members)
    ]
    return Checkpoint(
        network=network,
        predictor=combine(each),
        data_sha256="ab" * 32,
        scenes=10,
        rows=40,
        config={"loss": "rmse", "members": str(members)},
        figures={"loss_train": 57.0625, "loss_val": 58.56},
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "phi_auto.msgpack"
    save(path, example())
    return path.read_bytes()


def assert_bad(path, match):
    with pytest.raises(BadInput, match=match) as error:
        load(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("network", "hidden", "names", "members"),
    [
        ("phi_auto", (64, 32, 8), FEATURES, 1),
        ("phi_human", (64, 32, 16), FEATURES, 3),
        ("gain", (24,), STATE, 5),
        ("gain", (8, 8), ("turn", "distance"), 1),
        ("failure", (64, 32, 8), STATE[3:9], 2),
    ],
)
def test_round_trip_is_exact(tmp_path, network, hidden, names, members):
    path = tmp_path / "deep" / f"{network}.msgpack"
    saved = example(network, 3, hidden, names=names, members=members)
    save(path, saved)
    loaded = load(path)
    a, b = saved.predictor, loaded.predictor
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for old, new in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert np.asarray(old).tobytes() == np.asarray(new).tobytes()
    x = np.random.default_rng(0).gamma(1.0, 400.0, (5, len(names)))
    assert a.predict(x).tobytes() == b.predict(x).tobytes()
    for field in ("network", "data_sha256", "scenes", "rows", "config", "figures"):
        assert getattr(loaded, field) == getattr(saved, field)
    assert (loaded.predictor.hidden, loaded.predictor.features) == (hidden, names)
    assert loaded.predictor.params["Dense_0"]["bias"].shape == (members, hidden[0])
    save(tmp_path / "again.msgpack", loaded)
    assert (tmp_path / "again.msgpack").read_bytes() == path.read_bytes()
    assert [p.name for p in path.parent.iterdir()] == [f"{network}.msgpack"]


def test_missing(tmp_path):
    assert_bad(tmp_path / "phi_auto.msgpack", "no such file")
    assert_bad(tmp_path, "cannot be read")


def test_truncated_anywhere(tmp_path, whole):
    path = tmp_path / "phi_auto.msgpack"
    for size in [*range(0, len(whole), 61), *range(120), len(whole) - 1]:
        path.write_bytes(whole[:size])
        assert_bad(path, "truncated or corrupt|not a predictor checkpoint")
    path.write_bytes(whole + b"\0")
    assert_bad(path, "truncated or corrupt")


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_flipped_bit_is_found(tmp_path_factory, whole, data):
    path = tmp_path_factory.getbasetemp() / "flipped.msgpack"
    # The envelope is a few dozen bytes of many thousands: look there as often as inside.
    at = data.draw(st.one_of(st.integers(0, 120), st.integers(0, len(whole) - 1)))
    bit = 1 << data.draw(st.integers(0, 7))
    path.write_bytes(whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1 :])
    assert_bad(path, None)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200))
def test_foreign_bytes(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "foreign.msgpack"
    path.write_bytes(content)
    assert_bad(path, None)


class _Loud:
    def __reduce__(self):
        return (pytest.fail, ("a checkpoint was unpickled",))


def test_a_pickle_is_refused_unopened(tmp_path):
    path = tmp_path / "phi_auto.msgpack"
    path.write_bytes(pickle.dumps(_Loud()))
    assert_bad(path, "truncated or corrupt|not a predictor")


def tampered(path, whole, change):
    """Rewrite the payload with a right digest, so that only the content is wrong."""
    outer = serialization.msgpack_restore(whole)
    assert isinstance(outer, dict)
    content = serialization.msgpack_restore(outer["payload"])
    # Arrays come back read-only.
    content = jax.tree.map(lambda a: a.copy() if isinstance(a, np.ndarray) else a, content)
    change(content)
    payload = serialization.msgpack_serialize(content)
    digest = hashlib.sha256(payload).hexdigest()
    outer = {"version": ckpt.VERSION, "sha256": digest, "payload": payload}
    path.write_bytes(serialization.msgpack_serialize(outer))


def put(*where_and_value):
    *where, last, value = where_and_value

    def change(content):
        for key in where:
            content = content[key]
        content[last] = value

    return change


def remove(*where):
    def change(content):
        for key in where[:-1]:
            content = content[key]
        del content[where[-1]]

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            put("params", "Dense_1", "kernel", np.zeros((1, 64, 31), np.float32)),
            r"Dense_1 kernel has shape \(1, 64, 31\), expected \(1, 64, 32\)",
        ),
        (
            put("params", "Dense_3", "bias", np.zeros(1, np.float32)),
            r"Dense_3 bias has shape \(1,\), expected \(1, 1\)",
        ),
        (put("mean", np.zeros(9, np.float32)), r"mean has shape \(9,\), expected \(10,\)"),
        (put("mean", np.zeros(10)), "mean must be a float32 array, got float64"),
        (put("scale", np.zeros(10, np.float32)), "scale must be positive, got 0"),
        (put("scale", 1, np.float32(np.inf)), "scale holds a number that is not finite"),
        (put("params", "Dense_0", "kernel", 0, 2, np.float32(np.nan)), "Dense_0 kernel holds a"),
        (put("params", "Dense_2", "bias", [0.0] * 8), "Dense_2 bias must be a float32 array"),
        (put("params", "Dense_2", [1]), "Dense_2 must hold a kernel and a bias"),
        (remove("params", "Dense_2", "bias"), "Dense_2 must hold a kernel and a bias"),
        (remove("params", "Dense_3"), "layers are"),
        (put("params", "Dense_4", {}), "layers are"),
        (
            put("hidden", [64, 32, 16]),
            r"Dense_2 kernel has shape \(1, 32, 8\), expected \(1, 32, 16\)",
        ),
        (put("hidden", [64, -32, 8]), "hidden must be a list of one or more positive widths"),
        (put("hidden", []), "hidden must be a list of one or more positive widths"),
        (
            put("features", ["n_objects"]),
            r"Dense_0 kernel has shape \(1, 10, 64\), expected \(1, 1,",
        ),
        (put("features", []), "features are not all among n_objects, "),
        (put("features", [*FEATURES[:9], "colour"]), "features are not all among n_objects, "),
        (put("features", [np.zeros(2, np.float32)] * 10), "features are not all among"),
        (put("features", [*FEATURES[:9], FEATURES[0]]), "features are named twice"),
        (put("members", 2), r"Dense_0 kernel has shape \(1, 10, 64\), expected \(2, 10, 64\)"),
        (put("members", 0), "members must be 1 or more, got 0"),
        (put("config", {"loss": 1}), "config must be texts by name"),
        (put("config", {1: "rmse"}), None),
        (put("figures", "loss_val", np.zeros(2)), "figure 'loss_val' must be a finite number"),
        (put("hidden", [np.zeros(2)]), "hidden must be a list of one or more positive widths"),
        (
            put("network", "phi_best"),
            "network is 'phi_best', expected phi_auto or phi_human or gain",
        ),
        (put("rows", -1), "rows must be 0 or more, got -1"),
        (put("figures", "loss_val", float("nan")), "figure 'loss_val' must be a finite number"),
        (put("figures", "loss_val", "good"), "figure 'loss_val' must be a finite number"),
        *((remove(field), f"field {field} must be a .*, got nothing") for field in ckpt._FIELDS),
        *((put(field, None), f"field {field} must be a") for field in ckpt._FIELDS),
    ],
)
def test_wrong_content(tmp_path, whole, change, message):
    path = tmp_path / "phi_auto.msgpack"
    tampered(path, whole, change)
    assert_bad(path, message)


def test_untampered_content_loads(tmp_path, whole):
    tampered(tmp_path / "phi_auto.msgpack", whole, lambda content: None)
    assert (tmp_path / "phi_auto.msgpack").read_bytes() == whole
    load(tmp_path / "phi_auto.msgpack")


@pytest.mark.parametrize(
    ("outer", "message"),
    [
        ({"version": 1, "sha256": "", "payload": b""}, "checkpoint version 1, expected 2"),
        ({"version": "2", "sha256": "", "payload": b""}, "no version number"),
        ({"sha256": "", "payload": b""}, "no version"),
        ({"version": 2, "sha256": ""}, "no payload"),
        ({"version": 2, "sha256": "", "payload": b"x"}, "corrupt checkpoint"),
        ({"version": 2, "payload": b"x"}, "no payload with a digest"),
        ({"version": np.zeros(2)}, "no version number"),
        ({"version": 2, "sha256": np.zeros(2), "payload": b"x"}, "no payload with a digest"),
        ([1], "expected a mapping"),
    ],
)
def test_wrong_envelope(tmp_path, outer, message):
    path = tmp_path / "phi_auto.msgpack"
    path.write_bytes(serialization.msgpack_serialize(outer))
    assert_bad(path, message)


def test_what_would_not_load_is_not_saved(tmp_path):
    path = tmp_path / "phi_auto.msgpack"
    good = example()
    save(path, good)
    before = path.read_bytes()
    bad = dataclasses.replace(good, figures={"loss_val": float("nan")})
    with pytest.raises(BadInput, match="figure 'loss_val'"):
        save(path, bad)
    nan = dataclasses.replace(good.predictor, mean=good.predictor.mean * np.float32(np.nan))
    with pytest.raises(BadInput, match="mean holds a number that is not finite"):
        save(path, dataclasses.replace(good, predictor=nan))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["phi_auto.msgpack"]


def save_pair(folder, seed=0):
    save(folder / "phi_auto.msgpack", example("phi_auto", seed))
    save(folder / "phi_human.msgpack", example("phi_human", seed + 1))


def test_a_network_is_found_by_its_name(tmp_path):
    for network in NETWORKS:
        save(tmp_path / f"{network}.msgpack", example(network))
    assert [load_network(tmp_path, network).network for network in NETWORKS] == [*NETWORKS]
    (tmp_path / "gain.msgpack").write_bytes((tmp_path / "failure.msgpack").read_bytes())
    with pytest.raises(BadInput, match=r"gain\.msgpack: holds failure, expected gain"):
        load_network(tmp_path, "gain")
    (tmp_path / "gain.msgpack").unlink()
    with pytest.raises(BadInput, match=r"gain\.msgpack: no such file"):
        load_network(tmp_path, "gain")


@pytest.mark.parametrize("installed", [True, False])
def test_shipped_pair(tmp_path, monkeypatch, installed):
    """In the wheel the checkpoints lie inside the package, in a source tree beside it."""
    package = tmp_path / "pgf_jax"
    package.mkdir()
    monkeypatch.setattr(ckpt.resources, "files", lambda name: tmp_path / name)
    with pytest.raises(BadInput, match="no shipped checkpoints"):
        ckpt.shipped_checkpoints()
    save_pair(tmp_path / "checkpoints", seed=5)  # someone else's, unless this is a source tree
    if installed:
        save_pair(package / "checkpoints", seed=7)
        expected = example("phi_auto", 7)
    else:
        with pytest.raises(BadInput, match="no shipped checkpoints"):
            ckpt.shipped_checkpoints()
        (tmp_path / "pyproject.toml").touch()
        expected = example("phi_auto", 5)
    auto = load_network(ckpt.shipped_checkpoints(), "phi_auto")
    np.testing.assert_array_equal(auto.predictor.mean, expected.predictor.mean)


@pytest.mark.parametrize("network", PAIR)
def test_shipped_pair_of_this_checkout_loads(network):
    assert load_network(ckpt.shipped_checkpoints(), network).rows > 0
