"""Training: learns what can be learned, repeats itself to the bit, stops where it should."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.guidance import training
from pgf_jax.guidance.checkpoint import load_pair
from pgf_jax.guidance.predictor import init
from pgf_jax.guidance.rows import Rows, human_rows, split_by_scene
from pgf_jax.guidance.runs import Mode, RunLog, read_runs, runs_path, write_runs
from pgf_jax.guidance.train_config import TrainConfig
from pgf_jax.guidance.training import fit, rmse, train


@pytest.fixture(autouse=True, scope="module")
def strict():
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        yield


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
    return Rows(x, y, np.array([f"s{i // 4}" for i in range(rows)]), np.arange(rows))


@pytest.fixture(scope="module")
def fitted():
    rows = known_function(1600)
    return rows, fit(jax.random.key(0), rows, TrainConfig())


def test_it_learns_a_known_function(fitted):
    rows, done = fitted
    _, val = split_by_scene(rows.scene, fraction=0.2, seed=0)
    assert done.target_std_val == pytest.approx(rows.target[val].std())
    assert done.rmse_val < 0.08 * done.target_std_val
    error = done.predictor.predict(rows.features[val]) - rows.target[val]
    assert np.sqrt((error**2).mean()) == pytest.approx(done.rmse_val, rel=1e-4)
    assert (done.scenes_train, done.scenes_val) == (320, 80)


def test_early_stopping_returns_the_best_weights(fitted):
    rows, done = fitted
    train_index, val = split_by_scene(rows.scene, fraction=0.2, seed=0)
    for index, loss in ((val, done.loss_val), (train_index, done.loss_train)):
        x, y = (jnp.asarray(a[index], dtype=jnp.float32) for a in (rows.features, rows.target))
        assert float(jax.jit(rmse)(done.predictor, x, y)) == loss[done.best_epoch]
    assert done.best_epoch == int(np.argmin(done.loss_val))
    assert done.rmse_val == done.loss_val.min()
    assert len(done.loss_val) == min(done.best_epoch + 1 + TrainConfig().patience, 100)


def test_patience_and_the_limit_on_epochs():
    noise = Rows(
        features=known_function(330).features,
        target=np.random.default_rng(1).gamma(1, 300, 330),
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
        training._fit_once(k, rows, *split_by_scene(rows.scene, fraction=0.2, seed=0), config)
        for k in jax.random.split(jax.random.key(5), 3)
    ]
    assert best.rmse_val == min(one.rmse_val for one in alone)
    assert len({one.rmse_val for one in alone}) == 3


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
    stepped, _ = training._epoch(
        jax.random.key(1), predictor, state, x, y, batch=50, learning_rate=1e-2
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
    _, state = training._epoch(
        jax.random.key(1),
        predictor,
        optax.adam(1e-30).init(predictor.params),
        x,
        y,
        batch=50,
        learning_rate=1e-30,
    )
    order = np.asarray(jax.random.permutation(jax.random.key(1), 130))
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
    exact = jax.jit(jax.vmap(training.forward, in_axes=(None, 0)))(predictor, x)
    slope = slope_of_rmse(predictor, x, exact)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_divergence_and_one_scene_are_bad_input():
    rows = known_function(330)
    with pytest.raises(BadInput, match="training diverged with learning_rate 1e"):
        fit(jax.random.key(0), rows, TrainConfig(learning_rate=1e30, max_epochs=2))
    with pytest.raises(BadInput, match="at least 2 scenes"):
        fit(
            jax.random.key(0),
            Rows(rows.features[:3], rows.target[:3], rows.scene[:3], rows.iteration[:3]),
            TrainConfig(),
        )


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"restarts": 0}, "restarts must be at least 1, got 0"),
        ({"batch": -5}, "batch must be at least 1, got -5"),
        ({"max_epochs": 0}, "max_epochs"),
        ({"patience": 0}, "patience"),
        ({"seed": -1}, "seed must be within"),
        ({"learning_rate": float("nan")}, "learning_rate must be positive, got nan"),
        ({"learning_rate": 0.0}, "learning_rate must be positive, got 0.0"),
        ({"validation_fraction": 1.0}, "validation_fraction"),
        ({"hidden": ()}, "hidden"),
        ({"hidden": (64, 0)}, "hidden"),
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


def test_train_writes_two_checkpoints_and_a_figure(tmp_path):
    collect(tmp_path / "data")
    config = TrainConfig(max_epochs=3)
    report = train(tmp_path / "data", tmp_path / "out", config)
    names = ["fig3.png", "phi_auto.msgpack", "phi_human.msgpack"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == names
    assert (tmp_path / "out" / "fig3.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(report["files"]) == [str(tmp_path / "out" / name) for name in names]
    assert json.loads(json.dumps(report)) == report
    assert (report["phi_auto"]["runs"], report["phi_auto"]["rows"]) == (12, 12 * 17)
    assert (report["phi_human"]["scenes"], report["phi_human"]["rows"]) == (12, 12)

    for network, loaded in zip(("phi_auto", "phi_human"), load_pair(tmp_path / "out"), strict=True):
        about = report[network]
        assert loaded.figures["rmse_val"] == about["rmse_val"]
        assert (loaded.scenes, loaded.rows) == (about["scenes"], about["rows"])
        assert loaded.data_sha256 == about["data_sha256"]
    rows = human_rows(read_runs(runs_path(tmp_path / "data", Mode.HUMAN)))
    _, val = split_by_scene(rows.scene, fraction=0.2, seed=0)
    error = loaded.predictor.predict(rows.features[val]) - rows.target[val]
    assert np.sqrt((error**2).mean()) == pytest.approx(loaded.figures["rmse_val"], rel=1e-4)

    train(tmp_path / "data", tmp_path / "again", config)
    for name in names[1:]:
        first, second = (tmp_path / d / name for d in ("out", "again"))
        assert first.read_bytes() == second.read_bytes()


def test_train_writes_nothing_on_bad_data(tmp_path):
    collect(tmp_path / "data")
    path = runs_path(tmp_path / "data", Mode.HUMAN)
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    with pytest.raises(BadInput, match=r"human/runs\.parquet: not a readable Parquet"):
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
