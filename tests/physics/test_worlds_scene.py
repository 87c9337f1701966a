"""The world `scene`: a published scene file driven as its authors do, and files that are refused.

The drive against which it is compared is written here once more, on the model that MuJoCo reads of
the file by itself.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import pickle

import authors_world
import mujoco
import numpy as np
import pytest
import small_scene

from pgf_jax.errors import BadInput
from pgf_jax.physics.hand import EE_POINT
from pgf_jax.physics.worlds.scene import SceneWorld, read_scene_model
from pgf_jax.physics.worlds.world import Command, Executed, State, execute_all
from pgf_jax.scene import Scene, load_scene

KNOTS = 8


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return SceneWorld(read_scene_model(small_scene.write(tmp_path_factory.mktemp("small"))))


@pytest.fixture
def published(authors):
    """Path of a published scene."""
    return lambda number: authors / "models" / f"warehouse_{number}.xml"


def straight(speed=0.1, knots=KNOTS):
    """Ahead, and a little to the side, while the fingers close and open."""
    controls = np.tile([speed, 0.01, 0.05], (knots, 1))
    return controls, np.linspace(40.0, 200.0, knots) % 150


def kept(executed: Executed) -> State:
    assert executed.state is not None
    return executed.state


def same(a, b):
    """Whether two things that were executed are equal, bit for bit."""
    return all(x.tobytes() == y.tobytes() for x, y in zip(a.rollout, b.rollout, strict=True)) and (
        a.distance,
        a.upright,
        a.touched,
    ) == (b.distance, b.upright, b.touched)


# -- as the authors drive it ----------------------------------------------------------------------


class ByHand:
    """The published simulation: velocities and poses are set in every substep."""

    def __init__(self, path):
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.timestep = 0.0015
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.gripper = 0.0

    def run(self, velocity, gripper, seconds):
        names = authors_world.CLOSED
        base = [self.model.joint(n).dofadr[0] for n in authors_world.BASE]
        where = [self.model.joint(n).qposadr[0] for n in names]
        speeds = [self.model.joint(n).dofadr[0] for n in names]
        a_unit = np.array(list(names.values())) / 255
        steps = round(seconds / 0.0015)
        for s in range(steps):
            self.data.qvel[base], self.data.qvel[speeds] = velocity, 0
            self.data.qpos[where] = a_unit * (self.gripper + (gripper - self.gripper) * s / steps)
            mujoco.mj_step(self.model, self.data)
        self.gripper = gripper
        mujoco.mj_forward(self.model, self.data)

    def ahead(self):
        a, b = (self.data.site(f"ee_point_{i}").xpos[:2] for i in (1, 2))
        return (b - a) / np.linalg.norm(b - a)

    def distance(self, goal):
        to = self.data.body(f"object_{goal + 1}").xpos[:2] - self.data.site("ee_point_1").xpos[:2]
        bearing = np.arccos(np.clip(self.ahead() @ to / np.linalg.norm(to), -1, 1))
        return np.hypot(np.linalg.norm(to), 0.09 * bearing)

    def touches(self):
        """Whether a contact is between robot and shelf."""
        roots = {self.model.body(name).id for name in ("robot", "shelf")}
        bodies = self.model.geom_bodyid
        pairs = [self.model.body_rootid[bodies[c.geom]] for c in self.data.contact]
        return any(set(pair) == roots for pair in pairs)


@pytest.mark.parametrize("number", [1, 7, 1003, 2015])
def test_push_retreat_and_reach_are_the_authors_bit_for_bit(published, number):
    path, scene = published(number), load_scene(published(number))
    world, by_hand = SceneWorld(read_scene_model(path)), ByHand(path)
    state = world.start(scene)
    rng = np.random.default_rng(number)
    forward = np.c_[rng.uniform(0.02, 0.08, KNOTS), rng.normal(0, [0.03, 0.1], (KNOTS, 2))]
    closing, speeds = rng.uniform(0, 255, KNOTS), (1.0, 1.5)
    upright, touched = 1.0, []
    for speed, seconds in zip(speeds, (3.0, 1.5), strict=True):
        command = Command(state, speed * forward, closing, seconds, goal=scene.goal, keep=True)
        executed = world.execute(command)
        for k in range(KNOTS):
            by_hand.run(speed * forward[k], closing[k], seconds / KNOTS)
            centres = [by_hand.data.body(f"object_{i + 1}").xpos[:2] for i in range(20)]
            assert np.array_equal(executed.rollout.objects[k], centres)
            touched.append(by_hand.touches())
            upright = min(
                upright, *(by_hand.data.body(f"object_{i + 1}").xmat[8] for i in range(20))
            )
        assert executed.distance == by_hand.distance(scene.goal)
        assert executed.upright == upright and executed.touched == any(touched)
        back = world.retreat(kept(executed))
        by_hand.run([*(-0.07 * by_hand.ahead()), 0.0], by_hand.gripper, 1.0)
        state = kept(world.execute(back))
        assert np.array_equal(state.data.qpos, by_hand.data.qpos)
        assert np.array_equal(state.data.qvel, by_hand.data.qvel)
        touched, upright = [], 1.0
    assert np.abs(executed.rollout.objects[-1] - scene.positions).max() > 0.02


def test_the_published_hand_is_the_planners(published):
    world = SceneWorld(read_scene_model(published(7)))
    scene = load_scene(published(7))
    start = world.start(scene)
    point, _ = world._pointing(start.data)
    np.testing.assert_allclose(point, EE_POINT, atol=1e-5)
    np.testing.assert_array_equal(world._hand(start.data), np.zeros(3))
    np.testing.assert_allclose(world.seen(start).objects, scene.positions, atol=1e-6)
    assert world.n_objects == 20


def test_contacts_of_resting_objects_are_left_out(published):
    """Twenty objects stand on the table box; what is listed is of neighbours and walls."""
    world, scene = SceneWorld(read_scene_model(published(7))), load_scene(published(7))
    still = Command(world.start(scene), np.zeros((2, 3)), np.zeros(2), 0.75)
    rollout = world.execute(still).rollout
    force, bodies = rollout.force[-1], rollout.bodies[-1]
    pairs = bodies[force > 0]
    with_shelf = pairs[(pairs == 21).any(1)]
    # The shelf's inner faces are at x = 0.59 and y = 0.4 (at -0.4 the right one).
    for i in with_shelf.min(1):
        x, y = rollout.objects[-1, i]
        assert x > 0.555 or abs(y) > 0.365
    model = world.model
    standing = {
        int(world._codes[model.geom_bodyid[c.geom]].min())
        for c in world.start(scene).data.contact
        if abs(c.frame[2]) > 0.99
    }
    assert standing == set(range(20))


# -- a world of our own ---------------------------------------------------------------------------


def test_the_hand_follows_its_command_and_pushes(small):
    state = small.start(small_scene.scene())
    controls, gripper = straight()
    executed = small.execute(Command(state, controls, gripper, 3.0, goal=2, keep=True))
    # The goal resists by some newtons; only the hand's mass keeps its velocity within a step.
    np.testing.assert_allclose(executed.rollout.hand[-1], 3.0 * controls[0], atol=3e-3)
    moved = np.linalg.norm(executed.rollout.objects[-1] - small_scene.scene().positions, axis=1)
    assert moved[2] > 0.03 and moved[:2].max() < 1e-4
    assert executed.upright > 0.99 and not executed.touched
    # The block's front is 0.15 m before the hand's origin.
    assert abs(executed.rollout.objects[-1, 2, 0] - 0.45 - 0.03) < 0.01
    point = executed.rollout.hand[-1, :2] + EE_POINT
    assert executed.distance >= np.linalg.norm(executed.rollout.objects[-1, 2] - point) - 0.03
    fingers = [kept(executed).data.joint(n).qpos[0] for n in small_scene.FINGERS]
    expected = [a * gripper[-1] / 255 for a in authors_world.CLOSED.values()]
    np.testing.assert_allclose(fingers, expected, atol=1e-2)


def test_two_halves_of_a_segment_are_the_whole(small):
    state = small.start(small_scene.scene())
    controls, gripper = straight()
    whole = small.execute(Command(state, controls, gripper, 3.0, goal=2, keep=True))
    first = small.execute(Command(state, controls[:4], gripper[:4], 1.5, keep=True))
    second = small.execute(Command(kept(first), controls[4:], gripper[4:], 1.5, goal=2, keep=True))
    for name in ("qpos", "qvel", "qacc_warmstart", "xpos"):
        assert np.array_equal(getattr(kept(whole).data, name), getattr(kept(second).data, name))
    for a, b, both in zip(first.rollout, second.rollout, whole.rollout, strict=True):
        if len(both) == KNOTS:  # velocities are those at the end
            assert np.array_equal(np.concatenate([a, b]), both)
    assert second.distance == whole.distance
    again = small.execute(Command(state, controls, gripper, 3.0, goal=2))  # state as it was
    assert same(again, whole) and again.state is None


def test_a_published_segment_in_two_halves_is_the_whole(published):
    world, scene = SceneWorld(read_scene_model(published(20))), load_scene(published(20))
    state = world.start(scene)
    controls, gripper = straight(0.12)
    whole = world.execute(Command(state, controls, gripper, 3.0, keep=True))
    first = world.execute(Command(state, controls[:4], gripper[:4], 1.5, keep=True))
    second = world.execute(Command(kept(first), controls[4:], gripper[4:], 1.5, keep=True))
    assert np.array_equal(kept(whole).data.qpos, kept(second).data.qpos)
    assert np.array_equal(whole.rollout.objects[4:], second.rollout.objects)
    assert np.abs(whole.rollout.objects[-1] - scene.positions).max() > 0.01


def test_executing_side_by_side_changes_nothing(small):
    state = small.start(small_scene.scene())
    controls, gripper = straight()
    commands = [(small, Command(state, s * controls, gripper, 3.0, goal=2)) for s in (0.5, 1, 1.2)]
    alone = [world.execute(command) for world, command in commands]
    together = execute_all(commands[::-1])[::-1]
    assert all(map(same, alone, together))


def test_the_hand_retreats_straight_back(small):
    start, turn = small.start(small_scene.scene()), np.array([[0.0, 0.0, 0.6]])
    turned = kept(small.execute(Command(start, turn, np.zeros(1), 1.0, keep=True)))
    before, ahead = small._pointing(turned.data)
    after, _ = small._pointing(kept(small.execute(small.retreat(turned))).data)
    # 1 s is 667 steps of 1.5 ms.
    np.testing.assert_allclose(after - before, -0.07 * ahead * 1.0005, atol=1e-6)
    assert abs(np.arctan2(*ahead[::-1]) - 0.6 + 0.0485) < 1e-3


def test_models_travel(small, tmp_path):
    model = read_scene_model(small_scene.write(tmp_path / "elsewhere"))
    back = pickle.loads(pickle.dumps(model))
    assert back == model and hash(back) == hash(model) and back.digest == small.digest
    state = small.start(small_scene.scene())
    other = SceneWorld(back)
    controls, gripper = straight()
    assert same(
        small.execute(Command(state, controls, gripper, 3.0, goal=2)),
        other.execute(Command(other.start(small_scene.scene()), controls, gripper, 3.0, goal=2)),
    )
    moved = small_scene.document(places=((0.5, 0.2), (0.33, -0.15), (0.4, 0.0)))
    assert read_scene_model(small_scene.write(tmp_path / "moved", moved)).digest != model.digest


def test_models_of_one_robot_travel_together(published):
    models = [read_scene_model(published(number)) for number in (1, 7, 20)]
    assert len({model.digest for model in models}) == 3
    assert len(pickle.dumps(models)) < 1.1 * len(pickle.dumps(models[0]))


def test_a_mesh_counts(small, tmp_path):
    path = small_scene.write(tmp_path / "other")
    mesh = path.parent / "robot" / "meshes" / "block.stl"
    mesh.write_bytes(mesh.read_bytes().replace(np.float32(0.05).tobytes(), b"\x00\x00\x80\x3d"))
    assert read_scene_model(path).digest != small.digest


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ([[0.5, 0.2], [0.33, -0.15], [0.4, 0.02]], "object_3 is at (0.4, 0.02); expected (0.4, "),
        ([[0.5, 0.2], [0.33, -0.15]], "has 2 objects; expected 3"),
    ],
)
def test_another_scene_is_refused(small, places, said):
    other = Scene("other", np.c_[places, [0.03] * len(places)], 0)
    with pytest.raises(BadInput) as caught:
        small.start(other)
    assert str(caught.value).startswith("scene other: ") and said in str(caught.value)


# -- bad files ------------------------------------------------------------------------------------


@pytest.fixture
def refused(tmp_path):
    """Whether a file is refused in one line that names it; returns the rest of the line."""

    def read(path):
        with pytest.raises(BadInput) as caught:
            read_scene_model(path)
        message = str(caught.value)
        assert message.startswith(f"{path}: ") and "\n" not in message
        return message.removeprefix(f"{path}: ")

    return read


def test_what_is_no_file_is_refused(refused, tmp_path):
    assert "no such file" in refused(tmp_path / "none.xml")
    assert "cannot be read" in refused(tmp_path)


WORLD = small_scene.document()
INCLUDED = '<include file="robot/robot.xml"/>'
TEXTS = {
    "no XML": ("hello", "not well-formed XML"),
    "cut short": (WORLD[:400], "not well-formed XML"),
    "another root": ("<robot/>", "root element is <robot>; expected <mujoco>"),
    "deep": (WORLD.replace("<light", "<body>" * 5000 + "</body>" * 5000 + "<light"), "too deeply"),
    "no objects": (small_scene.document(places=()), "no objects"),
    "a gap": (WORLD.replace("object_2", "object_7"), "has no body object_2"),
    "no shelf": (WORLD.replace('name="shelf"', ""), "has no body shelf"),
    "no robot": (WORLD.replace(INCLUDED, ""), "has no body robot"),
    "fixed": (WORLD.replace("<freejoint/>", "", 1), "object_1 has 0 joints; expected one free"),
    "carried": (
        WORLD.replace(INCLUDED, f'<body name="cart">{INCLUDED}</body>'),
        "robot is inside another body",
    ),
    "refused by MuJoCo": (WORLD.replace('size=".03 .05"', 'size="0"'), "MuJoCo refuses it"),
    "unknown attribute": (WORLD.replace("<light", '<body speed="3"/><light'), "MuJoCo refuses it"),
    "extension": (
        small_scene.document(head='<extension><plugin plugin="mujoco.sdf.bolt"/></extension>'),
        "holds <extension>, which is not supported",
    ),
    "plugin": (
        WORLD.replace("<freejoint/>", '<freejoint/><plugin plugin="x"/>'),
        "holds <plugin>, which is not supported",
    ),
    "flex": (small_scene.document(body='<flexcomp name="f"/>'), "holds <flexcomp>"),
    "replicate": (small_scene.document(body='<replicate count="9"/>'), "holds <replicate>"),
    "another model": (
        small_scene.document(head='<asset><model name="m" file="m.xml"/></asset>'),
        "holds <model>",
    ),
    "built-in mesh": (
        small_scene.document(head='<asset><mesh name="m" builtin="sphere" params="12"/></asset>'),
        "built-in mesh",
    ),
    "much memory": (small_scene.document(head='<size memory="8G"/>'), "size asks for 8192 MiB"),
    "twice": (
        small_scene.document(body='<include file="robot/robot.xml"/>'),
        "'robot/robot.xml' is included twice",
    ),
    "circle": (small_scene.document(body='<include file="small.xml"/>'), "is included twice"),
    "missing": (small_scene.document(head='<include file="none.xml"/>'), "none.xml: no such file"),
    "a folder": (small_scene.document(head='<include file="robot"/>'), "robot: cannot be read"),
    "no name": (small_scene.document(head="<include/>"), "expected a file alone"),
    "a null": (small_scene.document(head='<include file="&#1;"/>'), "not well-formed XML"),
    "missing mesh": (
        small_scene.document(head='<asset><mesh file="none.stl"/></asset>'),
        "none.stl: no such file",
    ),
}


@pytest.mark.parametrize("case", TEXTS)
def test_bad_texts_are_refused(refused, tmp_path, case):
    text, said = TEXTS[case]
    assert said in refused(small_scene.write(tmp_path / "bad", text))


@pytest.mark.parametrize(
    "head",
    [
        '<include file="{}"/>',
        '<asset><mesh file="{}"/></asset>',
        '<asset><texture type="2d" name="t" file="{}"/></asset>',
        '<asset><texture type="cube" name="t" fileright="{}"/></asset>',
        '<asset><hfield name="h" file="{}"/></asset>',
        '<asset><skin name="s" file="{}"/></asset>',
        '<deformable><flex name="f" file="{}"/></deformable>',
    ],
)
@pytest.mark.parametrize("name", ["absolute", "../../../secret.xml", "robot/meshes/link.xml"])
def test_files_outside_the_folder_are_refused(refused, tmp_path, head, name):
    secret = tmp_path / "secret.xml"
    secret.write_text("<mujocoinclude/>")
    shown = str(secret) if name == "absolute" else name
    # A mesh is looked for in the folder of meshes.
    if "mesh" in head and name.endswith("link.xml"):
        shown = "link.xml"
    path = small_scene.write(tmp_path / "bad", small_scene.document(head=head.format(shown)))
    (path.parent / "robot" / "meshes" / "link.xml").symlink_to(secret)
    assert "leads outside the scene's folder" in refused(path)


@pytest.mark.parametrize("kind", ["meshdir", "assetdir"])
@pytest.mark.parametrize("leads", ["../meshes", "absolute", "link"])
def test_folders_outside_are_refused(refused, tmp_path, kind, leads):
    outside = tmp_path / "meshes"
    outside.mkdir()
    (outside / "block.stl").write_bytes(small_scene.block())
    leads = str(outside) if leads == "absolute" else leads
    text = WORLD.replace('meshdir="robot/meshes"', f'{kind}="{leads}"')
    path = small_scene.write(tmp_path / "bad", text)
    (path.parent / "link").symlink_to(outside)
    assert "leads outside the scene's folder" in refused(path)


def test_links_in_a_circle_are_refused(refused, tmp_path):
    path = small_scene.write(tmp_path / "bad", small_scene.document(head='<include file="a.xml"/>'))
    (path.parent / "a.xml").symlink_to("b.xml")
    (path.parent / "b.xml").symlink_to("a.xml")
    refused(path)


def test_links_inside_the_folder_are_followed(tmp_path, small):
    path = small_scene.write(
        tmp_path, small_scene.document().replace("robot/robot.xml", "link.xml")
    )
    (tmp_path / "link.xml").symlink_to("robot/robot.xml")
    assert read_scene_model(path).digest == small.digest


def test_what_another_parser_would_see_is_not_read(tmp_path, small):
    """A comment in a document type: for MuJoCo's own parser it would end at the first bracket."""
    hidden = '<!DOCTYPE mujoco [<!-- > <include file="/etc/hostname"/> --> ]>'
    assert read_scene_model(small_scene.write(tmp_path, hidden + WORLD)).digest == small.digest


def test_a_large_file_is_refused(refused, tmp_path):
    path = small_scene.write(tmp_path, WORLD + " " * (4 << 20))
    assert "too large" in refused(path)
    path.write_text(WORLD)
    with open(tmp_path / "robot" / "meshes" / "block.stl", "r+b") as file:
        file.truncate(65 << 20)
    assert "too large" in refused(path)


def test_many_files_are_too_large_together(refused, tmp_path):
    path = small_scene.write(tmp_path)
    for i in range(3):
        held = "<mujocoinclude>" + " " * (3 << 19) + "</mujocoinclude>"
        (tmp_path / f"{i}.xml").write_text(held)
    path.write_text(
        small_scene.document(head="".join(f'<include file="{i}.xml"/>' for i in range(3)))
    )
    assert "too large together" in refused(path)


def swapped(path, old, new):
    file = path.parent / "robot" / "robot.xml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name="robot_ang_z"', "", "has no joint robot_ang_z"),
        ('name="joint9_2"', "", "has no joint joint9_2"),
        ('name="ee_point_2"', "", "has no site ee_point_2"),
        ('axis="0 1 0"', 'axis="0 0 1"', "the axes of robot_lin_x"),
        ('"robot_lin_y" type="slide"', '"robot_lin_y" type="hinge"', "expected a slide"),
        ('"joint8_1" type="hinge"', '"joint8_1" type="slide"', "expected a hinge"),
        ('<body name="robot"', '<body name="robot" pos="-0.8 0 0"', "ee_point_1 is at (-0.6179,"),
        ('mesh="block"', 'mesh="none"', "MuJoCo refuses it"),
    ],
)
def test_other_robots_are_refused(refused, tmp_path, old, new, said):
    path = small_scene.write(tmp_path)
    swapped(path, old, new)
    assert said in refused(path)


def test_a_damaged_mesh_is_refused(refused, tmp_path):
    path = small_scene.write(tmp_path)
    (tmp_path / "robot" / "meshes" / "block.stl").write_bytes(b"solid nothing")
    assert "MuJoCo refuses it" in refused(path)


def test_a_bad_include_is_named(refused, tmp_path):
    path = small_scene.write(tmp_path)
    (tmp_path / "robot" / "robot.xml").write_text("<mujocoinclude>")
    assert refused(path).startswith("robot/robot.xml: not well-formed XML")
