"""A block, or the practice: runs its session, and says in plain data what the page shows.

The session runs in a thread of its own, as at the console; what a participant does comes in through
`take`, `pause` and `act`. A session that was killed goes on from its log.
"""

import dataclasses
import gc
import json
import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pgf_jax.console.config import ConsoleConfig
from pgf_jax.console.fleet_view import STATES
from pgf_jax.console.input_panel import Feedback, InputPanel
from pgf_jax.console.session import Frame, Session
from pgf_jax.console.session_spec import SessionSpec
from pgf_jax.fleet.events import EventKind
from pgf_jax.simulation.observer import FOUND
from pgf_jax.simulation.snapshot import RobotSnapshot
from pgf_jax.study.design import Shown
from pgf_jax.study.sureness import Sureness
from pgf_jax.tables.event_log import JOURNAL, TABLE

log = logging.getLogger(__name__)

TIMING = "timing.jsonl"
_CURVE = 60  # last costs that are shown
CLIENT = 1  # of the session: the participant, whatever the browser
Tell = Callable[[Mapping[str, Any]], None]
# What a participant can do at a shelf: name -> (whether the numbers are right, what it does).
_Act = Callable[[InputPanel, Mapping[str, Any]], Feedback]
ACTS: dict[str, _Act] = {
    "click": lambda panel, given: panel.click(
        CLIENT, _whole(given, "robot"), _number(given, "x"), _number(given, "y")
    ),
    "next": lambda panel, given: panel.next_object(CLIENT),
    "nudge": lambda panel, given: panel.nudge(CLIENT, _step(given, "deeper"), _step(given, "left")),
    "undo": lambda panel, given: panel.undo(CLIENT),
    "push": lambda panel, given: panel.confirm(CLIENT),
    "go_on": lambda panel, given: panel.go_on(CLIENT),
}


class BlockRunner:
    """Runs one session for one participant.

    Args:
      config: of the session; one that has begun is resumed.
      shown: what the page shows.
      tell: called, in other threads, with each message for the page.
      on_end: called, in the session's thread, when it has ended by itself.
      pushes: that end it once they were executed (practice); None: its horizon does.

    Attributes:
      failed: it has ended by a fault; what was recorded is kept.
    """

    def __init__(
        self,
        config: ConsoleConfig,
        shown: Shown,
        tell: Tell,
        on_end: Callable[[], None],
        pushes: int | None = None,
    ) -> None:
        self._config, self._tell, self._on_end, self._pushes = config, tell, on_end, pushes
        self._shown, self._sureness = shown, None
        self.failed = False
        self._session: Session | None = None
        self._wanted = False  # somebody is there
        self._stopping = False
        self._sent: dict[int, str] = {}  # robot -> what was shown last
        self._lock = threading.Lock()
        config.out.mkdir(parents=True, exist_ok=True)
        self._timing = config.out / TIMING
        self._timing.touch()
        self._thread = threading.Thread(target=self._run, name="block", daemon=True)
        self._thread.start()

    # -- what the participant does, from any thread ------------------------------------------------

    def take(self) -> None:
        """The participant is there: the clock runs."""
        with self._lock:
            if self._wanted:
                return
            self._wanted, self._sent = True, {}
            if self._session is not None:
                self._session.take(CLIENT, lambda feedback: None)

    def pause(self) -> None:
        """The participant is gone: the clock stands."""
        with self._lock:
            self._wanted = False
            if self._session is not None:
                self._session.pause(CLIENT)

    def act(self, given: Mapping[str, Any]) -> None:
        """Do what a message says; the page is told what came of it.

        Raises:
          ValueError: the message is none that a page sends.
        """
        do = ACTS.get(str(given.get("do")))
        number = _whole(given, "id")
        if do is None or number is None:
            raise ValueError("no action")
        session = self._session
        if session is None:
            return

        def reply(feedback: Feedback) -> None:
            self._tell(
                {
                    "type": "feedback",
                    "id": number,
                    "text": feedback.text,
                    "ok": feedback.ok,
                    "answered": feedback.answered,
                }
            )

        session.act(CLIENT, lambda panel: do(panel, given), reply)

    def note(self, event: Mapping[str, Any]) -> None:
        """Record when something happened at the page, and the server's clock; also at the end."""
        at_ms = round(time.time() * 1000)
        with self._lock, self._timing.open("a", encoding="utf-8") as file:
            file.write(json.dumps({**event, "server_ms": at_ms}) + "\n")

    def finish(self) -> None:
        """End the session now, as if its time were over."""
        with self._lock:
            if self._session is not None:
                self._session.stop()

    def stop(self) -> None:
        """Stop it where it is, so that it can be resumed; returns when it has stopped."""
        with self._lock:
            self._stopping = True
            if self._session is not None:
                self._session.stop()
        self._thread.join()

    # -- the session's thread ----------------------------------------------------------------------

    def _run(self) -> None:
        try:
            if not has_ended(self._config.out):
                self._run_session()
        except Exception:
            log.exception("a block failed")
            self.failed = True
            self._tell({"type": "failed"})
            return
        finally:
            with self._lock:
                self._session = self._sureness = None  # of which a page that lingers needs nothing
            gc.collect()  # a session refers to itself, and holds hundreds of megabytes
        if not self._stopping:
            self._on_end()

    def _run_session(self) -> None:
        self._tell({"type": "preparing"})
        if self._shown.sure:
            self._sureness = Sureness()
        spec = SessionSpec.load(_resumed(self._config))
        session = Session(spec, self._show)
        with self._lock:
            self._session = session
            if self._wanted:
                session.take(CLIENT, lambda feedback: None)
            if self._stopping:
                session.stop()
        session.run()
        if self._stopping:
            session.recorder.leave()
        else:
            session.recorder.close()

    def _show(self, frame: Frame) -> None:
        session = self._session
        if session is None:
            return
        if self._pushes is not None and _pushes_executed(session) >= self._pushes:
            session.stop()
        robots = []
        sure = {} if self._sureness is None else self._sureness.of(session.runner.robots)
        for robot in frame.fleet.robots:
            shown = robot_message(robot, self._shown, sure.get(robot.robot))
            text = json.dumps(shown)
            if self._sent.get(robot.robot) != text:
                self._sent[robot.robot] = text
                robots.append(shown)
        picked = frame.picked
        message: dict[str, Any] = {
            "type": "frame",
            "time_s": round(frame.fleet.time_ns / 1e9, 1),
            "running": frame.running,
            "robots": robots,
            "served": None if picked is None else picked.robot,
            "task": None if picked is None else picked.task,
            "request": None if picked is None else picked.request,
            "object": None if picked is None else picked.object,
            "target": None if picked is None else picked.target,
            "problem": "" if picked is None else picked.problem,
        }
        if self._pushes is not None:
            message["practice"] = [_pushes_executed(session), self._pushes]
        self._tell(message)


def has_ended(folder: Path) -> bool:
    """Whether the session of a folder has ended, and its tables are written."""
    return (folder / TABLE).exists()


def robot_message(robot: RobotSnapshot, shown: Shown, sure: float | None) -> dict[str, Any]:
    """What the page shows of a robot: places in mm, so that they are short.

    Args:
      robot: as it is.
      shown: what the page shows.
      sure: see `Sureness.of`.
    """
    words = "pushing" if robot.push is not None else STATES[robot.state][1]
    push = robot.push
    more: dict[str, Any] = {}
    if shown.sure:
        more["sure"] = None if sure is None else round(sure, 2)
    if shown.cost_curve:
        more["costs"] = [round(cost, 1) for cost in robot.costs[-_CURVE:] if math.isfinite(cost)]
    if shown.shelf_3d:
        more["heights"] = [round(1000 * float(height)) for height in robot.heights]
    return more | {
        "robot": robot.robot,
        "state": robot.state.name.lower(),
        "words": f"{words}, plans on" if robot.plans_on else words,
        "news": robot.news if robot.news == FOUND else "",  # the others are of bids
        "done": len(robot.done),
        "failed": len(robot.done) - robot.solved,
        "objects": [[round(1000 * float(c)) for c in place] for place in robot.objects],
        "radii": [round(1000 * float(radius)) for radius in robot.radii],
        "goal": robot.goal,
        "walls": [round(1000 * robot.back_x), round(1000 * robot.side_y)],
        "hand": [[[round(1000 * float(c)) for c in end] for end in axis]
                 for axis in robot.hand_axes()],
        "path": [[round(1000 * float(c)) for c in place] for place in robot.end_effector_path()],
        "push": None if push is None else [push.object, round(1000 * push.x), round(1000 * push.y)],
    }  # fmt: skip


def _resumed(config: ConsoleConfig) -> ConsoleConfig:
    return dataclasses.replace(config, resume=(config.out / JOURNAL).exists())


def _pushes_executed(session: Session) -> int:
    events = session.runner.fleet.events
    return sum(e.kind is EventKind.RETREAT_END and e.object is not None for e in events)


def _number(given: Mapping[str, Any], name: str) -> float:
    value = given.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return float("nan")
    return float(value)


def _whole(given: Mapping[str, Any], name: str) -> int | None:
    value = given.get(name)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _step(given: Mapping[str, Any], name: str) -> int:
    value = _whole(given, name)
    return max(-1, min(1, value or 0))
