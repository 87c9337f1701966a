"""Searches that stand in a world: their candidates are checked there, their pushes executed."""

from typing import NamedTuple

import numpy as np

from pgf_jax.batching.requests import Coroutine, Execute, KeyPath, Step
from pgf_jax.physics.engine import World
from pgf_jax.physics.worlds.world import Command, State, World3D
from pgf_jax.planning.candidates import Candidates
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search


class Place(NamedTuple):
    """Where a search stands: a world, and its whole state before the segment."""

    world: World3D
    state: State

    @property
    def seen(self) -> World:
        """The state as the planner sees it."""
        return self.world.seen(self.state)


def segment(planner: BatchPlanner, place: Place, search: Search, **options) -> Execute:
    """Request for the execution of the best trajectory of a search; for `options` see `Command`."""
    return _execute(planner, place, search.controls, search.gripper, **options)


def _execute(planner: BatchPlanner, place: Place, controls, gripper, **options) -> Execute:
    seconds = planner.engine.physics.rollout_s
    command = Command(
        place.state, np.asarray(controls, float), np.asarray(gripper, float), seconds, **options
    )
    return Execute(place.world, command)


def check(planner: BatchPlanner, place: Place, candidates: Candidates) -> Coroutine:
    """Check the next candidate; returns the `Candidates` after it."""
    before, i = candidates.before, candidates.next
    controls = candidates.rolled.controls[i]
    goal = int(before.task.goal)
    (executed,) = yield [_execute(planner, place, controls, before.gripper, goal=goal)]
    return candidates.checked(planner, executed.grasped, executed.rollout)


def iterate(
    planner: BatchPlanner, search: Search, key_path: KeyPath, place: Place | None
) -> Coroutine:
    """Do an iteration with all of its checks; returns the search after it, and how many checks.

    Without a place nothing is checked.
    """
    if place is None:
        (after,) = yield [Step(search, key_path)]
        return after, 0
    after, candidates = yield from _step(search, key_path)
    checks = 0
    if candidates is None:
        return after, checks
    while candidates.next is not None:
        candidates = yield from check(planner, place, candidates)
        checks += 1
    return candidates.search(planner), checks


def _step(search: Search, key_path: KeyPath) -> Coroutine:
    (pair,) = yield [Step(search, key_path, candidates=True)]
    return pair


def execute_and_retreat(planner: BatchPlanner, place: Place, search: Search) -> Coroutine:
    """Execute the best trajectory of a search, and retract; returns the `Place` after it."""
    (executed,) = yield [segment(planner, place, search, keep=True)]
    return (yield from retreat(place.world, executed.state))


def retreat(world: World3D, state: State) -> Coroutine:
    """Retract the hand; returns the `Place` after it."""
    (executed,) = yield [Execute(world, world.retreat(state))]
    return Place(world, executed.state)
