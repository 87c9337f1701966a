"""What a world in three dimensions is: it starts from a scene, and executes segments one by one.

A world differs from an engine in three ways. It keeps its whole state from one segment to the next,
with the solver's warm start and the bodies' sleep. It is exact rather than fast: MuJoCo's C engine
in float64. And it judges: how far from the goal a hand ended, what tipped, what it touched.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import abc
import concurrent.futures
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from pgf_jax import cores
from pgf_jax.physics.engine import Rollout, World, contact_slots
from pgf_jax.physics.hand import EE_POINT, POINTING_YAW, RETREAT_M, RETREAT_S
from pgf_jax.scene.scene import Scene
from pgf_jax.scene.shelf import RADIUS

GRASP_M = 0.06  # a reach that ends nearer to a standard goal has grasped it, see `_distance`
_M_PER_RAD = 0.09  # of the goal's bearing from where the hand points
# Warnings of a state with a number that is not finite, or larger than 1e10.
_DIVERGED = tuple(
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
)
_STANDS_ON = 0.7  # a contact whose normal is that steep is with what an object stands on


class State(NamedTuple):
    """The whole state of a world; opaque, and never changed: a world executes on a copy."""

    data: Any  # MjData
    gripper: float  # 0 open .. 255 closed


class Executed(NamedTuple):
    """What happened when a segment was executed.

    Attributes:
      rollout: seen from above: [T, N, 2] centres at the knots' ends and so on, float64; contacts of
        each pair of bodies as one, with the magnitude of the pair's whole force.
      state: at the end; None where it was not asked for.
      distance: of the goal from the end-effector point at the end, with its bearing counted in, m;
        nan where the segment has no goal, or the simulation diverged.
      upright: the smallest cosine between an object's axis and the vertical at the knots' ends: 1
        while all stand; nan where the simulation diverged.
      touched: whether the robot touched the shelf at a knot's end.
      within: the distance under which the goal is grasped, m.
    """

    rollout: Rollout
    state: State | None
    distance: float
    upright: float
    touched: bool
    within: float = GRASP_M

    @property
    def grasped(self) -> bool:
        """Whether the goal is within the hand at the end."""
        return self.distance < self.within


@dataclasses.dataclass(frozen=True)
class Command:
    """A segment to execute.

    Attributes:
      state: where it starts.
      controls: [T, 3] velocities of the hand along the world's axes, m/s, m/s, rad/s.
      gripper: [T] value that each knot moves to, linearly within the knot.
      seconds: of all knots together.
      goal: index of the object that is to be grasped; None: none is.
      keep: whether the state at the end is wanted.
    """

    state: State
    controls: np.ndarray
    gripper: np.ndarray
    seconds: float
    goal: int | None = None
    keep: bool = False


class World3D(abc.ABC):
    """A world of N objects. Subclasses say how it starts, and how the robot in it is driven.

    Args:
      model: MuJoCo's; `object_1` .. `object_N` are bodies on free joints.
      n_objects: N.
      radii: [N] m; None: standard.
    """

    name: str

    def __init__(
        self, model: mujoco.MjModel, n_objects: int, radii: np.ndarray | None = None
    ) -> None:
        self.model, self.n_objects = model, n_objects
        # A larger goal is grasped from as much further away.
        self._grasp_m = GRASP_M + (np.zeros(n_objects) if radii is None else radii - RADIUS)
        bodies = [model.body(f"object_{i + 1}").id for i in range(n_objects)]
        self._objects = np.array(bodies)
        address = model.jnt_qposadr[model.body_jntadr[bodies]]
        self._qpos = address[:, None] + np.arange(7)  # [N, 7] of each object's pose
        self._qvel = model.jnt_dofadr[model.body_jntadr[bodies]][:, None] + np.arange(6)
        # 0..N-1 an object, N the robot, N+1 the shelf, as in `Rollout`.
        self._codes = np.full(model.nbody, n_objects + 1, np.int32)
        self._codes[bodies] = np.arange(n_objects)
        robot = [model.body_rootid[b] == self._robot() for b in range(model.nbody)]
        self._codes[np.array(robot)] = n_objects
        # A diverged state stays; MuJoCo would reset it to the model's initial state.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET

    @abc.abstractmethod
    def start(self, scene: Scene) -> State:
        """The state before a scene's task: objects stand, an open hand before the shelf."""

    @abc.abstractmethod
    def _robot(self) -> int:
        """The body that is the root of the robot."""

    @abc.abstractmethod
    def _drive(
        self,
        data: Any,
        velocity: np.ndarray,
        gripper: tuple[float, float],
        seconds: float,
        watch: Callable[[float], None] | None = None,
    ) -> None:
        """Simulate one knot.

        Args:
          data: MjData.
          velocity: [3] of the hand.
          gripper: its values before and after.
          seconds: of the knot.
          watch: called with the share of the knot that is done, from time to time and at the end;
            what happens does not depend on it.
        """

    @abc.abstractmethod
    def _hand(self, data: Any) -> np.ndarray:
        """[3] pose of the hand: base x, y (m) and yaw (rad)."""

    def execute(
        self, command: Command, watch: Callable[[float, State], None] | None = None
    ) -> Executed:
        """Execute a segment on a copy of the state in which it starts.

        Args:
          command: the segment.
          watch: called from time to time with the share of the segment that is done, and the state,
            which is that during the call only; the execution does not depend on it.
        """
        state, n, t = command.state, self.n_objects, len(command.controls)
        data = self._copy(state.data)
        objects, hands = np.empty((t, n, 2)), np.empty((t, 3))
        slots = contact_slots(n)
        force, bodies = np.zeros((t, slots)), np.zeros((t, slots, 2), np.int32)
        before, upright, touched = state.gripper, 1.0, False
        for k in range(t):
            now = float(command.gripper[k])

            def note(share: float, k: int = k, before: float = before, now: float = now) -> None:
                assert watch is not None
                gripper = before + (now - before) * share
                watch((k + share) / t, State(data, gripper))

            knot_s = command.seconds / t
            noted = None if watch is None else note
            self._drive(data, command.controls[k], (before, now), knot_s, noted)
            before = now
            objects[k], hands[k] = data.xpos[self._objects, :2], self._hand(data)
            upright = min(upright, float(data.xmat[self._objects, 8].min()))
            touched |= self._contacts(data, force[k], bodies[k])
        velocities = data.qvel[self._qvel[:, :2]].copy()
        rollout = Rollout(objects, hands, velocities, force, bodies)
        end = State(data, before) if command.keep else None
        distance = np.nan if command.goal is None else self._distance(data, command.goal)
        if any(data.warning[kind].number for kind in _DIVERGED):
            distance = upright = np.nan
        within = GRASP_M if command.goal is None else float(self._grasp_m[command.goal])
        return Executed(rollout, end, distance, upright, touched, within)

    def retreat(self, state: State) -> Command:
        """The segment that retracts the hand 0.07 m straight back in 1 s."""
        back = np.array([[*-RETREAT_M / RETREAT_S * self._pointing(state.data)[1], 0.0]])
        return Command(state, back, np.array([state.gripper]), RETREAT_S, keep=True)

    def seen(self, state: State) -> World:
        """The state as a planner in the plane sees it; an object that has toppled is a disk too.

        Returns:
          [N, 2] centres and velocities, [3] hand pose, [] gripper: float32, unbatched.
        """
        data = state.data
        values = (
            data.xpos[self._objects, :2],
            data.qvel[self._qvel[:, :2]],
            self._hand(data),
            state.gripper,
        )
        return World(*(np.array(value, np.float32) for value in values))

    def leaning(self, state: State) -> np.ndarray:
        """How objects stand or lie: [N, 4] height of each centre, m, and direction of its axis."""
        heights, axes = state.data.xpos[self._objects, 2:], state.data.xmat[self._objects, 2::3]
        return np.concatenate([heights, axes], axis=1)

    def _pointing(self, data: Any) -> tuple[np.ndarray, np.ndarray]:
        """[2] end-effector point, m, and [2] direction in which the hand points."""
        x, y, yaw = self._hand(data)
        c, s = np.cos(yaw), np.sin(yaw)
        ahead = np.array([np.cos(yaw + POINTING_YAW), np.sin(yaw + POINTING_YAW)])
        return np.array([x, y]) + np.array([[c, -s], [s, c]]) @ EE_POINT, ahead

    def _distance(self, data: Any, goal: int) -> float:
        """sqrt(|ee - o|^2 + (0.09 bearing)^2), as the cost has it, m."""
        point, ahead = self._pointing(data)
        to = data.xpos[self._objects[goal], :2] - point
        away = float(np.linalg.norm(to))
        bearing = float(np.arccos(np.clip(ahead @ to / away, -1.0, 1.0))) if away > 0 else 0.0
        return float(np.hypot(away, _M_PER_RAD * bearing))

    def _copy(self, data: Any) -> Any:
        copy = mujoco.MjData(self.model)
        mujoco.mj_copyData(copy, self.model, data)
        return copy

    def _contacts(self, data: Any, force: np.ndarray, bodies: np.ndarray) -> bool:
        """Fill in the strongest contacts; returns whether robot and shelf touch.

        Contacts of the same two bodies are one, with the magnitude of their sum. Contacts with what
        an object stands on are left out.
        """
        n = self.n_objects
        sums: dict[tuple[int, int], np.ndarray] = {}
        touched, wrench = False, np.zeros(6)
        for c in range(data.ncon):
            contact = data.contact[c]
            pair = self._codes[self.model.geom_bodyid[contact.geom]]
            first, second = sorted(int(code) for code in pair)
            touched |= (first, second) == (n, n + 1)
            frame = contact.frame.reshape(3, 3)
            if first >= n or (second > n and abs(frame[0, 2]) > _STANDS_ON):
                continue
            mujoco.mj_contactForce(self.model, data, c, wrench)
            # Turned so that it acts on the second body, in the world's axes.
            sign = 1.0 if int(pair[0]) == first else -1.0
            sums.setdefault((first, second), np.zeros(3))
            sums[first, second] += sign * (frame.T @ wrench[:3])
        strongest = sorted(sums.items(), key=lambda item: -float(np.linalg.norm(item[1])))
        for slot, (pair, total) in enumerate(strongest[: len(force)]):
            force[slot], bodies[slot] = np.linalg.norm(total), pair
        return touched


def execute_all(commands: Sequence[tuple[World3D, Command]]) -> list[Executed]:
    """Execute segments in their worlds, side by side on the cores of this process."""
    if len(commands) == 1 or len(cores.usable()) == 1:
        return [world.execute(command) for world, command in commands]
    return list(_threads().map(lambda pair: pair[0].execute(pair[1]), commands))


@functools.cache
def _threads() -> concurrent.futures.ThreadPoolExecutor:
    return concurrent.futures.ThreadPoolExecutor(len(cores.usable()))
