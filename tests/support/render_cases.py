"""Made-up robots and fleets to draw."""

import math
from typing import Any

import numpy as np

from pgf_jax.fleet.records import State
from pgf_jax.planning.types import Push, Status
from pgf_jax.simulation.snapshot import FleetSnapshot, RobotSnapshot

OBJECTS = np.array([[0.45, 0.20], [0.40, -0.25], [0.50, -0.05], [0.30, 0.15]])
GOAL = 1
PATH = np.linspace([0.0, 0.0, 0.0], [0.2, -0.2, -0.4], 8)


def robot(index: int = 0, **changes: Any) -> RobotSnapshot:
    """A robot that plans, with its hand at the start of a task."""
    fields: dict[str, Any] = {
        "robot": index,
        "task": 0,
        "scene": "made_up",
        "state": State.PLANNING,
        "objects": OBJECTS,
        "goal": GOAL,
        "hand": np.zeros(3),
        "gripper": 0.0,
        "path": np.empty((0, 3)),
        "push": None,
        "costs": (900.0, 300.0, 40.0),
        "inputs_at": (2,),
        "stuck": False,
        "gain": 12.0,
        "bid": None,
        "waited_s": 1.5,
        "done": (),
    }
    return RobotSnapshot(**{**fields, **changes})


def fleet(count: int, serving: int | None = None, *, time_s: float = 0.0, task: int = 0):
    """A fleet with robots in all states, and with unusual values."""
    cases: list[dict[str, Any]] = [
        {"state": State.PLANNING, "path": PATH},
        {"state": State.PLANNING, "push": Push(0, 0.5, 0.3), "costs": (math.inf, 70.0)},
        {"state": State.EXECUTING, "push": Push(0, 0.5, 0.3), "hand": np.array([0.1, 0.0, 0.3])},
        {"state": State.EXECUTING, "gripper": 255.0},
        {"state": State.IN_WINDOW, "bid": 31.0, "stuck": True},
        {"state": State.IN_LINE, "bid": math.inf},
        {"state": State.IN_LINE, "costs": (), "inputs_at": (0,), "gain": math.nan},
        {"state": State.IDLE, "done": (Status.SOLVED, Status.TIMED_OUT)},
    ]
    robots = []
    for i in range(count):
        changes = {"state": State.SERVED} if i == serving else cases[i % len(cases)]
        robots.append(robot(i, task=task, **changes))
    return FleetSnapshot(
        time_ns=round(time_s * 1e9),
        policy="pgf",
        tasks=2,
        robots=tuple(robots),
        serving=serving,
        window_open=serving is None,
        attended=True,
    )


def count(picture: np.ndarray, color: str, box: tuple[int, int, int, int] | None = None) -> int:
    """Number of pixels of exactly a colour (`#rrggbb`), in a box or in the whole picture."""
    if box is not None:
        picture = picture[box[1] : box[3], box[0] : box[2]]
    return int((picture == rgb(color)).all(-1).sum())


def rgb(color: str) -> np.ndarray:
    """The colour `#rrggbb` as [3] uint8."""
    return np.frombuffer(bytes.fromhex(color[1:]), np.uint8)
