"""The fleet: simulated clock, allocation policies, simulator (core 2) and metrics.

Start with `simulator.py`: events come in time order, robots' work goes out as requests, results
come back. `course.py` says what happens at each event; `allocator.py` is Alg. 2; `policies.py` says
who asks and when; `stub.py` runs a whole fleet without any physics. Nothing here knows of JAX or
MuJoCo.
"""

from pgf_jax.fleet.config import FleetConfig
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.fleet.robots import IterationResult, Robots, Work, WorkKind
from pgf_jax.fleet.simulator import Fleet

__all__ = [
    "Event",
    "EventKind",
    "Fleet",
    "FleetConfig",
    "IterationResult",
    "Robots",
    "TaskRecord",
    "Work",
    "WorkKind",
]
