"""Drives whole participants through a study, from consent to the code, in a real browser.

    python experiments/study_platform.py --people 4 --trouble --pictures experiments/results/pages
    python experiments/study_platform.py --people 20 --robots 20 --minutes 1.2  # an hour

A server of its own runs the example of `pgf-jax study init` with real robots. With `--trouble` the
second participant closes the browser in the first block and comes back, and the third loses the
server (SIGKILL) in the second block. At the end the script says whether all data are there, whether
every acknowledged input is in the logs, whether the sessions replay bit for bit, how long clicks
took to be acknowledged, and what memory the server took, of the first participants and of the last.
"""

import contextlib
import dataclasses
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from playwright.sync_api import sync_playwright

from pgf_jax import configure
from pgf_jax.files import write_atomically
from pgf_jax.study.design import DESIGN, load_design
from pgf_jax.study.example import write_example
from pgf_jax.study.export import export
from pgf_jax.study.records import Person, SessionRecord, read_people
from pgf_jax.sweeping.replay import replay, replay_difference

SIZES = ((1280, 720), (1400, 900))
WAIT_S = 120.0
# Draws without a GPU that is simulated, which would take a core of those that robots plan on.
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-sync",
)


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    people: int = 4
    robots: int = 6
    scene_class: str = "packed"
    minutes: float = 1.0  # of a block
    pushes: int = 3  # of the practice
    trouble: bool = False
    pictures: Path | None = None
    replays: bool = True
    out: Path | None = None  # folder of the study; None: a temporary one
    port: int = 8765
    shelf_3d: bool = False
    cost_curve: bool = False


class Server:
    """The process `pgf-jax study serve`."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.port = folder, port
        self.process: subprocess.Popen[str] | None = None

    def start(self, people: int = 0) -> tuple[str, list[str]]:
        """Start it; returns the experimenter's address and the new participants' links."""
        command = [sys.executable, "-m", "pgf_jax", "study", "serve", str(self.folder)]
        command += ["--port", str(self.port), "--participants", str(people)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        said: list[str] = []
        for line in self.process.stdout:
            said.append(line.strip())
            if line.startswith("Ctrl-C"):
                break
        found = [re.findall(r"http://\S+", line) for line in said]
        links = [one[0] for one in found if one]
        return links[0], links[1:]

    def kill(self) -> None:
        """Kill it as a power cut would."""
        assert self.process is not None
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self) -> None:
        """Stop it as Ctrl-C does."""
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)

    @property
    def memory_mb(self) -> float:
        """Its resident memory, MB."""
        assert self.process is not None
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.findall(r"VmRSS:\s+(\d+)", status)[0]) / 1024


class Pictures:
    """Pictures of each kind of page, once in each size."""

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._taken = folder, set[str]()

    def take(self, page: Any, name: str) -> None:
        """Take one of a page, unless there is one of that name."""
        if self._folder is None or name in self._taken:
            return
        self._taken.add(name)
        self._folder.mkdir(parents=True, exist_ok=True)
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_timeout(400)
            page.screenshot(path=self._folder / f"{name}_{width}.png", full_page=False)
        page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})


def answer(page: Any) -> None:
    """Fill in the form that is shown, and send it."""
    for scale in page.query_selector_all("input[type=range]"):
        scale.focus()
        scale.press("ArrowRight")
    for group in page.query_selector_all("fieldset:has(input[type=radio])"):
        inputs = group.query_selector_all("input")
        values = [one.get_attribute("value") for one in inputs]
        inputs[values.index("green") if "green" in values else 1].check()
    page.click("form button")


def wait_until(page: Any, shown: str, seconds: float) -> bool:
    """Wait until something is true of a page; returns whether it came to be."""
    # Not `page.wait_for_function`: it needs `eval`, which the page's own rules forbid.
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if page.evaluate(shown):
            return True
        page.wait_for_timeout(50)
    return False


def moved_on(page: Any, step: int) -> None:
    """Wait for the page after a step; a server that is lost never sends it."""
    wait_until(page, f"page.step !== {step}", 5)


def help_robot(page: Any) -> None:
    """Push one of the nearest objects aside by keyboard, where there is room for it; else go on."""
    for _ in range(1 + (page.evaluate("frame.request") or 0) % 4):  # another than failed before
        page.keyboard.press("Tab")
    for key, times in (("j", 4), ("l", 8), ("i", 4)):
        for _ in range(times):
            page.keyboard.press(key)
        page.wait_for_timeout(150)
        if page.is_enabled("#push"):
            page.keyboard.press("Enter")
            break
    else:
        page.keyboard.press("g")
    page.wait_for_timeout(150)


def take_part(
    page: Any, pictures: Pictures, until: Callable[[Any], bool] = lambda page: False
) -> str:
    """Go on until the code is shown, or `until` holds; returns the code, or nothing."""
    silent_since = time.monotonic()
    while time.monotonic() - silent_since < WAIT_S:
        before = page.evaluate("[page && page.step, frame && frame.time_s, number]")
        if page.is_visible(".code"):
            pictures.take(page, "closing")
            return page.inner_text(".code")
        if until(page):
            return ""
        if page.is_visible("#block"):
            kind = page.evaluate("page.kind")
            if page.evaluate("frame !== null && frame.served !== null"):
                pictures.take(page, f"{kind}_asked")
                page.keyboard.press("Tab")
                page.keyboard.press("j")
                pictures.take(page, f"{kind}_picked")
                help_robot(page)
            elif page.evaluate("frame !== null && frame.running"):
                pictures.take(page, kind)
        elif page.is_visible("form"):
            pictures.take(page, "questions_" + page.evaluate("page.items[0].name"))
            answer(page)
            moved_on(page, before[0])
        elif page.is_visible("main > button") and page.is_enabled("main > button"):
            pictures.take(page, page.evaluate("document.querySelector('h1').innerText"))
            page.click("main > button")
            moved_on(page, before[0])
        elif page.is_visible("main > button"):
            pictures.take(page, "break")
        page.wait_for_timeout(50)
        if page.evaluate("[page && page.step, frame && frame.time_s, number]") != before:
            silent_since = time.monotonic()
    raise RuntimeError("the page has shown nothing new for two minutes")


def in_block(number: int, seconds: float) -> Callable[[Any], bool]:
    """Whether a page is in its block of that number (from 1), so many seconds in."""

    def there(page: Any) -> bool:
        return page.evaluate(
            "([number, seconds]) => page.kind === 'block' && frame !== null && "
            "frame.time_s > seconds && page.step > (number === 1 ? 2 : 5)",
            [number, seconds],
        )

    return there


@contextlib.contextmanager
def browser() -> Iterator[Callable[..., Any]]:
    """Headless Chromium: a function that opens a link, and waits for what its page shows."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)

        def arrive(link: str, shown: str = "page !== null") -> Any:
            width, height = SIZES[0]
            page = chromium.new_context(viewport={"width": width, "height": height}).new_page()
            page.goto(link)
            if not wait_until(page, shown, WAIT_S):
                raise RuntimeError(f"the page never showed {shown}")
            return page

        yield arrive
        chromium.close()


def write_study(folder: Path, config: Config) -> None:
    """The example, with the settings of the script."""
    write_example(folder)
    path = folder / DESIGN
    text = path.read_text()
    for old, new in (
        ("robots = 6", f"robots = {config.robots}"),
        ('scene_class = "packed"', f'scene_class = "{config.scene_class}"'),
        ("minutes = 5.0", f"minutes = {config.minutes}"),
        ("pushes = 3", f"pushes = {config.pushes}"),
        ("break_s = 30.0", "break_s = 3.0"),
        ("shelf_3d = false", f"shelf_3d = {str(config.shelf_3d).lower()}"),
        ("cost_curve = false", f"cost_curve = {str(config.cost_curve).lower()}"),
    ):
        assert old in text, old
        text = text.replace(old, new, 1)
    write_atomically(path, text.encode())


def run(config: Config, folder: Path) -> list[float]:
    """Drive everybody through; returns the server's memory after each, MB."""
    write_study(folder, config)
    server, pictures, memory = Server(folder, config.port), Pictures(config.pictures), []
    desk, links = server.start(config.people)
    try:
        with browser() as arrive:
            for number, link in enumerate(links, 1):
                page = arrive(link)
                if config.trouble and number == 2:
                    take_part(page, pictures, in_block(1, 30 * config.minutes))
                    page.context.close()
                    time.sleep(5)
                    page = arrive(link)
                if config.trouble and number == 3:
                    take_part(page, pictures, in_block(2, 30 * config.minutes))
                    help_robot(page)  # an input is under way
                    server.kill()
                    pictures.take(page, "lost")
                    server.start()
                code = take_part(page, pictures)
                memory.append(server.memory_mb)
                print(f"participant {number}: code {code}, server {memory[-1]:.0f} MB", flush=True)
                page.context.close()
            if config.pictures is not None and not config.trouble:
                page = arrive(desk, "document.querySelector('#people tbody tr') !== null")
                pictures.take(page, "experimenter")
    finally:
        server.stop()
    return memory


def latencies_ms(sessions: Sequence[SessionRecord]) -> np.ndarray:
    """Of each click or key, until the page was told what came of it, ms."""
    found = []
    for session in sessions:
        since: dict[Any, float] = {}
        for event in session.timing:
            if event["event"] in ("click", "submit"):
                since[event.get("id")] = event["client_ms"]
            elif event["event"] == "told" and event.get("id") in since:
                found.append(event["client_ms"] - since.pop(event.get("id")))
    return np.array(found)


def replays(session: SessionRecord) -> bool:
    """Whether a session replays bit for bit."""
    runner, log = replay(session.folder)
    runner.run_until(log.events[-1].time_ns)
    return replay_difference(runner.fleet.events, log) is None


def report(people: Sequence[Person], memory: Sequence[float], config: Config) -> None:
    """Print what came of it."""
    for person in people:
        inputs = [one for session in person.sessions for one in session.inputs]
        answered = [one for one in inputs if one.outcome in ("push", "go_on")]
        unsaid = sum(not one.acknowledged for one in answered)
        gaps, gaps_s = person.gaps
        blocks = [f"{one.condition} on {one.scene_seed}" for one in person.blocks]
        print(
            f"participant {person.number}: {', '.join(blocks)}; {len(person.answered)} "
            f"questionnaires; {len(answered)} answers, {unsaid} without a word that they are "
            f"recorded; {gaps} gaps, {gaps_s:.0f} s; "
            f"{'whole' if person.progress.finished else 'NOT FINISHED'}"
        )
        # What the page was told is recorded has to be: every word of it is of an answer in the log.
        for session in person.sessions:
            recorded = {(one.robot, one.task, one.request) for one in session.inputs
                        if one.outcome in ("push", "go_on")}  # fmt: skip
            told = {(event.get("robot"), event.get("task"), event.get("request"))
                    for event in session.timing if event["event"] == "acknowledged"}  # fmt: skip
            if told - recorded:
                print(f"  NOT IN THE LOG of {session.name}: {sorted(map(str, told - recorded))}")
    if config.replays:
        sessions = [session for person in people for session in person.sessions]
        same = sum(map(replays, sessions))
        print(f"{same} of {len(sessions)} sessions replay bit for bit")
    half = max(1, len(people) // 2)
    for name, some in (("first", people[:half]), ("last", people[-half:])):
        found = latencies_ms([session for person in some for session in person.sessions])
        if len(found):
            median, high = np.percentile(found, [50, 95])
            print(
                f"click to acknowledgement, the {name} {len(some)} participants: median "
                f"{median:.0f} ms, 95 % under {high:.0f} ms ({len(found)} clicks and keys)"
            )
    print(f"the server's memory: {', '.join(f'{mb:.0f}' for mb in memory)} MB")


def main(config: Config) -> None:
    """Drive, export, check and print."""
    if config.out is None:
        with tempfile.TemporaryDirectory() as folder:
            main(dataclasses.replace(config, out=Path(folder) / "study"))
        return
    memory = run(config, config.out)
    configure()
    design = load_design(config.out)
    tables = export(design, config.out / "export")
    print(", ".join(f"{len(frame)} {name}" for name, frame in tables.items()))
    report(read_people(design), memory, config)


if __name__ == "__main__":
    main(tyro.cli(Config))
