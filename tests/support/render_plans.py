"""A short plan for the engine `native`: a push with its retreat, then a reach."""

import numpy as np

from pgf_jax.planning.types import Status
from pgf_jax.plans.file import TERMS, Plan
from pgf_jax.scene.scene import Scene
from pgf_jax.simulation.robot import Segment

PUSH = Segment("push", 3.0, np.tile([0.05, 0.0, 0.02], (8, 1)), np.linspace(20.0, 200.0, 8))
REACH = Segment("reach", 3.0, np.tile([0.06, 0.01, 0.0], (8, 1)), np.zeros(8))


def plan(**changes) -> Plan:
    """A plan with three objects; the hand hits the first, which pushes the goal behind it."""
    objects = np.array([[0.33, -0.01, 0.03], [0.40, 0.2, 0.03], [0.40, -0.01, 0.03]])
    fields = {
        "scene": Scene("short", objects, 2),
        "status": Status.TIMED_OUT,
        "seed": 0,
        "engine": "native",
        "lanes": 1,
        "physics": "authors",
        "settings": {"world": "none"},
        "cost_variant": "source",
        "update": "greedy",
        "operator": "none",
        "ask": "stuck",
        "segments": (PUSH, REACH),
        "cost": dict.fromkeys((*TERMS, "total"), 1.0),
        "history": np.array([[100.0, 20.0, 3.0], [50.0, 0.0, 0.0], [np.inf, 0.0, 0.0]]),
        "history_starts": (0, 2),
        "iterations": 1,
        "reach_iterations": 1,
        "planning_time_s": 1.0,
        "waiting_s": 0.0,
        "interaction_s": 0.0,
        "execution_s": 7.0,
        "pushes": 1,
        "requests": 1,
        "grants": 1,
        "non_finite": 0,
    }
    return Plan(**{**fields, **changes})
