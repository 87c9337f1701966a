"""The rollouts of one iteration of a task, and where they were not finite."""

import dataclasses
import functools
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pgf_jax.files import write_atomically
from pgf_jax.physics.engine import Rollout, World
from pgf_jax.planning.search import Rolled, Search
from pgf_jax.planning.types import Push


class Fault(NamedTuple):
    """The first value in a rollout that is not finite; at one knot, positions come first.

    Attributes:
      knot: 0-based.
      what: position (at the knot's end), force (in its last substep) or velocity (at the very end).
      bodies: whose position or velocity it is, all of them; or the two of the first such contact.
        0..N-1 an object, N the hand, N+1 a wall.
    """

    knot: int
    what: str
    bodies: tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Reproduction:
    """An iteration of a task, with all of its rollouts.

    R rollouts (K; 1 at a segment's iteration 0; one more, the last, with the update `stomp`),
    T knots, N objects, C contact slots.

    Attributes:
      robot, task, iteration: which; the iteration counted over the task, as in the event log.
      scene: its name.
      key_path: of the iteration: seed, robot, task, iteration, purpose.
      before, after: the search.
      rolled: the rollouts.
    """

    robot: int
    task: int
    iteration: int
    scene: str
    key_path: tuple[int, int, int, int, int]
    before: Search
    after: Search
    rolled: Rolled

    @property
    def start(self) -> World:
        """The world in which each rollout starts: m, m/s, rad; the gripper's value."""
        return self.before.start

    @property
    def push(self) -> Push | None:
        """The push that is planned; None: a reach."""
        task = self.before.task
        return Push(int(task.pushed), *map(float, task.target)) if task.pushing else None

    @property
    def controls(self) -> np.ndarray:
        """[R, T, 3] m/s, m/s, rad/s along the world axes."""
        return self.rolled.controls

    @property
    def gripper(self) -> np.ndarray:
        """[T] values at knot ends, of every rollout."""
        return self.before.gripper

    @property
    def rollout(self) -> Rollout:
        """All rollouts: [R, T, N, 2] and so on."""
        return self.rolled.rollout

    @property
    def cost(self) -> np.ndarray:
        """[R] total cost; inf where it is not finite."""
        return self.rolled.value.total

    @property
    def finite(self) -> np.ndarray:
        """[R] bool, whether the cost is; a force may not be finite and the cost still be."""
        return self.rolled.value.finite

    @property
    def saturated(self) -> np.ndarray:
        """[R, T] bool, whether every contact slot was in use at the knot's end."""
        return (self.rollout.force > 0).all(-1)

    @functools.cached_property
    def faults(self) -> tuple[Fault | None, ...]:
        """The first fault of each rollout; None: all its values are finite."""
        parts = zip(*self.rollout, strict=True)
        return tuple(_fault(Rollout(*part)) for part in parts)

    @property
    def winner(self) -> int | None:
        """Index of the rollout that became the best so far; None: an earlier one still is.

        With `stomp`, the blend: of equal ones the last.
        """
        if self.before.iteration >= 0 and not self.after.value.total < self.before.value.total:
            return None
        same = (self.controls == self.after.controls).all((1, 2))
        return int(np.flatnonzero(same)[-1])

    def text(self) -> str:
        """Text for a person: which iteration, its outcome, and a line for each rollout."""
        seed, number = self.key_path[0], int(self.after.iteration)
        push = self.push
        what = "reaching" if push is None else f"pushing {_at(push)}"
        won = "still of an earlier one" if self.winner is None else f"rollout {self.winner}"
        costs = (float(search.value.total) for search in (self.before, self.after))
        total, knots = self.controls.shape[:2]
        lost, full = int((~self.finite).sum()), int(self.saturated.any(-1).sum())
        rows = [("rollout", "cost", "first not finite", "every slot in use at knots")]
        for i, fault in enumerate(self.faults):
            at = " ".join(map(str, np.flatnonzero(self.saturated[i])))
            rows.append((str(i), f"{self.cost[i]:.6g}", self._first(i, fault), at or "-"))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = (
            f"robot {self.robot}, task {self.task} of seed {seed}, scene {self.scene}: iteration "
            f"{self.iteration}, {number} of its segment, {what}",
            f"its key: {' '.join(map(str, self.key_path))}",
            f"rollouts: {total} of {knots} knots; {lost} with a cost that is not finite, "
            f"{full} with every contact slot in use",
            "best cost: before {:.6g}, after {:.6g}".format(*costs) + f" ({won})",
            *(
                f"{n:>{widths[0]}}  {cost:>{widths[1]}}  {fault:<{widths[2]}}  {at}"
                for n, cost, fault, at in rows
            ),
        )
        return "\n".join(lines)

    def save(self, path: Path | str) -> None:
        """Write everything as arrays (NumPy's .npz); the same iteration gives the same bytes.

        The names are those of the properties; `start_objects` and so on of the start, `objects` and
        so on of the rollouts; `fault_knot`, `fault_what` and `fault_body` ([R]; -1 and "" for none;
        of the bodies the first).

        Raises:
          BadInput: it cannot be written there.
        """
        task, value = self.before.task, self.rolled.value
        faults = [fault or Fault(-1, "", (-1,)) for fault in self.faults]
        arrays: dict[str, Any] = {
            "words": np.array(self.key_path, np.uint32),
            "goal": task.goal,
            "pushing": task.pushing,
            "pushed": task.pushed,
            "target": task.target,
            **{f"start_{name}": x for name, x in self.start._asdict().items()},
            "gripper": self.gripper,
            "controls": self.controls,
            **self.rollout._asdict(),
            "cost": self.cost,
            "terms": value.terms,
            "feasible": value.feasible,
            "finite": self.finite,
            "saturated": self.saturated,
            "fault_knot": np.array([fault.knot for fault in faults]),
            "fault_what": np.array([fault.what for fault in faults]),
            "fault_body": np.array([fault.bodies[0] for fault in faults]),
            "best_cost_before": self.before.value.total,
            "best_cost": self.after.value.total,
        }
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        write_atomically(path, buffer.getvalue())

    def _first(self, i: int, fault: Fault | None) -> str:
        if fault is None:
            return "-" if self.finite[i] else "the cost alone"
        n = self.rollout.objects.shape[2]
        names = [f"object {b}" if b < n else ("hand", "wall")[b - n] for b in fault.bodies]
        if fault.what == "force":
            return f"knot {fault.knot}: force of {' on '.join(names)}"
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        return f"knot {fault.knot}: {fault.what} of {names[0]}{more}"


def _fault(one: Rollout) -> Fault | None:
    """The first fault of one rollout ([T, N, 2] and so on), or None."""
    hand = ~np.isfinite(one.hand).all(-1, keepdims=True)  # [T, 1]
    lost = np.concatenate([~np.isfinite(one.objects).all(-1), hand], 1)  # [T, N + 1]
    force = ~np.isfinite(one.force)  # [T, C]
    fast = np.logical_not(np.isfinite(one.velocities).all(-1))  # [N]
    for knot in range(len(lost)):
        if lost[knot].any():
            return Fault(knot, "position", _numbers(lost[knot]))
        if force[knot].any():
            contact = one.bodies[knot, np.argmax(force[knot])]
            return Fault(knot, "force", (int(contact[0]), int(contact[1])))
    return Fault(len(lost) - 1, "velocity", _numbers(fast)) if fast.any() else None


def _numbers(mask: np.ndarray) -> tuple[int, ...]:
    return tuple(map(int, np.flatnonzero(mask)))


def _at(push: Push) -> str:
    return f"object {push.object} to ({push.x:.4g}, {push.y:.4g})"
