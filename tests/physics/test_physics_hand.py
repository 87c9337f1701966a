import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgf_jax.physics import hand

GRIPPERS = st.floats(0, 255)
_TRACED = {
    f: jax.jit(functools.partial(f, xp=jnp))
    for f in (hand.capsule_segments, hand.capsule_poses, hand.creep)
}
OF_LINK = np.array([c[0] for c in hand.CAPSULES])


def capsules_of(link):
    return np.isin(OF_LINK, [link])


def test_the_open_hand_is_the_table():
    table = np.array([c[1:5] for c in hand.CAPSULES]).reshape(-1, 2, 2)
    np.testing.assert_allclose(hand.capsule_segments(0.0), table, atol=1e-15)
    assert set(OF_LINK) <= {"palm", *hand.LINKS}


def test_pointing_direction():
    assert np.degrees(hand.POINTING_YAW) == pytest.approx(-2.78, abs=0.01)


@given(GRIPPERS)
def test_links_are_rigid(gripper):
    """All distances between points of one link stay as they are; the palm does not move at all."""
    now, before = hand.capsule_segments(gripper), hand.capsule_segments(0.0)
    for link in {*OF_LINK}:
        a, b = (s[capsules_of(link)].reshape(-1, 2) for s in (now, before))
        gaps = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (a, b)]
        np.testing.assert_allclose(*gaps, atol=1e-12)
    palm = capsules_of("palm")
    np.testing.assert_array_equal(now[palm], before[palm])


@given(GRIPPERS)
def test_links_turn_about_their_joints(gripper):
    """A link turns by its own angle in all; the joint's distances within its parent stay."""
    now, before = hand.capsule_segments(gripper), hand.capsule_segments(0.0)
    for name, link in hand.LINKS.items():
        own = capsules_of(name)
        if not own.any():
            continue
        along = [np.diff(s[own], axis=1)[:, 0] for s in (before, now)]
        turned = np.arctan2(along[1][:, 1], along[1][:, 0]) - np.arctan2(
            along[0][:, 1], along[0][:, 0]
        )
        wanted = link.angle * gripper / 255
        np.testing.assert_allclose(np.remainder(turned - wanted + 3, 2 * np.pi) - 3, 0, atol=1e-9)
        if link.parent is None:  # then the joint does not move, and so neither does the distance
            away = [np.linalg.norm(s[own] - np.array(link.joint), axis=-1) for s in (before, now)]
            np.testing.assert_allclose(*away, atol=1e-12)


def test_the_follower_hangs_on_the_driver_and_coupler():
    """The follower's joint, carried by hand along the chain at a quarter of the way."""

    def turn(point, joint, angle):
        c, s = np.cos(angle), np.sin(angle)
        return joint + np.array([[c, -s], [s, c]]) @ (np.asarray(point) - joint)

    for side in ("right", "left"):
        driver, coupler, follower = (
            hand.LINKS[f"{side}_{link}"] for link in ("driver", "coupler", "follower")
        )
        # A link's angle is its turn in all: the coupler turns about the joint that the driver
        # carries, by its own angle from its open direction.
        elbow = turn(coupler.joint, np.array(driver.joint), driver.angle / 4)
        arm = np.subtract(follower.joint, coupler.joint)
        joint = elbow + turn(arm, np.zeros(2), coupler.angle / 4)
        own = capsules_of(f"{side}_follower")
        before, now = hand.capsule_segments(0.0)[own], hand.capsule_segments(255 / 4)[own]
        expected = [
            [joint + turn(p - np.array(follower.joint), np.zeros(2), follower.angle / 4) for p in s]
            for s in before
        ]
        np.testing.assert_allclose(now, expected, atol=1e-12)


@settings(deadline=None)  # the first example compiles
@given(GRIPPERS)
def test_numpy_and_jax_agree(gripper):
    for f, g in _TRACED.items():
        for a, b in zip(g(jnp.float32(gripper)), f(gripper), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)


@given(GRIPPERS)
def test_geoms_lie_along_their_segments(gripper):
    positions, quats = hand.capsule_poses(gripper)
    ends = hand.capsule_segments(gripper)
    np.testing.assert_allclose(positions[:, :2], ends.mean(1), atol=1e-12)
    np.testing.assert_array_equal(positions[:, 2], 0)
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-6)
    w, x, y, z = quats.T
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
    along = np.diff(ends, axis=1)[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    np.testing.assert_allclose(axis, np.column_stack([along, np.zeros(len(along))]), atol=1e-6)


def test_creep_follows_its_table():
    for row in hand.CREEP:
        np.testing.assert_allclose(hand.creep(row[0]), row[1:], atol=1e-12)
    middle = (hand.CREEP[4] + hand.CREEP[5]) / 2
    np.testing.assert_allclose(hand.creep(middle[0]), middle[1:], atol=1e-12)


def covered_by_capsules(points, gripper):
    a, b = (hand.capsule_segments(gripper)[:, i] for i in (0, 1))
    t = ((points[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1)
    nearest = a + np.clip(t, 0, 1)[..., None] * (b - a)
    return (np.linalg.norm(points[:, None] - nearest, axis=-1) <= hand.RADII).any(1)


def covered_by_polygons(points, polygons):
    inside = np.zeros(len(points), bool)
    for polygon in polygons:
        corners = np.asarray(polygon)
        edges = np.roll(corners, -1, 0) - corners
        off = points[:, None] - corners
        side = edges[:, 0] * off[..., 1] - edges[:, 1] * off[..., 0]
        inside |= (side >= 0).all(1) | (side <= 0).all(1)
    return inside


@pytest.mark.parametrize("x_from", [-0.1, 0.13])  # the whole hand; the fingers alone
def test_capsules_cover_the_measured_footprint(authors, x_from):
    path = authors / "hand_footprint.json"
    if not path.is_file():
        pytest.skip(f"no {path.name}")
    measured = json.loads(path.read_text())["gripper"]
    assert len(measured) == 4
    step = 0.0015
    grid = np.mgrid[x_from:0.27:step, -0.16:0.16:step].reshape(2, -1).T
    for gripper, polygons in measured.items():
        want = covered_by_polygons(grid, polygons.values())
        got = covered_by_capsules(grid, float(gripper))
        missed, extra = (want & ~got).sum() / want.sum(), (got & ~want).sum() / want.sum()
        assert missed < 0.08, gripper  # most of it behind the palm, where nothing comes
        assert extra < 0.08, gripper
