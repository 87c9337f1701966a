"""Cost, stuck counter and STOMP's update in plain NumPy, from their definitions."""

import math

import numpy as np

from pgf_jax.physics import hand
from pgf_jax.physics.engine import Rollout, contact_slots

KNOTS = 8
SLOTS = contact_slots(20)


def ee_of(pose):
    """The end effector's [x, y] at a hand pose (x, y, yaw)."""
    x, y, yaw = (float(v) for v in pose)
    ex, ey = hand.EE_POINT
    return np.array(
        [x + math.cos(yaw) * ex - math.sin(yaw) * ey, y + math.sin(yaw) * ex + math.cos(yaw) * ey]
    )


def pointing(pose):
    """The pointing direction's angle at a hand pose."""
    return float(pose[2]) + math.atan2(*(hand.EE_POINT_AHEAD - hand.EE_POINT)[::-1])


def pose_at(ee, yaw=0.0):
    """The hand pose that puts the end effector there."""
    return np.array([*(np.asarray(ee) - ee_of((0.0, 0.0, yaw))), yaw])


def distance(pose, o):
    dx, dy = np.asarray(o, float) - ee_of(pose)
    bearing = math.remainder(math.atan2(dy, dx) - pointing(pose), math.tau)
    return math.sqrt(dx * dx + dy * dy + (0.09 * bearing) ** 2)


def shelf_margin(pose, gripper):
    """How deep the hand is in the shelf's walls, m (negative: clear), by sampling its axes."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    deepest = -math.inf
    for (a, b), r in zip(hand.capsule_segments(float(gripper)), hand.RADII, strict=True):
        t = np.linspace(0, 1, 400)[:, None]
        points = (1 - t) * a + t * b
        x = pose[0] + c * points[:, 0] - s * points[:, 1]
        y = pose[1] + s * points[:, 0] + c * points[:, 1]
        deepest = max(deepest, (x + r).max() - 0.59)
        inside = x >= 0.20
        if inside.any():
            deepest = max(deepest, (np.abs(y[inside]) + r).max() - 0.40)
    return deepest


def cost(rollout, gripper, task, config):
    """The five terms (c_d or c_h, c_f, c_b, c_e, c_s), total and feasible of one rollout."""
    objects, poses = np.asarray(rollout.objects, float), np.asarray(rollout.hand, float)
    paper, n = config.variant == "paper", objects.shape[1]
    last, pose = objects[-1], poses[-1]
    d = [distance(pose, o) for o in last]
    if not (np.isfinite(objects).all() and np.isfinite(poses).all()):
        return np.full(5, math.nan), math.inf, False
    if task.pushing:
        off = float(np.hypot(*(last[task.pushed] - np.asarray(task.target))))
        first = off if off < 0.05 else config.w_h * off
        arrived = off < 0.05
    else:
        goal = d[task.goal]
        first = goal if goal < 0.06 else config.w_d * goal
        if paper:
            first = config.w_d * float(np.hypot(*(last[task.goal] - ee_of(pose))))
        arrived = goal < 0.06
    c_f = 0.0
    for knot in range(len(objects)):
        for f, bodies in zip(rollout.force[knot], rollout.bodies[knot], strict=True):
            if paper:
                c_f += 30.0 * f
                continue
            for body in bodies:
                if body < n and not math.isfinite(f):
                    c_f += 30.0
                elif body < n and f > 40.0:
                    c_f += 0.3 * f
    spared = task.pushed if task.pushing else task.goal
    c_b = sum(config.w_b + d[i] for i in range(n) if i != spared and d[i] < 0.075)
    c_e = c_s = 0.0
    if not paper:
        for knot in range(len(objects)):
            for x, y in objects[knot]:
                c_e += 300.0 * ((not 0.20 <= x <= 0.58) + (not -0.38 <= y <= 0.38))
            c_s += 300.0 * (shelf_margin(poses[knot], gripper[knot]) > 0)
    terms = np.array([first, c_f, c_b, c_e, c_s])
    total = float(terms.sum()) if np.isfinite(terms).all() else math.inf
    if not math.isfinite(total):
        return terms, total, False
    if paper:
        return terms, total, arrived and (task.pushing or c_b == 0)
    return terms, total, arrived and total <= 20.0


class Stuck:
    """The stuck counter, fed with the cost of each iteration's winner from iteration 0 on."""

    def __init__(self):
        self.n, self.best, self.last, self.iteration = 0, math.inf, 0.0, -1

    def feed(self, c):
        self.iteration += 1
        before = self.best
        self.best = min(before, c)
        if self.iteration == 0:
            return  # c_0 counts as 0: `last` stays so
        if c < before:
            self.n = 0
        same = c == self.last or abs(c - self.last) < 50
        far = c == math.inf or c - self.best > 1000
        # Two infinite costs in a row have no difference: what counts is that both are far.
        self.n = self.n + 1 if same or far else 0
        self.last = c


def stomp_update(controls, noisy, totals, h=10.0):
    """Exponentially weighted mean of the finite rollouts' controls."""
    weights = np.zeros(len(totals))
    finite = [i for i, s in enumerate(totals) if math.isfinite(s)]
    if not finite:
        return np.asarray(controls)
    low, high = min(totals[i] for i in finite), max(totals[i] for i in finite)
    for i in finite:
        weights[i] = math.exp(-h * (totals[i] - low) / ((high - low) or 1.0))
    weights /= weights.sum()
    return sum(w * np.asarray(x, float) for w, x in zip(weights, noisy, strict=True))


def still(objects, pose, knots=KNOTS, contacts=SLOTS):
    """A rollout in which nothing moves or touches."""
    objects = np.asarray(objects, np.float32)
    return Rollout(
        objects=np.repeat(objects[None], knots, 0),
        hand=np.repeat(np.asarray(pose, np.float32)[None], knots, 0),
        velocities=np.zeros_like(objects),
        force=np.zeros((knots, contacts), np.float32),
        bodies=np.zeros((knots, contacts, 2), np.int32),
    )
