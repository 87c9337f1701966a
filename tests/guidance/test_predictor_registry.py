"""Names of predictors: what a text stands for, and what is loaded for it."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors import checkpoint, registry
from pgf_jax.guidance.predictors.features import FEATURES, STATE
from pgf_jax.guidance.predictors.network import CostDifference, FailureClassifier, GainNetwork, init
from pgf_jax.guidance.predictors.registry import PredictorSpec, predictor_spec
from pgf_jax.plans.config import PlanConfig
from pgf_jax.sweeping.config import SweepConfig

NAMES = {"gain": ("turn", "distance", "n_objects")}


def write(folder: Path, seed: int = 0) -> Path:
    """A checkpoint of every kind."""
    rng = np.random.default_rng(seed)
    for network in checkpoint.NETWORKS:
        names = NAMES.get(network, FEATURES)
        x, y = rng.uniform(0, 500, (30, len(names))), rng.normal(0, 1, 30)
        predictor = init(jax.random.key(seed), x, y, hidden=(4,), names=names)
        about = checkpoint.Checkpoint(network, predictor, "digest", 3, 30, {}, {})
        checkpoint.save(folder / checkpoint.checkpoint_name(network), about)
    return folder


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("paper", PredictorSpec("paper")),
        ("best", PredictorSpec("best")),
        ("first", PredictorSpec("paper", part="first")),
        ("first-best", PredictorSpec("best", part="first")),
        ("first:folder", PredictorSpec("paper", Path("first:folder"))),
        ("some/folder", PredictorSpec("paper", Path("some/folder"))),
        ("paper:some/folder", PredictorSpec("paper", Path("some/folder"))),
        ("best:some/folder", PredictorSpec("best", Path("some/folder"))),
        ("best:a:b", PredictorSpec("best", Path("a:b"))),
        ("worst:folder", PredictorSpec("paper", Path("worst:folder"))),
        # A classifier is no gain: it is chosen by the policy, not by name.
        ("classifier", PredictorSpec("paper", Path("classifier"))),
        ("./best", PredictorSpec("paper", Path("best"))),
    ],
)
def test_what_a_text_stands_for(text, expected):
    assert predictor_spec(text) == expected


def test_a_folder_may_be_given_as_a_path():
    for config in (PlanConfig, SweepConfig):
        assert dataclasses.replace(config(), predictor=Path("a/b")).predictor == "a/b"


@pytest.mark.parametrize(
    ("name", "kind", "networks"),
    [
        ("paper", CostDifference, ["phi_auto", "phi_human"]),
        ("best", GainNetwork, ["gain"]),
        ("classifier", FailureClassifier, ["failure"]),
    ],
)
def test_each_is_made_of_its_networks(tmp_path, monkeypatch, name, kind, networks):
    folder = write(tmp_path / "own")
    predictor, checkpoints = PredictorSpec(name, folder).load()
    assert type(predictor) is kind
    assert [loaded.network for loaded in checkpoints] == networks
    states = np.random.default_rng(1).uniform(0, 500, (6, len(STATE)))
    by_hand = kind(*(loaded.predictor for loaded in checkpoints)).gain(states)
    assert predictor.gain(states).tobytes() == by_hand.tobytes()
    # It may be sent to another process before any of JAX's backends is up there.
    leaves = jax.tree.leaves([getattr(predictor, f.name) for f in dataclasses.fields(kind)])
    assert all(type(leaf) is np.ndarray for leaf in leaves)
    # Without a folder it is the shipped one.
    shipped = write(tmp_path / "shipped", seed=1)
    monkeypatch.setattr(registry, "shipped_checkpoints", lambda: shipped)
    other, _ = PredictorSpec(name).load()
    assert not np.array_equal(other.gain(states), by_hand)


@pytest.mark.parametrize(
    ("damage", "text", "message"),
    [
        ("nothing", "best:{}/nowhere", "{}/nowhere: no such folder, expected one with checkp"),
        ("nothing", "{}/nowhere", "{}/nowhere: no such folder"),
        ("nothing", "{}/gain.msgpack", "{}/gain.msgpack: no such folder"),
        ("gain", "best:{}", "{}/gain.msgpack: no such file"),
        ("phi_human", "{}", "{}/phi_human.msgpack: no such file"),
        ("failure", "paper:{}", None),
    ],
)
def test_what_is_missing_is_named_in_one_line(tmp_path, damage, text, message):
    write(tmp_path)
    (tmp_path / f"{damage}.msgpack").unlink(missing_ok=True)
    chosen = predictor_spec(text.format(tmp_path))
    if message is None:
        chosen.load()
        return
    with pytest.raises(BadInput) as error:
        chosen.load()
    assert str(error.value).startswith(message.format(tmp_path))
    assert "\n" not in str(error.value)
