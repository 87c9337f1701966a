"""Objects of any size, mass and friction, on shelves of any size, in every engine."""

import functools

import jax
import numpy as np
import pytest

from pgf_jax.physics.engine import Engine, World, make_engine
from pgf_jax.planning import padding
from pgf_jax.planning.search import start_world
from pgf_jax.scene import Scene, sample_scene
from pgf_jax.scene.shelf import Shelf, standard_shelf

SUBSTEPS = 36
PLACES = 28


@functools.cache
def engine(name: str, n_objects: int = PLACES, lanes: int = 1) -> Engine:
    return make_engine(name, n_objects=n_objects, lanes=lanes)


def mixed(count: int) -> list[Scene]:
    """Scenes of the class `mixed` that have room in the places."""
    scenes = (sample_scene(seed, "mixed") for seed in range(1000))
    small = (scene for scene in scenes if len(scene.objects) <= PLACES)
    return [next(small) for _ in range(count)]


def reaches(scenes: list[Scene], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Noisy reaches to the scenes' goals: [B, 8, 3] controls, [B, 8] gripper."""
    noise = np.random.default_rng(seed).normal(0, 0.03, (len(scenes), 8, 3))
    to = np.array([scene.positions[scene.goal] - [0.22, 0.0] for scene in scenes])
    controls = noise + np.concatenate([to, np.zeros((len(to), 1))], 1)[:, None] / 3.0
    gripper = np.tile(np.repeat([255.0, 0.0], 4), (len(scenes), 1))
    return controls, gripper


def roll(on: Engine, scenes: list[Scene], places: int | None = None, seed: int = 0):
    """Roll noisy reaches out in scenes that get as many places."""
    pairs = [
        padding.pad(start_world(s.positions), s.shelf, places or len(s.objects)) for s in scenes
    ]
    pairs = [(world, shelf or standard_shelf(len(world.objects))) for world, shelf in pairs]
    worlds, shelves = (jax.tree.map(lambda *xs: np.stack(xs), *x) for x in zip(*pairs, strict=True))
    controls, gripper = reaches(scenes, seed)
    out = on.rollout(World(*worlds), controls, gripper, SUBSTEPS, None, shelf=Shelf(*shelves))  # pyright: ignore[reportCallIssue]
    return jax.tree.map(np.asarray, out)


def test_planar_is_as_native():
    scenes = mixed(8)
    ours = roll(engine("planar"), scenes, PLACES)
    for i, scene in enumerate(scenes):
        n = len(scene.objects)
        theirs = roll(engine("native", n), [scene], seed=0)
        # Each alone has the first noise; so the same scene is rolled out in ours.
        alone = roll(engine("planar"), [scene], PLACES)
        apart = np.linalg.norm(alone.objects[0, -1, :n] - theirs.objects[0, -1], axis=-1)
        moved = np.linalg.norm(theirs.objects[0, -1] - scene.positions, axis=-1) > 1e-3
        assert moved.any()
        assert np.median(apart[moved]) < 1e-3, (scene.name, apart[moved])
        assert apart[~moved].max(initial=0.0) < 2e-3
        assert np.isfinite(ours.objects[i]).all()


def test_a_lane_does_not_depend_on_the_others():
    scenes = mixed(6)
    together = roll(engine("planar"), scenes, PLACES)
    # The others in another order, but for the one that is compared.
    for i in (0, 5):
        order = [*reversed([j for j in range(6) if j != i])]
        order.insert(i, i)
        again = roll(engine("planar"), [scenes[j] for j in order], PLACES)
        for ours, theirs in zip(again, together, strict=True):
            np.testing.assert_array_equal(ours[i], theirs[i])


def test_empty_places_stay_empty():
    scene = min(mixed(20), key=lambda one: len(one.objects))
    n = len(scene.objects)
    out = roll(engine("planar"), [scene], PLACES)
    assert n < PLACES
    np.testing.assert_allclose(out.objects[0, :, n:], np.tile([0.4, 0.0], (8, PLACES - n, 1)))
    there = out.force[0] > 0
    named = out.bodies[0][there]
    assert there.any() and ((named < n) | (named >= PLACES)).all()


def test_standard_objects_as_data():
    """What is standard, given as data, moves as what is standard by itself."""
    scenes = [sample_scene(seed, "tight") for seed in range(4)]
    controls, gripper = reaches(scenes)
    for name in ("planar", "native"):
        on = engine(name, 20)
        start = World(
            *(np.stack(x) for x in zip(*(start_world(s.positions) for s in scenes), strict=True))
        )
        plain = on.rollout(start, controls, gripper, SUBSTEPS)
        given = roll(on, scenes)
        np.testing.assert_allclose(given.objects, plain.objects, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "within"),
    [("planar", 1e-5), pytest.param("mjx", 1e-4, marks=pytest.mark.slow)],  # it compiles for 30 s
)
@pytest.mark.parametrize("mass", [0.3, 3.0])
def test_an_object_of_any_mass_moves_as_in_native(name, within, mass):
    """Pushed by the hand, and let go; `within`: at the ends of knots, m."""
    shelf = standard_shelf(2)._replace(mass=np.array([mass, 1.0]))
    start = start_world(np.array([[0.3, -0.0088], [0.5, 0.3]]))
    controls = np.tile([0.12, 0.0, 0.0], (8, 1))
    controls[4:] = 0.0
    exact = make_engine("native", n_objects=2, lanes=1, tolerance=1e-16, iterations=200)
    ours, theirs = (_eight(on, start, controls, shelf) for on in (engine(name, 2), exact))
    assert theirs[-1, 0, 0] > 0.31
    np.testing.assert_allclose(ours, theirs, atol=within)


def _eight(on: Engine, start: World, controls: np.ndarray, shelf: Shelf) -> np.ndarray:
    """[T, N, 2] centres: the first of eight equal rollouts."""
    case = start, controls, np.full(8, 255.0), shelf
    world, u, gripper, own = jax.tree.map(lambda x: np.stack([np.asarray(x, float)] * 8), case)
    out = on.rollout(world, u, gripper, SUBSTEPS, None, shelf=own)  # pyright: ignore[reportCallIssue]
    return np.asarray(out.objects)[0]


@pytest.mark.parametrize("name", ["planar", "native"])
@pytest.mark.parametrize(("field", "value"), [("table_friction", 1.0), ("radius", 0.04)])
def test_what_is_rougher_or_larger(name, field, value):
    """An object that was pushed slides on for less, or was pushed from further away."""
    n = 2
    places = np.array([[0.3, -0.0088], [0.5, 0.3]])  # the hand meets the first
    shelf = standard_shelf(n)
    getattr(shelf, field)[0] = value
    ends = []
    for own in (standard_shelf(n), shelf):
        start = World(*(np.asarray(x, float)[None] for x in start_world(places)))
        controls = np.tile([0.12, 0.0, 0.0], (1, 8, 1))
        controls[:, 4:] = 0.0
        shelves = Shelf(*(np.asarray(x, float)[None] for x in own))
        out = engine(name, n).rollout(
            start,
            controls,
            np.full((1, 8), 255.0),
            SUBSTEPS,
            None,
            shelf=shelves,  # pyright: ignore[reportCallIssue]
        )
        ends.append(float(np.asarray(out.objects)[0, -1, 0, 0]))
    plain, other = ends
    assert plain > 0.31
    assert other > plain if field == "radius" else other < plain
