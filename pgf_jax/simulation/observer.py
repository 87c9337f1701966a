"""Observes a fleet: turns its events and searches into what a person may see at an instant."""

import dataclasses
import math

import numpy as np

from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.records import State
from pgf_jax.fleet.simulator import Fleet
from pgf_jax.physics import hand
from pgf_jax.physics.hand import RETREAT_M
from pgf_jax.planning import padding
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import Push, Status
from pgf_jax.simulation.planned_robots import PlannedRobots
from pgf_jax.simulation.snapshot import STUCK, FleetSnapshot, RobotSnapshot, short_number

NEWS_NS = 2_500_000_000  # how long an event stays news
FOUND = "has found its way meanwhile"
_SHOWS_ANOTHER_SEARCH = frozenset(
    {
        EventKind.TASK_START,
        EventKind.ITERATION,
        EventKind.CHECK,
        EventKind.SERVICE_END,
        EventKind.PUSH_DROPPED,
        EventKind.RETREAT_END,
    }
)


@dataclasses.dataclass
class _Seen:
    """What has been seen of a robot's task; `done` is kept from task to task."""

    search: Search
    scene: str = ""
    task: int = 0
    costs: list[float] = dataclasses.field(default_factory=list)
    inputs_at: list[int] = dataclasses.field(default_factory=list)
    push: Push | None = None
    stuck: bool = False
    gain: float = math.nan
    bid: float | None = None
    retreating_ns: int | None = None  # since when
    done: list[Status] = dataclasses.field(default_factory=list)
    bids_at: list[int] = dataclasses.field(default_factory=list)
    grants_at: list[int] = dataclasses.field(default_factory=list)
    news: str = ""
    told_ns: int = 0  # when that was news

    def tell(self, event: Event, words: str) -> None:
        """Say what has happened at an event."""
        self.news, self.told_ns = words, event.time_ns


def bid_words(bid: float) -> str:
    """A bid in words: a predicted gain in units of cost, or that the robot is stuck."""
    return f"as it is {STUCK}" if math.isinf(bid) else short_number(bid)


def input_words(event: Event) -> str:
    """The input that ended a service, in words."""
    if event.object is None or event.x is None or event.y is None:
        return "go on reaching"
    return f"push object {event.object + 1} to ({event.x:.2f}, {event.y:.2f}) m"


class FleetObserver:
    """Observes one fleet: call `update` after each `Fleet.advance`."""

    def __init__(self, fleet: Fleet, robots: PlannedRobots) -> None:
        self._fleet, self._robots = fleet, robots
        self._seen: dict[int, _Seen] = {}
        self._events = 0  # seen
        self._window_open = False

    def update(self) -> None:
        """Process the events since the last call."""
        events = self._fleet.events
        for event in events[self._events :]:
            if event.robot is not None:
                self._process(event.robot, event)
            elif event.kind is EventKind.WINDOW_CLOSE:
                self._window_open = False
            self._window_open |= event.kind is EventKind.WINDOW_OPEN
        self._events = len(events)

    def _process(self, index: int, event: Event) -> None:
        robot = self._robots.robots.get(index)
        if event.kind is EventKind.TASK_START:
            assert robot is not None
            done = self._seen[index].done if index in self._seen else []
            self._seen[index] = _Seen(robot.search, robot.scene.name, robot.task, done=done)
            return
        seen, run = self._seen[index], self._fleet.task_run(index)
        assert run is not None
        if event.kind is EventKind.TASK_END:
            seen.done.append(Status(event.outcome))
        if run.task != event.task:
            return  # the next task has begun at the same instant: nobody sees how this one ended
        if robot is not None and event.kind in _SHOWS_ANOTHER_SEARCH:
            seen.search = robot.search
        match event.kind:
            case EventKind.ITERATION:
                seen.stuck = event.outcome == "stuck"
                if event.object is None:
                    assert run.last_reach is not None
                    cost = run.last_reach.cost
                    seen.costs.append(cost if math.isfinite(cost) else math.inf)
                    seen.gain = math.nan if event.gain is None else event.gain
            case EventKind.CHECK:
                seen.stuck = event.outcome == "missed" and run.stuck
                assert run.last_reach is not None
                cost = run.last_reach.cost
                seen.costs[-1] = cost if math.isfinite(cost) else math.inf
                seen.gain = math.nan if event.gain is None else event.gain
                if event.outcome == "missed":
                    seen.tell(event, "the check has missed: plans on")
            case EventKind.BID:
                seen.bid = event.gain
                seen.bids_at.append(len(seen.costs))
                seen.tell(event, "asks" if event.gain is None else f"bids {bid_words(event.gain)}")
            case EventKind.GRANT:
                seen.grants_at.append(len(seen.costs))
                seen.tell(event, "granted: the operator looks at it")
            case EventKind.REFUSED | EventKind.EXPIRED:
                seen.bid = None
                why = {"busy": "the operator is busy", "lost": "another robot bid more"}
                if event.outcome == "solved_meanwhile":
                    seen.tell(event, FOUND)
                else:
                    seen.tell(event, f"not served: {why.get(event.outcome or '', 'out of time')}")
            case EventKind.SERVICE_END:
                seen.bid, seen.stuck = None, False
                if event.outcome == "solved_meanwhile":
                    seen.tell(event, FOUND)
                if event.outcome in ("push", "go_on"):
                    seen.inputs_at.append(len(seen.costs))
                    seen.tell(event, f"input: {input_words(event)}")
                if event.object is not None and event.x is not None and event.y is not None:
                    seen.push = Push(event.object, event.x, event.y)
            case EventKind.EXECUTION_END:
                seen.retreating_ns = event.time_ns
                if event.outcome == "missed":
                    seen.tell(event, "the grasp has missed: retracts")
            case EventKind.RETREAT_END | EventKind.PUSH_DROPPED:
                seen.push = seen.retreating_ns = None

    def snapshot(self, time_ns: int) -> FleetSnapshot:
        """The fleet at `time_ns`, which is not before the last event."""
        operators, config = self._fleet.operators, self._fleet.config
        return FleetSnapshot(
            time_ns=time_ns,
            policy=config.policy,
            tasks=config.tasks,
            robots=tuple(
                self._robot(index, seen, time_ns) for index, seen in sorted(self._seen.items())
            ),
            serving=operators.serving(0),
            window_open=self._window_open,
            attended=operators.is_present(0),
            ended_ns=self._fleet.now_ns if self._fleet.done else None,
        )

    def _robot(self, index: int, seen: _Seen, time_ns: int) -> RobotSnapshot:
        run = self._fleet.task_run(index)
        assert run is not None
        objects, pose, gripper = self._world(run.state, run.since_ns, seen, time_ns)
        rolled_out = int(seen.search.iteration) >= 0 and run.state is not State.EXECUTING
        best, n = seen.search.best, seen.search.objects
        since_ns = run.since_ns if run.request_state is None else run.request_since_ns
        return RobotSnapshot(
            robot=index,
            task=seen.task,
            scene=seen.scene,
            state=run.request_state or run.state,
            plans_on=run.request_state is not None and run.state is State.PLANNING,
            objects=objects[:n],
            goal=int(seen.search.task.goal),
            hand=pose,
            gripper=gripper,
            path=np.asarray(best.hand) if rolled_out else np.empty((0, 3)),
            ends=np.asarray(best.objects[-1])[:n] if rolled_out else np.empty((0, 2)),
            push=seen.push,
            costs=tuple(seen.costs),
            inputs_at=tuple(seen.inputs_at),
            stuck=seen.stuck,
            gain=seen.gain,
            bid=seen.bid,
            waited_s=max(0, time_ns - since_ns) / 1e9,
            done=tuple(seen.done),
            bids_at=tuple(seen.bids_at),
            grants_at=tuple(seen.grants_at),
            news=seen.news if time_ns - seen.told_ns <= NEWS_NS else "",
            shelf=padding.without_empty(seen.search.shelf),
        )

    def _world(
        self, state: State, since_ns: int, seen: _Seen, time_ns: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Objects [N, 2], hand [3] and gripper, on their way while something is executed."""
        search, config = seen.search, self._fleet.config
        start = search.start
        if state is not State.EXECUTING:
            return np.asarray(start.objects), np.asarray(start.hand), float(start.gripper)
        best = search.best
        if seen.retreating_ns is not None:
            end = np.array(best.hand[-1], np.float64)
            back = _share(time_ns - seen.retreating_ns, config.retreat_s) * RETREAT_M
            yaw = end[2] + hand.POINTING_YAW
            end[:2] -= back * np.array([np.cos(yaw), np.sin(yaw)])
            # The objects that it drags along are known when it has ended.
            return np.asarray(best.objects[-1]), end, float(search.gripper[-1])
        pushing = bool(search.task.pushing)
        length_s = config.push_execution_s if pushing else config.reach_execution_s
        at = _share(time_ns - since_ns, length_s)
        return (
            _along(start.objects, best.objects, at),
            _along(start.hand, best.hand, at),
            float(_along(np.asarray(start.gripper), search.gripper, at)),
        )


def _share(elapsed_ns: int, length_s: float) -> float:
    return 1.0 if length_s <= 0 else min(max(elapsed_ns / 1e9 / length_s, 0.0), 1.0)


def _along(start: np.ndarray, ends: np.ndarray, share: float) -> np.ndarray:
    """A quantity at `share` of the way from `start` through its values [T, ...] at knot ends."""
    values = np.concatenate([np.asarray(start)[None], np.asarray(ends)])
    place = share * (len(values) - 1)
    knot = min(int(place), len(values) - 2)
    return values[knot] + (place - knot) * (values[knot + 1] - values[knot])
