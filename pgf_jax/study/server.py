"""The server of a study: gives each participant the page of their link, and talks with it.

Every request names a token, and a wrong one gets the same answer as none. A link is open in one
browser at a time: a second one is refused while the first answers, and takes over when that has
been silent for `SILENT_S`. Nothing is kept of who asks: no address, and no name of a browser.
"""

import asyncio
import http
import json
import logging
import secrets
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from pgf_jax.console.access_control import Bucket
from pgf_jax.errors import BadInput
from pgf_jax.study.design import Design
from pgf_jax.study.progress import Participant, add_participant, participants
from pgf_jax.study.visit import Turns, Visit

log = logging.getLogger(__name__)

PAGE = Path(__file__).parent / "page"
FILES = {  # that anybody may fetch
    "study.css": "text/css",
    "study.js": "text/javascript",
    "shelves.js": "text/javascript",
    "shelf3d.js": "text/javascript",
    "experimenter.js": "text/javascript",
}
SILENT_S = 10.0
LARGEST = 64 * 1024  # bytes of a message: a form with every text at its longest
MOST_CONNECTIONS = 200
# Of a page: a key that is held down repeats 30 times a second, each with up to four messages.
MESSAGES_PER_S, BURST = 150.0, 600.0
_FRAME = "frame"  # in a queue: the last one, whatever it is by then
RETRY_S = 1.0  # between two looks at who may have a session now
_SAFE = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'self'; connect-src 'self' ws: wss:; "
    "img-src 'self' data:; "
    "frame-ancestors 'none'",
}


class StudyServer:
    """Serves a study.

    Args:
      design: of the study.
      at_once: sessions at a time.

    Attributes:
      key: of the experimenter's page.
      visits: by the participant's number.
    """

    def __init__(self, design: Design, at_once: int = 1) -> None:
        self._design, self._turns = design, Turns(at_once)
        self.key = secrets.token_urlsafe(18)
        self.visits: dict[int, Visit] = {}
        self._lines: dict[int, _Line] = {}  # participant -> the connection that is theirs
        self._open = 0
        for folder in participants(design.folder):
            self._know(folder)

    def _know(self, folder: Path) -> None:
        participant = Participant(self._design, folder)
        self.visits[participant.number] = Visit(self._design, participant, self._turns)

    def add(self) -> str:
        """Add a participant; returns the path of the link, which is shown once."""
        folder, token = add_participant(self._design)
        self._know(folder)
        return f"/p/{token}"

    async def run(self, host: str, port: int, ready: Any) -> None:
        """Serve until it is cancelled.

        Args:
          host, port: to listen on.
          ready: called with the port once it listens.

        Raises:
          BadInput: the port is not free.
        """
        try:
            server: Server = await serve(
                self._talk,
                host,
                port,
                process_request=self._answer,
                max_size=LARGEST,
                max_queue=16,
                server_header=None,
            )
        except OSError as error:
            raise BadInput(f"port: cannot listen on {host}:{port}: {error.strerror}") from None
        async with server:
            ready(next(iter(server.sockets)).getsockname()[1])
            try:
                while True:
                    await asyncio.sleep(RETRY_S)
                    for visit in list(self.visits.values()):
                        visit.begin()
            finally:
                for visit in self.visits.values():
                    await asyncio.to_thread(visit.close)

    # -- requests ----------------------------------------------------------------------------------

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The response to a request; None: it opens a connection that talks."""
        place, _, token = request.path.partition("?")[0].lstrip("/").partition("/")
        if place == "files" and token in FILES:
            return _response((PAGE / token).read_bytes(), FILES[token])
        name = {"p": "participant.html", "x": "experimenter.html"}.get(place)
        if name is not None and (place == "x") == self._is_key(token) and self._may(place, token):
            return _response((PAGE / name).read_bytes(), "text/html")
        if place in ("wp", "wx") and self._may(place[1:], token):
            if self._open >= MOST_CONNECTIONS:
                return _response(b"too many", "text/plain", http.HTTPStatus.SERVICE_UNAVAILABLE)
            if not _same_origin(request.headers):
                return _response(b"no", "text/plain", http.HTTPStatus.FORBIDDEN)
            return None
        log.warning("refused a request for /%s", place[:20])
        return _response(b"There is no such page.", "text/plain", http.HTTPStatus.NOT_FOUND)

    def _is_key(self, token: str) -> bool:
        return secrets.compare_digest(token.encode(), self.key.encode())

    def _may(self, place: str, token: str) -> bool:
        return self._is_key(token) if place == "x" else self._visit(token) is not None

    def _visit(self, token: str) -> Visit | None:
        found = None
        for visit in self.visits.values():  # all, so that no time tells which
            if visit.participant.is_token(token):
                found = visit
        return found

    async def _talk(self, connection: ServerConnection) -> None:
        assert connection.request is not None
        place, _, token = connection.request.path.lstrip("/").partition("/")
        self._open += 1
        try:
            if place == "wx":
                await self._experiment(connection)
            elif (visit := self._visit(token)) is not None:
                await self._participate(connection, visit)
        except ConnectionClosed:
            pass
        finally:
            self._open -= 1

    # -- participants ------------------------------------------------------------------------------

    async def _participate(self, connection: ServerConnection, visit: Visit) -> None:
        number = visit.participant.number
        before = self._lines.get(number)
        if before is not None and time.monotonic() - before.heard_at < SILENT_S:
            await connection.send(json.dumps({"type": "elsewhere"}))
            return
        line = self._lines[number] = _Line(connection)
        if before is not None:
            log.warning("participant %d: another browser takes over", number)
            before.stop()
            visit.detach()
        sender = asyncio.create_task(line.send_all())
        bucket = Bucket(MESSAGES_PER_S, BURST)
        try:
            visit.attach(line.put)
            async for message in connection:
                line.heard_at = time.monotonic()
                if early_s := bucket.take():
                    await asyncio.sleep(early_s)
                if self._lines.get(number) is not line:
                    return
                if not _received(visit, message):
                    log.warning("participant %d: a message that no page sends", number)
                    await connection.close(1008, "no message of a page")
                    return
        finally:
            sender.cancel()
            if self._lines.get(number) is line:
                del self._lines[number]
                visit.detach()

    # -- the experimenter --------------------------------------------------------------------------

    async def _experiment(self, connection: ServerConnection) -> None:
        async def show() -> None:
            while True:
                await connection.send(json.dumps({"type": "people", "people": self._people()}))
                await asyncio.sleep(1.0)

        showing = asyncio.create_task(show())
        try:
            async for message in connection:
                try:
                    given = json.loads(message)
                    if given.get("do") == "add":
                        await connection.send(json.dumps({"type": "link", "path": self.add()}))
                    elif given.get("do") in ("pause", "go_on"):
                        self.visits[given["number"]].pause(given["do"] == "pause")
                    elif given.get("do") == "end":
                        self.visits[given["number"]].end_session()
                except (ValueError, AttributeError, KeyError, TypeError):
                    return
        finally:
            showing.cancel()

    def _people(self) -> list[dict[str, Any]]:
        people = []
        for number, visit in sorted(self.visits.items()):
            person = visit.participant
            step = person.step
            people.append(
                {
                    "number": number,
                    "running": step is not None and step.kind in ("practice", "block"),
                    "step": "done" if step is None or person.finished else step.name,
                    "done": person.done,
                    "of": len(person.steps) - 1,
                    "connected": visit.connected,
                    "paused": visit.paused,
                }
            )
        return people


class _Line:
    """A participant's connection: what is put is sent in order, by the loop's thread.

    Frames that a page has not taken yet become one, so that a slow page is never far behind.
    """

    def __init__(self, connection: ServerConnection) -> None:
        self._connection, self._loop = connection, asyncio.get_running_loop()
        self._queue: asyncio.Queue[str | None] = asyncio.Queue()
        self._frame: dict[str, Any] = {}
        self._robots: dict[int, Any] = {}
        self.heard_at = time.monotonic()

    def put(self, message: Mapping[str, Any]) -> None:
        """Send a message soon; from any thread."""
        self._loop.call_soon_threadsafe(self._put, dict(message))

    def _put(self, message: dict[str, Any]) -> None:
        if message.get("type") != "frame":
            self._queue.put_nowait(json.dumps(message))
            return
        if not self._frame:
            self._queue.put_nowait(_FRAME)
        self._frame = message
        self._robots |= {robot["robot"]: robot for robot in message["robots"]}

    def stop(self) -> None:
        """Close the connection, after what has been put."""
        self._queue.put_nowait(json.dumps({"type": "elsewhere"}))
        self._queue.put_nowait(None)

    async def send_all(self) -> None:
        """Send what is put, until `stop`."""
        while (text := await self._queue.get()) is not None:
            if text == _FRAME:
                text = json.dumps(self._frame | {"robots": list(self._robots.values())})
                self._frame, self._robots = {}, {}
            await self._connection.send(text)
        await self._connection.close()


def _received(visit: Visit, message: str | bytes) -> bool:
    """Whether a message was one of a page."""
    try:
        content = json.loads(message)
        if not isinstance(content, dict):
            return False
        visit.receive(content)
    except (ValueError, RecursionError):
        return False
    return True


def _response(body: bytes, kind: str, status: http.HTTPStatus = http.HTTPStatus.OK) -> Response:
    headers = Headers(_SAFE)
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    return Response(status.value, status.phrase, headers, body)


def _same_origin(headers: Headers) -> bool:
    """Whether the page that asks is ours; programs that are no browsers name no origin."""
    origin = headers.get("Origin")
    return origin is None or origin.partition("://")[2] == headers.get("Host")
