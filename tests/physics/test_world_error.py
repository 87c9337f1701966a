"""How the world in which a robot acts is drawn."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.errors import BadInput
from pgf_jax.physics.worlds.config import WorldError, world_error_of
from pgf_jax.physics.worlds.error import draw, moved_apart
from pgf_jax.physics.worlds.solid import SolidWorld
from pgf_jax.scene import Scene, sample_scene
from pgf_jax.scene.shelf import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y

SCENE = sample_scene(1, "tight")


def test_spreads_are_as_stated():
    draws = [draw(WorldError(0.3, 0.2, 0.004), SCENE, 0, i, 0) for i in range(200)]
    mass, friction = np.array([d.mass for d in draws]), np.array([d.friction for d in draws])
    hand = np.array([d.hand_friction for d in draws])
    assert 0.8 <= mass.min() < 0.81 and 1.19 < mass.max() <= 1.2
    for factors in (friction, hand):
        assert 0.7 <= factors.min() < 0.72 and 1.28 < factors.max() <= 1.3
    # Of an object that stands alone nothing is moved apart.
    lonely = Scene("lonely", np.array([[0.4, 0.0, RADIUS]]), 0)
    places = np.array([draw(WorldError(0, 0, 0.004), lonely, 0, i).positions for i in range(2000)])
    assert places.std(0) == pytest.approx(0.004, rel=0.1)


def test_a_draw_depends_on_its_key_alone():
    one, same, other = (draw(WorldError(), SCENE, 7, *key) for key in ((1, 2), (1, 2), (2, 1)))
    assert all(np.array_equal(a, b) for a, b in zip(one, same, strict=True))
    assert not np.array_equal(one.mass, other.mass)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.02))
def test_objects_that_overlap_are_moved_apart(seed, sd):
    scene = sample_scene(seed, "tight")
    moved = scene.positions + sd * np.random.default_rng(seed).standard_normal((20, 2))
    apart = moved_apart(moved, scene)
    distance = np.linalg.norm(apart[:, None] - apart[None], axis=-1)[np.triu_indices(20, 1)]
    assert distance.min() >= 2 * RADIUS - 1e-5
    assert (apart[:, 0] >= FRONT_X).all() and (apart[:, 0] <= BACK_WALL_X - RADIUS + 1e-5).all()
    assert (np.abs(apart[:, 1]) <= SIDE_WALL_Y - RADIUS + 1e-5).all()
    assert np.array_equal(moved_apart(apart, scene), apart)


def test_objects_of_other_sizes_are_moved_apart():
    scene = sample_scene(3, "mixed")
    n = len(scene.objects)
    moved = scene.positions + 0.01 * np.random.default_rng(0).standard_normal((n, 2))
    apart = moved_apart(moved, scene)
    first, second = np.triu_indices(n, 1)
    distance = np.linalg.norm(apart[first] - apart[second], axis=-1)
    assert (distance >= scene.radii[first] + scene.radii[second] - 1e-5).all()
    assert (apart[:, 0] <= BACK_WALL_X - scene.radii + 1e-5).all()


def test_a_world_has_what_was_drawn():
    drawn = draw(WorldError(), SCENE, 0, 0, 0)
    plain, changed = SolidWorld(20), SolidWorld(20, drawn=drawn)
    objects = [plain.model.body(f"object_{i + 1}").id for i in range(20)]
    assert changed.model.body_mass[objects] == pytest.approx(drawn.mass)
    ratio = changed.model.geom_friction[:, 0] / plain.model.geom_friction[:, 0]
    for i, body in enumerate(objects):
        assert ratio[plain.model.geom_bodyid == body] == pytest.approx(drawn.friction[i])
    hand = plain.model.geom_bodyid == plain.model.body("palm").id
    assert ratio[hand] == pytest.approx(drawn.hand_friction)
    assert ratio[plain.model.geom("back").id] == 1.0
    seen = changed.seen(changed.start(SCENE))
    assert np.abs(seen.objects - drawn.positions).max() < 1e-6
    assert np.array_equal(plain.model.body_mass, SolidWorld(20).model.body_mass)  # a copy


@pytest.mark.parametrize(
    ("texts", "world", "message"),
    [
        (("default",), "none", "solid only, got world none"),
        (("default",), "scene", "solid only, got world scene"),
        (("weight=1",), "solid", "'weight'"),
        (("mass=1.5",), "solid", "mass"),
        (("mass=nan",), "solid", "mass"),
        (("position=-1",), "solid", "position"),
        (("default", "mass=0.1"), "solid", "default"),
        (("mass",), "solid", "mass=NUMBER"),
    ],
)
def test_a_wrong_error_is_one_line(texts, world, message):
    with pytest.raises(BadInput, match=message) as caught:
        world_error_of(texts, world)
    assert "\n" not in str(caught.value)


def test_what_is_not_named_is_not_wrong():
    assert world_error_of((), "none") is None
    assert world_error_of(("default",), "solid") == WorldError(0.3, 0.3, 0.005)
    assert world_error_of(("mass=0.1",), "solid") == WorldError(0.0, 0.1, 0.0)
