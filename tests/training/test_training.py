"""Training: learns what can be learned, repeats itself to the bit, stops where it should."""

import dataclasses
import hashlib
import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import polars as pl
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.guidance.predictors.checkpoint import PAIR, load_network
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.guidance.predictors.network import forward, init
from pgf_jax.tables.forks import FORK_SCHEMA, write_forks
from pgf_jax.tables.run_log import RunLog
from pgf_jax.tables.runs import Mode, read_runs, runs_path, write_runs
from pgf_jax.training import fit as fitting
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.fit import fit, rmse
from pgf_jax.training.rows import Rows, human_rows, split_by_scene
from pgf_jax.training.train import RECIPES, train


@pytest.fixture(autouse=True, scope="module")
def strict():
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        yield


ARRAYS = ("features", "target", "unsolved", "scene", "iteration")


def known_function(rows, seed=0):
    """Histories like a planner's, and a target that bends where a wall would."""
    rng = np.random.default_rng(seed)
    last = np.stack(
        [rng.uniform(100, 1600, rows), rng.exponential(60, rows), 450.0 * rng.poisson(0.7, rows)],
        axis=1,
    )
    history = np.stack([1.5 * last, 1.2 * last, last], axis=1).reshape(rows, 9)
    history *= rng.uniform(0.8, 1.2, (rows, 1))
    x = np.c_[np.full(rows, 20.0), history]
    y = np.maximum(0.6 * x[:, 7] + 0.3 * x[:, 9] - 250, 0) + x[:, 8]
    scene = np.array([f"s{i // 4}" for i in range(rows)])
    return Rows(x, y, np.ones(rows, bool), scene, np.arange(rows))


@pytest.fixture(scope="module")
def fitted():
    rows = known_function(1600)
    return rows, fit(jax.random.key(0), rows, TrainConfig())


def test_it_learns_a_known_function(fitted):
    rows, done = fitted
    _, val = split_by_scene(rows.scene, fraction=0.2, seed=0)
    assert done.target_std_val == pytest.approx(rows.target[val].std())
    assert done.kept_val < 0.08 * done.target_std_val
    error = done.predictor.predict(rows.features[val]) - rows.target[val]
    assert np.sqrt((error**2).mean()) == pytest.approx(done.kept_val, rel=1e-4)
    assert (done.scenes_train, done.scenes_val) == (320, 80)


def test_early_stopping_returns_the_best_weights(fitted):
    rows, done = fitted
    train_index, val = split_by_scene(rows.scene, fraction=0.2, seed=0)
    for index, loss in ((val, done.loss_val), (train_index, done.loss_train)):
        x, y = (jnp.asarray(a[index], dtype=jnp.float32) for a in (rows.features, rows.target))
        assert float(jax.jit(rmse)(done.predictor, x, y)) == loss[done.best_epoch]
    assert done.kept_train == done.loss_train[done.best_epoch]
    assert done.best_epoch == int(np.argmin(done.loss_val))
    assert done.kept_val == done.loss_val.min()
    assert len(done.loss_val) == min(done.best_epoch + 1 + TrainConfig().patience, 100)


def test_patience_and_the_limit_on_epochs():
    noise = Rows(
        features=known_function(330).features,
        target=np.random.default_rng(1).gamma(1, 300, 330),
        unsolved=np.ones(330, bool),
        scene=known_function(330).scene,
        iteration=np.arange(330),
    )
    impatient = fit(jax.random.key(0), noise, TrainConfig(patience=1))
    assert (np.diff(impatient.loss_val)[:-1] < 0).all()
    assert impatient.loss_val[-1] >= impatient.loss_val[-2]
    assert len(fit(jax.random.key(0), noise, TrainConfig(max_epochs=2)).loss_val) == 2


def test_training_repeats_itself_to_the_bit_and_the_key_matters():
    rows, config = known_function(330), TrainConfig(max_epochs=3)
    first, again, other = (fit(jax.random.key(k), rows, config) for k in (0, 0, 1))
    for a, b in zip(
        jax.tree.leaves(first.predictor), jax.tree.leaves(again.predictor), strict=True
    ):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    assert first.loss_train.tobytes() == again.loss_train.tobytes()
    assert first.loss_val.tobytes() == again.loss_val.tobytes()
    assert not np.array_equal(first.loss_val, other.loss_val)


def test_restarts_keep_the_best_by_validation():
    rows = known_function(330)
    config = TrainConfig(max_epochs=2, restarts=3)
    best = fit(jax.random.key(5), rows, config)
    alone = [
        fitting._fit_once(k, rows, *split_by_scene(rows.scene, fraction=0.2, seed=0), config)
        for k in jax.random.split(jax.random.split(jax.random.key(5), 1)[0], 3)
    ]
    assert best.kept_val == min(one.kept_val for one in alone)
    assert len({one.kept_val for one in alone}) == 3


def test_normalisation_is_of_the_training_scenes_only():
    rows = known_function(330)
    done = fit(jax.random.key(0), rows, TrainConfig(max_epochs=1))
    train_index, _ = split_by_scene(rows.scene, fraction=0.2, seed=0)
    np.testing.assert_allclose(
        done.predictor.mean, rows.features[train_index].mean(axis=0), rtol=1e-6
    )
    assert float(done.predictor.scale[0]) == 1  # N never varies


@jax.jit
def slope_of_rmse(predictor, x, y):
    return jax.grad(lambda p: rmse(dataclasses.replace(predictor, params=p), x, y))(
        predictor.params
    )


def test_a_part_filled_batch_is_one_adam_step_on_the_rmse_of_its_rows():
    rows = known_function(7)
    predictor = init(jax.random.key(0), rows.features, rows.target)
    x = jnp.asarray(rows.features, dtype=jnp.float32)
    y = jnp.asarray(rows.target, dtype=jnp.float32)
    adam = optax.adam(1e-2)
    state = adam.init(predictor.params)
    stepped, _ = fitting._epoch(
        jax.random.key(1), predictor, state, x, y, config=TrainConfig(learning_rate=1e-2)
    )
    # Adam's first step, by its definition: minus the learning rate times the slope's sign.
    slope = slope_of_rmse(predictor, x, y)
    for layer, values in slope.items():
        for part, g in values.items():
            expected = np.asarray(predictor.params[layer][part]) - 1e-2 * np.asarray(g) / (
                np.abs(g) + 1e-8
            )
            np.testing.assert_allclose(stepped.params[layer][part], expected, rtol=1e-4, atol=1e-4)


def test_every_row_is_seen_once_an_epoch():
    """With a learning rate of almost 0 only the optimiser's mean slope moves: a sum over rows."""
    rows = known_function(130)
    predictor = init(jax.random.key(0), rows.features, rows.target)
    x = jnp.asarray(rows.features, dtype=jnp.float32)
    y = jnp.asarray(rows.target, dtype=jnp.float32)
    _, state = fitting._epoch(
        jax.random.key(1),
        predictor,
        optax.adam(1e-30).init(predictor.params),
        x,
        y,
        config=TrainConfig(learning_rate=1e-30),
    )
    order = np.asarray(jax.random.permutation(jax.random.split(jax.random.key(1))[0], 130))
    assert sorted(order) == list(range(130))
    mean = jax.tree.map(np.zeros_like, predictor.params)
    for batch in (order[:50], order[50:100], order[100:]):  # the last has 30 rows
        slope = slope_of_rmse(predictor, x[batch], y[batch])
        mean = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * np.asarray(g), mean, slope)
    for a, b in zip(jax.tree.leaves(state[0].mu), jax.tree.leaves(mean), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)


def test_loss_is_the_rmse_and_has_a_slope_at_an_exact_fit():
    rows = known_function(7)
    predictor = init(jax.random.key(0), rows.features, rows.target)
    x = jnp.asarray(rows.features, dtype=jnp.float32)
    y = jnp.asarray(rows.target, dtype=jnp.float32)
    by_hand = np.sqrt(((predictor.predict(x) - rows.target) ** 2).mean())
    assert float(jax.jit(rmse)(predictor, x, y)) == pytest.approx(by_hand, rel=1e-5)
    exact = jax.jit(jax.vmap(forward, in_axes=(None, 0)))(predictor, x)
    slope = slope_of_rmse(predictor, x, exact)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_divergence_and_one_scene_are_bad_input():
    rows = known_function(330)
    with pytest.raises(BadInput, match="training diverged with learning_rate 1e"):
        fit(jax.random.key(0), rows, TrainConfig(learning_rate=1e30, max_epochs=2))
    one_scene = Rows(*(getattr(rows, f)[:3] for f in ARRAYS))
    with pytest.raises(BadInput, match="at least 2 scenes"):
        fit(jax.random.key(0), one_scene, TrainConfig())


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"restarts": 0}, "restarts: expected a whole number 1 or more, got 0"),
        ({"batch": -5}, "batch: expected a whole number 1 or more, got -5"),
        ({"max_epochs": 0}, "max_epochs: "),
        ({"patience": 0}, "patience: "),
        ({"seed": -1}, r"seed: expected a whole number within 0\.\.4294967295, got -1"),
        ({"learning_rate": float("nan")}, "learning_rate: expected a number above 0, got nan"),
        ({"learning_rate": 0.0}, r"learning_rate: expected a number above 0, got 0\.0"),
        (
            {"validation_fraction": 1.0},
            "validation_fraction: expected a number above 0 and below 1",
        ),
        ({"hidden": ()}, "hidden: expected one or more widths, got none"),
        ({"hidden": (64, 0)}, "hidden: expected a whole number 1 or more, got 0"),
        ({"members": 0}, "members: expected a whole number 1 or more, got 0"),
        ({"dropout": 1.0}, r"dropout: expected a number 0 or more and below 1, got 1\.0"),
        ({"dropout": float("nan")}, "dropout: expected a number 0 or more and below 1, got nan"),
        ({"loss": "mse"}, "loss: expected one of rmse, mae, logistic, got 'mse'"),
    ],
)
def test_bad_settings(bad, message):
    with pytest.raises(BadInput, match=message):
        TrainConfig(**bad)


def collect(folder, scenes=12):
    """Runs whose cost falls by a tenth an iteration, and by half where help was given."""
    autonomous, human = [], []
    for s in range(scenes):
        for mode, frames in ((Mode.AUTONOMOUS, autonomous), (Mode.HUMAN, human)):
            run = RunLog(scene=f"tight_{s}", seed=s, scene_class="tight", n_objects=20)
            run.begin_segment("reach")
            cost = 500.0 + 100 * s
            for t in range(20):
                if mode is Mode.HUMAN and t == 5 + s % 3:
                    run.input_given()
                    run.begin_segment("push")
                    run.add((30.0, 0.0, 0.0), feasible=True)
                    run.begin_segment("reach")
                    cost /= 2
                run.add((cost, 10.0, 450.0), feasible=False)
                cost *= 0.9
            frames.append(run.frame())
    write_runs(runs_path(folder, Mode.AUTONOMOUS), autonomous)
    write_runs(runs_path(folder, Mode.HUMAN), human)


def test_train_writes_checkpoints_and_a_figure(tmp_path):
    collect(tmp_path / "data")
    config = TrainConfig(max_epochs=3)
    report = train(tmp_path / "data", tmp_path / "out", config)
    names = ["failure.msgpack", "fig3.png", "phi_auto.msgpack", "phi_human.msgpack"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == names
    assert (tmp_path / "out" / "fig3.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(report["files"]) == [str(tmp_path / "out" / name) for name in names]
    assert json.loads(json.dumps(report)) == report
    assert (report["phi_auto"]["runs"], report["phi_auto"]["rows"]) == (12, 12 * 17)
    assert (report["phi_human"]["scenes"], report["phi_human"]["rows"]) == (12, 12)

    assert report["failure"]["rows"] == report["phi_auto"]["rows"]
    for network in ("failure", *PAIR):
        about, loaded = report[network], load_network(tmp_path / "out", network)
        assert loaded.figures["loss_val"] == about["loss_val"]
        assert loaded.config["loss"] == ("logistic" if network == "failure" else "rmse")
        assert (loaded.config["max_epochs"], loaded.config["members"]) == ("3", "1")
        assert (loaded.scenes, loaded.rows) == (about["scenes"], about["rows"])
        assert loaded.data_sha256 == about["data_sha256"]
    rows = human_rows(read_runs(runs_path(tmp_path / "data", Mode.HUMAN)))
    loaded = load_network(tmp_path / "out", "phi_human")
    _, val = split_by_scene(rows.scene, fraction=0.2, seed=0)
    error = loaded.predictor.predict(rows.features[val]) - rows.target[val]
    assert np.sqrt((error**2).mean()) == pytest.approx(loaded.figures["loss_val"], rel=1e-4)

    train(tmp_path / "data", tmp_path / "again", config)
    for name in names:
        first, second = (tmp_path / d / name for d in ("out", "again"))
        assert first.read_bytes() == second.read_bytes()


def test_train_writes_nothing_on_bad_data(tmp_path):
    collect(tmp_path / "data")
    path = runs_path(tmp_path / "data", Mode.HUMAN)
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    with pytest.raises(BadInput, match=r"human/runs\.parquet: truncated or corrupt"):
        train(tmp_path / "data", tmp_path / "out", TrainConfig())
    path.unlink()
    with pytest.raises(BadInput, match=r"human/runs\.parquet: no such file"):
        train(tmp_path / "data", tmp_path / "out", TrainConfig())
    path.write_bytes(whole)
    runs_path(tmp_path / "data", Mode.AUTONOMOUS).write_bytes(whole)
    with pytest.raises(BadInput, match=r"autonomous/runs\.parquet: scene tight_0 has human input"):
        train(tmp_path / "data", tmp_path / "out", TrainConfig())
    collect(tmp_path / "one", scenes=1)
    with pytest.raises(BadInput, match=r"runs\.parquet: rows from 1 scenes, expected at least 2"):
        train(tmp_path / "one", tmp_path / "out", TrainConfig())
    assert not (tmp_path / "out").exists()


def fork_table(states=24, keys=2):
    """States of 12 scenes whose gain is 100 times how far the goal stands from the hand."""
    rng = np.random.default_rng(0)
    rows = []
    for i in range(states):
        state = dict(zip(STATE, rng.uniform(0, 2, len(STATE)).tolist(), strict=True))
        for key in range(keys):
            helped = float(rng.uniform(0, 50))
            rows.append(
                {
                    "scene": f"tight_{i % 12}",
                    "seed": i,
                    "class": "tight",
                    "iteration": 3 + i % 4,
                    "input": "push",
                    "key": key,
                    "alone": helped + 100 * state["range"],
                    "helped": helped,
                    "alone_solved": False,
                    "helped_solved": True,
                    "alone_iterations": 10,
                    "helped_iterations": 2,
                    "pushed": True,
                    **{f"state:{name}": value for name, value in state.items()},
                }
            )
    return pl.DataFrame(rows, schema=FORK_SCHEMA)


def test_forks_beside_the_runs_train_the_gain_too(tmp_path):
    collect(tmp_path / "data")
    write_forks(runs_path(tmp_path / "data", Mode.FORKS), [fork_table()])
    report = train(tmp_path / "data", tmp_path / "out", TrainConfig(max_epochs=2))
    about, loaded = report["gain"], load_network(tmp_path / "out", "gain")
    assert (about["runs"], about["rows"], about["scenes"], about["short"]) == (24, 24, 12, 0)
    members = RECIPES["gain"].settings["members"]
    assert loaded.config["members"] == str(members)
    assert loaded.predictor.params["Dense_0"]["bias"].shape[0] == members > 1
    assert set(loaded.predictor.features) <= set(STATE)
    digest = hashlib.sha256((tmp_path / "data/forks/forks.parquet").read_bytes()).hexdigest()
    assert loaded.data_sha256 == about["data_sha256"] == digest
    # The others are not trained any differently for it.
    train(tmp_path / "data", tmp_path / "out", TrainConfig(max_epochs=2))
    runs_path(tmp_path / "data", Mode.FORKS).unlink()
    again = train(tmp_path / "data", tmp_path / "again", TrainConfig(max_epochs=2))
    assert "gain" not in again and not (tmp_path / "again" / "gain.msgpack").exists()
    for network in (*PAIR, "failure"):
        first, second = (tmp_path / d / f"{network}.msgpack" for d in ("out", "again"))
        assert first.read_bytes() == second.read_bytes()


# -- losses, dropout and ensembles ---------------------------------------------------------------


def made(rows, target, seed=0):
    """Two features that matter to nothing but `target(x)`, in scenes of four rows."""
    x = np.random.default_rng(seed).uniform(-1, 1, (rows, 2))
    scene = np.array([f"s{i // 4}" for i in range(rows)])
    return Rows(
        x, target(x), np.ones(rows, bool), scene, np.arange(rows), names=("turn", "distance")
    )


def held_out(rows):
    return split_by_scene(rows.scene, fraction=0.2, seed=0)[1]


def test_mae_finds_the_median_where_rmse_finds_the_mean():
    rng = np.random.default_rng(3)
    # Whatever is seen, the target is 0 mostly, and 100 every fourth time.
    rows = made(2000, lambda x: 100.0 * (rng.random(len(x)) < 0.25))
    config = TrainConfig(max_epochs=30, hidden=(8,))
    mae, squares = (
        fit(jax.random.key(0), rows, dataclasses.replace(config, loss=loss))
        for loss in ("mae", "rmse")
    )
    assert np.abs(mae.predictor.predict(rows.features)).mean() < 5
    assert squares.predictor.predict(rows.features).mean() == pytest.approx(25, abs=5)
    val = held_out(rows)
    error = np.abs(mae.predictor.predict(rows.features[val]) - rows.target[val]).mean()
    assert mae.kept_val == pytest.approx(error, rel=1e-3)


def test_logistic_finds_the_odds():
    rng = np.random.default_rng(4)

    def odds(x):
        return 3.0 * x[:, 0] - 1.0

    rows = made(4000, lambda x: (rng.random(len(x)) < 1 / (1 + np.exp(-odds(x)))).astype(float))
    done = fit(
        jax.random.key(0), rows, TrainConfig(loss="logistic", hidden=(16,), learning_rate=5e-3)
    )
    x = np.random.default_rng(9).uniform(-1, 1, (200, 2))
    found = done.predictor.predict(x)
    assert np.sqrt(((found - odds(x)) ** 2).mean()) < 0.35
    val = held_out(rows)
    z, y = done.predictor.predict(rows.features[val]).astype(float), rows.target[val]
    by_hand = (np.log1p(np.exp(-np.abs(z))) + np.maximum(z, 0) - z * y).mean()
    assert done.kept_val == pytest.approx(by_hand, rel=1e-4)
    assert done.kept_val < 0.69  # better than a coin


def test_dropout_is_for_training_alone():
    rows = known_function(330)
    config = TrainConfig(max_epochs=3, dropout=0.3)
    done, again = (fit(jax.random.key(2), rows, config) for _ in range(2))
    without = fit(jax.random.key(2), rows, dataclasses.replace(config, dropout=0.0))
    assert done.loss_val.tobytes() == again.loss_val.tobytes()
    assert not np.array_equal(done.loss_val, without.loss_val)
    # The losses reported, and what is predicted, are of the whole network.
    val = held_out(rows)
    prediction = done.predictor.predict(rows.features[val])
    assert prediction.tobytes() == done.predictor.predict(rows.features[val]).tobytes()
    error = np.sqrt(((prediction - rows.target[val]) ** 2).mean())
    assert done.kept_val == pytest.approx(error, rel=1e-4)


def test_an_ensemble_s_losses_are_those_of_its_mean():
    rows = known_function(330)
    config = TrainConfig(max_epochs=2, members=3)
    done, again = (fit(jax.random.key(6), rows, config) for _ in range(2))
    params = jax.tree.leaves(done.predictor.params)
    assert all(len(leaf) == 3 for leaf in params)
    for a, b in zip(params, jax.tree.leaves(again.predictor.params), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    kernel = np.asarray(done.predictor.params["Dense_0"]["kernel"])
    assert not np.array_equal(kernel[0], kernel[1])
    val = held_out(rows)
    members = [
        dataclasses.replace(
            done.predictor,
            params=jax.tree.map(lambda leaf, e=e: leaf[e : e + 1], done.predictor.params),
        )
        for e in range(3)
    ]
    each = np.stack([one.predict(rows.features[val]) for one in members])
    error = np.sqrt(((each.mean(axis=0) - rows.target[val]) ** 2).mean())
    assert done.kept_val == pytest.approx(error, rel=1e-4)
    # The curves are the first member's.
    first = np.sqrt(((each[0] - rows.target[val]) ** 2).mean())
    assert done.loss_val[done.best_epoch] == pytest.approx(first, rel=1e-4)
