"""Shape of the hand: capsules fitted to the authors' hand, and how the gripper moves them.

The hand's footprint was measured in the authors' world. Each of its links is rigid, so each capsule
is fitted once, to the open hand, and moves with its link: every link turns about a joint by an
angle proportional to the gripper value (0 open .. 255 closed). `experiments/fit_hand.py` prints the
tables below from the footprint file.
"""

import dataclasses
from types import ModuleType
from typing import Any

import numpy as np

GRIPPER_CLOSED = 255.0
# After a push the hand retracts straight back, with the gripper as it is (the published source's).
RETREAT_M, RETREAT_S = 0.07, 1.0

# End-effector point and pointing direction in the hand's frame (joints at zero): ee_point_1 and
# ee_point_2 of the footprint file. Metres.
EE_POINT = np.array([0.18209, -0.00884])
EE_POINT_AHEAD = np.array([0.20206, -0.00981])
POINTING_YAW = float(np.arctan2(*(EE_POINT_AHEAD - EE_POINT)[::-1]))  # -0.0485 rad, -2.78 deg


@dataclasses.dataclass(frozen=True)
class Link:
    """A moving link of the hand, which turns about a joint as the gripper closes.

    Attributes:
      joint: (x, y) of the joint in the open hand, metres.
      angle: the link's turn when the gripper is closed (255), rad.
      parent: the link that carries the joint; None is the palm.
    """

    joint: tuple[float, float]
    angle: float
    parent: str | None = None


LINKS = {
    "right_driver": Link((0.1385, 0.0239), -0.8225),
    "right_coupler": Link((0.1401, 0.0555), -0.6356, "right_driver"),
    "right_follower": Link((0.1878, 0.0590), 0.0066, "right_coupler"),
    "right_spring": Link((0.1441, 0.0050), -0.7214),
    "left_driver": Link((0.1356, -0.0372), 0.8227),
    "left_coupler": Link((0.1342, -0.0686), 0.6353, "left_driver"),
    "left_follower": Link((0.1812, -0.0770), -0.0058, "left_coupler"),
    "left_spring": Link((0.1429, -0.0189), 0.7211),
}

# The fingertips' fronts reach 6 mm further into the gap than the footprint. Where a cylinder
# overlaps a fingertip's edge, the authors' world uses the normal of the tip's front face, and so
# pushes the cylinder out of the gap; a disk on the plane would roll off the edge into the hand. Of
# 0 to 8 mm tried, 6 mm halves the number of rollouts that reach the goal here and not there, and an
# object of 60 mm still fits into the gap.
# (link or "palm", x1, y1, x2, y2, radius) in the open hand, metres.
CAPSULES: tuple[tuple[str, float, float, float, float, float], ...] = (
    ("palm", -0.0005, -0.0047, -0.0005, 0.0037, 0.0521),  # base
    ("palm", -0.0240, 0.0012, 0.0947, -0.0045, 0.0379),  # wrist and coupler
    ("palm", 0.1177, -0.0055, 0.1311, -0.0063, 0.0417),
    ("palm", 0.1495, -0.0209, 0.1465, -0.0035, 0.0138),
    ("right_driver", 0.1390, 0.0269, 0.1420, 0.0535, 0.0098),
    ("right_coupler", 0.1401, 0.0554, 0.1872, 0.0592, 0.0060),
    ("right_follower", 0.1930, 0.0335, 0.2300, 0.0312, 0.0032),  # the pad's inner face
    ("right_follower", 0.1850, 0.0534, 0.2179, 0.0362, 0.0080),  # its back
    ("right_follower", 0.2313, 0.0242, 0.2313, 0.0350, 0.0020),  # its front, see above
    ("right_spring", 0.1443, 0.0056, 0.1888, 0.0409, 0.0060),
    ("left_driver", 0.1361, -0.0669, 0.1356, -0.0405, 0.0099),
    ("left_coupler", 0.1342, -0.0687, 0.1807, -0.0771, 0.0060),
    ("left_follower", 0.1890, -0.0525, 0.2262, -0.0540, 0.0032),
    ("left_follower", 0.1789, -0.0711, 0.2138, -0.0571, 0.0079),
    ("left_follower", 0.2275, -0.0427, 0.2275, -0.0565, 0.0020),
    ("left_spring", 0.1429, -0.0185, 0.1841, -0.0580, 0.0060),
)
# Capsule -> y at which the front of its tip begins as measured, m.
MEASURED_FRONTS = {8: 0.0302, 14: -0.0487}
RADII = np.array([c[5] for c in CAPSULES])  # [C] metres
N_CAPSULES = len(CAPSULES)

# Bodies of the model: the palm, and one body for each finger, which turns with the palm but has a
# surface velocity of its own (see `CREEP`).
BODIES = ("palm", "right", "left")
CAPSULE_BODY = np.array([BODIES.index(c[0].split("_")[0]) for c in CAPSULES])  # [C] into BODIES

# In the authors' world the fingers' poses are set and their velocities zeroed before every substep,
# while their links press on each other and on their joint limits. Within a substep they therefore
# accelerate, and a contact feels that as a surface velocity: acceleration over the contact's
# damping (b = 2 / (dmax timeconst) = 1000 / s there). It drags an object that touches an open
# finger's tip outwards at up to 0.1 m/s, as fast as the hand moves. The table holds the follower
# link's twist as measured there with the hand alone: gripper, then (vx, vy, wz) at the hand's
# origin of the right and of the left finger.
CREEP = np.array(
    [
        [0, 0.0736, -0.1937, 1.1814, 0.0936, 0.1904, -1.2110],
        [2, 0.0035, -0.0069, 0.0414, 0.0050, 0.0097, -0.0635],
        [20, 0.0004, -0.0084, 0.0950, 0.0018, 0.0107, -0.1114],
        [40, -0.0073, 0.0170, -0.0379, -0.0084, -0.0143, 0.0241],
        [85, -0.0179, 0.0542, -0.1757, -0.0230, -0.0523, 0.1754],
        [128, -0.0281, 0.1153, -0.4756, -0.0394, -0.1132, 0.4825],
        [170, -0.0301, 0.1559, -0.6192, -0.0461, -0.1559, 0.6425],
        [212, -0.0284, 0.2017, -0.7944, -0.0497, -0.2040, 0.8340],
        [255, -0.0225, 0.2535, -1.0099, -0.0499, -0.2584, 1.0642],
    ]
)


def creep(gripper: Any, xp: ModuleType = np) -> Any:
    """Surface velocity of the fingers: [6] twist (m/s, m/s, rad/s) of right, then left finger.

    Both are in the hand's frame and interpolated from the table `CREEP`.
    """
    knots, values = xp.asarray(CREEP[:, 0]), xp.asarray(CREEP[:, 1:])
    return xp.stack([xp.interp(gripper, knots, values[:, i]) for i in range(values.shape[1])])


def capsule_segments(gripper: Any, xp: ModuleType = np) -> Any:
    """Axes of the capsules in the hand's frame.

    Args:
      gripper: scalar, 0 (open) .. 255 (closed).
      xp: the array module to compute with, `numpy` or `jax.numpy`.

    Returns:
      [C, 2, 2] endpoints (x, y) in metres.
    """
    closed = gripper / GRIPPER_CLOSED
    moved = {"palm": (xp.eye(2), xp.zeros(2))}
    for name, link in LINKS.items():
        angle, joint = link.angle * closed, xp.asarray(link.joint)
        c, s = xp.cos(angle), xp.sin(angle)
        turn = xp.stack([xp.stack([c, -s]), xp.stack([s, c])])
        carried_turn, carried_shift = moved[link.parent or "palm"]
        joint_now = carried_turn @ joint + carried_shift
        moved[name] = (turn, joint_now - turn @ joint)
    segments = []
    for name, x1, y1, x2, y2, _ in CAPSULES:
        turn, shift = moved[name]
        ends = xp.asarray([[x1, y1], [x2, y2]])
        segments.append(ends @ turn.T + shift[None])
    return xp.stack(segments)


def capsule_poses(gripper: Any, xp: ModuleType = np) -> tuple[Any, Any]:
    """Poses of the capsules in the hand's frame: [C, 3] positions, [C, 4] quaternions (wxyz)."""
    ends = capsule_segments(gripper, xp)
    middle, along = ends.mean(1), ends[:, 1] - ends[:, 0]
    along = along / xp.sqrt((along**2).sum(-1, keepdims=True))
    zero = xp.zeros_like(middle[:, :1])
    half = np.float32(np.sqrt(0.5))  # a quarter turn about an axis in the plane lays z along it
    quat = xp.concatenate([zero + half, -half * along[:, 1:], half * along[:, :1], zero], axis=1)
    return xp.concatenate([middle, zero], axis=1), quat
