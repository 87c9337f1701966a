"""Access control: which clients may connect, and how many messages of which types they may send.

viser serves the page and the websocket on one port and has no access control. So the server that
viser starts is wrapped: every request, that of the websocket too, is checked before viser sees it.
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
MESSAGES_PER_S = 100.0  # of a client; further messages are read later
BURST = 400.0  # messages; a page sends many when it opens
LARGEST = 1 << 20  # bytes of a message
# Types of the messages that a page sends. viser accepts others, such as one that opens a public
# tunnel to this computer.
ALLOWED = frozenset(
    {"ViewerCameraMessage", "ScenePointerMessage", "GuiUpdateMessage", "CommandTriggerMessage"}
)


class Bucket:
    """A token bucket: limits the rate of a client's actions, but allows bursts.

    Args:
      rate: actions per second.
      burst: actions at once.
      clock: returns the time, s.
    """

    def __init__(
        self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._at = burst, clock()

    def take(self) -> float:
        """Count one action; returns how much too early it is, s, or 0."""
        now = self._clock()
        self._left = min(self._burst, self._left + (now - self._at) * self._rate)
        self._at = now
        self._left -= 1
        return max(0.0, -self._left / self._rate)

    def allows(self) -> bool:
        """Whether one more action is allowed now; it is counted if it is allowed."""
        if self.take() == 0.0:
            return True
        self._left += 1
        return False


class AccessControl:
    """Checks the requests of clients that want to connect.

    Args:
      needs_token: whether clients need a token; it is drawn at random here.

    Attributes:
      token: that clients need; None: no token is needed.
    """

    def __init__(self, *, needs_token: bool) -> None:
        self.token = secrets.token_urlsafe(24) if needs_token else None

    def check(self, host: str, request: Request) -> Response | None:
        """Check a request.

        Args:
          host: address of the client.
          request: its headers and path.

        Returns:
          The response to send in place of the page; None: the request is allowed.
        """
        headers = request.headers
        name = _hostname(headers.get("Host", ""))
        origin = headers.get("Origin")
        if self.token is None and not _is_loopback(name):
            # Against DNS rebinding: the name of a foreign page may point to this computer.
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
        """Servers that viser starts in this context check their requests and messages."""
        serve = websockets.asyncio.server.serve

        def guarded(handler: Callable, *arguments: Any, **options: Any) -> Any:
            inner = options.pop("process_request")

            def process_request(connection: ServerConnection, request: Request) -> Any:
                refusal = self.check(_host(connection), request)
                return inner(connection, request) if refusal is None else refusal

            return serve(
                _limited(handler),
                *arguments,
                process_request=process_request,
                **(options | {"max_size": LARGEST}),
            )

        websockets.asyncio.server.serve = guarded  # pyright: ignore[reportAttributeAccessIssue]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # pyright: ignore[reportAttributeAccessIssue]


def _limited(
    handler: Callable[[ServerConnection], Awaitable[None]],
) -> Callable[[ServerConnection], Awaitable[None]]:
    """A handler that reads at a limited rate, and refuses messages that are not allowed."""

    async def handle(connection: ServerConnection) -> None:
        bucket, receive = Bucket(MESSAGES_PER_S, BURST), connection.recv
        warned: set[str] = set()

        def warn(what: str) -> None:
            if what not in warned:
                warned.add(what)
                log.warning("client at %s %s", _host(connection), what)

        async def recv() -> bytes:
            while True:
                message = await receive()
                early_s = bucket.take()
                if early_s > 0:
                    warn("sends too many messages: slowed")
                    await asyncio.sleep(early_s)
                kind = _kind(message)
                if kind in ALLOWED:
                    return message  # pyright: ignore[reportReturnType]
                warn(f"may not send {kind!r}: refused")

        connection.recv = recv  # pyright: ignore[reportAttributeAccessIssue]
        try:
            await handler(connection)
        except ConnectionClosed:
            pass
        except Exception as error:
            warn(f"sent a malformed message ({type(error).__name__}): closed")
            await connection.close(1003, "malformed message")

    return handle


def _kind(message: Any) -> str:
    """Type of a message, from the field that viser reads; ValueError if it is malformed."""
    if not isinstance(message, bytes):
        raise ValueError("expected bytes, got text")
    content = msgspec.msgpack.decode(message)
    if not isinstance(content, dict) or not isinstance(content.get("type"), str):
        raise ValueError("not a message of a page")
    return content["type"][:60]


def _host(connection: ServerConnection) -> str:
    address = connection.remote_address
    return str(address[0]) if address else "unknown"


def _hostname(host: str) -> str:
    """Name of a `Host` header, without its port."""
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
