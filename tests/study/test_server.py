"""The server of a study: over real connections, with a client that is no browser."""

import asyncio
import json
import time

import pytest
from study_toys import Served, wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from pgf_jax.study import server as module
from pgf_jax.study.server import FILES, StudyServer


@pytest.fixture
def served(tmp_path):
    served = Served(tmp_path / "study")
    yield served
    served.stop()


def hear(line: ClientConnection, kind: str) -> dict:
    """The next message of a type."""
    while (message := json.loads(line.recv(timeout=20)))["type"] != kind:
        pass
    return message


def say(line: ClientConnection, **message) -> None:
    line.send(json.dumps(message))


def closed(line: ClientConnection) -> int:
    """The code with which the server closes a connection."""
    with pytest.raises(ConnectionClosed) as error:
        while True:
            line.recv(timeout=20)
    assert error.value.rcvd is not None
    return error.value.rcvd.code


def test_pages_are_for_those_with_a_link(served, caplog):
    link, key = served.server.add(), served.server.key
    assert served.get(link)[0] == 200 and "study.js" in served.get(link)[1]
    assert served.get(f"/x/{key}")[0] == 200
    for name in FILES:
        assert served.get(f"/files/{name}")[0] == 200
    refused = served.get("/p/")[1]
    for path in (
        "/", "/p/x", f"{link}x", f"/x/{link[3:]}", f"/p/{key}", "/files/server.py", "/x/",
        "/files/../server.py", "/files/%2e%2e/server.py", "/w/", "/wp/x", "/" + "a" * 3000,
    ):  # fmt: skip
        assert served.get(path) == (404, refused)
    for path in ("/wp/x", f"/wx/{link[3:]}", f"/wp/{key}"):
        with pytest.raises(InvalidStatus):
            served.connect(path)
    with pytest.raises(InvalidStatus, match="403"):
        served.connect(f"/w{link[1:]}", origin="http://evil.example")
    assert link[3:] not in caplog.text and key not in caplog.text


def test_a_participant_and_what_the_experimenter_sees(served):
    link = served.server.add()
    with served.connect(f"/wx/{served.server.key}") as desk:
        assert hear(desk, "people")["people"] == [
            {"number": 0, "step": "consent", "done": 0, "of": 10, "connected": False,
             "paused": False, "running": False}
        ]  # fmt: skip
        with served.connect(f"/w{link[1:]}") as line:
            assert hear(line, "page")["kind"] == "text"
            say(line, type="done", step=0)
            assert "What you do" in hear(line, "page")["html"]
            say(line, type="ping", t=3)
            assert hear(line, "pong")["t"] == 3
            wait_for(lambda: hear(desk, "people")["people"][0]["connected"])
            say(desk, do="pause", number=0)
            hear(line, "paused")
            say(desk, do="go_on", number=0)
            assert hear(line, "page")["step"] == 1
            say(line, type="done", step=1)
            assert hear(line, "page")["kind"] == "practice"
            assert hear(line, "frame")["robots"]
            assert hear(line, "page")["kind"] == "block"
        wait_for(lambda: not hear(desk, "people")["people"][0]["connected"])
        say(desk, do="add")
        assert hear(desk, "link")["path"].startswith("/p/")
        wait_for(lambda: len(hear(desk, "people")["people"]) == 2)


def test_a_second_browser_waits_until_the_first_is_silent(served, monkeypatch):
    link = f"/w{served.server.add()[1:]}"
    with served.connect(link) as first:
        hear(first, "page")
        with served.connect(link) as second:
            assert hear(second, "elsewhere") and closed(second) == 1000
        say(first, type="done", step=0)
        assert hear(first, "page")["step"] == 1  # it has noticed nothing
        monkeypatch.setattr(module, "SILENT_S", 0.2)
        time.sleep(0.3)
        with served.connect(link) as second:
            assert hear(second, "page")["step"] == 1
            assert hear(first, "elsewhere") and closed(first) == 1000
            say(second, type="done", step=1)
            assert hear(second, "page")["kind"] == "practice"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("x" * 1_000_000, 1009),
        ("nonsense", 1008),
        ("[1]", 1008),
        ('{"type": "win"}', 1008),
        ("[" * 50_000, 1008),
        (b"\xff\xfe", 1008),
    ],
)
def test_messages_that_no_page_sends_end_the_connection_and_nothing_else(served, message, code):
    link = f"/w{served.server.add()[1:]}"
    with served.connect(link, max_size=None) as line:
        hear(line, "page")
        line.send(message)
        assert closed(line) == code
    with served.connect(link) as line:
        assert hear(line, "page")["step"] == 0


def test_a_page_that_floods_is_slowed(served, monkeypatch):
    monkeypatch.setattr(module, "MESSAGES_PER_S", 100.0)
    monkeypatch.setattr(module, "BURST", 10.0)
    with served.connect(f"/w{served.server.add()[1:]}") as line:
        hear(line, "page")
        began = time.monotonic()
        for number in range(60):
            say(line, type="ping", t=number)
        while hear(line, "pong")["t"] < 59:
            pass
        assert time.monotonic() - began > 0.4


def test_too_many_connections_are_refused(served, monkeypatch):
    monkeypatch.setattr(module, "MOST_CONNECTIONS", 3)
    desk = f"/wx/{served.server.key}"
    lines = [served.connect(desk) for _ in range(3)]
    with pytest.raises(InvalidStatus, match="503"):
        served.connect(desk)
    lines[0].close()
    wait_for(lambda: served.server._open < 3)
    served.connect(desk).close()
    for line in lines:
        line.close()


def test_a_port_that_is_taken_is_one_line(served, tmp_path):
    other = StudyServer(served.server._design)
    with pytest.raises(module.BadInput, match="port: cannot listen on"):
        asyncio.run(other.run("127.0.0.1", served.port, lambda port: None))
