"""Session of planning by hand: a page requests plans, shows the search and saves the problem."""

from __future__ import annotations

import queue
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError, SlipfreeError
from slipfree.problem.load import load_again
from slipfree.problem.plan_edit import Places, edited_text, places_from, places_in
from slipfree.problem.plan_worker import (
    FoundError,
    FoundIterate,
    FoundPlan,
    Message,
    PlanRequest,
    PlanWorker,
)
from slipfree.records import Array
from slipfree.regular_files import read_bytes

SHOWN = 12  # number of iterates drawn
KEPT = 2  # number of plans to compare
IDLE, PLANNING = "idle", "planning"


class Session(NamedTuple):
    """State of a session.

    Attributes
    ----------
    path : Path
        The problem file.
    text : str
        Text of the file as it was read or saved.
    places : Places
        Places in ``text``.
    phase : {"idle", "planning"}
        Whether a search runs.
    line : str
        Last report of the search, or a note on what happened.
    error : str
        Message of the last error; empty without one.
    iterates : tuple of ndarray, each of shape (n, 2)
        Paths of the last iterates, the newest last. [m]
    plans : tuple of FoundPlan
        The last plans, the newest first.
    version : int
        Number of changes, by which a page detects that it is out of date.
    trusted : frozenset of str
        Paths of xacro files that the command line trusts.
    """

    path: Path
    text: str
    places: Places
    phase: str = IDLE
    line: str = ""
    error: str = ""
    iterates: tuple[Array, ...] = ()
    plans: tuple[FoundPlan, ...] = ()
    version: int = 0
    trusted: frozenset[str] = frozenset()

    def changed(self, **values: Any) -> Session:
        """Return the session with other values and the next version."""
        return self._replace(version=self.version + 1, **values)


class Command(NamedTuple):
    """Command of the page: ``"plan"``, ``"cancel"`` or ``"save"``, with the places on the page."""

    name: str
    places: Places | None = None
    is_warm: bool = False


def command_from(name: str, data: object) -> Command:
    """Return the command in the JSON value of a page; errors as in `places_from`."""
    if name == "cancel":
        return Command(name)
    values = data if isinstance(data, dict) else {}
    return Command(name, places_from(values.get("places")), values.get("warm") is True)


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


def saved(session: Session, places: Places) -> Session:
    """Write the problem file with other places, and return the session with them.

    Raises
    ------
    DataError
        If the file has changed since it was read, or cannot be written.
    ProblemError
        If the result is not a valid problem; the file is then unchanged.
    """
    if _read(session.path) != session.text:
        raise DataError(
            f"{session.path}: expected an unchanged file, found that it was changed; restart "
            "slipfree edit"
        )
    text = edited_text(session.text, session.places, places)
    found = places_in(load_again(session.path, text, ()))
    try:
        replace_file(session.path, lambda part: part.write_bytes(text.encode()))
    except OSError as error:
        raise DataError(f"{session.path}: expected a writable file, found: {error}") from error
    words = f"saved {session.path.name}"
    return session.changed(text=text, places=found, line=words, error="")


def open_session(
    path: Path, text: str, places: Places, trusted: frozenset[str] = frozenset()
) -> Session:
    """Return a new session; ``trusted`` are the paths of trusted xacro files."""
    return Session(path, text, places, line="drag the handles, then press Plan", trusted=trusted)


def state_of(session: Session) -> dict[str, Any]:
    """Return the state of a session as a JSON value for the page."""
    return {
        "version": session.version,
        "phase": session.phase,
        "line": session.line,
        "error": session.error,
        "places": _json_places(session.places),
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
    session : Session
        The session at its start.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.worker = PlanWorker()
        self.worker.prepare()
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()

    def accept(self, name: str) -> Callable[[object], object]:
        """Return the function that takes a command of the page; see `command_from`."""

        def put(data: object) -> object:
            self._commands.put(command_from(name, data))
            return {"accepted": name}

        return put

    def step(self, seconds: float) -> None:
        """Execute a command, waiting for it at most ``seconds``, then read all messages."""
        try:
            command = self._commands.get(timeout=seconds)
        except queue.Empty:
            pass
        else:
            self._execute(command)
        for message in self.worker.messages():
            self.session = reported(self.session, message)

    def close(self) -> None:
        """End the worker process."""
        self.worker.cancel()

    def _execute(self, command: Command) -> None:
        session, places = self.session, command.places
        try:
            if places is None:
                self.worker.cancel()
                self.worker.prepare()
                self.session = cancelled(session) if session.phase == PLANNING else session
            elif command.name == "save":
                self.session = saved(session, places)
            else:
                text = edited_text(session.text, session.places, places)
                former = session.plans[0].arrays if command.is_warm and session.plans else {}
                self.worker.start(PlanRequest(session.path, text, (), former, session.trusted))
                self.session = begun(session)
        except SlipfreeError as error:
            self.session = session.changed(error=str(error))


def _read(path: Path) -> str:
    return read_bytes(path, "a problem file").decode("utf-8", errors="replace")
