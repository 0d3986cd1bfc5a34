"""Tests of the server of pages: it answers its own page alone, and tells its secret to nobody."""

import http.client
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from helpers.commands import refuses
from slipfree.cli.outputs import open_page
from slipfree.core.errors import DataError
from slipfree.show.local_server import ConflictError, Gate, json_content, start_server

PORT = 4321
EVIL = "http://evil.example"
JSON = "application/json"


@pytest.fixture
def told() -> list[str]:
    """Return the warnings of the gate."""
    return []


@pytest.fixture
def gate(told: list[str]) -> Gate:
    return Gate("slipfree edit", told.append)


def path_of(gate: Gate) -> str:
    return urlsplit(gate.url(PORT)).path


@pytest.mark.parametrize("name", ["127.0.0.1", "[::1]", "LocalHost"])
def test_own_pages_are_admitted(gate: Gate, told: list[str], name: str) -> None:
    host = f"{name}:{PORT}"
    for origins in ([], [f"http://{host}"]):
        assert gate.admit(f"{path_of(gate)}map.png", [host], origins, PORT) == ("/map.png", "")
    assert told == []


FOREIGN = {
    "rebound": (["evil.example:4321"], []),
    "rebound, with its origin": (["evil.example:4321"], [f"{EVIL}:4321"]),
    "another page": (["127.0.0.1:4321"], [EVIL]),
    "a file or a sandbox": (["127.0.0.1:4321"], ["null"]),
    "no origin": (["127.0.0.1:4321"], [""]),
    "another scheme": (["127.0.0.1:4321"], ["https://127.0.0.1:4321"]),
    "another port": (["127.0.0.1:1"], []),
    "a longer name": (["127.0.0.1.evil.example:4321"], []),
    "no host": ([], []),
    "two hosts": (["127.0.0.1:4321", "evil.example"], []),
}


@pytest.mark.parametrize(("hosts", "origins"), FOREIGN.values(), ids=FOREIGN)
def test_foreign_pages_are_refused(
    gate: Gate, told: list[str], hosts: list[str], origins: list[str]
) -> None:
    path, words = gate.admit(path_of(gate), hosts, origins, PORT)
    assert path == ""
    assert "expected the address that slipfree edit printed, with its secret; open" in words
    (warning,) = told
    assert warning.endswith("with the secret")
    assert ", ".join(hosts) in warning


def test_only_who_knows_the_secret_is_admitted_and_refusals_are_counted(
    gate: Gate, told: list[str]
) -> None:
    secret = path_of(gate).strip("/")
    near = secret[:-1]
    for path in ("/", "/echo", f"/{near}/", f"/x{near}/", f"/?a={secret}", f"/{secret}x/", "*"):
        assert gate.admit(path, [f"127.0.0.1:{PORT}"], [], PORT)[0] == ""
    for number in range(7, 300):
        gate.admit("/\udcff\xe9", [f"{number}\x9b2J{'x' * 500}"], [], PORT)
    first, *others = told
    assert first.endswith("without the secret")
    assert others == ["refused 10 requests", "refused 100 requests"]
    assert secret not in first
    gate.admit(path_of(gate), [f"\x9b2J{'x' * 500}"], [], PORT)
    for _ in range(700):
        gate.admit("/", [], [], PORT)
    assert all(words.isprintable() and words.isascii() and len(words) < 300 for words in told)


class Client:
    """Connection to a server that echoes what is posted to ``/echo``."""

    def __init__(self, port: int, path: str) -> None:
        self.port, self.path = port, path.rstrip("/")

    def ask(self, method: str, path: str, body: str = "", **headers: str) -> tuple[int, str]:
        """Return status and text of the answer to a request with the secret."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, f"{self.path}{path}", body or None, names)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


@pytest.fixture
def client(gate: Gate) -> Iterator[Client]:
    def refuse(_: object) -> object:
        raise DataError("expected another value")

    def conflict(_: object) -> object:
        raise ConflictError({"version": 1})

    get = {"/": lambda: json_content("page")}
    post = {"/echo": lambda data: data, "/no": refuse, "/old": conflict}
    server = start_server(0, get, post, gate)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield Client(server.server_port, path_of(gate))
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_server_answers_its_own_page_only(client: Client, told: list[str]) -> None:
    assert client.ask("GET", "/") == (200, '"page"')
    assert client.ask("POST", "/echo", "[1]", Content_Type=JSON) == (200, "[1]")
    assert client.ask("GET", "/other")[0] == 404
    assert client.ask("POST", "/", "[1]", Content_Type=JSON)[0] == 404
    assert client.ask("POST", "/no", "[1]", Content_Type=JSON) == (400, "expected another value")
    assert client.ask("POST", "/old", "[1]", Content_Type=JSON) == (409, '{"version": 1}')
    assert client.ask("POST", "/echo", "[1]", Content_Type="text/plain")[0] == 400
    assert client.ask("POST", "/echo", "{", Content_Type=JSON)[0] == 400
    assert client.ask("POST", "/echo", "[" * 100_000, Content_Type=JSON)[0] == 400
    assert client.ask("POST", "/echo", Content_Type=JSON, Content_Length="9" * 9)[0] == 400
    assert told == []
    assert client.ask("POST", "/echo", "[1]", Content_Type=JSON, Origin=EVIL)[0] == 403
    status, words = client.ask("GET", "/", Host="a.example")
    assert status == 403
    assert "expected the address that slipfree edit printed, with its secret" in words
    (warning,) = told
    assert "origin 'http://evil.example', with the secret" in warning
    bare = http.client.HTTPConnection("127.0.0.1", client.port, timeout=20)
    bare.putrequest("GET", f"{client.path}/", skip_host=True)
    bare.endheaders()
    assert bare.getresponse().status == 403


def test_a_port_in_use_is_refused(client: Client, gate: Gate) -> None:
    words = f"expected a free port, found {client.port} in use"
    refuses(DataError, words, start_server, client.port, {}, {}, gate)


def test_browsers_get_the_address_by_a_private_file(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", opened.append)
    open_page("http://127.0.0.1:1/secret/", browser=True)
    (address,) = opened
    assert "secret" not in address
    file = Path(urlsplit(address).path)
    assert "http://127.0.0.1:1/secret/" in file.read_text(encoding="utf-8")
    assert file.stat().st_mode & 0o077 == 0
