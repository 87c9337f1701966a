"""Robots whose solutions are checked in the solid world: what they call solved is grasped there."""

import functools

import numpy as np
import pytest

from pgf_jax.batching.places import Place
from pgf_jax.batching.planner_service import PlannerService, make_planner_service
from pgf_jax.fleet import Fleet, FleetConfig
from pgf_jax.fleet.events import EventKind
from pgf_jax.fleet.policies import after
from pgf_jax.physics.config import Physics
from pgf_jax.physics.worlds.config import WorldError
from pgf_jax.physics.worlds.world import Command
from pgf_jax.planning.config import Planner
from pgf_jax.planning.types import Push, Status
from pgf_jax.scene import sample_scene
from pgf_jax.simulation.loop import PlannedFleet, run_fleets
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.search_cache import SearchCache
from pgf_jax.simulation.task_worlds import WorldSpec
from pgf_jax.tables.results import events_frame

SOLID = WorldSpec("solid")


@functools.cache
def service() -> PlannerService:
    return make_planner_service("planar", Physics(), Planner(), 8)


def scene(robot: int, task: int):
    return sample_scene(np.array([5, robot, task], np.uint32), "tight")


class Aside:
    """An operator that pushes what stands nearest to the hand to the left, once."""

    name = "aside"

    def decide(self, view):
        distance = np.linalg.norm(view.objects - view.hand[:2], axis=1)
        distance[view.goal] = np.inf
        i = int(np.argmin(distance))
        x, y = view.objects[i]
        return Push(i, float(x), float(min(y + 0.08, 0.37))) if view.request == 0 else None


def planned(config: FleetConfig, world: WorldSpec | None = SOLID) -> PlannedFleet:
    cache = SearchCache(
        service(),
        scenes=scene,
        operator=Aside(),
        seed=config.seed,
        worlds=None if world is None else world.worlds,
    )
    robots = PlannedRobots(
        cache,
        robots=config.robots,
        tasks=config.tasks,
        misses=world is not None and world.error is not None,
    )
    return PlannedFleet(Fleet(config, robots), robots)


def run(*fleets: PlannedFleet, threads: int = 1) -> list[PlannedFleet]:
    list(run_fleets(fleets, service(), threads=threads))
    return [*fleets]


def eight() -> PlannedFleet:
    return planned(FleetConfig(robots=8, tasks=1, policy=after(2), task_limit_s=120.0))


@functools.cache
def checked() -> PlannedFleet:
    return run(eight())[0]


def test_what_is_solved_grasps_when_executed_from_the_start():
    """The pushes, the retreats and the reach, one after another from the scene as it was."""
    fleet, robots, _ = checked()
    solved = {r.robot for r in fleet.records if r.status is Status.SOLVED}
    pushed = 0
    for index in solved:
        robot = robots.robots[index]
        worlds = SOLID.worlds(robot.scene)
        place = Place(worlds.acting, worlds.start())
        for segment in (*robot.executed, robots.segment(robot.reach)):
            command = Command(
                place.state,
                np.asarray(segment.controls, float),
                np.asarray(segment.gripper, float),
                segment.duration_s,
                goal=robot.scene.goal,
                keep=True,
            )
            executed = place.world.execute(command)
            assert executed.state is not None
            place = place._replace(state=executed.state)
            if segment.kind == "push":
                pushed += 1
                place = place._replace(
                    state=place.world.execute(place.world.retreat(place.state)).state
                )
        assert executed.grasped, (robot.scene.name, executed.distance)
    assert len(solved) >= 5 and pushed >= 1


def test_checks_miss_and_planning_goes_on():
    fleet, robots, _ = checked()
    checks = [e for e in fleet.events if e.kind is EventKind.CHECK]
    outcomes = {e.outcome for e in checks}
    assert outcomes == {"passed", "missed"}
    for record in fleet.records:
        mine = [e for e in checks if e.robot == record.robot]
        passed = [e for e in mine if e.outcome == "passed"]
        assert len(passed) == (record.status is Status.SOLVED)
        assert record.checks == len(mine) and record.check_misses == len(mine) - len(passed)
    # What the log of a run says is feasible has passed; nothing refuted is.
    for index, robot in robots.robots.items():
        rows = robot.log.frame()
        solved = any(r.robot == index and r.status is Status.SOLVED for r in fleet.records)
        assert rows.filter(rows["kind"] == "reach")["feasible"].sum() == solved


def test_a_segment_starts_from_the_state_of_the_world():
    _, robots, _ = checked()
    found = 0
    for robot in robots.robots.values():
        if not robot.executed:
            continue
        found += 1
        assert robot.node.state is not None and robot.worlds is not None
        seen = robot.worlds.to_act(robot.node.state).seen
        for planner_has, world_has in zip(robot.search.start, seen, strict=True):
            assert np.array_equal(planner_has, world_has)
        assert np.abs(seen.objects - robot.scene.positions).max() > 0.02  # the push is in it
    assert found


def test_the_company_changes_nothing():
    """Alone, and together with a fleet of another size that shares the calls."""
    config = FleetConfig(robots=3, tasks=1, policy=after(2), task_limit_s=120.0)
    (alone,) = run(planned(config))
    both = run(planned(FleetConfig(robots=5, tasks=1, policy="autonomous")), planned(config))
    assert events_frame(alone.fleet.events).equals(events_frame(both[1].fleet.events))


def test_several_calls_at_a_time_change_nothing():
    (again,) = run(eight(), threads=2)
    assert events_frame(again.fleet.events).equals(events_frame(checked().fleet.events))


def test_without_a_world_nothing_is_checked():
    (fleet, robots, _), *_ = run(planned(FleetConfig(robots=3, tasks=1, policy=after(2)), None))
    assert not robots.verified and not robots.misses
    assert all(e.kind is not EventKind.CHECK for e in fleet.events)
    assert all(record.checks is None for record in fleet.records)


@functools.cache
def erring() -> PlannedFleet:
    spec = WorldSpec("solid", error=WorldError(), seed=3)
    return run(planned(FleetConfig(robots=8, tasks=2, policy="autonomous"), spec))[0]


def test_a_missed_grasp_is_planned_again_from_what_is_there():
    fleet, *_ = erring()
    ends = [e for e in fleet.events if e.kind is EventKind.EXECUTION_END]
    missed = [e for e in ends if e.outcome == "missed"]
    assert missed and len(missed) < len(ends)
    again = 0
    for event in missed:
        later = [e for e in fleet.events if (e.robot, e.task) == (event.robot, event.task)]
        after = later[later.index(event) + 1 :]
        assert after[0].kind is EventKind.RETREAT_END
        again += any(e.kind is EventKind.EXECUTION_END and e.outcome == "reach" for e in after)
    assert again  # some of them grasp in the end
    for record in fleet.records:
        mine = [e for e in ends if (e.robot, e.task) == (record.robot, record.task)]
        assert record.attempts == len(mine)


def test_a_world_error_is_drawn_once_a_task():
    spec = WorldSpec("solid", error=WorldError(), seed=3)
    one, again, other = (spec.worlds(scene(0, 0), *key) for key in ((0, 0), (0, 0), (0, 1)))
    masses = [worlds.acting.model.body_mass for worlds in (one, again, other)]
    assert np.array_equal(masses[0], masses[1]) and not np.array_equal(masses[0], masses[2])
    # The robot believes in the world without the error.
    assert one.believed is not None
    place = one.to_check(one.start(), one.to_act(one.start()).seen)
    assert place.world is not one.acting and np.ptp(place.world.model.body_mass[-20:]) == 0


def test_a_check_is_of_the_segment_as_planned():
    """Bit for bit what the world gives for the controls that the search has."""
    fleet, robots, _ = checked()
    index = next(r.robot for r in fleet.records if r.status is Status.SOLVED and not r.answered)
    robot = robots.robots[index]
    place = robot.acts_at(robot.node)
    command = Command(
        place.state,
        np.asarray(robot.search.controls, float),
        np.asarray(robot.search.gripper, float),
        service().engine.physics.rollout_s,
        goal=robot.scene.goal,
    )
    first, second = (place.world.execute(command) for _ in range(2))
    assert first.distance == second.distance < 0.06
    assert first.distance == pytest.approx(float(robot.search.value.distance), abs=0.05)
