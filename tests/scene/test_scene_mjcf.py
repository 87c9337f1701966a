import re

import numpy as np
import pytest

from pgf_jax.errors import BadInput
from pgf_jax.scene import (
    corridor_count,
    deeper_count,
    load_scene,
    load_scenes,
    nearest_distances,
    sample_scene,
    scene_statistics,
)

GEOM = '<geom friction="0.3 0.3 0.3" mass="1." size="0.03 0.05" type="cylinder"/>'
JOINT = '<joint damping="0.5" stiffness="0.01" armature="0.1" type="free"/>'
PLACES = {1: "0.45 0.1 0.18", 2: "0.35 -0.1 0.18", 3: "0.5 0.0 0.18"}


def body(number, pos=None, *, attributes='quat="0.6 0 0 0.8"', inside=GEOM + JOINT):
    pos = PLACES[number] if pos is None else pos
    return f'<body name="object_{number}" pos="{pos}" {attributes}>{inside}</body>'


def document(*bodies):
    return (
        '<?xml version="1.0"?><mujoco model="m"><include file="include/settings.xml"/>'
        f'<worldbody><include file="include/light.xml"/>{"".join(bodies)}'
        '<include file="include/small_shelf.xml"/></worldbody></mujoco>'
    )


def replaced(number, **changes):
    """Three good objects, one of them changed."""
    return document(*(body(n, **changes) if n == number else body(n) for n in PLACES))


@pytest.fixture
def refused(tmp_path):
    def load(text: str | bytes) -> str:
        path = tmp_path / "shelf_7.xml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(BadInput) as caught:
            load_scene(path)
        message = str(caught.value)
        assert "\n" not in message
        assert message.startswith(f"{path}: ")
        assert "expected" in message or "supported" in message
        return message.removeprefix(f"{path}: ")

    return load


def test_objects_come_in_the_order_of_their_numbers(tmp_path):
    path = tmp_path / "corner.xml"
    path.write_text(document(body(3), body(1), body(2)))
    scene = load_scene(str(path))
    assert scene.name == "corner"
    assert scene.goal == 2
    np.testing.assert_array_equal(
        scene.objects, [[0.45, 0.1, 0.03], [0.35, -0.1, 0.03], [0.5, 0.0, 0.03]]
    )


def test_numbers_are_not_sorted_as_text(tmp_path):
    path = tmp_path / "ten.xml"
    places = {n: f"{0.25 + 0.07 * (n % 4):.2f} {0.08 * (n // 4):.2f} 0.18" for n in range(1, 12)}
    path.write_text(document(*(body(n, places[n]) for n in sorted(places, key=str))))
    expected = [[float(v) for v in places[n].split()[:2]] for n in range(1, 12)]
    np.testing.assert_allclose(load_scene(path).positions, expected)


def test_what_a_file_leaves_out_is_standard(tmp_path):
    path = tmp_path / "plain.xml"
    plain = '<geom type="cylinder" size=".03 .05"/><freejoint/><site name="s"/>'
    path.write_text(document(*(body(n, attributes="", inside=plain) for n in PLACES)))
    assert load_scene(path).objects.shape == (3, 3)


def test_a_sampled_scene_survives_the_file_format(tmp_path):
    scene = sample_scene(4, "tight")
    bodies = [body(i + 1, f"{x!r} {y!r} 0.18") for i, (x, y) in enumerate(scene.positions.tolist())]
    path = tmp_path / "tight_4.xml"
    path.write_text(document(*bodies))
    read = load_scene(path)
    assert (read.name, read.goal) == (scene.name, scene.goal)
    np.testing.assert_array_equal(read.objects, scene.objects)


def test_missing_file(tmp_path):
    with pytest.raises(BadInput, match=r"nowhere\.xml: no such file, expected"):
        load_scene(tmp_path / "nowhere.xml")


def test_a_directory_is_not_a_file(tmp_path):
    with pytest.raises(BadInput, match=f"{re.escape(str(tmp_path))}: cannot be read"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"x,y\n0.4,0.1\n",
        document(body(1))[:-20],
        b"\x89PNG\r\n\x1a\n\x00\x00",
        b"<mujoco>\xff\xfe</mujoco>",
        b'<?xml version="1.0" encoding="klingon"?><mujoco/>',
    ],
)
def test_not_xml(refused, text):
    assert "not well-formed XML" in refused(text)


def test_another_root(refused):
    assert "<robot>" in refused("<robot/>")


@pytest.mark.parametrize(
    "text", [document(), "<mujoco/>", "<mujoco><worldbody/><worldbody/></mujoco>"]
)
def test_no_objects(refused, text):
    assert "no objects" in refused(text)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"inside": GEOM.replace("cylinder", "box") + JOINT}, ["'box'", "cylinder"]),
        ({"inside": '<geom size="0.03 0.05"/>' + JOINT}, ["type None", "cylinder"]),
        ({"inside": GEOM.replace("0.03 0.05", "0.03") + JOINT}, ["'0.03'", "half height"]),
        ({"inside": GEOM.replace("0.03 0.05", "thin") + JOINT}, ["size 'thin'", "numbers"]),
        ({"inside": '<geom type="cylinder"/>' + JOINT}, ["no size"]),
        ({"inside": GEOM.replace("0.3 0.3 0.3", "") + JOINT}, ["friction ''", "a number"]),
        ({"inside": GEOM.replace("/>", ' pos="0 0 1"/>') + JOINT}, ["pos='0 0 1'", "own pose"]),
        ({"inside": GEOM.replace("/>", ' euler="1 0 0"/>') + JOINT}, ["euler='1 0 0'"]),
        ({"inside": JOINT}, ["0 geoms", "one cylinder"]),
        ({"inside": GEOM + GEOM + JOINT}, ["2 geoms", "one cylinder"]),
        ({"inside": GEOM}, ["0 joints", "one free joint"]),
        ({"inside": GEOM + JOINT + JOINT}, ["2 joints", "one free joint"]),
        ({"inside": GEOM + '<joint type="slide"/>'}, ["'slide'", "free"]),
        ({"inside": GEOM + "<joint/>"}, ["'hinge'", "free"]),
        ({"inside": GEOM + JOINT.replace("0.5", "5")}, ["damping '5'", "0.5"]),
        ({"inside": GEOM + JOINT.replace("0.1", "0")}, ["armature '0'", "0.1"]),
        ({"inside": GEOM + JOINT + '<inertial mass="9"/>'}, ["<inertial>"]),
        ({"attributes": 'quat="0.7071 0.7071 0 0"'}, ["tilted by 90.0 deg", "upright"]),
        ({"attributes": 'quat="0 1 0 0"'}, ["tilted by 180.0 deg", "upright"]),
        ({"attributes": 'quat="0.999 0 0.0349 0"'}, ["tilted by 4.0 deg", "upright"]),
        ({"attributes": 'quat="0 0 0 0"'}, ["'0 0 0 0'", "not all 0"]),
        ({"attributes": 'quat="1 0 0"'}, ["'1 0 0'", "four numbers"]),
        ({"attributes": 'euler="1.57 0 0"'}, ["euler='1.57 0 0'", "quat"]),
        ({"pos": "0.4 left 0.18"}, ["pos '0.4 left 0.18'", "numbers"]),
        ({"pos": "0.4 nan 0.18"}, ["pos '0.4 nan 0.18'", "finite"]),
        ({"pos": "0.4 0.1"}, ["pos '0.4 0.1'", "three numbers"]),
        ({"pos": "0.35 -0.1 0.3"}, ["z 0.3 m", "one level"]),
    ],
)
def test_an_object_that_is_not_supported(refused, change, parts):
    message = refused(replaced(2, **change))
    assert message.startswith("object_2 ")
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.03 ", "0.06 ", "object_2 has radius 0.06 m; expected within 0.015..0.05 m"),
        ("0.05", "0.12", "object_2 has height 0.24 m; expected within 0.06..0.2 m"),
        ("0.03 0.05", "0.02 0.05", "object_2 is 0.1 m high at a radius of 0.02 m, and would tip"),
        ("1.", "9", "object_2 has mass 9 kg; expected within 0.05..5 kg"),
        ("0.3 0.3 0.3", "2 0 0", "object_2 has friction 2; expected within 0.05..1"),
    ],
)
def test_sizes_that_are_not_simulated(refused, old, new, message):
    text = GEOM.replace(old, new)
    z = 0.25 if new == "0.12" else 0.18
    assert message in refused(replaced(2, pos=f"0.35 -0.1 {z}", inside=text + JOINT))


def test_objects_of_other_sizes(tmp_path):
    path = tmp_path / "sizes.xml"
    large = GEOM.replace("0.03 0.05", "0.04 0.07").replace("1.", "2.5")
    rough = GEOM.replace("0.3 0.3 0.3", "0.7 0 0")
    second = body(2, "0.35 -0.1 0.2", inside=large + JOINT)
    path.write_text(document(body(1), second, body(3, inside=rough + JOINT)))
    scene = load_scene(path)
    assert scene.radii.tolist() == [0.03, 0.04, 0.03]
    assert scene.shelf is not None
    assert scene.shelf.height.tolist() == pytest.approx([0.1, 0.14, 0.1])
    assert scene.shelf.mass.tolist() == [1.0, 2.5, 1.0]
    assert scene.shelf.friction.tolist() == [0.3, 0.3, 0.7]
    assert scene.shelf.table_friction.tolist() == [0.5] * 3


def test_an_object_without_a_place(refused):
    assert "object_2 has no pos" in refused(
        document(body(1), f'<body name="object_2">{GEOM}{JOINT}</body>', body(3))
    )


@pytest.mark.parametrize("name", ["box", "object_", "object_x", "object_0", "object_03", ""])
def test_a_body_that_is_not_an_object(refused, name):
    other = body(1).replace("object_1", name)
    message = refused(document(body(1), body(2), body(3), other))
    assert repr(name) in message
    assert "object_N" in message


def test_a_geom_in_the_world(refused):
    assert "<geom>" in refused(document(body(1), body(2), body(3), GEOM))


def test_missing_goal(refused):
    assert "object_3 is missing" in refused(document(body(1), body(2)))


def test_missing_number(refused):
    message = refused(document(body(1), body(3)))
    assert "object_2 is missing" in message


def test_number_twice(refused):
    assert "object_2 appears twice" in refused(document(body(1), body(2), body(3), body(2)))


def test_overlapping_objects(refused):
    message = refused(replaced(2, pos="0.45 0.15 0.18"))
    assert "object_1 and object_2 overlap by 10.0 mm" in message


def test_object_outside_the_shelf(refused):
    message = refused(replaced(2, pos="0.35 -0.5 0.18"))
    assert "object_2 at (0.35, -0.5) is outside the shelf" in message


def test_directory_in_natural_order(tmp_path):
    for name in ("s_10", "s_2", "s_1", "a"):
        (tmp_path / f"{name}.xml").write_text(document(*map(body, PLACES)))
    (tmp_path / "notes.txt").write_text("not a scene")
    (tmp_path / "include").mkdir()
    assert [s.name for s in load_scenes(tmp_path)] == ["a", "s_1", "s_2", "s_10"]


def test_empty_and_missing_directories(tmp_path):
    with pytest.raises(BadInput, match="holds no scene file"):
        load_scenes(tmp_path)
    with pytest.raises(BadInput, match="nowhere: expected a directory"):
        load_scenes(tmp_path / "nowhere")


def test_a_bad_file_in_a_directory_is_named(tmp_path):
    (tmp_path / "s_1.xml").write_text(document(*map(body, PLACES)))
    (tmp_path / "s_2.xml").write_text("<mujoco/>")
    with pytest.raises(BadInput, match=r"s_2\.xml: no objects"):
        load_scenes(tmp_path)


def published(models, first):
    return [load_scene(models / f"warehouse_{n}.xml") for n in range(first, first + 20)]


def test_all_published_scenes_load(published_models):
    scenes = load_scenes(published_models)
    numbers = [*range(1, 21), *range(1001, 1021), *range(2001, 2021)]
    assert [s.name for s in scenes] == [f"warehouse_{n}" for n in numbers]
    assert all(s.objects.shape == (20, 3) and s.goal == 2 for s in scenes)
    assert scene_statistics(scenes).spacing_min >= 0.060
    np.testing.assert_array_equal(scenes[0].objects[2], [0.476276, 0.077285, 0.03])


# With 20 scenes a share p is known to 4 sqrt(p (1 - p) / 20): of 5 % at most 24.5 % (4 scenes)
# may lie outside a table's quantile, and a mean is known to 4 sd / sqrt(20).
@pytest.mark.parametrize(
    ("first", "x_range", "y_range", "goal_x", "deeper", "corridor"),
    [
        (1, (0.30, 0.55), 0.20, (0.455, 0.518), (3, 8), 4.0),
        # The first half of the medium thousand lies in the tight rectangle, goals included; their
        # quantiles are therefore inside those of the class, and the corridor is the tight one's.
        (1001, (0.30, 0.55), 0.20, (0.281, 0.526), (2, 18), 4.0),
        (2001, (0.27, 0.56), 0.35, (0.276, 0.547), (1, 19), 1.9),
    ],
)
def test_published_classes(published_models, first, x_range, y_range, goal_x, deeper, corridor):
    scenes = published(published_models, first)
    x, y = np.concatenate([s.positions for s in scenes]).T
    # The outermost of 400 centres come within 2.5 mm of the rectangle's edges.
    assert x_range[0] <= x.min() < x_range[0] + 0.0025
    assert x_range[1] - 0.0025 < x.max() <= x_range[1]
    assert y_range - 0.0025 < abs(y).max() <= y_range
    goals = np.array([s.positions[s.goal, 0] for s in scenes])
    depths = np.array([deeper_count(s) for s in scenes])
    for values, (low, high) in ((goals, goal_x), (depths, deeper)):
        assert np.count_nonzero(values < low) <= 4
        assert np.count_nonzero(values > high) <= 4
    counts = np.array([corridor_count(s) for s in scenes])
    assert abs(counts.mean() - corridor) < 4 * counts.std() / np.sqrt(20)
    if first != 2001:
        assert counts.min() > 0


@pytest.mark.parametrize(("first", "preset"), [(1, "tight"), (1001, "tight"), (2001, "wide")])
def test_sampled_scenes_are_packed_like_the_published(published_models, first, preset):
    real = np.array([nearest_distances(s) for s in published(published_models, first)])
    ours = np.array([nearest_distances(sample_scene(seed, preset)) for seed in range(200)])
    # Per scene, because the distances of one scene hang together.
    for summary in (np.median, np.mean, lambda d, axis: np.quantile(d, 0.9, axis=axis)):
        a, b = summary(real, axis=1), summary(ours, axis=1)
        error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
        assert abs(a.mean() - b.mean()) < 4 * error
