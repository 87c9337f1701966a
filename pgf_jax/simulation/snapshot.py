"""What a person sees of a fleet at one instant; the console shows it, and `render` draws it."""

import dataclasses
import math

import numpy as np

from pgf_jax.fleet.records import State
from pgf_jax.physics import hand
from pgf_jax.planning.types import Push, Status
from pgf_jax.scene.shelf import OnShelf, Shelf

STUCK = "stuck"  # in place of the bid of a stuck robot, which is inf
_ACTIVITIES = {
    State.IDLE: "done",
    State.PLANNING: "planning",
    State.IN_WINDOW: "bids",
    State.IN_LINE: "waiting",
    State.SERVED: "served",
    State.EXECUTING: "executing",
}
_PUSH_ACTIVITIES = {State.PLANNING: "planning push", State.EXECUTING: "pushing"}


def short_number(value: float) -> str:
    """A finite number in few characters: with fewer decimals, the larger it is."""
    return f"{value:.{0 if abs(value) >= 10 else 1 if abs(value) >= 1 else 2}f}"


def end_effector(poses: np.ndarray) -> np.ndarray:
    """[T, 2] positions of the end-effector point (m) of hand poses [T, 3] (m, m, rad)."""
    x, y, yaw = np.asarray(poses, float).reshape(-1, 3).T
    c, s = np.cos(yaw), np.sin(yaw)
    ahead, aside = hand.EE_POINT
    return np.stack([x + c * ahead - s * aside, y + s * ahead + c * aside], -1)


@dataclasses.dataclass(frozen=True, eq=False)
class RobotSnapshot(OnShelf):
    """What a person sees of one robot and its shelf.

    Attributes:
      robot, task: 0-based.
      scene: name of the task's scene.
      state: of the fleet's simulation; `IDLE` once its tasks are done.
      objects: [N, 2] centres of the objects, m; on their way while something is executed.
      goal: index of the goal.
      hand: [3] hand pose: base x, y (m), yaw (rad).
      gripper: 0 open .. 255 closed.
      path: [T, 3] hand poses of the best trajectory so far; empty before the first iteration and
        while served or executing nothing.
      push: the push that is planned or executed, None while reaching.
      costs: total cost of the best reach trajectory after each reach iteration of the task so far,
        iteration 0s included; what is not finite is inf.
      inputs_at: for each input answered, how many entries `costs` had then.
      stuck: the stuck counter says so.
      gain: the last number that it could bid, nan where there is none.
      bid: what it bids while it waits or is served, else None; inf when stuck.
      waited_s: simulated time since its state began, s.
      done: statuses of its tasks that have ended.
      ends: [N, 2] where the objects would end up on `path`, m; empty where that is.
      origins: [N, 2] where the objects stood at first, m; empty where it is not shown.
      bids_at: for each ask, how many entries `costs` had then.
      grants_at: for each grant, likewise.
      leaning: [N, 4] height of each object's centre, m, and direction of its axis; empty where all
        stand.
      news: what has just happened between the robot and the operator, in words; empty if nothing.
      shelf: sizes of the objects, and walls; None: they are standard.
      plans_on: it plans while it waits or is served, as `state` says.
    """

    robot: int
    task: int
    scene: str
    state: State
    objects: np.ndarray
    goal: int
    hand: np.ndarray
    gripper: float
    path: np.ndarray
    push: Push | None
    costs: tuple[float, ...]
    inputs_at: tuple[int, ...]
    stuck: bool
    gain: float
    bid: float | None
    waited_s: float
    done: tuple[Status, ...]
    ends: np.ndarray = dataclasses.field(default_factory=lambda: np.empty((0, 2)))
    origins: np.ndarray = dataclasses.field(default_factory=lambda: np.empty((0, 2)))
    bids_at: tuple[int, ...] = ()
    grants_at: tuple[int, ...] = ()
    leaning: np.ndarray = dataclasses.field(default_factory=lambda: np.empty((0, 4)))
    news: str = ""
    shelf: Shelf | None = None
    plans_on: bool = False

    @property
    def activity(self) -> str:
        """The state in one or two words."""
        name = _ACTIVITIES[self.state]
        if self.plans_on:
            return f"{name}, plans on"
        return name if self.push is None else _PUSH_ACTIVITIES.get(self.state, name)

    @property
    def is_waiting(self) -> bool:
        """Whether the robot waits for an operator, in a window or in the queue."""
        return self.state in (State.IN_WINDOW, State.IN_LINE)

    @property
    def bid_text(self) -> str:
        """The bid as text; empty where there is none."""
        if self.bid is None or math.isnan(self.bid):
            return ""
        return STUCK if math.isinf(self.bid) else short_number(self.bid)

    @property
    def solved(self) -> int:
        """Number of the robot's tasks that ended solved."""
        return sum(status is Status.SOLVED for status in self.done)

    def hand_axes(self) -> np.ndarray:
        """The axes of the hand's capsules on the plane: [C, 2, 2] end points (x, y), m."""
        x, y, yaw = (float(value) for value in self.hand)
        c, s = math.cos(yaw), math.sin(yaw)
        return hand.capsule_segments(float(self.gripper)) @ np.array([[c, s], [-s, c]]) + [x, y]

    def end_effector_path(self) -> np.ndarray:
        """[T, 2] positions of the end-effector point on `path`, m."""
        return end_effector(self.path)


@dataclasses.dataclass(frozen=True, eq=False)
class FleetSnapshot:
    """What a person sees of all robots at one instant.

    Attributes:
      time_ns: simulated time, ns.
      policy: its name.
      tasks: of each robot.
      robots: [R], by index.
      serving: the robot that the (first) operator serves, None: none.
      window_open: bids are being collected.
      attended: an operator is there.
      ended_ns: simulated time at which the fleet was done, ns; None: it is not.
    """

    time_ns: int
    policy: str
    tasks: int
    robots: tuple[RobotSnapshot, ...]
    serving: int | None
    window_open: bool
    attended: bool
    ended_ns: int | None = None

    @property
    def progress(self) -> str:
        """How many tasks have ended, and how many of them solved."""
        ended = sum(len(robot.done) for robot in self.robots)
        solved = sum(robot.solved for robot in self.robots)
        return f"{ended} of {len(self.robots) * self.tasks} tasks done, {solved} solved"
