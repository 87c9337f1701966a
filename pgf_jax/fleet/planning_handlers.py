"""Event handlers of what the robots of one fleet do: tasks, iterations, checks, execution."""

import dataclasses
from typing import Protocol

from pgf_jax.fleet.compute import ComputeModel
from pgf_jax.fleet.event_calendar import EventPriority, nanoseconds
from pgf_jax.fleet.events import EventKind
from pgf_jax.fleet.fleet_state import FleetState
from pgf_jax.fleet.records import State
from pgf_jax.fleet.robots import CheckResult, IterationResult, ReachResult, Work, WorkKind
from pgf_jax.fleet.task_run import TaskRun
from pgf_jax.planning.types import NoInput, Push, Status


class Requests(Protocol):
    """What these handlers need of those of asks and operators."""

    def ask_or_plan(self, run: TaskRun, bid: float | None) -> None:
        """Ask with a bid, or plan on where it is None."""
        ...

    def end(self, run: TaskRun, why: str) -> None:
        """End the request of a robot, if it has one, without an input."""
        ...

    def serve_waiting(self) -> None:
        """Let the operators who are free turn to robots that wait in line."""
        ...

    def note_event(self) -> None:
        """Something has happened, so that there may be another to serve."""
        ...


class PlanningHandlers:
    """Handlers of the events of robots that plan or execute.

    Attributes:
      requests: handlers of asks and operators; set before the first event.
      starting: robots that start an iteration at this instant.
    """

    requests: Requests

    def __init__(self, state: FleetState, compute: ComputeModel) -> None:
        config = state.config
        self.starting: set[int] = set()
        self._state = state
        self._compute = compute
        self._rollout_ns = nanoseconds(config.rollout_time_s)
        self._push_ns = nanoseconds(config.push_execution_s)
        self._reach_ns = nanoseconds(config.reach_execution_s)
        self._retreat_ns = nanoseconds(config.retreat_s)
        self._next_task = [0] * config.robots

    # --- events ---------------------------------------------------------------------------------

    def on_new_task(self, robot: int) -> None:
        """Begin the robot's next task."""
        state, now_ns = self._state, self._state.now_ns
        task = self._next_task[robot]
        self._next_task[robot] += 1
        run = state.runs[robot] = TaskRun(
            robot,
            task,
            now_ns,
            now_ns + nanoseconds(state.config.task_limit_s),
            verified=state.robots.verified,
            misses=state.robots.misses,
            plans_on=state.plans_while_asking or state.plans_while_served,
        )
        state.robots.begin(robot, task)
        state.log(EventKind.TASK_START, run)
        self.requests.ask_or_plan(run, self._state.policy.first_bid(run.progress(now_ns)))

    def on_iteration_end(self, run: TaskRun, result: IterationResult) -> None:
        """Go on with what an iteration has found."""
        run.count_iteration(result)
        self._state.log(
            EventKind.ITERATION,
            run,
            iteration=run.last_iteration,
            gain=result.gain,
            object=run.push.object if run.push else None,
            outcome="feasible" if result.feasible else "stuck" if result.stuck else None,
        )
        # Feasibility is tested before the policy is asked whether to ask for help.
        if result.feasible and run.push is not None:
            self._execute_push(run)
        elif result.feasible:
            run.check = 0
            self.plan(run)
        elif run.push is not None:
            self.plan(run)
        else:
            self._after_infeasible_reach(run, result)

    def on_check_end(self, run: TaskRun, check: CheckResult | None) -> None:
        """Go on with what a final check has found; None: it has no outcome."""
        if check is not None:
            run.count_check(check)
            outcome, gain = "passed" if check.passed else "missed", check.result.gain
            ended = run.last_iteration
            self._state.log(EventKind.CHECK, run, iteration=ended, gain=gain, outcome=outcome)
        if check is None or check.passed:
            self._execute_reach(run)
        elif check.more:
            assert run.check is not None
            run.check += 1
            self.plan(run)
        else:
            run.check = None
            self._after_infeasible_reach(run, check.result)

    def _after_infeasible_reach(self, run: TaskRun, result: IterationResult) -> None:
        now_ns = self._state.now_ns
        if run.go_on_given:  # while this was computed, from which it takes nothing
            self._go_on(run)
            result = dataclasses.replace(result, stuck=False)
        if now_ns + 2 * self._rollout_ns > run.deadline_ns:
            # Out of time. The robot does not ask: it would have no time left to use the input.
            # (On a shared computer an iteration may take even longer: see `_start_iteration`.)
            self.end_task(run, run.failure_status())
        elif run.request_state is not None:
            self.plan(run)
        else:
            self.requests.ask_or_plan(run, self._state.policy.bid(result, run.progress(now_ns)))

    def on_execution_end(
        self, run: TaskRun, work: Work | None, reached: ReachResult | None
    ) -> None:
        """Go on after a push, a reach or a retreat."""
        state = self._state
        pushed = run.push.object if run.push else None
        if work is not None and work.kind is WorkKind.RETREAT:
            state.log(EventKind.RETREAT_END, run, object=pushed)
            run.push = None
            run.start_segment()
            self.plan(run)
            return
        missed = reached is not None and not reached.grasped
        if run.push is None and not missed:
            state.log(EventKind.EXECUTION_END, run, outcome="reach")
            self.end_task(run, Status.SOLVED)
            return
        outcome = "missed" if missed else "push"
        state.log(EventKind.EXECUTION_END, run, object=pushed, outcome=outcome)
        end_ns = state.now_ns + self._retreat_ns
        if missed:
            # As a push does at its start, where it requests its retreat, too.
            run.deadline_ns += self._reach_ns + self._retreat_ns
            state.schedule(run, end_ns, EventPriority.EXECUTION_END, WorkKind.RETREAT)
        else:
            retreat = run.work(WorkKind.RETREAT)
            state.calendar.schedule(end_ns, EventPriority.EXECUTION_END, run.robot, retreat)

    # --- planning and execution -----------------------------------------------------------------

    def plan(self, run: TaskRun) -> None:
        """Start the next iteration, or the final check, at the end of this instant.

        It does not start at once, because A, the number of robots planning, must not depend on the
        order in which simultaneous events are handled.
        """
        run.enter(State.PLANNING, self._state.now_ns)
        self.starting.add(run.robot)

    def start_iterations(self) -> None:
        """Start the iterations of the robots in `starting`, at the end of an instant."""
        starting, self.starting = sorted(self.starting), set()
        runs = self._state.runs
        planning = sum(run.state is State.PLANNING for run in runs.values())  # A
        for robot in starting:
            self._start_iteration(runs[robot], planning)

    def break_off(self, run: TaskRun) -> None:
        """Stop the robot's iteration or check; what comes next uses the iteration's number."""
        self.starting.discard(run.robot)
        scheduled = self._state.calendar.cancel(run.robot)
        if scheduled is not None:
            self._state.discard_work(scheduled.work)
            run.broken_off += 1
            run.lost_ns += self._state.now_ns - run.started_ns

    def take_input(self, run: TaskRun, given: Push | NoInput | None) -> None:
        """Plan with the input that an operator has given."""
        state = self._state
        plans = run.state is State.PLANNING
        if isinstance(given, Push):
            if plans:
                self.break_off(run)
            run.check = None
            state.robots.start_push(run.robot, given)
            run.push = given
            run.push_deadline_ns = state.now_ns + nanoseconds(state.config.push_limit_s)
            run.pushes_planned += 1
            run.reach_nominal_done = run.nominal_done
            run.start_segment()
        elif plans:
            run.go_on_given = True
            return
        elif run.check is not None:  # the check that was broken off comes first
            run.go_on_given = True
        elif run.nominal_done:
            self._go_on(run)
        self.plan(run)

    def _go_on(self, run: TaskRun) -> None:
        self._state.robots.go_on(run.robot)
        run.stuck = run.go_on_given = False
        run.since_restart = 0

    def _start_iteration(self, run: TaskRun, planning: int) -> None:
        slowdown = self._compute.slowdown(run.robot, run.task, run.work_iterations, planning)
        state = self._state
        run.started_ns = state.now_ns

        def end_after(rollouts: int) -> int:
            # At least 1 ns, so that time advances with any compute model.
            return state.now_ns + max(1, round(rollouts * self._rollout_ns * slowdown))

        if run.check is not None:
            # A final check rolls one candidate out once more, on the same computer as the
            # iterations, so it is slowed too. No limit stops the first one.
            end_ns = end_after(1)
            if run.check > 0 and end_ns > run.deadline_ns:
                self.end_task(run, run.failure_status())
                return
            kind = WorkKind.CHECK if run.verified else None  # None: it has no outcome
            state.schedule(run, end_ns, EventPriority.ITERATION_END, kind)
            return
        # Iteration 0 is the nominal's rollout; a later one is K in parallel, then the winner's own.
        end_ns = end_after(2 if run.nominal_done else 1)
        if run.push is not None and end_ns > min(run.push_deadline_ns, run.deadline_ns):
            state.log(EventKind.PUSH_DROPPED, run, object=run.push.object)
            keep = state.plans_while_served
            state.robots.drop_push(run.robot, keep=keep)
            run.push = None
            run.start_segment(nominal_done=keep and run.reach_nominal_done)
            end_ns = end_after(2 if run.nominal_done else 1)
            self.requests.note_event()  # it may be helped from now on
        if end_ns > run.deadline_ns:
            self.end_task(run, run.failure_status())
            return
        state.schedule(run, end_ns, EventPriority.ITERATION_END, WorkKind.ITERATION)

    def _execute_push(self, run: TaskRun) -> None:
        now_ns = self._state.now_ns
        run.successful_grants_at.append(run.grants_at[-1])
        run.enter(State.EXECUTING, now_ns)
        end_ns = now_ns + self._push_ns
        # The limit is on planning, waiting and interaction, so execution extends the deadline.
        run.deadline_ns += self._push_ns + self._retreat_ns
        # Requested now though needed only when reaching restarts, so that it can share a batch.
        self._state.request_work(run.work(WorkKind.RETREAT), end_ns + self._retreat_ns)
        self._state.calendar.schedule(end_ns, EventPriority.EXECUTION_END, run.robot)

    def _execute_reach(self, run: TaskRun) -> None:
        self.requests.end(run, "solved_meanwhile")
        self.requests.serve_waiting()
        run.check = None
        run.attempts += 1
        run.enter(State.EXECUTING, self._state.now_ns)
        end_ns = self._state.now_ns + self._reach_ns
        kind = WorkKind.REACH if run.misses else None  # None: it cannot miss
        self._state.schedule(run, end_ns, EventPriority.EXECUTION_END, kind)

    def end_task(self, run: TaskRun, status: Status) -> None:
        """End a task, and begin the robot's next one."""
        state = self._state
        asked = run.request_state is not None
        self.requests.end(run, "limit")
        state.records.append(run.finish(status, state.now_ns))
        state.log(EventKind.TASK_END, run, outcome=status)
        more = self._next_task[run.robot] < state.config.tasks
        # A task that starts at the horizon would be cut off at once.
        if more and state.now_ns < state.calendar.horizon_ns:
            state.calendar.schedule(state.now_ns, EventPriority.NEW_TASK, run.robot)
        if asked:
            self.requests.serve_waiting()
            self.requests.note_event()
