"""A console in a process of its own, and what a test needs to look at it through a browser."""

import contextlib
import json
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
from playwright.sync_api import sync_playwright

from pgf_jax.console import layout
from pgf_jax.console.layout import Cell, Layout
from pgf_jax.console.page import MARGIN
from pgf_jax.scene import Scene, sample_scene

CHROMIUM = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-sync",
)
SIZE = {"width": 1400, "height": 900}
PATIENCE_S = 60.0  # of a test with a machine that is busy


class Server:
    """A running `pgf-jax console`."""

    def __init__(self, process: subprocess.Popen, out: Path, url: str) -> None:
        self.process, self.out, self.url = process, out, url

    @property
    def port(self) -> int:
        return int(self.url.rsplit(":", 1)[1].split("/")[0])

    def events(self) -> list[dict[str, Any]]:
        """What is in the log by now; a line that is being written is left out."""
        lines = (self.out / "events.jsonl").read_text().split("\n")[1:-1]
        return [json.loads(line) for line in lines]

    def log(self) -> str:
        return (self.out / "console.log").read_text()

    def wait_for(self, found: Callable[[list[dict[str, Any]]], Any]) -> Any:
        """What `found` makes of the events, once that is something."""
        return wait_for(lambda: found(self.events()))


def wait_for(found: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + PATIENCE_S
    while not (result := found()):
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.02)
    return result


@contextlib.contextmanager
def console(out: Path, *options: str) -> Iterator[Server]:
    """A console on any free port, killed in the end."""
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
    """Headless Chromium; skips where there is none."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("needs Chromium (apt-get install chromium)")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=CHROMIUM)
        try:
            yield chromium
        finally:
            chromium.close()


def visit(chromium: Any, url: str) -> Any:
    """A page that shows the console."""
    page = chromium.new_context(viewport=SIZE).new_page()
    page.goto(url)
    page.wait_for_selector("canvas", timeout=1e3 * PATIENCE_S)
    # Without a GPU viser says so, in front of the wall.
    notice = page.locator(".mantine-Notification-root").filter(has_text="WebGL")
    notice.locator("button").click(timeout=1e3 * PATIENCE_S)
    notice.wait_for(state="detached", timeout=1e3 * PATIENCE_S)
    return page


def wait_for_text(page: Any, text: str) -> None:
    page.wait_for_function(
        "text => document.body.innerText.includes(text)", arg=text, timeout=1e3 * PATIENCE_S
    )


def click_shelf(page: Any, cell: Cell, place: np.ndarray) -> None:
    """Click where a place of a shelf (x, y; m) is drawn."""
    x, y = cell.place(np.asarray(place))
    box = page.locator("canvas").first.bounding_box()
    units = max(layout.HEIGHT, layout.WIDTH * box["height"] / box["width"]) * MARGIN
    scale = box["height"] / units  # pixels a unit
    at = (
        box["x"] + box["width"] / 2 + scale * (x - layout.WIDTH / 2),
        box["y"] + box["height"] / 2 - scale * (y - layout.HEIGHT / 2),
    )
    page.mouse.move(*at)
    page.wait_for_timeout(200)  # a hand is no faster; viser takes a leap for a drag
    page.mouse.click(*at)


def scene_of(robot: int, task: int, seed: int = 0) -> Scene:
    """The scene of a task of a console that samples tight ones."""
    return sample_scene(np.array([seed, robot, task], np.uint32), "tight")


def large(robots: int, served: int) -> Cell:
    cell = Layout.of(robots, served).large
    assert cell is not None
    return cell


def interrupt(server: Server) -> str:
    """End the session in order; what it said."""
    server.process.send_signal(signal.SIGINT)
    out, _ = server.process.communicate(timeout=PATIENCE_S)
    assert server.process.returncode == 0, out
    return out
