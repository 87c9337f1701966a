"""Headless Chromium and the console's page, for `console_latency.py` and for the tests."""

import json
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from pgf_jax.console import layout
from pgf_jax.console.page import MARGIN

# Renders WebGL in software, and sends nothing to other computers.
CHROMIUM_FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-sync",
)
WIDTH, HEIGHT = 1400, 900  # of the page, pixels


def pixel_of(page: Page, x: float, y: float) -> tuple[float, float]:
    """The pixel of a page that shows a place (x, y) of the console's drawing, units."""
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    visible = max(layout.HEIGHT, layout.WIDTH * box["height"] / box["width"]) * MARGIN
    scale = box["height"] / visible  # pixels per unit
    return (
        box["x"] + box["width"] / 2 + scale * (x - layout.WIDTH / 2),
        box["y"] + box["height"] / 2 - scale * (y - layout.HEIGHT / 2),
    )


def journal_events(session: Path) -> list[dict[str, Any]]:
    """The events in a session's journal so far; a line that is being written is left out."""
    lines = (session / "events.jsonl").read_text().split("\n")[1:-1]
    return [json.loads(line) for line in lines]
