"""A study of seconds in a trivial world, served or not, and a page that is no browser."""

import asyncio
import contextlib
import functools
import http.client
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from session_toys import PATIENCE_S  # its import registers what the study names
from websockets.sync.client import ClientConnection, connect

from pgf_jax.study.design import DESIGN, Design, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.progress import Participant, add_participant
from pgf_jax.study.server import StudyServer
from pgf_jax.study.visit import Turns, Visit

FLEET = """[fleet]
robots = 2
scene_class = "tight"
engine = "phantom"
lanes = 4
rollout_time = 0.1
world = "none"
task_limit = 2.0
push_execution = 0.3
retreat = 0.1
"""


def toy_study(folder: Path, minutes: float = 0.05, pushes: int = 0) -> Design:
    """The example with a fleet that is quickly computed, and short blocks."""
    write_example(folder)
    path = folder / DESIGN
    text = path.read_text()
    fleet = text[text.index("[fleet]") : text.index("# The conditions")]
    for old, new in (
        (fleet, FLEET),
        ('policy = "or-hitl"', 'policy = "asking"'),
        ('policy = "gain-rate"', 'policy = "always"'),
        ("minutes = 5.0", f"minutes = {minutes}"),
        ("minutes = 10.0", f"minutes = {minutes}"),
        ("pushes = 3", f"pushes = {pushes}"),
        ("break_s = 30.0", "break_s = 0.2"),
        ("shelf_3d = false", "shelf_3d = true"),
        ("cost_curve = false", "cost_curve = true"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return load_design(folder)


def wait_for(condition: Callable[[], Any]) -> Any:
    """Wait until a condition holds; returns its value."""
    deadline = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, "nothing happens"
        time.sleep(0.005)
    return found


class ToyPage:
    """Keeps what a page would show; `answers` is what it says to questionnaires."""

    def __init__(self) -> None:
        self.messages: list[Mapping[str, Any]] = []

    def put(self, message: Mapping[str, Any]) -> None:
        self.messages.append(message)

    def of(self, kind: str) -> list[Mapping[str, Any]]:
        """The messages of a type."""
        return [message for message in self.messages if message["type"] == kind]

    @property
    def page(self) -> Mapping[str, Any]:
        """The page that is shown."""
        return self.of("page")[-1]

    def wait_for(self, kind: str, step: int | None = None) -> Mapping[str, Any]:
        """Wait for a page of a kind, of a step."""

        def there() -> Mapping[str, Any] | None:
            pages = [page for page in self.of("page") if page["kind"] == kind]
            fitting = [page for page in pages if step in (None, page["step"])]
            return fitting[-1] if fitting else None

        return wait_for(there)


@functools.cache
def answers() -> dict[str, dict[str, Any]]:
    """Answers to the questionnaires of the example, by their headings."""
    tlx = ("mental_demand", "physical_demand", "temporal_demand", "performance", "effort")
    return {
        "How was the work that you have just done?": dict.fromkeys((*tlx, "frustration"), 35),
        "How was the system?": {f"sus_{i}": 4 for i in range(1, 11)},
        "Before you go": {"preferred": "the second", "attention": "green"},
    }


def arrive(
    design: Design, turns: Turns | None = None, folder: Path | None = None
) -> tuple[Visit, ToyPage]:
    """A participant whose page is there: a new one, or the one of a folder."""
    folder = folder or add_participant(design)[0]
    visit, page = Visit(design, Participant(design, folder), turns or Turns()), ToyPage()
    visit.attach(page.put)
    return visit, page


def take_part(visit: Visit, page: ToyPage) -> None:
    """Go on to the code as a page does, and help the robots that ask."""
    helped, number = set(), 0

    def act(what: str, **more: int) -> Mapping[str, Any] | None:
        nonlocal number
        number += 1
        visit.receive({"type": "act", "do": what, "id": number, **more})
        told = wait_for(
            lambda: [one for one in page.of("feedback") if one["id"] == number] or not in_session()
        )
        return told[0] if told is not True else None

    def in_session() -> bool:
        return page.page["kind"] in ("practice", "block")

    def time_of(event: str, service: Mapping[str, Any]) -> None:
        at_ms = 1000 * time.time()
        visit.receive({"type": "timing", "event": event, "client_ms": at_ms, **service})

    def help_robot(service: Mapping[str, Any]) -> None:
        time_of("shown", service)
        time_of("first_input", service)
        time_of("click", service)
        act("next")
        act("nudge", deeper=-1, left=0)
        for what in ("push", "go_on") if len(helped) % 2 else ("go_on",):
            time_of("submit", service)
            told = act(what)
            if told is not None and told["answered"]:
                time_of("acknowledged", service)
                return

    def step() -> bool:
        shown, kind = page.page, page.page["kind"]
        if kind == "questions":
            answered = answers()[shown["heading"]]
            visit.receive({"type": "done", "step": shown["step"], "answers": answered})
        elif in_session():
            frames = page.of("frame")
            if frames and frames[-1]["served"] is not None:
                frame = frames[-1]
                service = {"robot": frame["served"], "task": frame["task"],
                           "request": frame["request"]}  # fmt: skip
                key = (shown["step"], *service.values())
                if key not in helped:
                    helped.add(key)
                    help_robot(service)
        elif kind != "closing":
            visit.receive({"type": "done", "step": shown["step"]})
        return page.page["kind"] == "closing"

    wait_for(step)


class Served:
    """A study that is served in a thread."""

    def __init__(self, folder: Path, minutes: float = 0.05) -> None:
        self.server = StudyServer(toy_study(folder, minutes))
        self.port = 0
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        wait_for(lambda: self.port)

    def _run(self) -> None:
        async def run() -> None:
            self._task = asyncio.current_task()
            await self.server.run("127.0.0.1", 0, lambda port: setattr(self, "port", port))

        with contextlib.suppress(asyncio.CancelledError):
            self._loop.run_until_complete(run())

    def stop(self) -> None:
        assert self._task is not None
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(30)
        assert not self._thread.is_alive()

    def get(self, path: str, **headers: str) -> tuple[int, str]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        assert response.headers["Content-Security-Policy"].startswith("default-src 'self'")
        return response.status, response.read().decode()

    def connect(self, path: str, **how) -> ClientConnection:
        return connect(f"ws://127.0.0.1:{self.port}{path}", **how)
