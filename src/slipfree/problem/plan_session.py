"""Planning by hand: a page requests plans from a process and shows the search; see `Session`."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.core.errors import SlipfreeError
from slipfree.core.records import Array
from slipfree.problem.plan_edit import (
    Document,
    Places,
    is_current,
    places_from,
    read_document,
    saved,
)
from slipfree.show.html_page import PlanPage
from slipfree.show.local_server import ConflictError
from slipfree.system.processes import for_children, prepare_process

INTERVAL = 0.08  # shortest time between two reported iterates [s]
SAMPLES = 400  # largest number of points of a reported path
SHOWN = 12  # number of iterates drawn
KEPT = 2  # number of plans to compare
WATCH = 0.5  # interval between checks of the file for changes by other programs [s]
IDLE, PLANNING = "idle", "planning"


class PlanRequest(NamedTuple):
    """Planning problem to solve."""

    path: Path  # for messages and input files
    text: str
    former: Mapping[str, Array] = {}  # arrays of a plan for a warm start
    trusted: frozenset[str] = frozenset()


class FoundIterate(NamedTuple):
    """Iterate of a search: a line of text and the path, shape (n, 2) [m]."""

    line: str
    path: Array


class FoundPlan(NamedTuple):
    """Result of a search."""

    path: Array  # in the simulation of the plan, shape (n, 2) [m]
    is_complete: bool  # solved and accurate
    facts: tuple[tuple[str, str], ...]
    arrays: Mapping[str, Array]  # for a warm start


Message = FoundIterate | FoundPlan | str  # a text is the error that ended a search


class PlanWorker:
    """Process that solves one problem at a time; it must be used in the main thread.

    The process is kept for further problems. `cancel` kills it, so that a search ends at once.
    """

    def __init__(self) -> None:
        self._process: Any = None
        self._connection: Connection[Any, Any] | None = None
        self.is_busy = False

    def prepare(self) -> None:
        """Start the process, which loads its packages, so that the first search begins sooner."""
        if self._connection is None or not self._process.is_alive():
            self.cancel()
            context = get_context("spawn")  # CasADi is not safe in forked processes
            self._connection, other = context.Pipe()
            self._process = context.Process(target=_solve_requests, args=(other,), daemon=True)
            with for_children():
                self._process.start()
            other.close()

    def start(self, request: PlanRequest) -> None:
        """Begin to solve a problem; a search that still runs is cancelled."""
        if self.is_busy:
            self.cancel()
        self.prepare()
        if self._connection is not None:
            self._connection.send(request)
        self.is_busy = True

    def messages(self) -> Iterator[Message]:
        """Yield the messages that have arrived."""
        while self.is_busy and self._connection is not None:
            try:
                if not self._connection.poll():
                    return
                message: Message = self._connection.recv()
            except (EOFError, OSError):
                self.cancel()
                yield (
                    "expected a running planning process, found that it ended, possibly out of "
                    "memory; plan again, with fewer intervals"
                )
                return
            self.is_busy = isinstance(message, FoundIterate)
            yield message

    def cancel(self) -> None:
        """Kill the process; without one, do nothing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._connection is not None:
            self._connection.close()
        self._process, self._connection, self.is_busy = None, None, False


def _solve_requests(connection: Connection[Any, Any]) -> None:
    import slipfree.problem.result  # noqa: F401 - loads while the user is editing

    prepare_process()
    while True:
        try:
            request: PlanRequest = connection.recv()
        except EOFError:
            return
        connection.send(_solve(request, connection))


def _solve(request: PlanRequest, connection: Connection[Any, Any]) -> Message:
    """Return the plan of a problem, or the error; send iterates to a connection."""
    from slipfree.plan.polynomial_motion import from_arrays
    from slipfree.problem.load import load_again
    from slipfree.problem.result import run_problem

    last, line = 0.0, ""

    def keep_line(_phase: str, words: str) -> None:
        nonlocal line
        line = words

    def send_path(path: Array) -> None:
        nonlocal last
        if time.monotonic() - last >= INTERVAL:
            connection.send(FoundIterate(line, path))
            last = time.monotonic()

    begin = time.monotonic()
    try:
        problem = load_again(request.path, request.text, (), request.trusted)
        former = from_arrays(request.former, "the last plan") if request.former else None
        result = run_problem(problem, None, keep_line, former, send_path)
    except SlipfreeError as error:
        return str(error)
    except MemoryError:
        return "expected enough memory for the plan, found none left; use fewer intervals"
    return _plan_of(result, time.monotonic() - begin)


def _plan_of(result: Any, seconds: float) -> FoundPlan:
    """Return path and facts of a result; ``seconds`` is the time of the whole search."""
    import numpy as np

    from slipfree.core.facts import starting_with
    from slipfree.core.trajectory import outcome_words
    from slipfree.problem.verbs.base import drive_facts

    run = result.trajectory
    costs = starting_with("plan_cost_", run.facts)
    driven = drive_facts(run)
    facts = [
        ("outcome", outcome_words(run)),
        ("duration", f"{driven['duration']:.4g}"),
        ("path length", f"{driven['path_length']:.4g}"),
        *((f"cost {name.replace('_', ' ')}", f"{cost.value:.4g}") for name, cost in costs.items()),
        ("largest slip", f"{driven['slip_largest']:.3g}"),
        ("iterations", f"{run.facts['plan_iterations'].value:.0f}"),
        ("time of the search", f"{seconds:.1f} s"),
    ]
    chosen = np.unique(np.linspace(0, run.t.size - 1, SAMPLES).round().astype(int))
    path = np.stack([run["x"], run["y"]], axis=1)[chosen]
    return FoundPlan(path, not result.outcome.exit_code, tuple(facts), dict(result.arrays))


class Session(NamedTuple):
    """State of a session."""

    document: Document
    page: PlanPage
    file_error: str = ""  # by which the present file cannot be used
    phase: str = IDLE
    line: str = ""  # last report of the search, or a note on what happened
    error: str = ""  # that ended the last search
    iterates: tuple[Array, ...] = ()  # paths, the newest last, shape (n, 2) [m]
    plans: tuple[FoundPlan, ...] = ()  # the newest first
    version: int = 0  # number of changes, by which a page detects that it is out of date

    def changed(self, **values: Any) -> Session:
        """Return the session with other values and the next version."""
        return self._replace(version=self.version + 1, **values)


class Command(NamedTuple):
    """Command of the page: "plan", "cancel" or "save"."""

    name: str
    revision: str = ""  # of the document from which the page was made
    places: Places | None = None  # None to cancel
    is_warm: bool = False  # whether the search begins with the last plan


def reported(session: Session, message: Message) -> Session:
    """Return the session after a message of the search."""
    if isinstance(message, FoundIterate):
        iterates = (*session.iterates, message.path)[-SHOWN:]
        return session.changed(line=message.line, iterates=iterates)
    if isinstance(message, str):
        return session.changed(phase=IDLE, line="no plan", error=message)
    words = "found a plan" if message.is_complete else "found no complete plan"
    plans = (message, *session.plans)[:KEPT]
    return session.changed(phase=IDLE, line=words, plans=plans, iterates=())


def state_of(session: Session) -> dict[str, Any]:
    """Return the state of a session as a JSON value for the page."""
    places = session.document.places
    return {
        "version": session.version,
        "phase": session.phase,
        "line": session.line,
        "error": session.error,
        "file_error": session.file_error,
        "page": session.page.identity,
        "revision": session.document.revision,
        "places": places._asdict() | {"regions": [region._asdict() for region in places.regions]},
        "iterates": [_rounded(each) for each in session.iterates],
        "plans": [
            {"path": _rounded(each.path), "complete": each.is_complete, "facts": each.facts}
            for each in session.plans
        ],
    }


def _rounded(path: Array) -> list[list[float]]:
    return [[round(float(x), 4), round(float(y), 4)] for x, y in path]


class Desk:
    """Session with its worker process; ``draw`` returns the page of a document.

    Any thread may give commands; `step` must run in the main thread.
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

        ConflictError is raised if the page was made from another revision of the file; DataError as
        in `places_from`.
        """

        def put(data: object) -> object:
            answer, command = Future[object](), Command(name)
            if name != "cancel":
                values = data if isinstance(data, dict) else {}
                places, is_warm = places_from(values.get("places")), values.get("warm") is True
                command = Command(name, str(values.get("revision")), places, is_warm)
            self._commands.put((command, answer))
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
            signature = _signature(self.session.document.path)
            if signature != self._signature:
                self._signature = signature
                self._read_again()
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
        """Execute a command of the page: cancel, save, or plan."""
        if command.places is None:
            self.worker.cancel()
            self.worker.prepare()
            if self.session.phase == PLANNING:
                self.session = self.session.changed(phase=IDLE, line="cancelled")
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
            self.worker.start(PlanRequest(document.path, text, former, document.problem.trusted))
            line = "setting up the problem"
            self.session = session.changed(phase=PLANNING, line=line, error="", iterates=())

    def _read_again(self) -> None:
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
