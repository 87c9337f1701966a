"""Fleets that really plan: robots, search cache and the loop between events and requests.

Read `loop.py` first: it runs fleets to their ends; `planned_robots.py` turns a fleet's work into
coroutines, `search_cache.py` shares searches between fleets, `fleet_spec.py` says what a fleet is
made from, `task_worlds.py` in which worlds its tasks are checked and executed. `runner.py` runs one
fleet step by step, `observer.py` and `snapshot.py` are what a person sees of it.

Imports `training`, `tables`, `guidance`, `fleet`, `batching` and what is below them.
"""
