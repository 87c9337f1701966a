"""A session: runs a fleet by the wall clock, with a person who gives the inputs.

One thread owns the fleet, the input panel and the log. Another thread calls the engine; XLA
releases the interpreter lock meanwhile, so that the page is served while robots plan. Actions of
clients come in through `ask`; the reply is sent when the events that follow are on the disk.
"""

import dataclasses
import functools
import logging
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from pgf_jax.batching.planner_service import warm_up
from pgf_jax.console.input_panel import Feedback, InputPanel
from pgf_jax.console.live_operator import InputRequest
from pgf_jax.console.recorder import SessionRecorder
from pgf_jax.console.session_spec import SessionSpec
from pgf_jax.fleet.events import EventKind
from pgf_jax.planning.types import UNANSWERED
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.simulation.snapshot import FleetSnapshot

log = logging.getLogger(__name__)

TICK_S = 0.02  # longest wait for an action of a client
FRAME_S = 0.2  # between two frames, unless an action of a client changes the panel
LATE = Feedback("Too late: the robot had no time left.", ok=False)
HOLD_S = 0.5  # how late a computation may be before the clock waits for it


@dataclasses.dataclass(frozen=True, eq=False)
class Picked:
    """The push that the operator has picked so far.

    Attributes:
      robot, task, request: the service.
      object, target, problem: see `InputPanel`.
    """

    robot: int
    task: int
    request: int
    object: int | None
    target: tuple[float, float] | None
    problem: str


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """The state of a session that the page shows.

    Attributes:
      fleet: the robots.
      picked: None while no robot is served by a person.
      running: whether the clock runs; False before its start and after the end.
      over: whether the session has ended.
      behind_s: wall time for which the clock has waited for computations so far, s.
    """

    fleet: FleetSnapshot
    picked: Picked | None
    running: bool
    over: bool
    behind_s: float


class WallClock:
    """Simulated time that follows the wall clock.

    Args:
      speed: simulated seconds per second.
      at_ns: simulated time at the start, ns.
    """

    def __init__(self, speed: float, at_ns: int) -> None:
        self._speed, self._at_ns = speed, at_ns
        self._since: float | None = None
        self.held_s = 0.0  # wall time by which the clock was set back in all

    @property
    def running(self) -> bool:
        """Whether the clock has been started, and not stopped."""
        return self._since is not None

    def start(self) -> None:
        """Start the clock, at the time at which it stands."""
        self._since = time.monotonic()

    def stop(self) -> None:
        """Stop the clock."""
        self._at_ns, self._since = self.now_ns(), None

    def now_ns(self) -> int:
        """Simulated time, ns."""
        if self._since is None:
            return self._at_ns
        return self._at_ns + round((time.monotonic() - self._since) * self._speed * 1e9)

    def hold(self, at_ns: int) -> None:
        """Set the clock back to `at_ns`, because a computation is late."""
        self.held_s += max(0, self.now_ns() - at_ns) / 1e9 / self._speed
        self._at_ns, self._since = at_ns, time.monotonic()


class Session:
    """Runs a fleet in real time.

    Args:
      spec: of the session.
      on_frame: called with every frame, in the session's thread.
    """

    def __init__(self, spec: SessionSpec, on_frame: Callable[[Frame], None]) -> None:
        self.panel = InputPanel()
        self.runner: FleetRunner = spec.new_runner(self._open)
        spec.restore(self.runner)
        self.recorder: SessionRecorder = spec.open_recorder(self.runner)
        self.clock = WallClock(spec.config.speed, spec.start_ns)
        self._config, self._on_frame = spec.config, on_frame
        self._live = spec.config.operator == "live"
        self._inbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._replies: list[Callable[[], None]] = []  # sent when all events are on the disk
        # By service: replies that are sent when the end of the service is on the disk.
        self._answers: dict[tuple, Callable[[bool], None]] = {}
        self._until_ns = spec.start_ns
        self._asked_ns = spec.start_ns  # when the present service began
        self._seen = 0  # events; `restore` may have ended a service that it opened
        self._present = self.runner.fleet.operators.is_present(0)
        self._frame_at = 0.0
        self._shown_ns = spec.start_ns
        self._stopping = False

    # -- from other threads ---------------------------------------------------------------------

    def ask(self, act: Callable[[InputPanel], Feedback], reply: Callable[[Feedback], None]) -> None:
        """Do a client's action on the panel soon; `reply` is called with the feedback."""

        def do() -> None:
            pending = self.panel.pending
            try:
                feedback = act(self.panel)
            except Exception:  # whatever a client sent, the fleet keeps planning
                log.exception("the action of a client failed")
                feedback = Feedback("That did not work.", ok=False)
            if feedback.answered and pending is not None:
                service = pending.service
                self._answers[service] = lambda in_time: reply(feedback if in_time else LATE)
            else:
                self._replies.append(lambda: reply(feedback))
            self._frame_at = 0.0  # show it at once

        self._inbox.put(do)

    def take(self, client: int, reply: Callable[[Feedback], None]) -> None:
        """Make a client the operator, unless another one operates; the first starts the clock."""

        def act(panel: InputPanel) -> Feedback:
            feedback = panel.take(client)
            if feedback.ok:
                self._attend(True)
                if self._live and not self.clock.running:
                    self.clock.start()
            return feedback

        self.ask(act, reply)

    def leave(self, client: int) -> None:
        """Remove a client; if it operated, the operator is away."""

        def act(panel: InputPanel) -> Feedback:
            if panel.leave(client):
                log.info("client %d, who operated, has left", client)
                self._attend(False)
            return Feedback("")

        self.ask(act, lambda feedback: None)

    def pause(self, client: int) -> None:
        """Remove the client that operates, and stop the clock until somebody operates again.

        In simulated time the operator has not been away, so robots do not see it.
        """

        def act(panel: InputPanel) -> Feedback:
            if panel.leave(client) and self.clock.running:
                self.clock.stop()
            return Feedback("")

        self.ask(act, lambda feedback: None)

    def act(
        self, client: int, do: Callable[[InputPanel], Feedback], reply: Callable[[Feedback], None]
    ) -> None:
        """Do an action of a client; an operator who acts is present, even if taken to be away."""

        def act(panel: InputPanel) -> Feedback:
            if client == panel.operator:
                self._attend(True)
            return do(panel)

        self.ask(act, reply)

    def stop(self) -> None:
        """End the session soon."""
        self._stopping = True
        self._inbox.put(None)

    # -- the session's thread -------------------------------------------------------------------

    def run(self) -> None:
        """Run until all tasks are done, the horizon has passed, or `stop`.

        Unless the fleet is done, the session can be resumed from its log.
        """
        fleet = self.runner.fleet
        checked = self.runner.robots.verified
        service, seed = self.runner.planner_service, self._config.seed
        warm_up(service, self._any_search(), seed, checked=checked)
        if not self._live:
            self.clock.start()
        with ThreadPoolExecutor(1, "engine") as worker:
            under_way: tuple[list, Future] | None = None
            while not (fleet.done or self._stopping):
                self._take_in()
                self._advance()
                if under_way is not None and under_way[1].done():
                    batch, future = under_way
                    under_way = None
                    self.runner.scheduler.resolve(batch, future.result())
                    self._inbox.put(None)  # process the consequences at once
                if under_way is None:
                    under_way = self._next_call(worker)
                self._show()
            if under_way is not None:
                self.runner.scheduler.resolve(under_way[0], under_way[1].result())
        self.clock.stop()
        self._show(over=True)

    def _any_search(self):
        return next(iter(self.runner.robots.robots.values())).search

    def _take_in(self) -> None:
        """Do the actions of clients; wait a little for the first."""
        try:
            do = self._inbox.get(timeout=TICK_S)
            while True:
                if do is not None:
                    do()
                do = self._inbox.get_nowait()
        except queue.Empty:
            pass

    def _advance(self) -> None:
        now_ns = self.clock.now_ns()
        if self.clock.running:
            # An input takes effect at the next instant, not at the next tick.
            self._until_ns = max(now_ns, self._until_ns + 1)
            self.runner.step(self._until_ns)
            blocked_at_ns = self.runner.fleet.blocked_at_ns
            late_ns = round(HOLD_S * 1e9 * self._config.speed)
            if blocked_at_ns is not None and now_ns > blocked_at_ns + late_ns:
                self.clock.hold(blocked_at_ns + late_ns)
            self._give_up_waiting(now_ns)
        self._end_services()
        self.recorder.write()
        replies, self._replies = self._replies, []
        for reply in replies:
            _safely(reply)

    def _give_up_waiting(self, now_ns: int) -> None:
        if self.panel.pending is None:
            return
        if now_ns - self._asked_ns >= self._config.patience * 1e9:
            log.info("robot %d goes on alone: no answer", self.panel.pending.robot)
            self.panel.answer(UNANSWERED)
            self._attend(False)  # other robots would get no answer either

    def _end_services(self) -> None:
        """Acknowledge answers; close the panel of a robot that needs no answer any more."""
        events = self.runner.fleet.events
        for event in events[self._seen :]:
            if event.kind is not EventKind.SERVICE_END:
                continue
            service = (event.robot, event.task, event.request)
            if service in self._answers:
                in_time = event.outcome in ("push", "go_on")
                self._replies.append(functools.partial(self._answers.pop(service), in_time))
            elif self.panel.pending is not None and self.panel.pending.service == service:
                found = event.outcome == "solved_meanwhile"
                why = "has found its way" if found else "has no time left for an answer"
                log.info("robot %d %s", event.robot, why)
                self.panel.close()
        self._seen = len(events)

    def _next_call(self, worker: ThreadPoolExecutor) -> tuple[list, Future] | None:
        # Short computations first: a robot may wait for its predicted gain.
        batch = self.runner.scheduler.take_others() or self.runner.scheduler.take_steps()
        if not batch:
            return None
        future = worker.submit(
            self.runner.planner_service.compute, [request for *_, request in batch]
        )
        future.add_done_callback(lambda _: self._inbox.put(None))
        return batch, future

    def _open(self, request: InputRequest) -> None:
        self.panel.open(request)
        self._asked_ns = self.runner.fleet.now_ns
        self._frame_at = 0.0

    def _attend(self, present: bool) -> None:
        if self._live and self._present != present:
            self._present = present
            self.runner.fleet.set_attendance(0, present)

    def _show(self, *, over: bool = False) -> None:
        now = time.monotonic()
        if now < self._frame_at and not over:
            return
        self._frame_at = now + FRAME_S
        panel, request = self.panel, self.panel.pending
        picked = request and Picked(*request.service, panel.object, panel.target, panel.problem)
        # Where the clock was set back, what is shown waits for it.
        time_ns = max(self.clock.now_ns(), self.runner.fleet.now_ns, self._shown_ns)
        self._shown_ns = time_ns
        frame = Frame(
            self.runner.observer.snapshot(time_ns),
            picked,
            self.clock.running,
            over,
            self.clock.held_s,
        )
        _safely(functools.partial(self._on_frame, frame))


def _safely(show: Callable[[], None]) -> None:
    """Call a function of the page; log its errors, so that the fleet keeps planning."""
    try:
        show()
    except Exception:
        log.exception("the page failed")
