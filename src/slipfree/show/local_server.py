"""Server of pages on this machine, and checks of the requests that reach it.

A malicious page in the user's browser could send requests, directly or by a domain name that
resolves to this machine (DNS rebinding). Programs of other users of this machine reach the port as
well; they do not know the secret in the address of the page.
"""

from __future__ import annotations

import hmac
import json
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, NamedTuple

from slipfree.core.errors import DataError, SlipfreeError, shortened

HOST = "127.0.0.1"  # not reachable from the network
NAMES = (HOST, "localhost", "[::1]")  # names of this machine
DEFAULT_PORT = 80  # port of http, which browsers omit
LONGEST = 60  # maximum number of characters of a value in a warning
MAX_REQUEST = 1_000_000  # maximum size of a request [bytes]
TIMEOUT = 20.0  # longest wait for the rest of a request [s]
POLICY = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
Post = Callable[[object], object]


class Gate:
    """Checks of requests to a page of ``command``; ``report`` gets warnings, from any thread."""

    def __init__(self, command: str, report: Callable[[str], None]) -> None:
        self._command, self._show, self._refused = command, report, 0
        self._prefix = f"/{secrets.token_urlsafe(24)}/"

    def url(self, port: int) -> str:
        """Return the address of the page, which contains the secret."""
        return f"http://{HOST}:{port}{self._prefix}"

    def admit(
        self, path: str, hosts: Sequence[str], origins: Sequence[str], port: int
    ) -> tuple[str, str]:
        """Return the path of a request without the secret, or else the message of a refusal.

        ``hosts`` and ``origins`` are its headers Host and Origin, which must address this server:
        that of another page would let a web site send requests.
        """
        prefix, rest = path[: len(self._prefix)], path[len(self._prefix) :]
        prefix = f"{prefix.rstrip('/')}/"  # viser's page connects to its address without this slash
        has_secret = hmac.compare_digest(
            prefix.encode(errors="backslashreplace"), self._prefix.encode()
        )
        # the headers Host and Origin must address this machine from its own page
        own = {f"{name}:{port}" for name in NAMES} | ({*NAMES} if port == DEFAULT_PORT else set())
        lower = [each.lower() for each in hosts]
        is_same = [each.lower() for each in origins] == [f"http://{each}" for each in lower]
        is_own = len(lower) == 1 and lower[0] in own and (is_same or not origins)
        if is_own and has_secret:
            return f"/{rest}", ""
        expected = f"expected the address that {self._command} printed, with its secret"
        # in one line without control characters
        host, origin = (
            shortened(ascii(", ".join(each).lower()), LONGEST) for each in (hosts, origins)
        )
        secret = "with" if has_secret else "without"
        self._refused += 1
        if self._refused == 1:
            self._show(
                f"refused a request: {expected}, found host {host}, "
                f"origin {origin}, {secret} the secret"
            )
        elif str(self._refused).strip("0") == "1":
            self._show(f"refused {self._refused} requests")
        return "", f"refused: {expected}; open that address in the browser\n"


def page_file(name: str) -> str:
    """Return the text of a page, a script or a style sheet of this package."""
    return files("slipfree.show").joinpath(name).read_text("utf-8")


class Content(NamedTuple):
    """Body of a response, its media type and its content security policy."""

    body: bytes
    kind: str
    policy: str = POLICY


Get = Callable[[], Content]


class ConflictError(SlipfreeError):
    """Refusal of a request that was made from another state than the present one, a JSON value."""

    def __init__(self, state: object) -> None:
        super().__init__("expected a request made from the present state, found an earlier one")
        self.state = state


def start_server(
    port: int, get: Mapping[str, Get], post: Mapping[str, Post], gate: Gate
) -> ThreadingHTTPServer:
    """Return an HTTP server for the requests of its own page; the caller must start it.

    Functions of ``get`` return the content of a path; those of ``post`` take the JSON value sent to
    a path and return one. Their `SlipfreeError` becomes a response with status 400, a
    `ConflictError` one with status 409 and its state. Port zero selects a free one.
    """

    class Handler(BaseHTTPRequestHandler):
        """Handler of requests; see `start_server`."""

        timeout = TIMEOUT

        def do_GET(self) -> None:
            if (path := self._admitted()) is None:
                return
            content = get.get(path)
            self._send(200, content()) if content else self._send(404, _text("not found"))

        def do_POST(self) -> None:
            if (path := self._admitted()) is None:
                return
            act = post.get(path)
            length = self.headers.get("Content-Length", "")
            is_json = self.headers.get_content_type() == "application/json"
            if act is None:
                self._send(404, _text("not found"))
            elif not is_json or not length.isdecimal() or int(length) > MAX_REQUEST:
                self._send(400, _text(f"expected JSON of at most {MAX_REQUEST} bytes"))
            else:
                try:
                    self._send(200, json_content(act(json.loads(self.rfile.read(int(length))))))
                except ConflictError as error:
                    self._send(409, json_content(error.state))
                except SlipfreeError as error:
                    self._send(400, _text(str(error)))
                except (ValueError, RecursionError):
                    self._send(400, _text("expected JSON, found invalid JSON; reload the page"))

        def _admitted(self) -> str | None:
            """Return the path without the secret; send the refusal and return None without it."""
            hosts, origins = (self.headers.get_all(each) or [] for each in ("Host", "Origin"))
            here = int(self.connection.getsockname()[1])
            path, refusal = gate.admit(self.path, hosts, origins, here)
            if refusal:
                self._send(403, _text(refusal))
            return path or None

        def _send(self, status: int, content: Content) -> None:
            self.send_response(status)
            self.send_header("Content-Type", content.kind)
            self.send_header("Content-Length", str(len(content.body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("Content-Security-Policy", content.policy)
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Referrer-Policy", "no-referrer")  # the address has a secret
            self.end_headers()
            self.wfile.write(content.body)

        def log_message(self, *_: Any) -> None:
            """Log nothing."""

    try:
        server = _Server((HOST, port), Handler)
    except OSError as error:
        raise taken(port) from error
    return server


def taken(port: int) -> DataError:
    """Return the error of a port in use."""
    remedy = "omit --port to choose a free port"
    return DataError(f"--port: expected a free port, found {port} in use; {remedy}")


class _Server(ThreadingHTTPServer):
    """Server whose connections end silently when the page is closed."""

    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # elsewhere it would share a port that is in use

    def handle_error(self, *_: Any) -> None:
        """Ignore errors of a connection."""


def json_content(value: object) -> Content:
    """Return a value as JSON."""
    return Content(json.dumps(value).encode(), "application/json")


def _text(words: str) -> Content:
    return Content(words.encode(), "text/plain; charset=utf-8")
