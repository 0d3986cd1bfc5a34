"""Session of planning by hand: a page requests plans, shows the search and saves the problem."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.core.errors import SlipfreeError
from slipfree.core.records import Array
from slipfree.problem.plan_document import Document, is_current, read_document, saved
from slipfree.problem.plan_edit import Places, places_from
from slipfree.problem.plan_worker import (
    FoundError,
    FoundIterate,
    FoundPlan,
    Message,
    PlanRequest,
    PlanWorker,
)
from slipfree.show.local_server import ConflictError
from slipfree.show.plan_page import PlanPage

SHOWN = 12  # number of iterates drawn
KEPT = 2  # number of plans to compare
WATCH = 0.5  # interval between checks of the file for changes by other programs [s]
IDLE, PLANNING = "idle", "planning"


class Session(NamedTuple):
    """State of a session.

    Attributes
    ----------
    document : Document
        The problem file.
    page : PlanPage
        Page and map of the problem.
    file_error : str
        Message of the error by which the present file cannot be used; empty without one.
    phase : {"idle", "planning"}
        Whether a search runs.
    line : str
        Last report of the search, or a note on what happened.
    error : str
        Message of the error that ended the last search; empty without one.
    iterates : tuple of ndarray, each of shape (n, 2)
        Paths of the last iterates, the newest last. [m]
    plans : tuple of FoundPlan
        The last plans, the newest first.
    version : int
        Number of changes, by which a page detects that it is out of date.
    """

    document: Document
    page: PlanPage
    file_error: str = ""
    phase: str = IDLE
    line: str = ""
    error: str = ""
    iterates: tuple[Array, ...] = ()
    plans: tuple[FoundPlan, ...] = ()
    version: int = 0

    def changed(self, **values: Any) -> Session:
        """Return the session with other values and the next version."""
        return self._replace(version=self.version + 1, **values)


class Command(NamedTuple):
    """Command of the page.

    Attributes
    ----------
    name : {"plan", "cancel", "save"}
        Name of the command.
    revision : str
        Revision of the document that the page was made from.
    places : Places or None
        Places on the page; None for ``"cancel"``.
    is_warm : bool
        Whether the search begins with the last plan.
    """

    name: str
    revision: str = ""
    places: Places | None = None
    is_warm: bool = False


def command_from(name: str, data: object) -> Command:
    """Return the command in the JSON value of a page; errors as in `places_from`."""
    if name == "cancel":
        return Command(name)
    values = data if isinstance(data, dict) else {}
    places = places_from(values.get("places"))
    return Command(name, str(values.get("revision")), places, values.get("warm") is True)


def begun(session: Session) -> Session:
    """Return the session at the start of a search."""
    return session.changed(phase=PLANNING, line="setting up the problem", error="", iterates=())


def cancelled(session: Session) -> Session:
    """Return the session after its search was cancelled; the iterates stay visible."""
    return session.changed(phase=IDLE, line="cancelled")


def reported(session: Session, message: Message) -> Session:
    """Return the session after a message of the search."""
    if isinstance(message, FoundIterate):
        iterates = (*session.iterates, message.path)[-SHOWN:]
        return session.changed(line=message.line, iterates=iterates)
    if isinstance(message, FoundError):
        return session.changed(phase=IDLE, line="no plan", error=message.words)
    words = "found a plan" if message.is_complete else "found no complete plan"
    plans = (message, *session.plans)[:KEPT]
    return session.changed(phase=IDLE, line=words, plans=plans, iterates=())


def state_of(session: Session) -> dict[str, Any]:
    """Return the state of a session as a JSON value for the page."""
    return {
        "version": session.version,
        "phase": session.phase,
        "line": session.line,
        "error": session.error,
        "file_error": session.file_error,
        "page": session.page.identity,
        "revision": session.document.revision,
        "places": _json_places(session.document.places),
        "iterates": [_rounded(each) for each in session.iterates],
        "plans": [
            {"path": _rounded(each.path), "complete": each.is_complete, "facts": each.facts}
            for each in session.plans
        ],
    }


def _json_places(places: Places) -> dict[str, Any]:
    regions = [each._asdict() for each in places.regions]
    return {**places._asdict(), "regions": regions}


def _rounded(path: Array) -> list[list[float]]:
    return [[round(float(x), 4), round(float(y), 4)] for x, y in path]


class Desk:
    """Session with its worker process.

    Any thread may give commands; `step` must run in the main thread.

    Parameters
    ----------
    document : Document
        The problem file.
    draw : callable
        Function that returns the page of a document.
    """

    def __init__(self, document: Document, draw: Callable[[Document], PlanPage]) -> None:
        line = "drag the handles, then press Plan"
        self.session = Session(document, draw(document), line=line)
        self.worker = PlanWorker()
        self.worker.prepare()
        self._draw, self._signature, self._next_watch = draw, _signature(document.path), 0.0
        self._commands: queue.SimpleQueue[tuple[Command, Future[object]]] = queue.SimpleQueue()

    def accept(self, name: str) -> Callable[[object], object]:
        """Return the function that executes a command of the page and returns the new state.

        Its errors are those of `command_from` and `saved`, and `ConflictError` if the page was made
        from another revision of the file.
        """

        def put(data: object) -> object:
            answer: Future[object] = Future()
            self._commands.put((command_from(name, data), answer))
            return answer.result()

        return put

    def step(self, seconds: float) -> None:
        """Execute a command, waiting for it at most ``seconds``, then read all messages."""
        try:
            command, answer = self._commands.get(timeout=seconds)
        except queue.Empty:
            pass
        else:
            self._answer(command, answer)
        if time.monotonic() > self._next_watch:
            self._next_watch = time.monotonic() + WATCH
            self._watch()
        for message in self.worker.messages():
            self.session = reported(self.session, message)

    def close(self) -> None:
        """End the worker process."""
        self.worker.cancel()

    def _answer(self, command: Command, answer: Future[object]) -> None:
        try:
            self._execute(command)
        except SlipfreeError as error:
            answer.set_exception(error)
        else:
            answer.set_result(state_of(self.session))

    def _execute(self, command: Command) -> None:
        if command.places is None:
            self.worker.cancel()
            self.worker.prepare()
            if self.session.phase == PLANNING:
                self.session = cancelled(self.session)
            return
        self._read_again()
        session, document = self.session, self.session.document
        if command.revision != document.revision or session.file_error:
            raise ConflictError(state_of(session))
        if command.name == "save":
            document = saved(document, command.places)
            line = f"saved {document.path.name}"
            self.session = session.changed(document=document, line=line)
            self._signature = _signature(document.path)
        else:
            text = document.text_with(command.places)
            former = session.plans[0].arrays if command.is_warm and session.plans else {}
            self.worker.start(
                PlanRequest(document.path, text, (), former, document.problem.trusted)
            )
            self.session = begun(session)

    def _watch(self) -> None:
        """Read the file again if its size, time or inode has changed."""
        signature = _signature(self.session.document.path)
        if signature != self._signature:
            self._signature = signature
            self._read_again()

    def _read_again(self) -> None:
        """Take over the contents of the file if another program has changed them."""
        session, document = self.session, self.session.document
        try:
            if not is_current(document):
                document = read_document(document.path, document.problem.trusted)
                line = f"{document.path.name} was changed by another program"
                self.session = session.changed(
                    document=document, page=self._draw(document), file_error="", line=line
                )
            elif session.file_error:
                self.session = session.changed(file_error="")
        except SlipfreeError as error:
            if str(error) != session.file_error:
                self.session = session.changed(file_error=str(error))


def _signature(path: Path) -> tuple[int, ...]:
    """Return numbers that change when a file is written; none for a missing file."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino
