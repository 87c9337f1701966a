"""Measures the console's page while a fleet plans: frames, and acknowledgements of clicks.

Starts `pgf-jax console` in real time, opens it in headless Chromium (rendered in software: the
worst case), waits until a robot is served, and then measures in the page: the times between frames,
and the time from each click or key to the feedback that acknowledges it. The picture shows a push
that is picked, at full resolution, which viser lowers where rendering is slow.

    python experiments/console_latency.py --robots 20
"""

import dataclasses
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from console_browser import CHROMIUM_FLAGS, HEIGHT, WIDTH, journal_events, pixel_of
from playwright.sync_api import Page, sync_playwright

from pgf_jax.console.layout import Cell, Layout
from pgf_jax.scene import Scene, sample_scene

# Stores the time of each frame, of each click and key, and of each change of the feedback.
MEASURE = """() => {
  const seen = window.seen = {frames: [], acts: [], feedback: []};
  const frame = t => { seen.frames.push(t); requestAnimationFrame(frame); };
  requestAnimationFrame(frame);
  for (const kind of ['pointerup', 'keydown'])
    addEventListener(kind, e => seen.acts.push(performance.now()), true);
  const feedback = () => document.querySelector('strong')?.parentElement.innerText;
  let last = feedback();
  new MutationObserver(() => {
    const now = feedback();
    if (now !== last) { last = now; seen.feedback.push([performance.now(), now]); }
  }).observe(document.body, {subtree: true, childList: true, characterData: true});
}"""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
      robots: fleet size.
      acts: number of clicks and keys to time.
      seconds: least duration for which frames are timed.
      out: file for a picture of the page.
    """

    robots: int = 20
    acts: int = 60
    seconds: float = 30.0
    out: Path | None = None


def main(options: Options) -> None:
    """Measure, and print a table as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pgf_jax", "console", "--port", "0", "--tasks", "100"]
        # `random` asks soon. Nobody answers, so the other robots plan all the time.
        command += ["--robots", str(options.robots), "--policy", "random", "--patience", "10000"]
        command += ["--out", f"{folder}/session"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            url = next(line for line in server.stdout if line.startswith("http")).split(";")[0]
            with sync_playwright() as playwright:
                chromium = playwright.chromium.launch(
                    executable_path=shutil.which("chromium"), args=CHROMIUM_FLAGS
                )
                page = chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT})
                page.goto(url)
                found = measure(page, Path(folder) / "session", options)
                if options.out is not None:
                    page.goto(f"{url}?fixedDpr=1")
                    picture(page, Path(folder) / "session", options)
                chromium.close()
        finally:
            server.terminate()
            output = server.communicate()[0]
    print(json.dumps(found | {"session": output.strip().splitlines()[-1]}, indent=2))


def measure(page: Page, session: Path, options: Options) -> dict[str, Any]:
    """Time the frames and the acknowledgements of a page, ms."""
    scene, cell = served_shelf(page, session, options)
    before = sum(event["kind"] == "iteration" for event in journal_events(session))
    page.evaluate(MEASURE)
    for number in range(options.acts // 2):
        x, y = cell.place(scene.positions[number % len(scene.objects)])
        page.mouse.click(*pixel_of(page, x, y))
        page.wait_for_timeout(1e3 * options.seconds / options.acts)
        page.keyboard.press("Escape")
        page.wait_for_timeout(1e3 * options.seconds / options.acts)
    seen = page.evaluate("window.seen")
    iterations = sum(event["kind"] == "iteration" for event in journal_events(session)) - before
    acknowledged = [
        min((t for t, _ in seen["feedback"] if t >= act), default=np.nan) - act
        for act in seen["acts"]
    ]
    return {
        "robots": options.robots,
        "iterations": iterations,
        "frames": figures(np.diff(seen["frames"])),
        "acknowledged": figures(np.array(acknowledged)),
    }


def picture(page: Page, session: Path, options: Options) -> None:
    """Draw the page, with a push of the object at the front towards the hand."""
    scene, cell = served_shelf(page, session, options)
    front = scene.positions[np.argmin(scene.positions[:, 0])]
    for place in (front, front - (0.06, 0.0)):
        pixel = pixel_of(page, *cell.place(place))
        page.mouse.move(*pixel)
        page.wait_for_timeout(200)  # viser takes a jump of the mouse for a drag
        page.mouse.click(*pixel)
        page.wait_for_timeout(1000)
    page.screenshot(path=options.out)


def served_shelf(page: Page, session: Path, options: Options) -> tuple[Scene, Cell]:
    """Wait until a robot is served; returns its scene, and where its shelf is drawn."""
    page.wait_for_function(r"/Robot \d+ asks/.test(document.body.innerText)", timeout=120_000)
    page.locator(".mantine-Notification-closeButton").first.click()
    served = next(e["robot"] for e in journal_events(session) if e["kind"] == "grant")
    cell = Layout.of(options.robots, served).large
    assert cell is not None
    return sample_scene(np.array([0, served, 0], np.uint32), "tight"), cell


def figures(milliseconds: np.ndarray) -> dict[str, float]:
    """Median, 95th percentile and maximum of times, and how many there are."""
    known = milliseconds[np.isfinite(milliseconds)]
    return {
        "n": len(known),
        "missing": len(milliseconds) - len(known),
        "median_ms": round(float(np.median(known)), 1),
        "p95_ms": round(float(np.percentile(known, 95)), 1),
        "max_ms": round(float(known.max()), 1),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
