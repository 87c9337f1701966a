"""A trivial engine, and a person who acts in a session, for tests without a page."""

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.input_panel import Feedback, InputPanel
from pgf_jax.console.session import Frame, Session
from pgf_jax.console.session_spec import SessionSpec
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.fleet.policies import AskWhenStuck, Discipline, register_policy
from pgf_jax.physics.engine import Rollout, contact_slots, register_engine
from pgf_jax.planning.types import Push
from pgf_jax.tables.event_log import JOURNAL

PATIENCE_S = 60.0  # longest wait of a test for what should happen; it takes far less
ME, OTHER = 1, 2


class Phantom:
    """An engine whose hand passes through objects, at a speed that depends on the scene."""

    name = "phantom"

    def __init__(self, physics, n_objects, *, lanes=1):
        self.physics, self.n_objects, self.lanes = physics, n_objects, lanes

    def rollout(self, start, controls, gripper, substeps, wanted=None, shelf=None):
        b, t = np.shape(gripper)
        luck = 9e3 * np.asarray(start.objects, np.float64).sum((1, 2)) % 1
        grip = np.maximum(0.0, 1.2 * luck - 0.2)
        wanted = np.cumsum(np.asarray(controls, np.float64), axis=1) * self.physics.knot_s
        moved = (grip[:, None, None] * wanted).astype(np.float32)
        return Rollout(
            objects=np.repeat(np.asarray(start.objects)[:, None], t, axis=1),
            hand=np.asarray(start.hand)[:, None] + moved,
            velocities=np.zeros_like(np.asarray(start.objects)),
            force=np.zeros((b, t, contact_slots(self.n_objects)), np.float32),
            bodies=np.zeros((b, t, contact_slots(self.n_objects), 2), np.int32),
        )


class Asking(AskWhenStuck):
    """A policy that asks before planning, and again when stuck."""

    def first_bid(self, progress):
        return math.inf


class FirstAsks(AskWhenStuck):
    """A policy in which robot 0 asks before planning, and the others never ask."""

    def first_bid(self, progress):
        return math.inf if progress.robot == 0 else None

    def bid(self, result, progress):
        return None


register_engine("phantom", Phantom)
register_policy("asking", lambda config: Asking(Discipline.LINE))
register_policy("first asks", lambda config: FirstAsks(Discipline.LINE))


def toy(out: Path, **changes) -> ConsoleConfig:
    """Settings of a session of a few seconds."""
    settings = {
        "robots": 2,
        "tasks": 2,
        "policy": "asking",
        "engine": "phantom",
        "lanes": 4,
        "world": "none",  # nothing that a phantom does is true in any
        "physics": "authors",
        "speed": 50.0,
        "rollout_time": 6.0,
        "out": out,
    }
    return ConsoleConfig(**(settings | changes))


class Person:
    """Runs a session in a thread of its own, and acts in it as a page would.

    Attributes:
      frames: all that were shown.
      acknowledged: answers that were acknowledged: (service, input, bytes of the journal then).
    """

    def __init__(self, config: ConsoleConfig) -> None:
        self.frames: list[Frame] = []
        self.acknowledged: list[tuple[tuple, Push | None, bytes]] = []
        self.session = Session(SessionSpec.load(config), self.frames.append)
        self.journal = config.out / JOURNAL
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        try:
            self.session.run()
        except BaseException as error:
            self.error = error

    # -- the session -------------------------------------------------------------------------------

    def __enter__(self) -> "Person":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.session.stop()
        self.join()

    def join(self) -> None:
        """Wait until the session ends by itself."""
        self._thread.join(PATIENCE_S)
        if self.error is not None:
            raise self.error
        assert not self._thread.is_alive(), "the session does not end"

    @property
    def events(self) -> list[Event]:
        return self.session.runner.fleet.events

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def wait(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.running, f"the session is over: {self.error!r}"
            assert time.monotonic() < deadline, "nothing happens"
            time.sleep(0.002)

    def wait_for(self, kind: EventKind, count: int = 1, outcome: str | None = None) -> None:
        self.wait(lambda: self.count(kind, outcome) >= count)

    def count(self, kind: EventKind, outcome: str | None = None) -> int:
        """Number of events of a kind so far."""
        return sum(
            event.kind is kind and outcome in (None, event.outcome) for event in [*self.events]
        )

    # -- acts --------------------------------------------------------------------------------------

    def take(self, client: int = ME) -> Feedback:
        return self._ask(lambda reply: self.session.take(client, reply))

    def act(self, do: Callable[[InputPanel], Feedback], client: int = ME) -> Feedback:
        return self._ask(lambda reply: self.session.act(client, do, reply))

    def _ask(self, ask: Callable[[Callable[[Feedback], None]], None]) -> Feedback:
        feedbacks: list[Feedback] = []
        ask(feedbacks.append)
        self.wait(lambda: feedbacks)
        assert len(feedbacks) == 1
        return feedbacks[0]

    def answer(self, choose: Callable[[int], int], client: int = ME) -> Feedback:
        """Answer a request; `choose` maps its number to 0 a push, 1 a push that fails, 2 go on."""
        said: list[tuple[tuple, Push | None]] = []
        feedbacks: list[Feedback] = []

        def do(panel: InputPanel) -> Feedback:
            if panel.pending is None:
                return Feedback("", ok=False)
            service, kind = panel.pending.service, choose(len(self.acknowledged))
            if kind == 2:
                said.append((service, None))
                return panel.go_on(client)
            robot, places = panel.pending.robot, panel.pending.view.objects
            panel.click(client, robot, *map(float, places[5]))
            for place in [places[5]] if kind == 0 else FAR:
                if panel.click(client, robot, *map(float, place)).ok:
                    break
            assert panel.object is not None and panel.target is not None
            said.append((service, Push(panel.object, *panel.target)))
            return panel.confirm(client)

        def reply(feedback: Feedback) -> None:
            if feedback.answered:
                self.acknowledged.append((*said[0], self.journal.read_bytes()))
            feedbacks.append(feedback)

        self.session.act(client, do, reply)
        self.wait(lambda: feedbacks or not self.running)
        return feedbacks[0] if feedbacks else Feedback("", ok=False)

    def serve(self, choose: Callable[[int], int] = lambda number: number % 3) -> None:
        """Answer all requests, to the end of the session."""
        deadline = time.monotonic() + PATIENCE_S
        while self.running:
            assert time.monotonic() < deadline, "the session does not end"
            if self.session.panel.pending is None:
                time.sleep(0.002)
                continue
            try:
                self.answer(choose)
            except AssertionError:
                if self.running:
                    raise
        self.join()


# Places to which the hand cannot bring an object, because it passes through; one of them is free.
FAR = [(0.22 + 0.05 * i, 0.05 * j - 0.3) for i in range(6) for j in range(12)]
