"""Dynamic batching: planner requests of many robots, computed in calls of fixed shape.

Robots, operators and forks are coroutines that yield requests (`requests.py`, read it first).
`scheduler.py` collects the requests of all coroutines of a process; `planner_service.py` computes
them, L lanes in a call, so that no result depends on who shares the call. `places.py` has the
coroutines of searches that stand in a world: iterations with their checks, pushes executed.

Imports `planning`, `physics` and what is below them; knows nothing of fleets.
"""
