"""Tests of the viewer's guard: only its own page is answered, and invalid values are ignored."""

from __future__ import annotations

import http.client
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

from slipfree.core.errors import DataError
from slipfree.show.local_server import Guard, stop

viser = pytest.importorskip("viser")
msgpack = pytest.importorskip("msgspec.msgpack")  # which viser needs, as the others
zstandard = pytest.importorskip("zstandard")
errors = pytest.importorskip("websockets.exceptions")
client = pytest.importorskip("websockets.sync.client")

PATIENCE = 30.0  # [s]
EVIL = "http://evil.example"
SLIDER = (float("nan"), float("inf"), None, "boom", True, [1.0], {"a": 1}, b"1")
WRONG = {
    "speed": ("boom", "", None, 1.0, float("nan"), ["1x"], True),
    "time [s]": SLIDER,
    "play": ("boom", None, 1, 0.0, [], float("nan")),
}


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def server(told: list[str]) -> Iterator[Any]:
    guard = Guard(told.append)
    found = guard.start(0)
    found.path = urlsplit(guard.gate.url(found.get_port())).path
    yield found
    stop(found)


def _get(server: Any, path: str | None = None, **headers: str) -> tuple[int, str]:
    """Return the status and the text of a request that has only these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=PATIENCE)
    words = server.path if path is None else path
    connection.putrequest("GET", words, skip_host=True, skip_accept_encoding=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    found = response.status, response.read().decode()
    connection.close()
    return found


def _joined(port: int, path: str, host: str | None = None, origin: str | None = None) -> Any:
    """Return a connection of WebSocket that names a host and an origin."""
    return client.connect(
        f"ws://{host or f'127.0.0.1:{port}'}{path}",
        sock=socket.create_connection(("127.0.0.1", port)),
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        open_timeout=PATIENCE,
        max_size=None,
    )


def _await(is_so: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.02)


def _messages(page: Any) -> Iterator[dict[str, Any]]:
    """Yield the messages of the server."""
    while True:
        data = page.recv(timeout=PATIENCE)
        size = int.from_bytes(data[8:16], "little")
        yield from msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))[
            "messages"
        ]


def _update(uuid: object, updates: object) -> bytes:
    return msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})


@pytest.mark.parametrize("name", ["127.0.0.1", "[::1]", "LocalHost"])
def test_own_pages_are_answered(server: Any, told: list[str], name: str) -> None:
    port = server.get_port()
    host = f"{name}:{port}"
    for headers in ({"Host": host}, {"Host": host, "Origin": f"http://{host}"}):
        status, text = _get(server, **headers)
        assert status == 200
        assert "<title>Viser</title>" in text
    for path, origin in ((server.path, None), (server.path[:-1], f"http://{host}")):
        with _joined(port, path, host, origin) as page:
            assert next(_messages(page))["type"]
    assert told == []


@pytest.mark.parametrize("path", ["/", "/wrong/", "/?a={}", "/{}x/"])
def test_requests_without_the_secret_are_refused(server: Any, told: list[str], path: str) -> None:
    port, secret = server.get_port(), server.path.strip("/")
    path = path.format(secret)
    status, text = _get(server, path, Host=f"127.0.0.1:{port}")
    assert status == 403
    assert "expected the address that slipfree show printed, with its secret" in text
    assert "open that address in the browser" in text
    with pytest.raises(errors.InvalidStatus, match="403"):
        _joined(port, path or "/")
    (words,) = told
    assert words.endswith("without the secret")
    assert secret not in words + text


FOREIGN = {
    "rebound": ("evil.example:{}", None),
    "rebound, with its origin": ("evil.example:{}", f"{EVIL}:{{}}"),
    "another page": ("127.0.0.1:{}", EVIL),
    "a file or a sandbox": ("127.0.0.1:{}", "null"),
    "no origin": ("127.0.0.1:{}", ""),
    "another scheme": ("127.0.0.1:{}", "https://127.0.0.1:{}"),
    "another port": ("127.0.0.1:1", None),
    "a longer name": ("127.0.0.1.evil.example:{}", None),
}


@pytest.mark.parametrize(("host", "origin"), FOREIGN.values(), ids=FOREIGN)
def test_foreign_pages_are_refused(
    server: Any, told: list[str], host: str, origin: str | None
) -> None:
    port = server.get_port()
    headers = {"Host": host.format(port)}
    if origin is not None:
        headers["Origin"] = origin.format(port)
    status, text = _get(server, **headers)
    assert status == 403
    assert "expected the address that slipfree show printed" in text
    (words,) = told
    assert words.endswith("with the secret")
    assert headers["Host"] in words
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    assert _get(server, **headers, **upgrade)[0] == 403
    assert server.get_clients() == {}


def test_requests_without_or_with_two_hosts_are_refused(server: Any, told: list[str]) -> None:
    port = server.get_port()
    assert _get(server)[0] == 403
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.putrequest("GET", "/")
    connection.putheader("Host", "evil.example")
    connection.endheaders()
    assert connection.getresponse().status == 403
    connection.close()
    assert len(told) == 1


def test_warnings_are_few_and_plain(server: Any, told: list[str]) -> None:
    for number in range(12):
        _get(server, Host=f"{number}\x9b2J{'x' * 500}")
    assert len(told) == 2
    assert told[-1] == "refused 10 requests"
    assert all(words.isprintable() and words.isascii() and len(words) < 300 for words in told)


def test_values_that_fit_no_control_are_ignored(
    server: Any, told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slipfree.show.local_server.MAX_WARNINGS", 100)
    gui = server.gui
    controls = {
        "speed": gui.add_dropdown("speed", ("1x", "2x"), initial_value="1x"),
        "time [s]": gui.add_slider("time [s]", 0.0, 4.0, 0.1, 0.0),
        "play": gui.add_checkbox("play", False),
    }
    before = {name: control.value for name, control in controls.items()}
    with _joined(server.get_port(), server.path) as page:
        for name, values in WRONG.items():
            uuid = controls[name]._impl.uuid
            for value in values:
                told.clear()
                page.send(_update(uuid, {"value": value}))
                _await(lambda: bool(told))
                (words,) = told
                assert words.startswith(f"ignored a value of {name!r}: expected "), words
            for updates in ({"update_cb": 1}, {"value": before[name], "gui_api": 1}, {}, None, 1):
                told.clear()
                page.send(_update(uuid, updates))
                _await(lambda: bool(told))
                assert f"ignored a value of {name!r}: expected a value, found " in told[0]
        assert {name: control.value for name, control in controls.items()} == before
        told.clear()
        for name, value in (("speed", "2x"), ("time [s]", 3), ("play", True)):
            page.send(_update(controls[name]._impl.uuid, {"value": value}))
            _await(lambda name=name, value=value: controls[name].value == value)
    assert told == []
    assert isinstance(controls["time [s]"].value, float)


def test_what_is_no_message_closes_its_connection_alone(server: Any, told: list[str]) -> None:
    box = server.gui.add_checkbox("play", False)
    with _joined(server.get_port(), server.path) as good:
        for data in (b"", b"\xc1", b"\x01", "text", msgpack.encode({"type": "Nothing"})):
            told.clear()
            with _joined(server.get_port(), server.path) as bad:
                bad.send(data)
                with pytest.raises(errors.ConnectionClosed):
                    for _ in _messages(bad):
                        pass
            _await(lambda: bool(told))
            assert told[0].startswith("closed a connection: connection handler failed: ")
        told.clear()
        good.send(_update(["no", "name"], {"value": 1}))
        _await(lambda: bool(told))
        assert told[0].startswith("ignored a message: TypeError")
        good.send(_update(box._impl.uuid, {"value": True}))
        _await(lambda: box.value)


def test_nobody_can_ask_for_a_public_address(server: Any) -> None:
    names = {each.__name__ for each in server._websock_server._incoming_handlers}
    assert "GuiUpdateMessage" in names
    assert not any("Share" in name and "Request" in name for name in names)


def test_a_server_that_cannot_be_guarded_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []

    class Other:
        def __init__(self, **_: Any) -> None:
            pass

        def stop(self) -> None:
            ended.append(self)

    monkeypatch.setattr(viser, "ViserServer", Other)
    with pytest.raises(DataError, match="expected a version of viser whose requests"):
        Guard(print).start(0)
    assert len(ended) == 1
