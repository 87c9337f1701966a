"""A session: a fleet that runs as the wall clock goes, and the person who guides it.

One thread owns fleet, desk and log; the engine's calls are made in another, and XLA lets go of the
interpreter meanwhile, so that the page is answered while robots plan. What a client does comes in
through `ask`; its reply is sent when what it led to is on the disk.
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

TICK_S = 0.02  # how long nothing is done at most
FRAME_S = 0.2  # between pictures of a fleet in which nothing is picked
LATE = Feedback("Too late: the robot had no time left.", ok=False)
HOLD_S = 0.5  # how far the computer may be behind before the clock waits for it


@dataclasses.dataclass(frozen=True, eq=False)
class Picked:
    """What the operator is at.

    Attributes:
      robot: that is served.
      object, target, problem: see `Desk`.
    """

    robot: int
    object: int | None
    target: tuple[float, float] | None
    problem: str


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """What the page shows.

    Attributes:
      fleet: the robots.
      picked: None while nobody is served by a person.
      running: the clock runs; False before its start and after the end.
      over: the session has ended.
      behind_s: wall time for which the clock has waited for the computer so far, s.
    """

    fleet: FleetSnapshot
    picked: Picked | None
    running: bool
    over: bool
    behind_s: float


class WallClock:
    """Simulated time, driven by the wall clock.

    Args:
      speed: simulated seconds a second.
      at_ns: where it stands until it is started.
    """

    def __init__(self, speed: float, at_ns: int) -> None:
        self._speed, self._at_ns = speed, at_ns
        self._since: float | None = None
        self.held_s = 0.0  # wall time that it has been turned back by

    @property
    def running(self) -> bool:
        """Whether it has been started, and not stopped."""
        return self._since is not None

    def start(self) -> None:
        """Go on from where it stands."""
        self._since = time.monotonic()

    def stop(self) -> None:
        """Stand still."""
        self._at_ns, self._since = self.now_ns(), None

    def now_ns(self) -> int:
        """Simulated time, ns."""
        if self._since is None:
            return self._at_ns
        return self._at_ns + round((time.monotonic() - self._since) * self._speed * 1e9)

    def hold(self, at_ns: int) -> None:
        """Turn it back to `at_ns`: the computer is that late."""
        self.held_s += max(0, self.now_ns() - at_ns) / 1e9 / self._speed
        self._at_ns, self._since = at_ns, time.monotonic()


class Session:
    """Runs a fleet in real time.

    Args:
      setting: what it is made of.
      on_frame: shown to with every picture, in the session's thread.
    """

    def __init__(self, spec: SessionSpec, on_frame: Callable[[Frame], None]) -> None:
        self.panel = InputPanel()
        self.play: FleetRunner = spec.play(self._open)
        spec.catch_up(self.play)
        self.record: SessionRecorder = spec.record(self.play)
        self.clock = WallClock(spec.config.speed, spec.start_ns)
        self._config, self._on_frame = spec.config, on_frame
        self._live = spec.config.operator == "live"
        self._inbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._replies: list[Callable[[], None]] = []  # sent when all is on the disk
        self._answers: dict[tuple, Callable[[bool], None]] = {}  # by service: when its end is
        self._until_ns = spec.start_ns
        self._asked_ns = spec.start_ns  # when the service under way began
        self._seen = 0  # events; catching up may have ended a service that it opened
        self._there = self.play.fleet.operators.is_there(0)
        self._frame_at = 0.0
        self._stopping = False

    # -- from other threads ---------------------------------------------------------------------

    def ask(self, act: Callable[[InputPanel], Feedback], reply: Callable[[Feedback], None]) -> None:
        """Have a client's act done at the desk; `reply` is called with what they are told."""

        def do() -> None:
            asked = self.panel.asked
            try:
                word = act(self.panel)
            except Exception:  # whatever a client sent, the fleet keeps planning
                log.exception("a client's act failed")
                word = Feedback("That did not work.", ok=False)
            if word.answered and asked is not None:
                self._answers[asked.service] = lambda in_time: reply(word if in_time else LATE)
            else:
                self._replies.append(lambda: reply(word))
            self._frame_at = 0.0  # to be seen at once

        self._inbox.put(do)

    def take(self, client: int, reply: Callable[[Feedback], None]) -> None:
        """A client wants to operate."""

        def act(panel: InputPanel) -> Feedback:
            word = panel.take(client)
            if word.ok:
                self._attend(True)
                if self._live and not self.clock.running:
                    self.clock.start()
            return word

        self.ask(act, reply)

    def leave(self, client: int) -> None:
        """A client has gone."""

        def act(panel: InputPanel) -> Feedback:
            if panel.leave(client):
                log.info("client %d, who operated, has left", client)
                self._attend(False)
            return Feedback("")

        self.ask(act, lambda word: None)

    def act(
        self, client: int, do: Callable[[InputPanel], Feedback], reply: Callable[[Feedback], None]
    ) -> None:
        """The operator did something; they are there, even if they were taken to be away."""

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

        The log can be gone on with unless the fleet is done.
        """
        fleet = self.play.fleet
        warm_up(self.play.planner_service, self._any_search(), self._config.seed)
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
                    self.play.queue.resolve(batch, future.result())
                    self._inbox.put(None)  # what follows from it follows at once
                if under_way is None:
                    under_way = self._next_call(worker)
                self._show()
            if under_way is not None:
                self.play.queue.resolve(under_way[0], under_way[1].result())
        self.clock.stop()
        self._show(over=True)

    def _any_search(self):
        return next(iter(self.play.planned.robots.values())).search

    def _take_in(self) -> None:
        """Do what clients have asked for; wait for it a little."""
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
            # An input counts from the next instant on: it is not put off to the next tick.
            self._until_ns = max(now_ns, self._until_ns + 1)
            self.play.step(self._until_ns)
            waits_for_ns = self.play.fleet.waits_for_ns
            late_ns = round(HOLD_S * 1e9 * self._config.speed)
            if waits_for_ns is not None and now_ns > waits_for_ns + late_ns:
                self.clock.hold(waits_for_ns + late_ns)
            self._give_up_waiting(now_ns)
        self._end_services()
        self.record.write()
        replies, self._replies = self._replies, []
        for reply in replies:
            _safely(reply)

    def _give_up_waiting(self, now_ns: int) -> None:
        if self.panel.asked is None:
            return
        if now_ns - self._asked_ns >= self._config.patience * 1e9:
            log.info("robot %d goes on alone: no answer", self.panel.asked.robot)
            self.panel.answer(UNANSWERED)
            self._attend(False)  # nor would others get one

    def _end_services(self) -> None:
        """Acknowledge answers; close the desk where a robot had no time left for one."""
        events = self.play.fleet.events
        for event in events[self._seen :]:
            if event.kind is not EventKind.SERVICE_END:
                continue
            service = (event.robot, event.task, event.request)
            if service in self._answers:
                in_time = event.outcome in ("push", "go_on")
                self._replies.append(functools.partial(self._answers.pop(service), in_time))
            elif self.panel.asked is not None and self.panel.asked.service == service:
                log.info("robot %d has no time left for an answer", event.robot)
                self.panel.close()
        self._seen = len(events)

    def _next_call(self, worker: ThreadPoolExecutor) -> tuple[list, Future] | None:
        # What costs little first: a robot may wait for its gain.
        batch = self.play.queue.take_others() or self.play.queue.take_steps()
        if not batch:
            return None
        future = worker.submit(
            self.play.planner_service.compute, [request for *_, request in batch]
        )
        future.add_done_callback(lambda _: self._inbox.put(None))
        return batch, future

    def _open(self, asked: InputRequest) -> None:
        self.panel.open(asked)
        self._asked_ns = self.play.fleet.now_ns
        self._frame_at = 0.0

    def _attend(self, present: bool) -> None:
        if self._live and self._there != present:
            self._there = present
            self.play.fleet.attend(0, present)

    def _show(self, *, over: bool = False) -> None:
        now = time.monotonic()
        if now < self._frame_at and not over:
            return
        self._frame_at = now + FRAME_S
        asked, panel = self.panel.asked, self.panel
        picked = asked and Picked(asked.robot, panel.object, panel.target, panel.problem)
        time_ns = max(self.clock.now_ns(), self.play.fleet.now_ns)
        frame = Frame(
            self.play.watch.snapshot(time_ns),
            picked,
            self.clock.running,
            over,
            self.clock.held_s,
        )
        _safely(functools.partial(self._on_frame, frame))


def _safely(show: Callable[[], None]) -> None:
    """Whatever is wrong with a page, the fleet keeps planning."""
    try:
        show()
    except Exception:
        log.exception("a page could not be told")
