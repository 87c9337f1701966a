"""The state of one fleet, which its event handlers share."""

from typing import Any

from pgf_jax.fleet.config import FleetConfig, plans_meanwhile
from pgf_jax.fleet.event_calendar import Calendar, EventPriority
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.policies import make_policy
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.fleet.robots import Robots, Work, WorkKind
from pgf_jax.fleet.task_run import TaskRun
from pgf_jax.fleet.work_tracker import WorkTracker


class FleetState:
    """The clock, the running tasks and the log of one fleet; its robots, calendar and work.

    Attributes:
      events: the event log so far, in order.
      records: one for each task that has ended, in order of their ends.
      now_ns: simulated time of the last event handled, ns.
      runs: robot -> its running task; no entry before its first task.
      policy: when robots ask, and what they bid.
      plans_while_asking, plans_while_served: whether robots plan on meanwhile.
    """

    def __init__(
        self, config: FleetConfig, robots: Robots, calendar: Calendar, work: WorkTracker
    ) -> None:
        self.events: list[Event] = []
        self.records: list[TaskRecord] = []
        self.now_ns = 0
        self.runs: dict[int, TaskRun] = {}
        self.config = config
        self.policy = make_policy(config)
        self.plans_while_asking, self.plans_while_served = plans_meanwhile(config, self.policy)
        self.robots = robots
        self.calendar = calendar
        self.work = work

    def schedule(
        self, run: TaskRun, end_ns: int, priority: EventPriority, kind: WorkKind | None
    ) -> None:
        """Schedule a robot's next event, and request the work whose result it needs, if any."""
        work = None if kind is None else run.work(kind)
        if work is not None:
            self.request_work(work, end_ns)
        self.calendar.schedule(end_ns, priority, run.robot, work)

    def request_work(self, work: Work, needed_ns: int = 0, *, is_open: bool = False) -> None:
        """Request work, unless its result is needed only after the horizon."""
        if needed_ns <= self.calendar.horizon_ns:
            self.robots.request(work)
            self.work.request(work, is_open=is_open)

    def discard_work(self, work: Work | None) -> None:
        """Do without the result of work that was requested, if any."""
        if work is not None:
            self.work.discard(work)
            self.robots.discard(work)

    def log(self, kind: EventKind, run: TaskRun | None = None, **columns: Any) -> None:
        """Add an event to the log."""
        if run is not None:
            columns.update(robot=run.robot, task=run.task)
        self.events.append(Event(self.now_ns, kind, **columns))
