"""Event handlers of one fleet (Alg. 2).

`simulator.py` takes events from the calendar in time order, once the results that they need have
been delivered. A handler changes the robots' tasks and the operators, writes to the event log,
schedules further events and requests work. `planning_handlers.py` has those of what robots do,
`request_handlers.py` those of asks and operators.
"""

from pgf_jax.fleet.compute import ComputeModel
from pgf_jax.fleet.event_calendar import SERVICE_ENDS, EventPriority, ScheduledEvent
from pgf_jax.fleet.fleet_state import FleetState
from pgf_jax.fleet.operators import AttendanceSchedule
from pgf_jax.fleet.planning_handlers import PlanningHandlers
from pgf_jax.fleet.records import State
from pgf_jax.fleet.request_handlers import RequestHandlers
from pgf_jax.fleet.robots import CheckResult, IterationResult, ReachResult
from pgf_jax.fleet.service import ServiceTimes
from pgf_jax.planning.types import NoInput, Push, Status


class EventHandlers:
    """Hands each scheduled event of a fleet to its handler.

    Attributes:
      planning: handlers of what robots do.
      requests: handlers of what they ask, and of the operators.
    """

    def __init__(
        self,
        state: FleetState,
        *,
        service: ServiceTimes,
        compute: ComputeModel,
        attendance: AttendanceSchedule,
    ) -> None:
        """Schedule the first events; for the arguments see `Fleet`."""
        self._state = state
        self.planning = PlanningHandlers(state, compute)
        self.requests = RequestHandlers(state, self.planning, service, attendance)
        self.planning.requests = self.requests
        for robot in range(state.config.robots):
            state.calendar.schedule(0, EventPriority.NEW_TASK, robot)

    def handle(self, scheduled: ScheduledEvent) -> None:
        """Handle an event; the result that it needs, if any, must have been delivered."""
        state, planning, requests = self._state, self.planning, self.requests
        state.now_ns = scheduled.time_ns
        result = state.work.consume(scheduled.work)
        if scheduled.work is not None:
            state.robots.end(scheduled.work)
        if scheduled.priority is EventPriority.WINDOW_CLOSE:
            requests.on_window_close()
        elif scheduled.priority is EventPriority.ATTENDANCE:
            requests.on_attendance()
        elif scheduled.priority is EventPriority.NEW_TASK:
            planning.on_new_task(scheduled.robot)
        else:
            run = state.runs[scheduled.robot]
            if scheduled.priority is EventPriority.EXPIRY:
                requests.on_expiry(run)
            elif scheduled.priority in SERVICE_ENDS:
                assert result is None or isinstance(result, Push | NoInput)
                requests.on_service_end(run, result, expired=scheduled.work is None)
            elif scheduled.priority is EventPriority.EXECUTION_END:
                assert result is None or isinstance(result, ReachResult)
                planning.on_execution_end(run, scheduled.work, result)
            elif run.check is not None:
                assert result is None or isinstance(result, CheckResult)
                planning.on_check_end(run, result)
            else:
                assert isinstance(result, IterationResult)
                planning.on_iteration_end(run, result)
        requests.note_event()

    @property
    def has_pending(self) -> bool:
        """Whether something is left to be done at the end of this instant."""
        return self.requests.undecided or bool(self.planning.starting)

    def end_instant(self) -> None:
        """Decide whom to serve, or else start iterations: all events of the instant are handled."""
        if self.requests.undecided:
            self.requests.decide()
        else:
            self.planning.start_iterations()

    def censor(self, horizon_ns: int) -> None:
        """End all running tasks at the horizon, as censored."""
        self._state.now_ns = horizon_ns
        for _, run in sorted(self._state.runs.items()):
            if run.state is not State.IDLE:
                self.requests.end(run, "censored")
                self.planning.end_task(run, Status.CENSORED)
        self._state.work.clear()
