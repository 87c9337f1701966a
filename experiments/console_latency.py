"""Does the console's page keep up? Frames, and acknowledged clicks, while a fleet plans.

Starts `pgf-jax console` in real time, opens it in headless Chromium (rendered in software where
there is no GPU: the worst case), waits until a robot asks, and then measures in the page itself:
the times between frames, and from each click or key to the word that acknowledges it.

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
from playwright.sync_api import Page, sync_playwright

from pgf_jax.console import layout
from pgf_jax.console.layout import Layout
from pgf_jax.console.page import MARGIN
from pgf_jax.scene import sample_scene

FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-sync",
)
# Notes the time of each frame, of each click and key, and of each change of the operator's word.
WATCH = """() => {
  const seen = window.seen = {frames: [], acts: [], words: []};
  const frame = t => { seen.frames.push(t); requestAnimationFrame(frame); };
  requestAnimationFrame(frame);
  for (const kind of ['pointerup', 'keydown'])
    addEventListener(kind, e => seen.acts.push(performance.now()), true);
  const word = () => document.querySelector('strong')?.parentElement.innerText;
  let last = word();
  new MutationObserver(() => {
    const now = word();
    if (now !== last) { last = now; seen.words.push([performance.now(), now]); }
  }).observe(document.body, {subtree: true, childList: true, characterData: true});
}"""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options.

    Attributes:
      robots: fleet size.
      acts: clicks and keys to time.
      seconds: for which frames are timed at least.
      out: where a picture of the page is put.
    """

    robots: int = 20
    acts: int = 60
    seconds: float = 30.0
    out: Path | None = None


def main(options: Options) -> None:
    """Measure, and print a table as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pgf_jax", "console", "--port", "0", "--tasks", "100"]
        # `random` asks soon; nobody answers, so the others go on planning all the time.
        command += ["--robots", str(options.robots), "--policy", "random", "--patience", "10000"]
        command += ["--out", f"{folder}/session"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            url = next(line for line in server.stdout if line.startswith("http")).split(";")[0]
            with sync_playwright() as playwright:
                chromium = playwright.chromium.launch(
                    executable_path=shutil.which("chromium"), args=FLAGS
                )
                page = chromium.new_page(viewport={"width": 1400, "height": 900})
                page.goto(url)
                found = measure(page, Path(folder) / "session", options)
                chromium.close()
        finally:
            server.terminate()
            said = server.communicate()[0]
    print(json.dumps(found | {"session": said.strip().splitlines()[-1]}, indent=2))


def measure(page: Page, session: Path, options: Options) -> dict[str, Any]:
    """Frames and acknowledgements of a page, ms."""
    page.wait_for_function("document.body.innerText.includes('asks (')", timeout=120_000)
    page.locator(".mantine-Notification-closeButton").first.click()
    served = next(e["robot"] for e in events(session) if e["kind"] == "grant")
    scene = sample_scene(np.array([0, served, 0], np.uint32), "tight")
    cell = Layout.of(options.robots, served).large
    assert cell is not None
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    scale = box["height"] / max(layout.HEIGHT, layout.WIDTH * box["height"] / box["width"]) / MARGIN
    before = sum(event["kind"] == "iteration" for event in events(session))
    page.evaluate(WATCH)
    for number in range(options.acts // 2):
        x, y = cell.place(scene.positions[number % len(scene.objects)])
        page.mouse.click(
            box["x"] + box["width"] / 2 + scale * (x - layout.WIDTH / 2),
            box["y"] + box["height"] / 2 - scale * (y - layout.HEIGHT / 2),
        )
        page.wait_for_timeout(1e3 * options.seconds / options.acts)
        page.keyboard.press("Escape")
        page.wait_for_timeout(1e3 * options.seconds / options.acts)
    if options.out is not None:
        page.screenshot(path=options.out)
    seen = page.evaluate("window.seen")
    iterations = sum(event["kind"] == "iteration" for event in events(session)) - before
    acknowledged = [
        min((t for t, _ in seen["words"] if t >= act), default=np.nan) - act for act in seen["acts"]
    ]
    return {
        "robots": options.robots,
        "iterations": iterations,
        "frames": figures(np.diff(seen["frames"])),
        "acknowledged": figures(np.array(acknowledged)),
    }


def events(session: Path) -> list[dict[str, Any]]:
    """What the log has so far."""
    lines = (session / "events.jsonl").read_text().split("\n")[1:-1]
    return [json.loads(line) for line in lines]


def figures(milliseconds: np.ndarray) -> dict[str, float]:
    """Median, 95th percentile and largest."""
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
