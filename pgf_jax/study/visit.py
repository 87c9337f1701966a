"""The conversation with a participant: which page is shown, and what a message from it does.

No network here: a `Visit` is told what a page sends, and calls `send` with what the page is to
show. It outlives the connection, so that whoever comes back finds the page where it was.
"""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from markdown_it import MarkdownIt

from pgf_jax.study.block import BlockRunner
from pgf_jax.study.design import Design
from pgf_jax.study.progress import Participant, Step

log = logging.getLogger(__name__)

_EARLY_S = 0.5  # by which a page's clock may end a break before the server's
# Things at the page whose times are recorded: name -> whether the participant's journal has it,
# else the session's.
EVENTS = {
    "shown": False,  # a request
    "first_input": False,
    "click": False,
    "submit": False,
    "told": False,  # what came of a click or key
    "acknowledged": False,  # an answer is recorded
    "clock": False,  # of browser and server, and the round trip
    "focus_lost": True,
    "focus_back": True,
    "hidden": True,
    "visible": True,
}
_MARKDOWN = MarkdownIt("commonmark", {"html": False})

Send = Callable[[Mapping[str, Any]], None]


class Turns:
    """Who may have a session now: one participant, unless more are allowed.

    Args:
      most: sessions at a time.
    """

    def __init__(self, most: int = 1) -> None:
        self._most, self._active = most, set[int]()
        self._lock = threading.Lock()

    def enter(self, participant: int) -> bool:
        """Whether a participant may have a session now; it is theirs until `leave`."""
        with self._lock:
            if participant not in self._active and len(self._active) >= self._most:
                return False
            self._active.add(participant)
            return True

    def leave(self, participant: int) -> None:
        """The participant's session has ended, or they are gone."""
        with self._lock:
            self._active.discard(participant)


class Visit:
    """One participant's way through the study.

    Args:
      design: of the study.
      participant: who it is.
      turns: of sessions.
    """

    def __init__(self, design: Design, participant: Participant, turns: Turns) -> None:
        self._design, self.participant, self._turns = design, participant, turns
        self._send: Send | None = None
        self._runner: BlockRunner | None = None
        self._ended: BlockRunner | None = None  # the one before: the page may still speak of it
        self._lock = threading.RLock()
        self._shown_at = 0.0
        self.paused = False  # by the experimenter

    # -- pages that come and go --------------------------------------------------------------------

    @property
    def connected(self) -> bool:
        """Whether a page is there."""
        return self._send is not None

    def attach(self, send: Send) -> None:
        """A page is there: show it where the participant is."""
        with self._lock:
            self._send = send
            self.participant.note("connected")
            if self._runner is not None and self._runner.failed:
                self._runner = None  # once more, for whoever comes back
            self._show()

    def detach(self) -> None:
        """The page is lost: the clock of a session stands until it is back."""
        with self._lock:
            if self._send is None:
                return
            self._send = None
            self.participant.note("lost")
            if self._runner is not None:
                self._runner.pause()
            self._turns.leave(self.participant.number)

    def close(self) -> None:
        """The server stops: a session is left so that it can be resumed."""
        with self._lock:
            runner, self._runner, self._send = self._runner, None, None
        if runner is not None:
            runner.stop()
        self._turns.leave(self.participant.number)
        self.participant.close()

    def pause(self, paused: bool) -> None:
        """The experimenter pauses the participant, or lets them go on."""
        with self._lock:
            self.paused = paused
            self.participant.note("paused" if paused else "unpaused")
            if self._runner is not None:
                self._runner.pause()
            self._show()

    def end_session(self) -> None:
        """The experimenter ends the session that runs; the participant goes on to the next step."""
        with self._lock:
            if self._runner is not None and not self._runner.failed:
                self.participant.note("ended_by_experimenter")
                self._runner.finish()

    # -- what a page sends -------------------------------------------------------------------------

    def receive(self, message: Mapping[str, Any]) -> None:
        """Do what a message of the page says.

        Raises:
          ValueError: no page sends such a message.
        """
        kind = message.get("type")
        with self._lock:
            if kind == "done":
                self._done(message)
            elif kind == "act":
                if self._runner is not None and not self.paused:
                    self._runner.act(message)
            elif kind == "timing":
                self._time(message)
            elif kind == "ping":
                self._tell({"type": "pong", "t": message.get("t"), "server_ms": _now_ms()})
            else:
                raise ValueError("an unknown message")

    def _done(self, message: Mapping[str, Any]) -> None:
        """A page of text, a questionnaire or a break is finished."""
        number, step = message.get("step"), self.participant.step
        if step is None or number != self.participant.done:
            self._show()  # it was sent twice: show where the participant is
            return
        if step.kind in ("practice", "block", "closing"):
            raise ValueError("a page that does not end so")
        details: dict[str, Any] = {"took_s": round(time.monotonic() - self._shown_at, 3)}
        if step.kind == "break":
            left = self._design.blocks.break_s - (time.monotonic() - self._shown_at)
            if left > _EARLY_S:
                self._show()
                return
        if step.kind == "questions":
            answers = message.get("answers")
            if not isinstance(answers, dict):
                raise ValueError("no answers")
            asked = self._design.questionnaires[step.name]
            problems = asked.problems(answers)
            if problems:
                self._tell({"type": "problems", "step": number, "problems": problems})
                return
            details |= {"answers": answers, "attentive": asked.attentive(answers)}
        self._finish(details)

    def _finish(self, details: Mapping[str, Any]) -> None:
        self.participant.finish(self.participant.done, details)
        step = self.participant.step
        if step is not None and step.kind == "closing":
            self.participant.note("reached_the_end")
        self._show()

    def _time(self, message: Mapping[str, Any]) -> None:
        name, client = message.get("event"), message.get("client_ms")
        if name not in EVENTS or isinstance(client, bool) or not isinstance(client, int | float):
            raise ValueError("no event of a page")
        event = {"event": name, "client_ms": client}
        for key in ("id", "robot", "task", "request", "rtt_ms", "offset_ms"):
            value = message.get(key)
            if isinstance(value, int | float) and not isinstance(value, bool):
                event[key] = value
        if EVENTS[name]:
            self.participant.note("page", event)
        elif (runner := self._runner or self._ended) is not None:
            runner.note(event)

    # -- what the page shows -----------------------------------------------------------------------

    def _tell(self, message: Mapping[str, Any]) -> None:
        if self._send is not None:
            self._send(message)

    def _show(self) -> None:
        """Show the participant's step; a session begins, or goes on."""
        if self._send is None:
            return
        step = self.participant.step
        if self.paused:
            self._tell({"type": "paused"})
            return
        self._shown_at = time.monotonic()
        if step is None or step.kind == "closing":
            text = self._design.texts["closing"]
            self._tell(self._page(Step("closing", "closing"), html=_html(text),
                                  code=self.participant.code))  # fmt: skip
        elif step.kind in ("practice", "block"):
            self._tell(self._page(step))
            self.begin()
        elif step.kind == "questions":
            self._tell(self._page(step, **self._questions(step)))
        else:
            text = _html(self._design.texts[step.name])
            wait = self._design.blocks.break_s if step.kind == "break" else 0.0
            self._tell(self._page(step, html=text, wait_s=wait))

    def _page(self, step: Step, **more: Any) -> dict[str, Any]:
        steps = self.participant.steps
        message = {"type": "page", "kind": step.kind, "step": self.participant.done}
        # No name of a condition: it might tell what is expected.
        return message | {"title": self._design.title, "of": len(steps)} | more

    def _questions(self, step: Step) -> dict[str, Any]:
        asked = self._design.questionnaires[step.name]
        items = [
            {
                "name": item.name,
                "text": item.text,
                "kind": item.kind,
                "low": item.low,
                "high": item.high,
                "least": item.least,
                "most": item.most,
                "step": item.step,
                "options": item.options,
                "required": item.required,
            }
            for item in asked.items
        ]
        return {"heading": asked.title, "items": items}

    def begin(self) -> None:
        """Begin or go on with the session of the present step, if it is the participant's turn."""
        with self._lock:
            step, number = self.participant.step, self.participant.done
            if step is None or step.kind not in ("practice", "block") or self._send is None:
                return
            if self._runner is not None and self._runner.failed:
                self._turns.leave(self.participant.number)
                return
            if not self._turns.enter(self.participant.number):
                self._tell({"type": "queued"})
                return
            if self._runner is None:
                folder = self.participant.session(step)
                if step.block is None:
                    config = self._design.practice_session(folder)
                    pushes = self._design.practice.pushes
                else:
                    config = self._design.session(self.participant.blocks[step.block], folder)
                    pushes = None
                self._runner = BlockRunner(
                    config, self._design.shown, self._tell,
                    lambda: self._session_ended(number), pushes,
                )  # fmt: skip
            self._runner.take()

    def _session_ended(self, number: int) -> None:
        with self._lock:
            self._ended, self._runner = self._runner, None
            self._turns.leave(self.participant.number)
            if number == self.participant.done:
                self._finish({})


def _html(markdown: str) -> str:
    return _MARKDOWN.render(markdown)


def _now_ms() -> float:
    return round(time.time() * 1000, 1)
