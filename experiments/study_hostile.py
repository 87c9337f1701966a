"""Attacks a study while a participant takes part, and says what came of each attack.

    python experiments/study_hostile.py --minutes 1

A server of its own runs the example of `pgf-jax study init`. While the first participant goes from
consent to the code in a browser, programs that are no pages do, again and again: ask for pages of
50 tokens that nobody has; open 50 connections to the participant's own link; send a form twice, and
one of a page that is over, and answers that no questionnaire has; send a million characters as an
answer; and send as many messages as they can. Counts, and how long the participant's clicks took to
be acknowledged meanwhile.
"""

import collections
import dataclasses
import http.client
import json
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from study_platform import Config as PlatformConfig
from study_platform import Pictures, Server, browser, latencies_ms, take_part, write_study
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from pgf_jax.study.design import load_design
from pgf_jax.study.records import read_people

FORMS = 50


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    minutes: float = 1.0  # of a block
    robots: int = 6
    port: int = 8766


class Attacker:
    """Attacks a server until it is told to stop.

    Args:
      port: of the server.
      victim: token of the participant who takes part.
      own: token of the attacker's own link.
    """

    def __init__(self, port: int, victim: str, own: str) -> None:
        self._port, self._victim, self._own = port, victim, own
        self.counts: collections.Counter[str] = collections.Counter()
        self.stopping = threading.Event()

    def run(self) -> None:
        """Attack in turn."""
        attacks: tuple[Callable[[], None], ...] = (
            self._tokens, self._elsewhere, self._forms, self._million, self._flood
        )  # fmt: skip
        while not self.stopping.is_set():
            for attack in attacks:
                attack()

    def _connect(self, token: str) -> Connection:
        return connect(f"ws://127.0.0.1:{self._port}/wp/{token}", max_size=None)

    def _tokens(self) -> None:
        for number in range(FORMS):
            asking = http.client.HTTPConnection("127.0.0.1", self._port, timeout=30)
            asking.request("GET", f"/p/{number:024d}")
            self.counts[f"a token that nobody has: answered {asking.getresponse().status}"] += 1
            asking.close()
            try:
                self._connect(f"{number:024d}").close()
            except InvalidStatus as error:
                self.counts[f"a connection with one: {error.response.status_code}"] += 1

    def _elsewhere(self) -> None:
        lines = [self._connect(self._victim) for _ in range(FORMS)]
        for line in lines:
            said = json.loads(line.recv(timeout=30))["type"]
            self.counts[f"the participant's own link, {FORMS} at a time: {said}"] += 1
            line.close()

    def _forms(self) -> None:
        """Of the own page while it is one of text; after that, of a page that is over."""
        with self._connect(self._own) as line:
            page = self._page(line)
            over = page["kind"] != "text"
            for _ in range(FORMS):
                line.send(json.dumps({"type": "done", "step": 0 if over else page["step"]}))
            moved = max(self._page(line)["step"] for _ in range(FORMS)) - page["step"]
            which = "of a page that is over" if over else "of the page that is shown"
            self.counts[f"a form {which}, {FORMS} times: moves on by {moved} steps"] += 1

    def _page(self, line: Connection) -> dict[str, Any]:
        while (told := json.loads(line.recv(timeout=30)))["type"] != "page":
            pass
        return told

    def _million(self) -> None:
        try:
            with self._connect(self._own) as line:
                line.recv(timeout=30)
                answers = {"comments": "x" * 1_000_000}
                line.send(json.dumps({"type": "done", "step": 1, "answers": answers}))
                while True:
                    line.recv(timeout=30)
        except ConnectionClosed as closed:
            assert closed.rcvd is not None
            self.counts[f"a million characters: closed with {closed.rcvd.code}"] += 1

    def _flood(self) -> None:
        with self._connect(self._own) as line:
            line.recv(timeout=30)
            began = time.monotonic()
            for number in range(1500):
                line.send(json.dumps({"type": "ping", "t": number}))
            while True:
                told = json.loads(line.recv(timeout=60))
                if told["type"] == "pong" and told["t"] == 1499:
                    break
            self.counts["1500 messages at once"] += 1
            self.counts["1500 messages at once: s that they took, in all"] += round(
                time.monotonic() - began
            )


def main(config: Config) -> None:
    """Take part, attack, and print."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "study"
        settings = PlatformConfig(robots=config.robots, minutes=config.minutes)
        write_study(folder, settings)
        server = Server(folder, config.port)
        _, links = server.start(2)
        victim, own = (link.rpartition("/")[2] for link in links)
        attacker = Attacker(config.port, victim, own)
        attacking = threading.Thread(target=attacker.run)
        try:
            with browser() as arrive:
                page = arrive(links[0])
                attacking.start()
                code = take_part(page, Pictures(None))
        finally:
            attacker.stopping.set()
            if attacking.ident is not None:
                attacking.join()
            server.stop()
        print(f"the participant has come to the code {code}")
        for name, count in sorted(attacker.counts.items()):
            print(f"{count:6d}  {name}")
        logged = (folder / "server.log").read_text().splitlines()
        print(f"{sum('WARNING' in line for line in logged)} warnings in the server's log")
        person = read_people(load_design(folder))[0]
        print(f"{sum(len(one.inputs) for one in person.sessions)} services of the participant")
        found = latencies_ms(person.sessions)
        median, high = np.percentile(found, [50, 95])
        print(f"click to acknowledgement: median {median:.0f} ms, 95 % under {high:.0f} ms")


if __name__ == "__main__":
    main(tyro.cli(Config))
