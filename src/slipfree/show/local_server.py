"""HTTP server of a page on this machine, with the checks of requests of `slipfree.show.guard`."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

from slipfree.core.errors import DataError, SlipfreeError
from slipfree.show.guard import HOST, Gate

MOST = 1_000_000  # maximum size of a request [bytes]
TIMEOUT = 20.0  # longest wait for the rest of a request [s]
POLICY = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Content(NamedTuple):
    """Body of a response and its media type."""

    body: bytes
    kind: str


Get = Callable[[], Content]
Post = Callable[[object], object]


class ConflictError(SlipfreeError):
    """Refusal of a request that was made from another state than the present one.

    Parameters
    ----------
    state : object
        The present state, a JSON value.
    """

    def __init__(self, state: object) -> None:
        super().__init__("expected a request made from the present state, found an earlier one")
        self.state = state


def start_server(
    port: int, get: Mapping[str, Get], post: Mapping[str, Post], gate: Gate
) -> ThreadingHTTPServer:
    """Return an HTTP server for the requests of its own page; the caller must start it.

    Parameters
    ----------
    port : int
        Port; zero selects a free one.
    get : mapping of str to callable
        Functions that return the content of a path.
    post : mapping of str to callable
        Functions that take the JSON value sent to a path and return a JSON value. A `SlipfreeError`
        becomes a response with status 400, a `ConflictError` one with status 409 and its state.
    gate : Gate
        Checks of the requests.

    Raises
    ------
    DataError
        If the port is in use.
    """

    class Handler(BaseHTTPRequestHandler):
        """Handler of requests; see `start_server`."""

        timeout = TIMEOUT

        def do_GET(self) -> None:
            if (path := self._admitted()) is None:
                return
            found = get.get(path)
            self._send(200, found()) if found else self._send(404, _text("not found"))

        def do_POST(self) -> None:
            if (path := self._admitted()) is None:
                return
            act = post.get(path)
            length = self.headers.get("Content-Length", "")
            is_json = self.headers.get_content_type() == "application/json"
            if act is None:
                self._send(404, _text("not found"))
            elif not is_json or not length.isdecimal() or int(length) > MOST:
                self._send(400, _text(f"expected JSON of at most {MOST} bytes"))
            else:
                self._answer(act, self.rfile.read(int(length)))

        def _answer(self, act: Post, body: bytes) -> None:
            try:
                self._send(200, json_content(act(json.loads(body))))
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
            self.send_header("Content-Security-Policy", POLICY)
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Referrer-Policy", "no-referrer")  # the address has a secret
            self.end_headers()
            self.wfile.write(content.body)

        def log_message(self, *_: Any) -> None:
            """Log nothing."""

    try:
        server = _Server((HOST, port), Handler)
    except OSError as error:
        raise DataError(
            f"--port: expected a free port, found {port} in use; omit --port to choose a free port"
        ) from error
    return server


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
