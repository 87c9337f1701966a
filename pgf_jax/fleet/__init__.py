"""The fleet: a discrete-event simulation of robots that share human operators (Alg. 2).

Read `simulator.py` first: it takes events in time order, hands out the robots' work and takes the
results back. `event_handlers.py` and its two parts hold what each event changes, `allocator.py` is
Alg. 2, `policies.py` says when a robot asks, `index.py` ranks robots that need not ask, `stub.py`
runs a fleet without physics.

May import `planning.types`, `settings`, `streams` and `errors`; nothing of JAX or MuJoCo.
"""

from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.fleet.robots import (
    CheckResult,
    IterationResult,
    ReachResult,
    Robots,
    Work,
    WorkKind,
)
from pgf_jax.fleet.simulator import Fleet

__all__ = [
    "CheckResult",
    "Event",
    "EventKind",
    "Fleet",
    "FleetConfig",
    "IterationResult",
    "ReachResult",
    "Robots",
    "TaskRecord",
    "Work",
    "WorkKind",
]
