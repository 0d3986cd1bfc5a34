"""Servers of pages on this machine, and checks of the requests and values that reach them.

viser answers every request to its port and stores every value that it receives. A malicious page in
the user's browser could send such requests and values, directly or by a domain name that resolves
to this machine (DNS rebinding). Programs of other users of this machine reach the port as well;
they do not know the secret in the address of the page.
"""

from __future__ import annotations

import asyncio
import hmac
import io
import json
import logging
import math
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

from slipfree.core.errors import DataError, SlipfreeError

if TYPE_CHECKING:
    import viser

HOST = "127.0.0.1"  # not reachable from the network
NAMES = (HOST, "localhost", "[::1]")  # names of this machine
DEFAULT_PORT = 80  # port of http, which browsers omit
MAX_WARNINGS = 20  # maximum number of warnings
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
        """Return the path of a request without the secret, or else the message of a refusal."""
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
        host, origin = (_short(", ".join(each).lower()) for each in (hosts, origins))
        secret = "with" if has_secret else "without"
        self._count(
            f"refused a request: {expected}, found host {host}, "
            f"origin {origin}, {secret} the secret"
        )
        return "", f"refused: {expected}; open that address in the browser\n"

    def _count(self, words: str) -> None:
        self._refused += 1
        if self._refused == 1:
            self._show(words)
        elif str(self._refused).strip("0") == "1":
            self._show(f"refused {self._refused} requests")


class Guard:
    """Factory of viser servers that accept only requests and values from their own page."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._show, self._shown, self._is_used = report, set[str](), False
        self.gate = Gate("slipfree show", report)
        self._script = f"<script>{page_script('viewer_keys.js')}</script>".encode()

    def start(self, port: int) -> viser.ViserServer:
        """Return a server on this machine; port zero selects a free port."""
        import viser
        from websockets.asyncio import server as web

        serve = web.serve

        logger, handler = logging.Logger("slipfree.show", logging.WARNING), logging.Handler()
        handler.emit = self._log  # type: ignore[method-assign]
        logger.addHandler(handler)

        def guarded(*words: Any, **options: Any) -> Any:
            self._is_used = True
            asyncio.get_running_loop().set_exception_handler(self._report)
            answer = options["process_request"]

            def check(connection: Any, request: Any) -> Any:
                refusal = self._refusal(connection, request)
                if "Accept-Encoding" in request.headers:  # the page is changed before compression
                    del request.headers["Accept-Encoding"]
                return refusal or _with_script(answer(connection, request), self._script)

            options |= {"process_request": check, "logger": logger}
            return serve(*words, **options)

        web.serve = guarded  # type: ignore[assignment, misc]  # viser has no option for it
        try:
            with redirect_stdout(io.StringIO()):  # viser prints a banner despite verbose=False
                server = viser.ViserServer(host=HOST, port=port, verbose=False)
        finally:
            web.serve = serve  # type: ignore[misc]
        if not self._is_used:
            stop(server)
            raise DataError(
                "show: expected a version of viser whose requests slipfree can check, found "
                f"{viser.__version__}; install one: python -m pip install 'viser>=1.1,<1.2'"
            )
        if port and server.get_port() != port:
            stop(server)
            raise taken(port)
        self._check_values(server)
        return server

    def warn(self, words: str) -> None:
        """Report a warning unless it was reported before; report at most 20 warnings."""
        if words not in self._shown and len(self._shown) < MAX_WARNINGS:
            self._shown.add(words)
            more = "; further warnings are not shown" if len(self._shown) == MAX_WARNINGS else ""
            self._show(words + more)

    def _refusal(self, connection: Any, request: Any) -> Any:
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        port = connection.local_address[1]
        path, refusal = self.gate.admit(request.path, hosts, origins, port)
        request.path = path or request.path
        return connection.respond(403, refusal) if refusal else None

    def _check_values(self, server: viser.ViserServer) -> None:
        """Install a handler that passes only valid values to the controls of the page."""
        from viser._messages import GuiUpdateMessage, ShareUrlRequest

        gui, socket = server.gui, server._websock_server

        async def update(client: Any, message: Any) -> None:
            control = gui._gui_input_handle_from_uuid.get(message.uuid)
            if control is None:
                return
            if words := _misfit(control, message.updates):
                self.warn(f"ignored a value of {control.label!r}: {words}")
                return
            await gui._handle_gui_updates(client, message)

        socket.unregister_handler(GuiUpdateMessage)
        socket.register_handler(GuiUpdateMessage, update)
        socket.unregister_handler(ShareUrlRequest)  # it would publish the page on another host

    def _report(self, _loop: object, context: Mapping[str, Any]) -> None:
        self.warn(f"ignored a message: {_short(context.get('exception', context['message']))}")

    def _log(self, record: logging.LogRecord) -> None:
        """Report an error of a connection without its traceback."""
        from websockets.exceptions import InvalidStatus

        error = record.exc_info[1] if record.exc_info else ""
        if isinstance(error, InvalidStatus):
            return  # a response was sent, which websockets before version 14 reports
        self.warn(f"closed a connection: {record.getMessage()}: {_short(error)}")


def _with_script(response: Any, script: bytes) -> Any:
    """Return a response with a script at the end of the page, unchanged if it has no page."""
    before, end, after = response.body.rpartition(b"</body>") if response else (b"", b"", b"")
    if end:
        response.body = before + script + end + after
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response


def page_script(name: str) -> str:
    """Return the text of a script of this package."""
    return files("slipfree.show").joinpath(name).read_text("utf-8")


def stop(server: viser.ViserServer) -> None:
    """Stop a server and suppress its messages."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def _misfit(control: Any, updates: object) -> str | None:
    """Return the error message for an update of a control; None for a valid update."""
    if not isinstance(updates, Mapping) or set(updates) != {"value"}:
        return f"expected a value, found {_short(updates)}"
    value = updates["value"]
    if isinstance(control.value, bool):
        fits, expected = isinstance(value, bool), "true or false"
    elif isinstance(control.value, str):
        fits, expected = value in control.options, f"one of {', '.join(control.options)}"
    else:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        fits, expected = is_number and math.isfinite(value), "a finite number"
    return None if fits else f"expected {expected}, found {_short(value)}"


def _short(value: object) -> str:
    """Return a value as one short line without control characters."""
    words = ascii(value)
    return words if len(words) <= LONGEST else f"{words[:LONGEST]}..."


class Content(NamedTuple):
    """Body of a response and its media type."""

    body: bytes
    kind: str


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
        raise taken(port) from error
    return server


def taken(port: int) -> DataError:
    """Return the error of a port in use."""
    return DataError(
        f"--port: expected a free port, found {port} in use; omit --port to choose a free port"
    )


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
