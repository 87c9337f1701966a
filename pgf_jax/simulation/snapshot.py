"""A fleet at an instant, as a person may see it: what the console shows and `render` draws."""

import dataclasses

import numpy as np

from pgf_jax.fleet.records import State
from pgf_jax.planning.types import Push, Status


@dataclasses.dataclass(frozen=True, eq=False)
class RobotSnapshot:
    """One robot and its shelf.

    Attributes:
      robot, task: 0-based.
      scene: name of the task's scene.
      state: what it does; `IDLE` once its tasks are done.
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


@dataclasses.dataclass(frozen=True, eq=False)
class FleetSnapshot:
    """All robots at one instant.

    Attributes:
      time_ns: simulated time, ns.
      policy: its name.
      tasks: of each robot.
      robots: [R], by index.
      serving: the robot that the (first) operator serves, None: none.
      window_open: bids are being collected.
      attended: an operator is there.
    """

    time_ns: int
    policy: str
    tasks: int
    robots: tuple[RobotSnapshot, ...]
    serving: int | None
    window_open: bool
    attended: bool
