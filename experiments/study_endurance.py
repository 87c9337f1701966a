"""Sends a study's page the messages of many hours, and looks for what grows.

    python experiments/study_endurance.py --hours 8

The robots are a recording: the frames of a real fleet's first minutes, again and again. Everything
else is the real server: its connections, the conversation with the participant, its files. A client
takes every frame and clicks once in five seconds of the study's time, all of it `--faster` times as
fast as at a real study. Memory, and how long clicks took to be answered, by eighths of the time.
"""

import asyncio
import dataclasses
import json
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import tyro
from study_platform import Config as PlatformConfig
from study_platform import write_study
from websockets.sync.client import connect

from pgf_jax import configure
from pgf_jax.console.session import FRAME_S
from pgf_jax.simulation.runner import FleetRunner
from pgf_jax.study import visit
from pgf_jax.study.block import TIMING, BlockRunner, robot_message
from pgf_jax.study.design import Shown, load_design
from pgf_jax.study.orders import Block
from pgf_jax.study.server import StudyServer
from pgf_jax.study.simulated import fleet_of

PARTS = 8
CLICK_S = 5.0  # of the study's time; at 60 times as fast below the messages that the server takes
RECORDED_S = 60.0


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    hours: float = 8.0
    faster: float = 60.0
    robots: int = 20


class Recorded(BlockRunner):
    """A block whose frames are recorded ones; what the page sends is answered at once.

    Args:
      frames: of each robot what the page shows, in turn.
      every_s: wall time between two frames.
      folder: of the session.
      tell: see `BlockRunner`.
    """

    def __init__(
        self, frames: list[list[dict]], every_s: float, folder: Path, tell: Callable[..., None]
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.failed, self._session = False, None
        self._frames, self._every_s, self._tell = frames, every_s, tell
        self._lock = threading.Lock()
        self._timing = folder / TIMING
        self._over = threading.Event()
        self.sent = 0
        threading.Thread(target=self._send, daemon=True).start()

    def _send(self) -> None:
        due = time.monotonic()
        while not self._over.is_set():
            frame = self._frames[self.sent % len(self._frames)]
            served = self.sent // 25 % 2
            self._tell(
                {
                    "type": "frame",
                    "time_s": round(self.sent * FRAME_S, 1),
                    "running": True,
                    "robots": frame,
                    **dict.fromkeys(("served", "task", "request"), 0 if served else None),
                    "object": None,
                    "target": None,
                    "problem": "",
                }
            )
            self.sent += 1
            due += self._every_s
            time.sleep(max(0.0, due - time.monotonic()))

    def take(self) -> None:
        """Nothing to do: the frames come anyway."""

    def pause(self) -> None:
        """Nothing to do: the frames come anyway."""

    def act(self, given: Mapping[str, Any]) -> None:
        """Answer at once."""
        self._tell({"type": "feedback", "id": given["id"], "text": "Click.", "ok": True,
                    "answered": False})  # fmt: skip

    def stop(self) -> None:
        """End the frames."""
        self._over.set()


def recorded_frames(config: Config, folder: Path) -> list[list[dict]]:
    """What the page is shown of a real fleet at first: in each frame what has changed."""
    spec = fleet_of(load_design(folder).session(Block(0, 0), folder))
    runner, frames, last = FleetRunner.of(spec), [], {}
    for number in range(round(RECORDED_S / FRAME_S)):
        now_ns = round(number * FRAME_S * 1e9)
        runner.run_until(now_ns)
        shown = [robot_message(robot, Shown(), 0.5)
                 for robot in runner.observer.snapshot(now_ns).robots]  # fmt: skip
        frames.append([robot for robot in shown if last.get(robot["robot"]) != robot])
        last = {robot["robot"]: robot for robot in shown}
    return frames


def memory_mb() -> float:
    """Resident memory of this process, MB."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def main(config: Config) -> None:
    """Record, send, measure and print."""
    configure()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "study"
        write_study(folder, PlatformConfig(robots=config.robots))
        frames = recorded_frames(config, folder)
        server, port = StudyServer(load_design(folder)), []

        def runner(session: Any, shown: Any, tell: Any, on_end: Any, pushes: Any) -> Recorded:
            return Recorded(frames, FRAME_S / config.faster, session.out, tell)

        loop = asyncio.new_event_loop()

        def serve() -> None:
            loop.run_until_complete(server.run("127.0.0.1", 0, port.append))

        with mock.patch.object(visit, "BlockRunner", runner):
            threading.Thread(target=serve, daemon=True).start()
            while not port:
                time.sleep(0.01)
            token = server.add().rpartition("/")[2]
            _take_part(config, f"ws://127.0.0.1:{port[0]}/wp/{token}")


def _take_part(config: Config, address: str) -> None:
    until, part = 3600 * config.hours, 3600 * config.hours / PARTS
    clicked: dict[int, float] = {}
    waited_ms: list[list[float]] = [[] for _ in range(PARTS)]
    got = number = 0
    next_click_s, printed, at_s = 0.0, 0, 0.0
    print(f"{config.hours:g} hours, {config.robots} robots, {config.faster:g} times as fast")
    with connect(address, max_size=None) as line:
        while at_s < until:
            told = json.loads(line.recv(timeout=60))
            if told["type"] == "page" and told["kind"] == "text":
                line.send(json.dumps({"type": "done", "step": told["step"]}))
            elif told["type"] == "frame":
                got, at_s = got + 1, told["time_s"]
                if at_s >= next_click_s:
                    number, next_click_s = number + 1, at_s + CLICK_S
                    clicked[number] = time.monotonic()
                    click = {"type": "timing", "event": "click", "client_ms": 1000 * time.time()}
                    line.send(json.dumps(click | {"id": number}))
                    line.send(json.dumps({"type": "act", "do": "next", "id": number}))
            elif told["type"] == "feedback":
                since = clicked.pop(told["id"])
                place = min(PARTS - 1, int(at_s / part))
                waited_ms[place].append(1000 * (time.monotonic() - since))
            if at_s >= (printed + 1) * part:
                median, high = np.percentile(waited_ms[printed] or [np.nan], [50, 95])
                printed += 1
                print(
                    f"after {at_s / 3600:.1f} h: {memory_mb():.0f} MB, {got} frames taken; answer "
                    f"to a click: median {median:.1f} ms, 95 % under {high:.1f} ms",
                    flush=True,
                )


if __name__ == "__main__":
    main(tyro.cli(Config))
