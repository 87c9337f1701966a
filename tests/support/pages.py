"""Runs the console in a process of its own, and opens its page in a browser, for tests."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from console_browser import CHROMIUM_FLAGS, HEIGHT, WIDTH, journal_events, pixel_of
from playwright.sync_api import sync_playwright

from pgf_jax.console.layout import Cell, Layout
from pgf_jax.scene import Scene, sample_scene

PATIENCE_S = 60.0  # longest wait of a test on a busy machine


class Server:
    """A running `pgf-jax console`."""

    def __init__(self, process: subprocess.Popen, out: Path, url: str) -> None:
        self.process, self.out, self.url = process, out, url

    @property
    def port(self) -> int:
        return int(self.url.rsplit(":", 1)[1].split("/")[0])

    def events(self) -> list[dict[str, Any]]:
        """The events in the journal so far."""
        return journal_events(self.out)

    def log(self) -> str:
        return (self.out / "console.log").read_text()

    def wait_for(self, found: Callable[[list[dict[str, Any]]], Any]) -> Any:
        """Wait until `found(events)` is true, and return it."""
        return wait_for(lambda: found(self.events()))


def wait_for(found: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + PATIENCE_S
    while not (result := found()):
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.02)
    return result


@contextlib.contextmanager
def console(out: Path, *options: str) -> Iterator[Server]:
    """A running console, by default on any free port; it is killed at the end."""
    port = () if "--port" in options else ("--port", "0")
    command = [sys.executable, "-m", "pgf_jax", "console", *port, "--out", str(out)]
    process = subprocess.Popen(
        [*command, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if line.startswith("http://"):
                break
        assert said and said[-1].startswith("http://"), "".join(said)
        yield Server(process, out, said[-1].split(";")[0])
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """Headless Chromium; the test is skipped if it is not installed."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("needs Chromium (apt-get install chromium)")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        try:
            yield chromium
        finally:
            chromium.close()


def visit(chromium: Any, url: str, received: list[bytes] | None = None) -> Any:
    """Open a page that shows the console; `received` takes the messages that it is sent."""
    size = {"width": WIDTH, "height": HEIGHT}
    page = chromium.new_context(viewport=size).new_page()
    if received is not None:
        keep = received.append
        page.on(
            "websocket",
            lambda socket: socket.on("framereceived", lambda frame: keep(messages_in(frame))),
        )
    page.goto(url)
    page.wait_for_selector("canvas", timeout=1e3 * PATIENCE_S)
    # Without a GPU viser shows a notice in front of the drawing.
    notice = page.locator(".mantine-Notification-root").filter(has_text="WebGL")
    notice.locator("button").click(timeout=1e3 * PATIENCE_S)
    notice.wait_for(state="detached", timeout=1e3 * PATIENCE_S)
    return page


def messages_in(frame: bytes) -> bytes:
    """The messages of a websocket frame of viser, without their arrays."""
    end = 16 + int.from_bytes(frame[8:16], "little")  # after two lengths: raw, and compressed
    return zstandard.decompress(frame[16:end])


def wait_for_text(page: Any, text: str) -> None:
    page.wait_for_function(
        "text => document.body.innerText.includes(text)", arg=text, timeout=1e3 * PATIENCE_S
    )


def click_shelf(page: Any, cell: Cell, place: np.ndarray) -> None:
    """Click on a place of a shelf (x, y; m)."""
    x, y = cell.place(np.asarray(place))
    pixel = pixel_of(page, x, y)
    page.mouse.move(*pixel)
    page.wait_for_timeout(200)  # viser takes a jump of the mouse for a drag
    page.mouse.click(*pixel)


def scene_of(robot: int, task: int, seed: int = 0) -> Scene:
    """The scene of a task in a console with tight scenes."""
    return sample_scene(np.array([seed, robot, task], np.uint32), "tight")


def large(robots: int, served: int) -> Cell:
    cell = Layout.of(robots, served).large
    assert cell is not None
    return cell


def interrupt(server: Server) -> str:
    """End the session in order; returns the rest of its output."""
    server.process.send_signal(signal.SIGINT)
    out, _ = server.process.communicate(timeout=PATIENCE_S)
    assert server.process.returncode == 0, out
    return out
