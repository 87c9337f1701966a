"""Access control: checked request by request, and over real connections."""

import http.client
import math

import msgspec
import pytest
import viser
from pages import Server, console, wait_for
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from pgf_jax.console.access_control import COOKIE, AccessControl, Bucket


def request(path="/", **headers):
    return Request(path, Headers({"Host": "127.0.0.1:8080"} | headers))


# --- single requests --------------------------------------------------------------------------


def test_without_a_token_only_names_of_this_computer_pass():
    access = AccessControl(needs_token=False)
    assert access.token is None
    for host in ("127.0.0.1:8080", "localhost:8080", "[::1]:8080"):
        assert access.check("x", request(Host=host)) is None
    for host in ("evil.example:8080", "", "[:::", "192.168.0.3"):
        refusal = access.check("x", request(Host=host))
        assert refusal is not None and refusal.status_code == 403


@pytest.mark.parametrize("needs_token", [False, True])
def test_pages_of_others_cannot_connect(needs_token):
    access = AccessControl(needs_token=needs_token)
    own = {} if access.token is None else {"Cookie": f"{COOKIE}={access.token}"}
    assert access.check("x", request(Origin="http://127.0.0.1:8080", **own)) is None
    for origin in ("http://evil.example", "null", "http://127.0.0.1:9999"):
        refusal = access.check("x", request(Origin=origin, **own))
        assert refusal is not None and refusal.status_code == 403


def test_a_token_is_asked_for_once_and_checked_every_time(caplog):
    access = AccessControl(needs_token=True)
    assert access.token is not None and len(access.token) >= 24
    first = access.check("x", request(f"/?token={access.token}", Host="lab:8080"))
    assert first is not None and first.status_code == 303
    assert first.headers["Location"] == "/"
    cookie = first.headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert access.check("x", request(Host="lab:8080", Cookie=cookie.split(";")[0])) is None
    wrong = [
        request(),
        request(f"/?token={access.token}x"),
        request("/?token="),
        request("/?token=%ff%00"),
        request(Cookie=f"{COOKIE}={access.token[:-1]}"),
        request(Cookie=f"{COOKIE}="),
        request(Cookie=";;=;"),
        request(Cookie=f"other={access.token}"),
    ]
    for each in wrong:
        refusal = access.check("10.0.0.9", each)
        assert refusal is not None and refusal.status_code == 403
    assert caplog.text.count("connection from 10.0.0.9 refused") == len(wrong)
    assert access.token not in caplog.text
    assert AccessControl(needs_token=True).token != access.token


def test_a_bucket_allows_bursts_and_then_its_rate():
    now = [0.0]
    bucket = Bucket(2.0, 3.0, clock=lambda: now[0])
    assert [bucket.allows() for _ in range(5)] == [True] * 3 + [False] * 2
    now[0] = 0.5
    assert [bucket.allows() for _ in range(2)] == [True, False]
    now[0] = 1e6
    assert [bucket.allows() for _ in range(4)] == [True] * 3 + [False]
    slow = Bucket(2.0, 1.0, clock=lambda: now[0])
    assert [slow.take() for _ in range(3)] == [0.0, 0.5, 1.0]


# --- real connections -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A console that listens on all addresses of this computer, and so needs a token."""
    out = tmp_path_factory.mktemp("access") / "s"
    with console(out, "--robots", "2", "--tasks", "50", "--host", "0.0.0.0") as server:
        yield server


def token(server: Server) -> str:
    return server.url.split("token=")[1].strip()


def join(server: Server, cookie: str | None = None, **options) -> Connection:
    headers = {} if cookie is None else {"Cookie": f"{COOKIE}={cookie}"}
    return connect(
        f"ws://127.0.0.1:{server.port}",
        subprotocols=[f"viser-v{viser.__version__}"],  # pyright: ignore[reportArgumentType]
        additional_headers=headers,
        max_size=None,
        **options,
    )


def get(server: Server, path: str, **headers) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def say(connection: Connection, kind: str, **content) -> None:
    connection.send(msgspec.msgpack.encode({"type": kind, **content}))


def look(connection: Connection) -> None:
    """Send the first message of a page, with which viser counts a client as connected."""
    say(
        connection,
        "ViewerCameraMessage",
        wxyz=(0.0, 1.0, 0.0, 0.0),
        position=(6.0, 5.0, 29.0),
        fov=0.35,
        near=0.1,
        far=1e3,
        image_height=900,
        image_width=1055,
        look_at=(6.0, 5.0, 0.0),
        up_direction=(0.0, 1.0, 0.0),
    )


def click(connection: Connection, **changes) -> None:
    content = {
        "event_type": "click",
        "ray_origin": (6.0, 5.0, 29.0),
        "ray_direction": (0.0, 0.0, -1.0),
        "screen_pos": ((0.5, 0.5),),
        "modifier": None,
    }
    say(connection, "ScenePointerMessage", **(content | changes))


def iterations(server: Server) -> int:
    return sum(event["kind"] == "iteration" for event in server.events())


def keeps_planning(server: Server) -> None:
    before = iterations(server)
    wait_for(lambda: iterations(server) > before + 1)


def test_nobody_gets_in_without_the_token(server):
    assert get(server, "/").status == 403
    assert get(server, "/assets/").status == 403
    assert get(server, "/?token=wrong").status == 403
    for cookie in (None, "wrong"):
        with pytest.raises(InvalidStatus) as refused:
            join(server, cookie)
        assert refused.value.response.status_code == 403
    welcome = get(server, f"/?token={token(server)}")
    assert welcome.status == 303
    cookie = str(welcome.getheader("Set-Cookie")).split(";")[0]
    assert get(server, "/", Cookie=cookie).status == 200
    assert token(server) not in server.log()
    assert "a wrong token" in server.log() and "no token" in server.log()


def test_malformed_messages_are_refused_and_the_fleet_keeps_planning(server):
    with join(server, token(server)) as operator:
        look(operator)
        keeps_planning(server)
        known = {"type": "ScenePointerMessage", "event_type": "click", "screen_pos": None}
        for nonsense in (
            b"",
            b"\xc1",
            msgspec.msgpack.encode([1]),
            "text",
            msgspec.msgpack.encode(known),
        ):
            with join(server, token(server)) as client:
                look(client)
                client.send(nonsense)
                with pytest.raises(ConnectionClosed):
                    while True:
                        client.recv(timeout=30)
        with join(server, token(server)) as client:
            look(client)
            # Without the check, viser would open a public tunnel.
            say(client, "ShareUrlRequest")
            say(client, "NoSuchMessage")
            # Messages of a known type with malformed content.
            click(client, ray_origin=None)
            click(client, ray_direction="up")
            click(client, ray_direction=(0.0, 0.0, float("nan")))
            click(client, ray_direction=(1.0, 0.0, 0.0))
            say(client, "GuiUpdateMessage", uuid="none", updates={"value": True})
            say(client, "CommandTriggerMessage", uuid="none")
            wait_for(lambda: "may not send 'ShareUrlRequest'" in server.log())
            wait_for(lambda: "may not send 'NoSuchMessage'" in server.log())
        keeps_planning(server)
        assert server.log().count("malformed message") == 5


def test_a_second_operator_and_a_flood_are_refused_and_the_fleet_keeps_planning(server):
    with join(server, token(server)) as operator, join(server, token(server)) as other:
        look(operator)
        look(other)
        wait_for(lambda: "Somebody else operates; you can watch." in server.log())
        answered = len([e for e in server.events() if e["kind"] == "service_end"])
        for i in range(600):
            click(other, ray_direction=(math.sin(i) / 9, math.cos(i) / 9, -1.0))
        wait_for(lambda: "acts too fast: refused" in server.log())
        wait_for(lambda: "sends too many messages: slowed" in server.log())
        keeps_planning(server)
        # The second client gave no answer, and neither did the operator.
        ends = [e for e in server.events() if e["kind"] == "service_end"]
        assert [e["outcome"] for e in ends[answered:] if e["outcome"] in ("push", "go_on")] == []


def test_a_port_that_is_taken_is_one_line(server, tmp_path, capsys):
    from pgf_jax.cli import main

    code = main(["console", "--port", str(server.port), "--out", str(tmp_path / "s")])
    assert code == 2
    assert f"port: {server.port} is taken" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()
