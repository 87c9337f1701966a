"""The door: who may connect, and how much they may say.

viser serves page and websocket on one port and has no notion of access, so the server that it
starts is wrapped: every request, the websocket's own included, is checked before viser sees it.
"""

import asyncio
import contextlib
import hmac
import http
import ipaddress
import logging
import secrets
import time
from collections.abc import Awaitable, Callable, Iterator
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

log = logging.getLogger(__name__)

COOKIE = "pgf_jax_token"
MESSAGES_PER_S = 100.0  # of a client; more wait, and so does who sends them
BURST = 400.0  # a page says much as it opens
LARGEST = 1 << 20  # bytes of a message
# What a page says. A client could say more to viser, such as to open a public tunnel.
ALLOWED = frozenset(
    {"ViewerCameraMessage", "ScenePointerMessage", "GuiUpdateMessage", "CommandTriggerMessage"}
)


class Bucket:
    """So many things a second, with bursts.

    Args:
      rate: things a second.
      burst: at once.
      clock: time in s.
    """

    def __init__(
        self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._at = burst, clock()

    def take(self) -> float:
        """One thing; how long it is too early, s: 0 if it is not."""
        now = self._clock()
        self._left = min(self._burst, self._left + (now - self._at) * self._rate)
        self._at = now
        self._left -= 1
        return max(0.0, -self._left / self._rate)

    def allows(self) -> bool:
        """Whether one more thing is not too early; counted only if so."""
        if self.take() == 0.0:
            return True
        self._left += 1
        return False


class AccessControl:
    """Checks connections.

    Args:
      needs_token: whether a token is asked for; it is drawn here.

    Attributes:
      token: to be shown to whoever may connect; None: none is needed.
    """

    def __init__(self, *, needs_token: bool) -> None:
        self.token = secrets.token_urlsafe(24) if needs_token else None

    def check(self, host: str, request: Request) -> Response | None:
        """Look at a request; what to answer instead of serving it, or None: it may pass.

        Args:
          host: address that it comes from.
          request: its head.
        """
        headers = request.headers
        name = _hostname(headers.get("Host", ""))
        origin = headers.get("Origin")
        if self.token is None and not _is_loopback(name):
            # A page elsewhere whose name has been made to point here.
            return self._refuse(host, f"the name {name!r} is not this computer's")
        if origin is not None and urlsplit(origin).netloc != headers.get("Host"):
            return self._refuse(host, f"a page of {origin!r}")
        if self.token is None:
            return None
        given = parse_qs(urlsplit(request.path).query).get("token")
        if given is not None:
            if not self._is_token(given[0]):
                return self._refuse(host, "a wrong token")
            cookie = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            return Response(
                http.HTTPStatus.SEE_OTHER,
                "See Other",
                Headers({"Location": "/", "Set-Cookie": cookie, "Content-Length": "0"}),
            )
        if not self._is_token(_cookie(headers.get("Cookie", ""))):
            return self._refuse(host, "no token")
        return None

    def _is_token(self, given: str) -> bool:
        assert self.token is not None
        return hmac.compare_digest(given.encode(), self.token.encode())

    @staticmethod
    def _refuse(host: str, why: str) -> Response:
        log.warning("connection from %s refused: %s", host, why)
        body = b"Refused: open the address that the server has printed, token included.\n"
        headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body))})
        return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)

    @contextlib.contextmanager
    def guard(self) -> Iterator[None]:
        """Servers that viser starts in here have this door."""
        serve = websockets.asyncio.server.serve

        def guarded(handler: Callable, *arguments: Any, **options: Any) -> Any:
            inner = options.pop("process_request")

            def process_request(connection: ServerConnection, request: Request) -> Any:
                refusal = self.check(_host(connection), request)
                return inner(connection, request) if refusal is None else refusal

            return serve(
                _patient(handler),
                *arguments,
                process_request=process_request,
                **(options | {"max_size": LARGEST}),
            )

        websockets.asyncio.server.serve = guarded  # pyright: ignore[reportAttributeAccessIssue]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # pyright: ignore[reportAttributeAccessIssue]


def _patient(
    handler: Callable[[ServerConnection], Awaitable[None]],
) -> Callable[[ServerConnection], Awaitable[None]]:
    """A connection's handler that reads no faster than it may, and survives what it cannot read."""

    async def handle(connection: ServerConnection) -> None:
        bucket, receive = Bucket(MESSAGES_PER_S, BURST), connection.recv
        told: set[str] = set()

        def tell(what: str) -> None:
            if what not in told:
                told.add(what)
                log.warning("client at %s %s", _host(connection), what)

        async def recv() -> bytes:
            while True:
                message = await receive()
                early_s = bucket.take()
                if early_s > 0:
                    tell("sends too much: slowed")
                    await asyncio.sleep(early_s)
                kind = _kind(message)
                if kind in ALLOWED:
                    return message  # pyright: ignore[reportReturnType]
                tell(f"may not say {kind!r}: refused")

        connection.recv = recv  # pyright: ignore[reportAttributeAccessIssue]
        try:
            await handler(connection)
        except ConnectionClosed:
            pass
        except Exception as error:
            tell(f"sent a malformed message ({type(error).__name__}): closed")
            await connection.close(1003, "malformed message")

    return handle


def _kind(message: Any) -> str:
    """What a message is, by the word in it that viser goes by; ValueError if it is none."""
    if not isinstance(message, bytes):
        raise ValueError("text, where bytes were expected")
    content = msgspec.msgpack.decode(message)
    if not isinstance(content, dict) or not isinstance(content.get("type"), str):
        raise ValueError("no message of a page")
    return content["type"][:60]


def _host(connection: ServerConnection) -> str:
    address = connection.remote_address
    return str(address[0]) if address else "unknown"


def _hostname(host: str) -> str:
    """Of a `Host` header, its port left out."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_loopback(name: str) -> bool:
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _cookie(header: str) -> str:
    try:
        morsel = SimpleCookie(header).get(COOKIE)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value
